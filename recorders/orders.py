"""What a recorder may be asked for: each field is an option of `tunenet-record` and of Python.

Nothing heavy is imported, for `--help`. The options of a camera and of outcomes are in
`camera/options.py` and `outcome.py`.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.console import numbers, option, printable, size_px
from tunenet_logs.recorders.simulators.arm.known import ARMS, DEFAULT
from tunenet_logs.recorders.simulators.known import BALLS
from tunenet_logs.terminal import short_name

if TYPE_CHECKING:
    from tunenet_logs.recorders.simulators.camera import PinholeCamera
    from tunenet_logs.recorders.simulators.shot import ShotRig

_LAST_DOMAIN = 232  # of DDS: the ports of a higher domain's discovery would be over 65535
_place = numbers(3, -1e4, 1e4, "a point X,Y,Z in meters, such as 1,-2,1")


def _joint_names(text: str) -> tuple[str, ...]:
    names = tuple(part.strip() for part in text.split(","))
    # No robot has over 100: what is longer is a mistake in the command.
    if not all(name and name.isprintable() for name in names) or len(names) > 100:
        raise argparse.ArgumentTypeError(
            f"{short_name(text)!r} is not a list of joints, such as joint_1,joint_2"
        )
    if len(set(names)) < len(names):
        raise argparse.ArgumentTypeError(f"{short_name(text)!r} names a joint twice")
    return names


# ---- Options that several sources have

_simulated = partial(option, group="simulate")
_filmed = partial(option, group="simulate:the same drop filmed")
_of_arm = partial(option, group="arm")
_of_ros2 = partial(option, group="ros2")


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """How often it is sampled."""

    rate_hz: float | None = option(
        "samples, or a camera's frames, a second (default: 60)", limits=(10, 10_000, "Hz")
    )


@dataclass(frozen=True, kw_only=True)
class Lasting:
    """How long it lasts."""

    seconds: float | None = option(
        "how long (default: 400/60 after a simulated release, the paper's; payload: 5; a camera, "
        "joints: until they end or Ctrl-C)",
        limits=(0.1, 600, "s"),
    )


@dataclass(frozen=True, kw_only=True)
class Pictured:
    """What its pictures are like."""

    size_px: tuple[int, int] | None = option(
        "of the picture [px], of a plugged-in camera or a rendered one (there: 320x240)",
        flag="--size",
        group="camera",
        metavar="WxH",
        parse=size_px,
    )


@dataclass(frozen=True, kw_only=True)
class OfBall:
    """Which ball it is."""

    ball: str | None = option(
        "which ball it is, for the log or the outcome; with its size and mass for "
        f"{', '.join(BALLS)}",
        group="camera",
        metavar="NAME",
        parse=printable(100, "a name"),  # it is one line of a log's notes
    )


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """What is drawn, and as whose."""

    preset: str = _simulated(
        "as in the paper: PyBullet's own contact settings at 60 Hz, or an arm under "
        "position control at 240 Hz",
        "default",
        choices=("default", "paper"),
    )
    seed: int = _simulated(
        "for what is drawn: restitution, height, noise, camera; mass, path, what a "
        "driver does (default: 0)",
        0,
        metavar="N",
        limits=(0, 2**32 - 1, ""),
        is_whole=True,
    )


@dataclass(frozen=True, kw_only=True)
class Bouncing:
    """A ball that falls and bounces."""

    restitution: float | None = _simulated(
        "coefficient of restitution at the first impact, 0 to 1 (default: drawn from .1 to .95; of "
        "a bounce shot from .5 to .85)",
        metavar="E",
        limits=(0, 1, ""),
    )
    slope: float = _simulated(
        "how the restitution falls with an impact's speed: E (v / v_first)^-P, constant "
        "below .05 m/s (default: 0); of a bounce shot from the one at 3 m/s",
        0.0,
        metavar="P",
        limits=(-0.5, 0.5, ""),
    )
    drag_1_m: float | None = _simulated(
        "of the air on the ball, its deceleration over speed squared [1/m]; a "
        "table-tennis ball has .13 (default: 0; of a bounce shot by its ball's size and mass)",
        metavar="K",
        limits=(0, 2, "1/m"),
    )
    height_m: float | None = _simulated(
        "drop height, from the ball's underside to the table [m] "
        "(default: drawn, .3 to 5; with --render .4 to 2); of a bounce shot, how far it falls "
        "to the plane (default: drawn from what the rig reaches)",
        limits=(0.01, 1000, "m"),
    )


# ---- Simulated episodes


@dataclass(frozen=True, kw_only=True)
class DropOrder(Simulated, Sampled, Lasting, Bouncing):
    """A drop to simulate; None is drawn from the seed or left to the preset."""

    drag_1_m: float = 0.0
    radius_m: float | None = _simulated(
        "of the ball [m] (default: .05; preset paper: .5)", limits=(0.001, 10, "m")
    )
    hold_s: float = _simulated(
        "hold the ball before letting go [s] (default: 0)", 0.0, limits=(0, 600, "s")
    )
    noise_m: float = _simulated(
        "standard deviation of the sensor's noise [m] (default: 0)", 0.0, limits=(0, 1, "m")
    )


@dataclass(frozen=True)
class FilmOrder(Pictured):
    """How to film a drop; a camera is drawn from the seed where none is given."""

    camera: PinholeCamera | None = None
    size_px: tuple[int, int] = (320, 240)
    fov_deg: float = _filmed(
        "its field of view, from the upper to the lower edge (default: 60)",
        60.0,
        metavar="DEG",
        limits=(1, 150, "degrees"),
    )
    exposure_s: float = _filmed(
        "how long its shutter is open, centred on a frame's stamp [ms] (default: 0)",
        0.0,
        flag="--blur",
        limits=(0, 1000, "ms"),
        factor=1e-3,
    )
    noise: float = _filmed(
        "standard deviation of a pixel, of 255 (default: 2)",
        2.0,
        flag="--pixel-noise",
        metavar="N",
        limits=(0, 100, ""),
    )
    lost_share: float = _filmed(
        "share of the frames that are missing (default: 0)",
        0.0,
        flag="--lost",
        metavar="SHARE",
        limits=(0, 0.9, ""),
    )
    camera_at: tuple[float, float, float] | None = _filmed(
        "where the camera stands [m]; the ball falls at 0,0 (default: drawn, as the "
        "paper does, in drop heights)",
        metavar="X,Y,Z",
        parse=_place,
    )
    look_at: tuple[float, float, float] | None = _filmed(
        "what it looks at [m] (default: 0.44 drop heights over the table)",
        metavar="X,Y,Z",
        parse=_place,
    )


@dataclass(frozen=True, kw_only=True)
class PayloadOrder(Simulated, Sampled, Lasting):
    """An arm's run to simulate; None is drawn from the seed or left to other fields."""

    mass_kg: float | None = _of_arm(
        "of what the gripper holds [kg] (default: drawn from .1 to 1.5)", limits=(0, 20, "kg")
    )
    com_m: tuple[float, float, float] = _of_arm(
        "its centre of mass in the tool frame [m], x along the Jaco's gripper (default: 0,0,0)",
        (0.0, 0.0, 0.0),
        flag="--com",
        metavar="X,Y,Z",
        parse=numbers(3, -1, 1, "X,Y,Z in meters, each within 1, such as 0.02,0,0.01"),
    )
    is_empty: bool = _of_arm(
        "hold nothing: the tare of the run with the same --seed and options", False
    )
    path: str | None = _of_arm(
        "circle (the paper's), random, or a CSV: time_s, then a column of rad for each "
        "joint (default: circle; of another arm than a Jaco with 7 joints random)",
        metavar="PATH",
    )
    arm: str | None = _of_arm(f"which: {', '.join(ARMS)} (default: {DEFAULT})", metavar="NAME")
    urdf: Path | None = _of_arm("any other serial arm", metavar="FILE", parse=Path)
    tool_link: str | None = _of_arm("the link of that file that holds the payload", metavar="NAME")
    is_driver: bool = _of_arm(
        "as a real arm's driver: all that follows, links 5 % off, 65 messages a second "
        "with jitter and stale repeats (--rate 10: a slow one)",
        False,
    )
    torque_noise_nm: float | None = _of_arm(
        "standard deviation of a torque [N·m] (default: 0; --driver: .2)", limits=(0, 100, "N·m")
    )
    friction_nm: float | None = _of_arm(
        "of each joint, drawn: standard deviation of the viscous [N·m s/rad] and of "
        "Coulomb's [N·m] (default: 0; --driver: .5)",
        limits=(0, 100, "N·m"),
    )
    offset_nm: float | None = _of_arm(
        "drawn likewise, of each joint's torque [N·m] (default: 0; --driver: .3)",
        flag="--joint-offsets",
        limits=(0, 100, "N·m"),
    )
    gain_error: float | None = _of_arm(
        "drawn likewise (default: 0; --driver: .03)", metavar="SHARE", limits=(0, 0.2, "")
    )
    lag_s: float | None = _of_arm(
        "torques are those of so long ago [ms] (default: 0; --driver: drawn, 0 to 30)",
        limits=(0, 1000, "ms"),
        factor=1e-3,
    )


