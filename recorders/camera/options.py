"""Command-line options of `tunenet-record --camera`, and the recording they ask for."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.console import number
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.known import BALLS, Ball
from tunenet_logs.terminal import Progress

if TYPE_CHECKING:
    from tunenet_logs.recorders.camera.network import NetworkOptions
    from tunenet_logs.recorders.local_page import Preview
    from tunenet_logs.recorders.microphone import LiveSound

_MAX_NAME = 100  # characters of a ball's or surface's name: it is one line of a log's notes


def camera_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options of cameras to a group."""
    add = group.add_argument
    return [
        add(
            "--fps",
            type=number(1, 100_000, "Hz"),
            metavar="HZ",
            help="rate at which a video file was filmed (default: as its tags say)",
        ),
        add(
            "--stall",
            type=number(0.1, 600, "s"),
            metavar="S",
            help="end when a camera delivers nothing for so long [s] (default: 5)",
        ),
        add(
            "--wait",
            type=number(0.1, 3600, "s"),
            metavar="S",
            help="for so long, try a network camera that is not there yet [s] (default: not)",
        ),
        add(
            "--stamps",
            choices=["camera", "arrival"],
            help="when a live camera's pictures were taken: as it reports, else by a uniform "
            "clock fitted to their arrivals (default); or when they arrived",
        ),
        add(
            "--password-file",
            type=Path,
            metavar="FILE",
            help="whose one line is the password of the user whom an http or rtsp address names "
            "(rtsp://USER@HOST/...), for that host alone (default: TUNENET_CAMERA_PASSWORD, then "
            "~/.netrc)",
        ),
        add(
            "--fingerprint",
            metavar="HEX",
            help="SHA-256 of the certificate that an https or rtsps camera shows, to believe that "
            "one (default: those that a known authority signed)",
        ),
        add(
            "--insecure",
            action="store_true",
            default=None,
            help="believe any certificate of an https or rtsps camera",
        ),
        add(
            "--rtsp-transport",
            choices=("tcp", "udp"),
            help="what an rtsp camera's packets come by (default: tcp, and udp where the camera "
            "refuses that)",
        ),
        add(
            "--exposure",
            type=number(0.1, 1000, "ms"),
            metavar="MS",
            help="of a plugged-in camera; 4 ms or less keeps a ball sharp (default: left alone)",
        ),
        add(
            "--white-balance",
            type=number(1000, 20_000, "K"),
            metavar="K",
            help="of a plugged-in camera, locked [K] (default: left alone)",
        ),
        add(
            "--focus",
            type=number(0, 10_000),
            metavar="N",
            help="of a plugged-in camera, locked, in its own units (default: left alone)",
        ),
        add(
            "--preview",
            action="store_true",
            default=None,
            help="show a live camera on a page of this machine, and record from there on",
        ),
        add(
            "--microphone",
            nargs="?",
            const="",
            metavar="NAME",
            help="hear it beside a live camera: its number or a part of its name (default: the "
            "system's; one that is not there lists them), or a sound file to play in its place",
        ),
        add(
            "--transcode",
            action="store_true",
            default=None,
            help="record a camera's video as JPEGs (default: H.264 and H.265 as they come)",
        ),
        add(
            "--ball",
            type=_name,
            metavar="NAME",
            help="which ball it is, for the log or the outcome; with its size and mass for "
            f"{', '.join(BALLS)}",
        ),
        add(
            "--ball-diameter",
            type=number(0.001, 10, "m"),
            metavar="M",
            help="of the ball [m]; lets the frame rate be checked",
        ),
        add("--ball-mass", type=number(0.0001, 1000, "kg"), metavar="KG", help="of the ball [kg]"),
        add(
            "--drop-height",
            type=number(0.01, 1000, "m"),
            metavar="M",
            help="from the ball's underside to the table [m]",
        ),
    ]


def record_camera_as_asked(arguments: argparse.Namespace, path: Path) -> str:
    """Record the camera; return the summary for the last line.

    Raises:
        TuneNetError: it cannot be opened, read or written.
    """
    from tunenet_logs.recorders.microphone import opened_microphone

    progress = Progress(quiet=arguments.quiet)
    with opened_microphone(arguments.microphone, arguments.camera, progress.say) as microphone:
        return _recorded(arguments, path, progress, microphone)


