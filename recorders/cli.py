"""Record an episode to a log: the entry point of `tunenet-record`.

Each simulated source comes first: its options, and the recording that they ask for. (The options
of cameras and outcomes are next door.) Then the command, which selects the source.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.console import Parser, number, run, size_px, whole
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.camera.options import camera_options, record_camera_as_asked
from tunenet_logs.recorders.outcome import outcome_options, record_outcome_as_asked
from tunenet_logs.recorders.ros2 import checked_topic
from tunenet_logs.recorders.simulators.arm.known import ARMS, DEFAULT
from tunenet_logs.recorders.simulators.known import engine_option, in_engine
from tunenet_logs.terminal import Progress, one_line, short_name

if TYPE_CHECKING:
    from tunenet_logs.recorders.simulated import DropOrder, FilmOrder, PayloadOrder


# ---- Simulated drop


def drop_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options of the simulated drop; None where they are not given."""
    add = group.add_argument
    return [
        add(
            "--restitution",
            type=number(0, 1),
            metavar="E",
            help="coefficient of restitution, 0 to 1 (default: drawn from .1 to .95; of a bounce "
            "shot from .5 to .85)",
        ),
        add(
            "--slope",
            type=number(-0.5, 0.5),
            metavar="P",
            help="how the restitution falls with an impact's speed: E (v / v_first)^-P, constant "
            "below .05 m/s (default: 0); of a bounce shot from the one at 3 m/s",
        ),
        add(
            "--drag",
            type=number(0, 2, "1/m"),
            metavar="K",
            help="of the air on the ball, its deceleration over speed squared [1/m]; a "
            "table-tennis ball has .13 (default: 0; of a bounce shot by its ball's size and mass)",
        ),
        add(
            "--height",
            type=number(0.01, 1000, "m"),
            metavar="M",
            help="drop height, from the ball's underside to the table [m] "
            "(default: drawn, .3 to 5; with --render .4 to 2); of a bounce shot, how far it falls "
            "to the plane (default: drawn from what the rig reaches)",
        ),
        add(
            "--radius",
            type=number(0.001, 10, "m"),
            metavar="M",
            help="of the ball [m] (default: .05; preset paper: .5)",
        ),
        add(
            "--hold",
            type=number(0, 600, "s"),
            metavar="S",
            help="hold the ball before letting go [s] (default: 0)",
        ),
        add(
            "--noise",
            type=number(0, 1, "m"),
            metavar="M",
            help="standard deviation of the sensor's noise [m] (default: 0)",
        ),
        add(
            "--render",
            action="store_true",
            default=None,
            help="film it: the log holds a camera's pictures instead of positions",
        ),
        *_film_options(group),
    ]


