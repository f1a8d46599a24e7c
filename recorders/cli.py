"""Record an episode to a log: the entry point of `tunenet-record`.

`orders` and its neighbours say what each source may be asked for. Here are the command, which
selects the source, and the recordings that a simulation or ROS 2 is asked for.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.console import Parser, Topic, add_options, given, number, options_in, run, whole
from tunenet_logs.errors import UsageError, pip_install
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.orders import DropOrder, FilmOrder, JointOrder, PayloadOrder, ShotOrder
from tunenet_logs.recorders.outcome import OutcomeOptions, record_outcome_as_asked
from tunenet_logs.recorders.ros2 import checked_topic
from tunenet_logs.recorders.simulators.known import engine_option, in_engine
from tunenet_logs.terminal import Progress, one_line

if TYPE_CHECKING:
    from tunenet_logs.episode import Episode
    from tunenet_logs.recorders.simulators.arm.description import Arm


@dataclass(frozen=True)
class _Source:
    """What is recorded."""

    flag: str  # the option that asks for it, as errors name it
    stem: str  # what a log's name begins with
    kinds: tuple[type, ...]  # dataclasses of its options
    is_simulated: bool = False  # whether it has the options of all simulations

    @property
    def names(self) -> set[str]:
        """Its options."""
        names = {name for kind in self.kinds for name in options_in(kind)}
        return names | {"engine"} if self.is_simulated else names


_SOURCES = {
    "camera": _Source("--camera", "drop", (CameraOptions,)),
    "drop": _Source("--simulate drop", "drop", (DropOrder, FilmOrder), is_simulated=True),
    "payload": _Source("--simulate payload", "payload", (PayloadOrder,), is_simulated=True),
    "bounce-shot": _Source("--simulate bounce-shot", "shot", (ShotOrder,), is_simulated=True),
    "joints": _Source("--joint-states", "joints", (JointOrder,)),
    "outcome": _Source("--outcome", "", (OutcomeOptions,)),
}


# ---- What a simulation or ROS 2 is asked for; each returns the summary for the last line


def _record_camera(arguments: argparse.Namespace, path: Path) -> str:
    from tunenet_logs.recorders.camera.recording import record_camera_as_asked

    return record_camera_as_asked(arguments, path)


def _record_drop(arguments: argparse.Namespace, path: Path) -> str:
    from tunenet_logs.recorders.simulated import film_drop, simulate_drop

    order, film = DropOrder(**given(arguments, DropOrder)), given(arguments, FilmOrder)
    if arguments.render:
        episode = film_drop(order, FilmOrder(**film))
    elif film:
        name = next(iter(film))
        flag = options_in(FilmOrder)[name].flag_of(name)
        raise UsageError(f"{flag} is for a drop that is filmed; add --render")
    else:
        episode = simulate_drop(order)
    written = _written(episode, path, arguments, "frames" if arguments.render else "samples")
    truth, height_m = episode.info.truth, episode.info.rig["drop_height_m"]
    more = f"slope {truth['restitution_slope']:g}, " if truth.get("restitution_slope") else ""
    more += f"drag {truth['drag']:g} /m, " if truth.get("drag") else ""
    return f"restitution {truth['restitution']:.4f}, {more}drop height {height_m:.3f} m, {written}"


def _record_payload(arguments: argparse.Namespace, path: Path) -> str:
    from tunenet_logs.recorders.simulated import ordered_arm, simulate_payload

    order = _payload_order(arguments)
    episode = simulate_payload(order)
    written = _written(episode, path, arguments, "samples", ordered_arm(order))
    held = "no payload" if arguments.is_empty else f"{episode.info.truth['payload_mass']:.4f} kg"
    return f"{held}, {written}"


def _save_path(arguments: argparse.Namespace) -> str:
    """Write the path for a real arm to follow; return the summary line."""
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
    if arguments.is_empty and (arguments.mass_kg is not None or arguments.com_m is not None):
        raise UsageError("--empty holds nothing; leave --mass and --com out, or --empty")
    return PayloadOrder(**given(arguments, PayloadOrder))


def _record_shot(arguments: argparse.Namespace, path: Path) -> str:
    from tunenet_logs.recorders.simulated import simulate_shot

    order = ShotOrder(**given(arguments, ShotOrder))
    if order.preset == "paper":
        raise UsageError("--preset paper is for drop and payload; leave it out")
    if order.rate_hz < 50.0:  # a flight between two impacts lasts some tenths of a second
        raise UsageError(f"--rate {order.rate_hz:g} is too slow for a shot; 50 Hz or more")
    episode = simulate_shot(order)
    written = _written(episode, path, arguments, "samples")
    truth, height_m = episode.info.truth, episode.info.rig["shot_height_m"]
    outcome = "through the hoop" if truth["success"] else "not through the hoop"
    return f"restitution {truth['restitution']:.4f}, from {height_m:.3f} m, {outcome}, {written}"


def _written(
    episode: Episode,
    path: Path,
    arguments: argparse.Namespace,
    what: str,
    arm: Arm | None = None,
) -> str:
    """Record a simulated episode, and say by what engine and how much."""
    from tunenet_logs.recorders.session import record_episode

    summary = record_episode(
        episode,
        path,
        overwrite=arguments.overwrite,
        progress=Progress(quiet=arguments.quiet),
        min_free_bytes=round(arguments.min_free * 1e6),
        arm=arm,
    )
    return f"by {episode.info.source}; {summary.in_words(what)}"


def _record_joints(arguments: argparse.Namespace, path: Path) -> str:
    # Topics are given once or several times, with commas or without.
    named = [part for one in arguments.joint_states for part in one.split(",") if part.strip()]
    topics = tuple(dict.fromkeys(checked_topic(part) for part in named))
    if not 0 < len(topics) <= 16:  # more than any robot has
        raise UsageError(f"--joint-states: {len(topics)} topics; name 1 to 16")
    asked = given(arguments, JointOrder)
    if "domain" not in asked:
        text = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
        low, high, _ = options_in(JointOrder)["domain"].limits or (0, 0, "")
        try:
            asked["domain"] = whole(int(low), int(high))(text)
        except argparse.ArgumentTypeError as error:
            raise UsageError(f"ROS_DOMAIN_ID: {error}; or give --domain") from error
    if os.environ.get("ROS_LOCALHOST_ONLY") == "1":
        asked["is_loopback"] = True
    try:
        import_module("cyclonedds")
    except ModuleNotFoundError as error:
        raise UsageError(f"--joint-states needs cyclonedds; {pip_install('ros2')}") from error
    from tunenet_logs.recorders.ros2.recording import record_joints

    order = JointOrder(topics=topics, min_free_bytes=round(arguments.min_free * 1e6), **asked)
    summary = record_joints(
        order,
        path,
        overwrite=arguments.overwrite,
        progress=Progress(quiet=arguments.quiet),
        warn=lambda text: print(one_line(f"tunenet-record: {text}"), file=sys.stderr, flush=True),
    )
    return f"{order.source}; {summary.in_words()}"


# ---- Command

_DESCRIPTION = """\
Record an episode to an MCAP log: a ball dropped before a camera or in a video, an arm's
joints and torques live from ROS 2, a simulated drop, payload or bounce shot; or what the
hardware did with a shot. Ctrl-C ends a recording cleanly."""
_EXAMPLES = """\
  tunenet-record --camera                              (the first webcam, until Ctrl-C)
  tunenet-record --simulate drop --seed 7              (draws restitution and height)
  tunenet-record --joint-states /joint_states --seconds 10 -o held.mcap"""
TOPICS = {
    "camera": Topic(
        "a ball before a camera, in a network or a video file",
        """\
  tunenet-record --camera drop.mp4 -o drop.mcap
  tunenet-record --camera 2 --size 1280x720 --rate 60 --exposure 4 --seconds 8
  tunenet-record --camera drop.mp4 --ball-diameter 0.04 --drop-height 1
  tunenet-record --camera slow.mp4 --fps 240           (slow motion without a tag)
  tunenet-record --camera 192.168.1.20:8080/video --wait 60 -o drop.mcap     (a phone)
  tunenet-record --camera rtsp://user@192.168.1.21/stream1 --password-file camera.txt
  gst-launch-1.0 -q ... ! matroskamux streamable=true ! fdsink | tunenet-record --camera -""",
    ),
    "microphone": Topic(
        "what the bounces sound like, beside a camera",
        """\
  tunenet-record --camera 0 --microphone -o drop.mcap
  tunenet-tune bounce.wav                              (sound alone needs no recording)""",
    ),
    "simulate": Topic(
        "a simulated drop, or a bounce shot",
        """\
  tunenet-record --simulate drop --restitution 0.75 --height 1.2 -o drop.mcap
  tunenet-record --simulate drop --rate 240 --noise 0.001 --hold 0.5 -o mocap.mcap
  tunenet-record --simulate drop --render --seed 7     (the same, filmed)
  tunenet-record --simulate drop --preset paper        (the paper's 60 Hz settings)
  tunenet-record --simulate bounce-shot --restitution 0.7 --height 0.335 -o shot.mcap""",
    ),
    "arm": Topic(
        "a simulated arm that holds something",
        """\
  tunenet-record --simulate payload --mass 0.6 -o payload.mcap
  tunenet-record --simulate payload --mass 0.6 --driver --seed 3 -o payload.mcap
  tunenet-record --simulate payload --empty --driver --seed 3 -o tare.mcap
  tunenet-record --simulate payload --save-path circle.csv  (for a real arm)""",
    ),
    "ros2": Topic(
        "a real arm's joints and torques, live (of ROS 1: rosbag record, then tune the bag)",
        """\
  tunenet-record --joint-states /joint_states --seconds 10 -o held.mcap
  tunenet-record --joint-states /arm/out/joint_state,/arm/out/joint_torques""",
    ),
    "outcome": Topic(
        "what the hardware did with a shot: a file in a campaign's folder",
        """\
  tunenet-record --outcome success --ball "red gel" --shot-height 0.62 -o campaign/
  tunenet-record --outcome failure --ball racquetball --reason short --miss 0.04 \\
      --tuning campaign/drop_3.json -o campaign/""",
    ),
}


def build_parser() -> Parser:
    """Build the command's parser."""
    parser = Parser(
        "tunenet-record",
        _DESCRIPTION,
        _EXAMPLES,
        failed="nothing, or not all of it, could be recorded",
        ended="done, a recording that Ctrl-C ends too",
        called="SOURCE [-o LOG] [options]",
        topics=TOPICS,
    )
    source = parser.add_argument_group("source, one of").add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--camera",
        nargs="?",
        const="0",
        metavar="SOURCE",
        help="a camera's number or /dev/... path (default: 0); an http, https, rtsp, rtsps, tcp or "
        "udp address; a video file; or - for what another program writes",
    )
    source.add_argument(
        "--list-cameras",
        action="store_true",
        help="list what is plugged in, with pictures",
    )
    source.add_argument(
        "--simulate", choices=["drop", "payload", "bounce-shot"], help="what to simulate"
    )
    source.add_argument(
        "--joint-states",
        action="append",
        metavar="TOPIC",
        help="a ROS 2 topic of JointState; several with commas",
    )
    source.add_argument(
        "--outcome", choices=["success", "failure"], help="how an attempt of the hardware ended"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="LOG",
        help="log to write (default: such as drop_DATE_TIME.mcap), or the folder of a campaign "
        "of outcomes (default: here)",
    )
    parser.topic("simulate")  # its own options come first
    parser.place(options_in(FilmOrder)["fov_deg"].group).add_argument(
        "--render",
        action="store_true",
        default=None,
        help="film it: the log holds a camera's pictures instead of positions",
    )
    for one in _SOURCES.values():
        for kind in one.kinds:
            add_options(kind, parser.place)
    engine_option(parser.topic("simulate"))
    parser.topic("arm").add_argument(
        "--save-path",
        type=Path,
        metavar="CSV",
        help="write the path for a real arm, from rest to rest, 100 rows a second unless "
        "--rate, and record nothing",
    )
    parser.topic("camera").add_argument(
        "--min-free",
        type=number(0, 1e9, "MB"),
        default=100.0,
        metavar="MB",
        help="end any recording, with a whole log, before the disk has less left [MB] (default: "
        "100; 0: never)",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an existing log")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet-record`."""
    parser = build_parser()

    def record(arguments: argparse.Namespace) -> int:
        if arguments.list_cameras:
            from tunenet_logs.recorders.camera.device import list_cameras

            print("\n".join(map(one_line, list_cameras())))
            return 0
        path, source = arguments.output, arguments.simulate or "joints"
        if arguments.camera is not None or arguments.outcome:
            source = "outcome" if arguments.outcome else "camera"
        # Refuse options that the source does not have.
        own = _SOURCES[source].names | {"drop": {"render"}, "payload": {"save_path"}}.get(
            source, set()
        )
        others = {name for one in _SOURCES.values() for name in one.names} | {"render", "save_path"}
        for action in parser._actions:
            if action.dest in others - own and getattr(arguments, action.dest) is not None:
                flag = action.option_strings[0]
                parser.error(f"{flag} does not go with {_SOURCES[source].flag}; leave it out")
        if source == "outcome":
            print(one_line(record_outcome_as_asked(arguments)))
            return 0
        if path is not None and path.suffix != ".mcap" and not path.is_dir():
            name = path.with_suffix(".mcap")  # a folder's errors come later
            parser.error(f"-o {str(path)!r}: what is written is MCAP; name it {name}")
        if arguments.save_path is not None:
            print(one_line(f"{arguments.save_path}: {_save_path(arguments)}"))
            return 0
        record_as_asked = {
            "camera": _record_camera,
            "drop": _record_drop,
            "payload": _record_payload,
            "bounce-shot": _record_shot,
            "joints": _record_joints,
        }[source]
        path = path or Path(f"{_SOURCES[source].stem}_{datetime.now():%Y%m%d_%H%M%S}.mcap")
        print(one_line(f"{path}: {record_as_asked(arguments, path)}"))
        return 0

    return run(parser, in_engine(record), argv)


if __name__ == "__main__":
    sys.exit(main())