def _recorded(
    arguments: argparse.Namespace, path: Path, progress: Progress, microphone: LiveSound | None
) -> str:
    from tunenet_logs.episode import EpisodeInfo
    from tunenet_logs.recorders.camera.device import Settings
    from tunenet_logs.recorders.camera.reconnecting import lasting_camera
    from tunenet_logs.recorders.camera.recording import Limits, record_camera
    from tunenet_logs.recorders.camera.sources import is_asked_again, open_source, shows_password
    from tunenet_logs.writing.owned_path import check_log_name

    limits = Limits(
        seconds=arguments.seconds,
        stall_s=arguments.stall or Limits.stall_s,
        wait_s=arguments.wait or Limits.wait_s,
        min_free_bytes=round(arguments.min_free * 1e6),
        stamps=arguments.stamps or Limits.stamps,
    )
    settings = Settings(
        size=arguments.size,
        rate_hz=arguments.rate,
        exposure_ms=arguments.exposure,
        white_balance_k=arguments.white_balance,
        focus=arguments.focus,
    )
    ball = _ball(arguments)
    rig = {
        "ball_diameter_m": ball.diameter_m,
        "ball_mass_kg": ball.mass_kg,
        "drop_height_m": arguments.drop_height,
    }
    info = EpisodeInfo(
        kind="drop",
        rig={name: value for name, value in rig.items() if value is not None},
        notes={"ball": arguments.ball} if arguments.ball else {},
    )
    open_camera = partial(
        open_source,
        arguments.camera,
        settings=settings,
        filmed_hz=arguments.fps,
        timeout_s=limits.stall_s,
        network=_network(arguments, progress),
        transcode=bool(arguments.transcode),
    )
    if is_asked_again(arguments.camera):
        check_log_name(path, overwrite=arguments.overwrite)  # not after having waited
        source = lasting_camera(
            open_camera, wait_s=limits.wait_s, stall_s=limits.stall_s, say=progress.say
        )
    elif arguments.wait:
        raise UsageError("--wait is for a camera in a network; leave it out")
    else:
        source = open_camera()
    if shows_password(arguments.camera):
        progress.say(
            "tunenet-record: the password in the address shows in the list of processes (ps); "
            "write it into a file for --password-file, or into ~/.netrc"
        )
    with _preview(arguments, source.live) as preview:
        summary = record_camera(
            source,
            info,
            path,
            limits=limits,
            overwrite=arguments.overwrite,
            progress=progress,
            preview=preview,
            microphone=microphone,
        )
    return f"{source.name}; {summary.in_words('frames')}"


def _network(arguments: argparse.Namespace, progress: Progress) -> NetworkOptions:
    """Collect the network camera's options, with its password."""
    from tunenet_logs.passwords import read_password
    from tunenet_logs.recorders.camera.network import (
        PASSWORD_OPTION,
        PASSWORD_VARIABLE,
        NetworkOptions,
        Transport,
        Trust,
    )

    file = arguments.password_file
    password = os.environ.get(PASSWORD_VARIABLE) or None
    if file is not None:
        password, is_public = read_password(file, PASSWORD_OPTION)
        if is_public:
            progress.say(f"tunenet-record: {file}: others can read this password; chmod 600 {file}")
    return NetworkOptions(
        Trust.of(arguments.fingerprint, bool(arguments.insecure)),
        Transport(arguments.rtsp_transport) if arguments.rtsp_transport else None,
        password,
        must_serve=file is not None,
    )


def _ball(arguments: argparse.Namespace) -> Ball:
    """Return the ball's properties; measured values override the table of common balls."""
    known = BALLS.get(arguments.ball, Ball())
    diameter_m, mass_kg = arguments.ball_diameter, arguments.ball_mass
    return Ball(
        known.diameter_m if diameter_m is None else diameter_m,
        known.mass_kg if mass_kg is None else mass_kg,
        known.drag_coefficient,
    )


@contextmanager
def _preview(arguments: argparse.Namespace, is_live: bool) -> Iterator[Preview | None]:
    if not arguments.preview:
        yield None
        return
    if not is_live:
        raise UsageError("--preview is for a live camera; a video can be looked at as it is")
    from tunenet_logs.recorders.local_page import Preview

    preview = Preview()
    print(f"preview at {preview.url}", file=sys.stderr, flush=True)
    try:
        yield preview
    finally:
        preview.close()


def _name(text: str) -> str:
    if not text.strip() or not text.isprintable() or len(text) > _MAX_NAME:
        raise argparse.ArgumentTypeError(
            f"{text[:_MAX_NAME]!r} is not a name of 1 to {_MAX_NAME} printable characters"
        )
    return text