def _film_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options of `--render`."""
    add = group.add_argument
    return [
        add(
            "--camera-at",
            type=_point,
            metavar="X,Y,Z",
            help="where the camera stands [m]; the ball falls at 0,0 (default: drawn, as the "
            "paper does, in drop heights)",
        ),
        add(
            "--look-at",
            type=_point,
            metavar="X,Y,Z",
            help="what it looks at [m] (default: 0.44 drop heights over the table)",
        ),
        add(
            "--fov",
            type=number(1, 150, "degrees"),
            metavar="DEG",
            help="its field of view, from the upper to the lower edge (default: 60)",
        ),
        add(
            "--blur",
            type=number(0, 1000, "ms"),
            metavar="MS",
            help="how long its shutter is open [ms] (default: 0)",
        ),
        add(
            "--pixel-noise",
            type=number(0, 100),
            metavar="N",
            help="standard deviation of a pixel, of 255 (default: 2)",
        ),
        add(
            "--lost",
            type=number(0, 0.9),
            metavar="SHARE",
            help="share of the frames that are missing (default: 0)",
        ),
    ]


def record_drop_as_asked(arguments: argparse.Namespace, path: Path) -> str:
    """Record a simulated drop; return the summary for the last line.

    Raises:
        TuneNetError: a value is invalid, or the log cannot be written.
    """
    from tunenet_logs.recorders.session import record_episode
    from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
    from tunenet_logs.terminal import Progress

    given = {
        "restitution": arguments.restitution,
        "slope": arguments.slope,
        "drag_1_m": arguments.drag,
        "height_m": arguments.height,
        "radius_m": arguments.radius,
        "rate_hz": arguments.rate,
        "seconds": arguments.seconds,
        "hold_s": arguments.hold,
        "noise_m": arguments.noise,
        "preset": arguments.preset,
        "seed": arguments.seed,
    }
    order = DropOrder(**{name: value for name, value in given.items() if value is not None})
    if arguments.render:
        from tunenet_logs.recorders.simulated import film_drop

        episode = film_drop(order, _film_order(arguments, order))
    else:
        _refuse_film_options(arguments)
        episode = simulate_drop(order)
    progress = Progress(quiet=arguments.quiet)
    summary = record_episode(
        episode,
        path,
        overwrite=arguments.overwrite,
        progress=progress,
        min_free_bytes=round(arguments.min_free * 1e6),
    )
    truth, rig = episode.info.truth, episode.info.rig
    more = "".join(
        f"{words} {truth[name]:g}{unit}, "
        for name, words, unit in (("restitution_slope", "slope", ""), ("drag", "drag", " /m"))
        if truth.get(name)
    )
    return (
        f"restitution {truth['restitution']:.4f}, {more}"
        f"drop height {rig['drop_height_m']:.3f} m, by {episode.info.source}; "
        + summary.in_words("frames" if arguments.render else "samples")
    )


# Options that mean something to a camera alone: refused without --render.
_FILM_OPTIONS = ("camera_at", "look_at", "fov", "blur", "pixel_noise", "lost", "size")


def _refuse_film_options(arguments: argparse.Namespace) -> None:
    for name in _FILM_OPTIONS:
        if getattr(arguments, name) is not None:
            option = "--" + name.replace("_", "-")
            raise UsageError(f"{option} is for a drop that is filmed; add --render")


def _film_order(arguments: argparse.Namespace, order: DropOrder) -> FilmOrder:
    from tunenet_logs.recorders.simulated import FilmOrder
    from tunenet_logs.recorders.simulators.camera import PinholeCamera

    given = {
        "size_px": arguments.size,
        "fov_deg": arguments.fov,
        "noise": arguments.pixel_noise,
        "lost_share": arguments.lost,
        "exposure_s": None if arguments.blur is None else arguments.blur * 1e-3,
    }
    film = FilmOrder(**{name: value for name, value in given.items() if value is not None})
    if arguments.camera_at is None:
        if arguments.look_at is not None:
            raise UsageError("--look-at needs --camera-at: where does the camera stand?")
        return film
    target = arguments.look_at
    if target is None:
        if order.height_m is None:
            raise UsageError("--camera-at needs --look-at or --height: where is the drop?")
        target = (0.0, 0.0, 0.44 * order.height_m)
    return replace(
        film, camera=PinholeCamera(arguments.camera_at, target, film.size_px, film.fov_deg)
    )


def _point(text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != 3 or not all(abs(value) < 1e4 for value in values):
        raise argparse.ArgumentTypeError(f"{text!r} is not a point X,Y,Z in meters, such as 1,-2,1")
    return values


# ---- Simulated payload


def payload_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options of the simulated arm; None where they are not given."""
    add = group.add_argument
    return [
        add(
            "--mass",
            type=number(0, 20, "kg"),
            metavar="KG",
            help="of what the gripper holds [kg] (default: drawn from .1 to 1.5)",
        ),
        add(
            "--com",
            type=_com_offset,
            metavar="X,Y,Z",
            help="its centre of mass in the tool frame [m], x along the Jaco's gripper "
            "(default: 0,0,0)",
        ),
        add(
            "--empty",
            action="store_true",
            default=None,
            help="hold nothing: the tare of the run with the same --seed and options",
        ),
        add(
            "--path",
            metavar="PATH",
            help="circle (the paper's), random, or a CSV: time_s, then a column of rad for each "
            "joint (default: circle; of another arm than a Jaco with 7 joints random)",
        ),
        add(
            "--save-path",
            type=Path,
            metavar="CSV",
            help="write the path for a real arm, from rest to rest, 100 rows a second unless "
            "--rate, and record nothing",
        ),
        add("--arm", metavar="NAME", help=f"which: {', '.join(ARMS)} (default: {DEFAULT})"),
        add("--urdf", type=Path, metavar="FILE", help="any other serial arm"),
        add("--tool-link", metavar="NAME", help="the link of that file that holds the payload"),
        *_driver_options(group),
    ]