@dataclass(frozen=True, kw_only=True)
class ShotOrder(Simulated, Sampled, Bouncing):
    """A bounce shot to simulate; None is drawn from the seed."""

    rig: ShotRig | Path | None = _simulated(
        "plane, hoop and ball (default: the built-in rig; see tunenet-plan --save-rig)",
        metavar="FILE.yaml",
        parse=Path,
    )
    rate_hz: float = 240.0


# ---- Joint states of a ROS 2 graph


@dataclass(frozen=True, kw_only=True)
class JointOrder(Lasting):
    """Joint states to record."""

    topics: tuple[str, ...] = ()  # as ROS 2 writes them
    joint_names: tuple[str, ...] = _of_ros2(
        "joints that must be there; of messages without names, theirs in order",
        (),
        metavar="A,B,...",
        parse=_joint_names,
    )
    domain: int = _of_ros2(
        f"ROS 2 domain, 0 to {_LAST_DOMAIN} (default: ROS_DOMAIN_ID, else 0)",
        0,
        metavar="N",
        limits=(0, _LAST_DOMAIN, ""),
        is_whole=True,
    )
    is_loopback: bool = _of_ros2("stay on this machine (also where ROS_LOCALHOST_ONLY is 1)", False)
    timeout_s: float = _of_ros2(
        "end when a topic is not published or silent for so long [s] (default: 5)",
        5.0,
        limits=(0.1, 3600, "s"),
    )
    min_free_bytes: int = 0  # space to leave free on the disk; 0 for no such bound

    @property
    def source(self) -> str:
        """The topics, in words."""
        return f"ros2 {', '.join(self.topics)}"
