"""Options of `tunenet-record --camera`, and the recording they ask for."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tunenet_logs.console import given, option
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.orders import Lasting, OfBall, Pictured, Sampled
from tunenet_logs.recorders.simulators.known import BALLS, Ball
from tunenet_logs.terminal import Progress

if TYPE_CHECKING:
    from tunenet_logs.recorders.camera.network import NetworkOptions
    from tunenet_logs.recorders.local_page import Preview
    from tunenet_logs.recorders.microphone import LiveSound


_of_camera = partial(option, group="camera")


@dataclass(frozen=True, kw_only=True)
class CameraOptions(OfBall, Pictured, Sampled, Lasting):
    """What a camera may be asked for; None leaves it as it is."""

    fps: float | None = _of_camera(
        "rate at which a video file was filmed (default: as its tags say)",
        limits=(1, 100_000, "Hz"),
    )
    stall_s: float = _of_camera(
        "end when a camera delivers nothing for so long [s] (default: 5)",
        5.0,
        limits=(0.1, 600, "s"),
    )
    wait_s: float = _of_camera(
        "for so long, try a network camera that is not there yet [s] (default: not)",
        0.0,
        limits=(0.1, 3600, "s"),
    )
    stamps: Literal["camera", "arrival"] = _of_camera(
        "when a live camera's pictures were taken: as it reports, else by a uniform "
        "clock fitted to their arrivals (default); or when they arrived",
        "camera",
        choices=("camera", "arrival"),
    )
    password_file: Path | None = _of_camera(
        "whose one line is the password of the user whom an http or rtsp address names "
        "(rtsp://USER@HOST/...), for that host alone (default: TUNENET_CAMERA_PASSWORD, then "
        "~/.netrc)",
        metavar="FILE",
        parse=Path,
    )
    fingerprint: str | None = _of_camera(
        "SHA-256 of the certificate that an https or rtsps camera shows, to believe that "
        "one (default: those that a known authority signed)",
        metavar="HEX",
    )
    insecure: bool = _of_camera("believe any certificate of an https or rtsps camera", False)
    rtsp_transport: str | None = _of_camera(
        "what an rtsp camera's packets come by (default: tcp, and udp where the camera "
        "refuses that)",
        choices=("tcp", "udp"),
    )
    exposure_ms: float | None = _of_camera(
        "of a plugged-in camera; 4 ms or less keeps a ball sharp (default: left alone)",
        limits=(0.1, 1000, "ms"),
    )
    white_balance_k: float | None = _of_camera(
        "of a plugged-in camera, locked [K] (default: left alone)", limits=(1000, 20_000, "K")
    )
    focus: float | None = _of_camera(
        "of a plugged-in camera, locked, in its own units (default: left alone)",
        metavar="N",
        limits=(0, 10_000, ""),
    )
    preview: bool = _of_camera(
        "show a live camera on a page of this machine, and record from there on",
        False,
    )
    microphone: str | None = option(
        "hear it beside a live camera: its number or a part of its name (default: the "
        "system's; one that is not there lists them), or a sound file to play in its place",
        group="microphone",
        metavar="NAME",
        alone="",
    )
    transcode: bool = _of_camera(
        "record a camera's video as JPEGs (default: H.264 and H.265 as they come)",
        False,
    )
    ball_diameter_m: float | None = _of_camera(
        "of the ball [m]; lets the frame rate be checked", limits=(0.001, 10, "m")
    )
    ball_mass_kg: float | None = _of_camera("of the ball [kg]", limits=(0.0001, 1000, "kg"))
    drop_height_m: float | None = _of_camera(
        "from the ball's underside to the table [m]", limits=(0.01, 1000, "m")
    )

    @property
    def rig(self) -> dict[str, float]:
        """What is known of ball and drop; what is measured overrides the table of balls."""
        known = BALLS.get(self.ball or "", Ball())
        diameter_m, mass_kg = self.ball_diameter_m, self.ball_mass_kg
        ball = Ball(
            known.diameter_m if diameter_m is None else diameter_m,
            known.mass_kg if mass_kg is None else mass_kg,
            known.drag_coefficient,
        )
        rig = {
            "ball_diameter_m": ball.diameter_m,
            "ball_mass_kg": ball.mass_kg,
            "drop_height_m": self.drop_height_m,
        }
        return {name: value for name, value in rig.items() if value is not None}


def record_camera_as_asked(arguments: argparse.Namespace, path: Path) -> str:
    """Record the camera; return the summary for the last line.

    Raises:
        TuneNetError: it cannot be opened, read or written.
    """
    from tunenet_logs.recorders.microphone import opened_microphone

    asked = CameraOptions(**given(arguments, CameraOptions))
    progress = Progress(quiet=arguments.quiet)
    with opened_microphone(asked.microphone, arguments.camera, progress.say) as microphone:
        return _recorded(arguments, asked, path, progress, microphone)


def _recorded(
    arguments: argparse.Namespace,
    asked: CameraOptions,
    path: Path,
    progress: Progress,
    microphone: LiveSound | None,
) -> str:
    from tunenet_logs.episode import EpisodeInfo
    from tunenet_logs.recorders.camera.device import Settings
    from tunenet_logs.recorders.camera.reconnecting import lasting_camera
    from tunenet_logs.recorders.camera.recording import Limits, record_camera
    from tunenet_logs.recorders.camera.sources import is_asked_again, open_source, shows_password
    from tunenet_logs.writing.owned_path import check_log_name

    limits = Limits(
        seconds=asked.seconds,
        stall_s=asked.stall_s,
        wait_s=asked.wait_s,
        min_free_bytes=round(arguments.min_free * 1e6),
        stamps=asked.stamps,
    )
    info = EpisodeInfo(kind="drop", rig=asked.rig, notes={"ball": asked.ball} if asked.ball else {})
    open_camera = partial(
        open_source,
        arguments.camera,
        settings=Settings(
            size=asked.size_px,
            rate_hz=asked.rate_hz,
            exposure_ms=asked.exposure_ms,
            white_balance_k=asked.white_balance_k,
            focus=asked.focus,
        ),
        filmed_hz=asked.fps,
        timeout_s=limits.stall_s,
        network=_network(asked, progress),
        transcode=asked.transcode,
    )
    if is_asked_again(arguments.camera):
        check_log_name(path, overwrite=arguments.overwrite)  # not after having waited
        source = lasting_camera(
            open_camera, wait_s=limits.wait_s, stall_s=limits.stall_s, say=progress.say
        )
    elif asked.wait_s:
        raise UsageError("--wait is for a camera in a network; leave it out")
    else:
        source = open_camera()
    if shows_password(arguments.camera):
        progress.say(
            "tunenet-record: the password in the address shows in the list of processes (ps); "
            "write it into a file for --password-file, or into ~/.netrc"
        )
    with _preview(source.live) if asked.preview else nullcontext() as preview:
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


def _network(asked: CameraOptions, progress: Progress) -> NetworkOptions:
    """Collect the network camera's options, with its password."""
    from tunenet_logs.passwords import read_password
    from tunenet_logs.recorders.camera.network import (
        PASSWORD_OPTION,
        PASSWORD_VARIABLE,
        NetworkOptions,
        Transport,
        Trust,
    )

    file = asked.password_file
    password = os.environ.get(PASSWORD_VARIABLE) or None
    if file is not None:
        password, is_public = read_password(file, PASSWORD_OPTION)
        if is_public:
            progress.say(f"tunenet-record: {file}: others can read this password; chmod 600 {file}")
    return NetworkOptions(
        Trust.of(asked.fingerprint, asked.insecure),
        Transport(asked.rtsp_transport) if asked.rtsp_transport else None,
        password,
        must_serve=file is not None,
    )


@contextmanager
def _preview(is_live: bool) -> Iterator[Preview]:
    if not is_live:
        raise UsageError("--preview is for a live camera; a video can be looked at as it is")
    from tunenet_logs.recorders.local_page import Preview

    preview = Preview()
    print(f"preview at {preview.url}", file=sys.stderr, flush=True)
    try:
        yield preview
    finally:
        preview.close()