def _driver_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options that make ideal torques a real driver's."""
    add = group.add_argument
    return [
        add(
            "--driver",
            action="store_true",
            default=None,
            help="as a real arm's driver: all that follows, links 5 %% off, 65 messages a second "
            "with jitter and stale repeats (--rate 10: a slow one)",
        ),
        add(
            "--torque-noise",
            type=number(0, 100, "N·m"),
            metavar="NM",
            help="standard deviation of a torque [N·m] (default: 0; --driver: .2)",
        ),
        add(
            "--friction",
            type=number(0, 100, "N·m"),
            metavar="NM",
            help="of each joint, drawn: standard deviation of the viscous [N·m s/rad] and of "
            "Coulomb's [N·m] (default: 0; --driver: .5)",
        ),
        add(
            "--joint-offsets",
            type=number(0, 100, "N·m"),
            metavar="NM",
            help="drawn likewise, of each joint's torque [N·m] (default: 0; --driver: .3)",
        ),
        add(
            "--gain-error",
            type=number(0, 0.2),
            metavar="SHARE",
            help="drawn likewise (default: 0; --driver: .03)",
        ),
        add(
            "--lag",
            type=number(0, 1000, "ms"),
            metavar="MS",
            help="torques are those of so long ago [ms] (default: 0; --driver: drawn, 0 to 30)",
        ),
    ]


def record_payload_as_asked(arguments: argparse.Namespace, path: Path) -> str:
    """Record a simulated arm; return the summary for the last line.

    Raises:
        TuneNetError: a value is invalid, or the log cannot be written.
    """
    from tunenet_logs.recorders.session import record_episode
    from tunenet_logs.recorders.simulated import simulate_payload
    from tunenet_logs.terminal import Progress

    episode = simulate_payload(_payload_order(arguments))
    summary = record_episode(
        episode,
        path,
        overwrite=arguments.overwrite,
        progress=Progress(quiet=arguments.quiet),
        min_free_bytes=round(arguments.min_free * 1e6),
    )
    held = "no payload" if arguments.empty else f"{episode.info.truth['payload_mass']:.4f} kg"
    return f"{held}, by {episode.info.source}; {summary.in_words('samples')}"


def save_path_as_asked(arguments: argparse.Namespace) -> str:
    """Write the path for a real arm to follow; return the summary line.

    Raises:
        TuneNetError: as `record_payload_as_asked`.
    """
    from tunenet_logs.recorders.simulated import command_path
    from tunenet_logs.recorders.simulators.arm.path import write_path_file

    if arguments.output is not None:
        raise UsageError("--save-path records nothing; leave -o out")
    arm, path = command_path(_payload_order(arguments))
    write_path_file(
        arguments.save_path,
        arm.joint_names,
        path.seconds,
        path.position_rad,
        overwrite=arguments.overwrite,
    )
    return (
        f"{len(path.seconds)} rows, {path.seconds[-1]:.2f} s from rest to rest; bring the arm to "
        "the first row slowly before"
    )


def _payload_order(arguments: argparse.Namespace) -> PayloadOrder:
    from tunenet_logs.recorders.simulated import PayloadOrder

    if arguments.empty and (arguments.mass is not None or arguments.com is not None):
        raise UsageError("--empty holds nothing; leave --mass and --com out, or --empty")
    if arguments.size is not None:
        raise UsageError("--size is a picture's; it does not go with --simulate payload")
    given = {
        "mass_kg": arguments.mass,
        "com_m": arguments.com,
        "is_empty": arguments.empty,
        "path": arguments.path,
        "arm": arguments.arm,
        "urdf": arguments.urdf,
        "tool_link": arguments.tool_link,
        "rate_hz": arguments.rate,
        "seconds": arguments.seconds,
        "is_driver": arguments.driver,
        "torque_noise_nm": arguments.torque_noise,
        "friction_nm": arguments.friction,
        "offset_nm": arguments.joint_offsets,
        "gain_error": arguments.gain_error,
        "lag_s": None if arguments.lag is None else arguments.lag * 1e-3,
        "preset": arguments.preset,
        "seed": arguments.seed,
    }
    return PayloadOrder(**{name: value for name, value in given.items() if value is not None})


