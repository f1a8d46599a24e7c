"""Options of `tunenet-record --camera`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

from tunenet_logs.console import option
from tunenet_logs.recorders.orders import Lasting, OfBall, Pictured, Sampled
from tunenet_logs.recorders.simulators.known import BALLS, UNKNOWN_BALL

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
    rtsp_transport: Literal["tcp", "udp"] | None = _of_camera(
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
        measured = {"diameter_m": self.ball_diameter_m, "mass_kg": self.ball_mass_kg}
        known = {name: value for name, value in measured.items() if value is not None}
        ball = replace(BALLS.get(self.ball or "", UNKNOWN_BALL), **known)
        rig = {
            "ball_diameter_m": ball.diameter_m,
            "ball_mass_kg": ball.mass_kg,
            "drop_height_m": self.drop_height_m,
        }
        return {name: value for name, value in rig.items() if value is not None}
