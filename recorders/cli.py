"""Entry point of `tunenet-record`: record an episode to a log."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from recorders.camera.options import camera_options, record_camera_as_asked
from recorders.drop_options import drop_options, record_drop_as_asked
from recorders.engine_option import engine_option, in_engine
from recorders.outcome_options import outcome_options, record_outcome_as_asked
from recorders.payload_options import (
    payload_options,
    record_payload_as_asked,
    save_path_as_asked,
)
from recorders.ros2.options import record_joints_as_asked, ros2_options
from recorders.shot_options import record_shot_as_asked, shot_options
from tunenet_logs.commandline import Parser, number, run, size_px, whole
from tunenet_logs.terminal import one_line

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

# What a log is called after where that is not its source.
_WHAT = {"camera": "drop", "bounce_shot": "shot"}


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
        what = _WHAT.get(source, source)
        path = arguments.output or Path(f"{what}_{datetime.now():%Y%m%d_%H%M%S}.mcap")
        print(one_line(f"{path}: {record_as_asked(arguments, path)}"))
        return 0

    return run(parser, in_engine(record), argv)


if __name__ == "__main__":
    sys.exit(main())