def _com_offset(text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != 3 or not all(abs(value) <= 1 for value in values):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not X,Y,Z in meters, each within 1, such as 0.02,0,0.01"
        )
    return values


# ---- Simulated bounce shot

# A flight between two impacts lasts some tenths of a second; a lower rate leaves few samples.
_MIN_SHOT_RATE_HZ = 50.0


def shot_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options of the bounce shot; None where they are not given."""
    add = group.add_argument
    return [
        add(
            "--rig",
            type=Path,
            metavar="FILE.yaml",
            help="plane, hoop and ball (default: the built-in rig; see tunenet-plan --save-rig)",
        ),
    ]


def record_shot_as_asked(arguments: argparse.Namespace, path: Path) -> str:
    """Record a simulated shot; return the summary for the last line.

    Raises:
        TuneNetError: a value is invalid, or the log cannot be written.
    """
    from tunenet_logs.recorders.session import record_episode
    from tunenet_logs.recorders.simulated import ShotOrder, simulate_shot
    from tunenet_logs.recorders.simulators.shot import ShotRig, read_rig
    from tunenet_logs.terminal import Progress

    for name, why in (("size", "a picture's"), ("seconds", "for what has no end of its own")):
        if getattr(arguments, name) is not None:
            raise UsageError(f"--{name} is {why}; it does not go with --simulate bounce-shot")
    if arguments.preset == "paper":
        raise UsageError("--preset paper is for drop and payload; leave it out")
    if arguments.rate is not None and arguments.rate < _MIN_SHOT_RATE_HZ:
        raise UsageError(f"--rate {arguments.rate:g} is too slow for a shot; 50 Hz or more")
    given = {
        "rig": ShotRig() if arguments.rig is None else read_rig(arguments.rig),
        "restitution": arguments.restitution,
        "slope": arguments.slope,
        "drag_1_m": arguments.drag,
        "height_m": arguments.height,
        "rate_hz": arguments.rate,
        "seed": arguments.seed,
    }
    episode = simulate_shot(
        ShotOrder(**{name: value for name, value in given.items() if value is not None})
    )
    summary = record_episode(
        episode,
        path,
        overwrite=arguments.overwrite,
        progress=Progress(quiet=arguments.quiet),
        min_free_bytes=round(arguments.min_free * 1e6),
    )
    truth, rig = episode.info.truth, episode.info.rig
    outcome = "through the hoop" if truth["success"] else "not through the hoop"
    return (
        f"restitution {truth['restitution']:.4f}, from {rig['shot_height_m']:.3f} m, {outcome}, by "
        f"{episode.info.source}; " + summary.in_words("samples")
    )


# ---- Joint states of a ROS 2 graph

_LAST_DOMAIN = 232  # of DDS: the ports of a higher domain's discovery would be over 65535
# More than any robot has: what is longer is a mistake in the command.
_MAX_TOPICS, _MAX_JOINTS = 16, 100


def ros2_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options of joint states."""
    add = group.add_argument
    return [
        add(
            "--joint-names",
            type=_joint_names,
            metavar="A,B,...",
            help="joints that must be there; of messages without names, theirs in order",
        ),
        add(
            "--domain",
            type=whole(0, _LAST_DOMAIN),
            metavar="N",
            help=f"ROS 2 domain, 0 to {_LAST_DOMAIN} (default: ROS_DOMAIN_ID, else 0)",
        ),
        add(
            "--loopback",
            action="store_true",
            default=None,
            help="stay on this machine (also where ROS_LOCALHOST_ONLY is 1)",
        ),
        add(
            "--timeout",
            type=number(0.1, 3600, "s"),
            metavar="S",
            help="end when a topic is not published or silent for so long [s] (default: 5)",
        ),
    ]


def record_joints_as_asked(arguments: argparse.Namespace, path: Path) -> str:
    """Record the topics; return the summary for the last line.

    Raises:
        TuneNetError: they cannot be received or written, or cyclonedds is not installed.
    """
    for option, value in (("--rate", arguments.rate), ("--size", arguments.size)):
        if value is not None:
            raise UsageError(f"{option} does not go with --joint-states; leave it out")
    topics = _topics(arguments.joint_states)
    domain = _domain_of_environment() if arguments.domain is None else arguments.domain
    try:
        import_module("cyclonedds")
    except ModuleNotFoundError as error:
        raise UsageError(
            "--joint-states needs cyclonedds; pip install 'tunenet-logs[ros2]'"
        ) from error
    from tunenet_logs.recorders.ros2.recording import JointOrder, record_joints

    order = JointOrder(
        topics=topics,
        joint_names=arguments.joint_names or (),
        seconds=arguments.seconds,
        timeout_s=arguments.timeout or JointOrder.timeout_s,
        domain=domain,
        is_loopback=bool(arguments.loopback) or os.environ.get("ROS_LOCALHOST_ONLY") == "1",
        min_free_bytes=round(arguments.min_free * 1e6),
    )
    summary = record_joints(
        order,
        path,
        overwrite=arguments.overwrite,
        progress=Progress(quiet=arguments.quiet),
        warn=_warn,
    )
    return f"{order.source}; {summary.in_words()}"


def _warn(text: str) -> None:
    print(one_line(f"tunenet-record: {text}"), file=sys.stderr, flush=True)


def _topics(words: list[str]) -> tuple[str, ...]:
    """Parse the topics, given once or several times, with commas or without."""
    named = [part for word in words for part in word.split(",") if part.strip()]
    topics = tuple(dict.fromkeys(checked_topic(part) for part in named))
    if not 0 < len(topics) <= _MAX_TOPICS:
        raise UsageError(f"--joint-states: {len(topics)} topics; name 1 to {_MAX_TOPICS}")
    return topics


def _domain_of_environment() -> int:
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
    try:
        return whole(0, _LAST_DOMAIN)(text)
    except argparse.ArgumentTypeError as error:
        raise UsageError(f"ROS_DOMAIN_ID: {error}; or give --domain") from error


def _joint_names(text: str) -> tuple[str, ...]:
    names = tuple(part.strip() for part in text.split(","))
    if not all(name and name.isprintable() for name in names) or len(names) > _MAX_JOINTS:
        raise argparse.ArgumentTypeError(
            f"{short_name(text)!r} is not a list of joints, such as joint_1,joint_2"
        )
    if len(set(names)) < len(names):
        raise argparse.ArgumentTypeError(f"{short_name(text)!r} names a joint twice")
    return names


# ---- Command

_DESCRIPTION = """\
Record an episode to an MCAP log: a real ball that is dropped before a camera or in a
video (--camera), or a simulated one (--simulate drop: PyBullet, with contact settings
in which the ball has the restitution that was set; --render films it); an arm's joints
and torques live from ROS 2 (--joint-states; no ROS installation is needed. With ROS 1:
rosbag record, then tune the bag), or simulated ones of an arm that holds something
(--simulate payload); or a simulated bounce shot off an inclined plane into a hoop
(--simulate bounce-shot). Ctrl-C ends a recording cleanly.

Or record what the hardware did with a shot (--outcome): a file of its own in the folder
of a campaign, whole or not there, for tunenet-review."""

_EXAMPLES = """\
  tunenet-record --camera                              (the first webcam, until Ctrl-C)
  tunenet-record --camera 2 --size 1280x720 --rate 60 --exposure 4 --seconds 8
  tunenet-record --camera 0 --microphone -o drop.mcap  (and what the bounces sound like)
  tunenet-record --camera drop.mp4 --ball-diameter 0.04 --drop-height 1
  tunenet-record --camera slow.mp4 --fps 240           (slow motion without a tag)
  tunenet-record --camera 192.168.1.20:8080/video --wait 60 -o drop.mcap     (a phone)
  tunenet-record --camera rtsp://user@192.168.1.21/stream1 --password-file camera.txt
  gst-launch-1.0 -q ... ! matroskamux streamable=true ! fdsink | tunenet-record --camera -
  tunenet-record --simulate drop --restitution 0.75 --height 1.2 -o drop.mcap
  tunenet-record --simulate drop --seed 7              (draws restitution and height)
  tunenet-record --simulate drop --rate 240 --noise 0.001 --hold 0.5 -o mocap.mcap
  tunenet-record --simulate drop --render --seed 7     (the same, filmed)
  tunenet-record --simulate drop --preset paper        (the paper's 60 Hz settings)
  tunenet-record --simulate payload --mass 0.6 -o payload.mcap
  tunenet-record --simulate payload --mass 0.6 --driver --seed 3 -o payload.mcap
  tunenet-record --simulate payload --empty --driver --seed 3 -o tare.mcap
  tunenet-record --simulate payload --save-path circle.csv  (for a real arm)
  tunenet-record --simulate bounce-shot --restitution 0.7 --height 0.335 -o shot.mcap
  tunenet-record --joint-states /joint_states --seconds 10 -o held.mcap
  tunenet-record --joint-states /arm/out/joint_state,/arm/out/joint_torques
  tunenet-record --outcome success --ball "red gel" --shot-height 0.62 -o campaign/
  tunenet-record --outcome failure --ball racquetball --reason short --miss 0.04 \\
      --tuning campaign/drop_3.json -o campaign/"""

# The option of each source, as errors name it.
_SOURCES = {
    "camera": "--camera",
    "drop": "--simulate drop",
    "payload": "--simulate payload",
    "bounce_shot": "--simulate bounce-shot",
    "joints": "--joint-states",
    "outcome": "--outcome",
}

# What a log's name begins with, where that is not its source.
_NAME_STEMS = {"camera": "drop", "bounce_shot": "shot"}

# Options of a drop that a bounce shot has, too.
_OF_SHOTS_TOO = ("restitution", "slope", "drag", "height")


def build_parser() -> Parser:
    """Build the command's parser; `..._only` are the options of one source alone."""
    parser = Parser(
        "tunenet-record",
        _DESCRIPTION,
        _EXAMPLES,
        failed="nothing, or not all of it, could be recorded",
        ended="done, a recording that Ctrl-C ends too",
    )
    source = parser.add_argument_group("source, one of").add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--camera",
        nargs="?",
        const="0",
        metavar="SOURCE",
        help="a camera's number or /dev/... path (default: 0); an http, https, rtsp, rtsps, tcp or "
        "udp address; a video file, with its sound; or - for what another program writes (sound "
        "alone needs no recording: tunenet-tune bounce.wav)",
    )
    source.add_argument(
        "--simulate", choices=["drop", "payload", "bounce-shot"], help="what to simulate"
    )
    source.add_argument(
        "--joint-states",
        action="append",
        metavar="TOPIC",
        help="a ROS 2 topic of JointState or Kinova's JointAngles; several with commas",
    )
    source.add_argument(
        "--outcome", choices=["success", "failure"], help="how an attempt of the hardware ended"
    )
    _shared_options(parser.add_argument_group("shared"))
    camera = camera_options(parser.add_argument_group("camera"))
    simulated = _simulated_options(parser.add_argument_group("simulated"))
    drop = drop_options(parser.add_argument_group("simulated drop"))
    payload = payload_options(parser.add_argument_group("simulated payload"))
    shot = shot_options(parser.add_argument_group("simulated bounce shot"))
    joints = ros2_options(parser.add_argument_group("joint states"))
    outcome = outcome_options(parser.add_argument_group("outcome"))
    ball = [action for action in camera if action.dest == "ball"]
    parser.set_defaults(
        camera_only=camera,
        simulated_only=simulated,
        drop_only=drop,
        payload_only=payload,
        bounce_shot_only=[
            *shot,
            *(action for action in drop if action.dest in _OF_SHOTS_TOO),
        ],
        joints_only=joints,
        outcome_only=[*outcome, *ball],
    )
    return parser


def _shared_options(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    add(
        "-o",
        "--output",
        type=Path,
        metavar="LOG",
        help="log to write (default: drop_DATE_TIME.mcap, or payload_..., shot_..., joints_...), "
        "or the folder of a campaign of outcomes (default: here)",
    )
    add(
        "--rate",
        type=number(10, 10_000, "Hz"),
        metavar="HZ",
        help="samples a second (default: 60), or frames a second asked of a plugged-in camera",
    )
    add(
        "--seconds",
        type=number(0.1, 600, "s"),
        metavar="S",
        help="how long; simulated, after the release (default: 400/60, the paper's; payload: 5; "
        "a camera, joints: until they end or Ctrl-C)",
    )
    add(
        "--size",
        type=size_px,
        metavar="WxH",
        help="of the picture [px], of a plugged-in camera or a rendered one (there: 320x240)",
    )
    add(
        "--min-free",
        type=number(0, 1e9, "MB"),
        default=100.0,
        metavar="MB",
        help="end, with a whole log, before the disk has less left [MB] (default: 100; 0: never)",
    )
    add("--overwrite", action="store_true", help="replace an existing log")
    add("--quiet", action="store_true", help="no progress bar")


def _simulated_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options of all simulated sources; None where they are not given."""
    return [
        group.add_argument(
            "--seed",
            type=whole(0, 2**32 - 1),
            metavar="N",
            help="for what is drawn: restitution, height, noise, camera; mass, path, what a "
            "driver does (default: 0)",
        ),
        group.add_argument(
            "--preset",
            choices=["default", "paper"],
            help="as in the paper: PyBullet's own contact settings at 60 Hz, or an arm under "
            "position control at 240 Hz",
        ),
        engine_option(group),
    ]


def _check_log_name(parser: Parser, path: Path | None) -> None:
    """Refuse a name that is not a log's; a folder's errors come later."""
    if path is not None and path.suffix != ".mcap" and not path.is_dir():
        name = path.with_suffix(".mcap")
        parser.error(f"-o {str(path)!r}: what is written is MCAP; name it {name}")


def _refuse_what_is_others(parser: Parser, arguments: argparse.Namespace, source: str) -> None:
    others = _SOURCES.keys() - {source}
    own = getattr(arguments, f"{source}_only")
    if arguments.simulate is None:
        others |= {"simulated"}
    for other in sorted(others):
        for action in getattr(arguments, f"{other}_only"):
            if action not in own and getattr(arguments, action.dest) is not None:
                name = action.option_strings[0]
                parser.error(f"{name} does not go with {_SOURCES[source]}; leave it out")


def _source(arguments: argparse.Namespace) -> str:
    if arguments.camera is not None:
        return "camera"
    if arguments.simulate is not None:
        return arguments.simulate.replace("-", "_")
    return "outcome" if arguments.outcome else "joints"


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet-record`."""
    parser = build_parser()

    def record(arguments: argparse.Namespace) -> int:
        source = _source(arguments)
        _refuse_what_is_others(parser, arguments, source)
        if source == "outcome":
            print(one_line(record_outcome_as_asked(arguments)))
            return 0
        _check_log_name(parser, arguments.output)
        if arguments.save_path is not None:
            print(one_line(f"{arguments.save_path}: {save_path_as_asked(arguments)}"))
            return 0
        record_as_asked = {
            "camera": record_camera_as_asked,
            "drop": record_drop_as_asked,
            "payload": record_payload_as_asked,
            "bounce_shot": record_shot_as_asked,
            "joints": record_joints_as_asked,
        }[source]
        what = _NAME_STEMS.get(source, source)
        path = arguments.output or Path(f"{what}_{datetime.now():%Y%m%d_%H%M%S}.mcap")
        print(one_line(f"{path}: {record_as_asked(arguments, path)}"))
        return 0

    return run(parser, in_engine(record), argv)


if __name__ == "__main__":
    sys.exit(main())
