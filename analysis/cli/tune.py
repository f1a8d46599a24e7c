"""tunenet-tune: from logs to tuned parameters, and a review of each."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.cli.options import (
    arm_options,
    ball_options,
    jobs_option,
    known_arm,
    known_ball,
    known_card,
    known_tares,
    of_efforts,
    preset_option,
)
from analysis.registry import METHODS, kinds
from recorders.engine_option import engine_option, in_engine
from tunenet_logs.commandline import (
    Parser,
    number,
    read_options_of,
    reading_options,
    run,
    whole,
)
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.terminal import Progress, listed, one_line

if TYPE_CHECKING:
    from analysis.record import Provenance, Tuning
    from analysis.selection import Selection

_DESCRIPTION = """\
Find the physical parameters that make a simulator move as a log shows: for a
dropped ball, its coefficient of restitution; for an arm that moves and holds something,
its mass. Reads videos (.mp4, .mov, ...), tables (.csv), exports of motion capture,
video trackers, sensors and robots, and logs (MCAP, ROS 1 .bag, ROS 2 .db3 and bag
folders) that hold the ball's position (PoseStamped, Odometry, TF,
...), a camera's pictures, or joints with their torques (JointState, Kinova's) under
any topic, ours or not.

Writes NAME.json (the result) and NAME.rrd (the review, for `rerun NAME.rrd`)
beside each log, and prints a table. Exit code 1 if a log was rejected."""

_EXAMPLES = """\
  tunenet-tune drop.mcap
  tunenet-tune sample_logs/*.mcap -o tuned --jobs 2
  tunenet-tune phone.mp4
  tunenet-tune phone.mp4 --preview                 (mark the ball on a page)
  tunenet-tune phone.mp4 --roi 400,0,500,1080 --start 2.5
  tunenet-tune phone.mp4 --ball table-tennis       (takes the air's drag into account)
  tunenet-tune phone.mp4 --ball-diameter 0.04 --ball-mass 0.0027
  tunenet-tune mocap.mcap --topic /vrpn/ball/pose --start 3.5 --end 8
  tunenet-tune Take_07.csv                         (OptiTrack, Vicon, Qualisys, ...)
  tunenet-tune ball.csv --columns t=Zeit,z='Hoehe (cm)'
  tunenet-tune spots.csv --fps 240                 (frames and no times)
  tunenet-tune claps.csv --columns times=1         (times of impacts alone)
  tunenet-tune drop.mcap --iterations 10 --initial 0.5
  tunenet-tune payload.bag --tare empty.bag        (what a Jaco holds)
  tunenet-tune payload.bag --arm ur5e
  tunenet-tune run.mcap --tare empty.mcap --save-arm-card arm.json
  tunenet-tune next.mcap --arm-card arm.json       (no tare needed)
  tunenet-tune run.mcap --gravity included --effort-unit A --torque-constants 9.5
  tunenet-tune run.mcap --urdf arm.urdf --tool-link flange
  tunenet-tune drop.mcap --weights my-drop.safetensors"""


def build_parser() -> Parser:
    """The command's arguments."""
    parser = Parser("tunenet-tune", _DESCRIPTION, _EXAMPLES)
    add = parser.add_argument
    add("logs", nargs="+", type=Path, metavar="LOG", help="log to tune from")
    add("-o", "--output", type=Path, metavar="DIR", help="folder for the results")
    add(
        "--task",
        choices=kinds(),
        help="what the log shows (default: what it says itself, or what is in it)",
    )
    add(
        "--topic",
        help="channel with the ball's position (default: /ball/pose, one named like a "
        "ball, else the first in which a ball drops), with pictures of it, or with torques",
    )
    add("--start", type=number(0, 1e9, "s"), metavar="S", help="leave out what comes before [s]")
    add("--end", type=number(0, 1e9, "s"), metavar="S", help="leave out what comes after [s]")
    add(
        "--height",
        type=number(1e-3, 100, "m"),
        metavar="M",
        help="of the drop, where a log holds impact times alone [m]",
    )
    _picture_options(parser.add_argument_group("ball in pictures (found by its flight without)"))
    ball_options(parser.add_argument_group("ball in pictures, where it is known"))
    arm_options(parser.add_argument_group("payload of an arm"))
    reading_options(parser.add_argument_group("what a file does not say itself"))
    preset_option(parser)
    engine_option(parser)
    add(
        "--method",
        choices=METHODS,
        metavar="NAME",
        help="how the parameters are estimated: the network's steps and the exact fit after them "
        "(tunenet+refine, the default of the preset default), the steps alone (tunenet), the fit "
        f"alone (fit), or by rollouts alone: {', '.join(list(METHODS)[3:])}. Only fits give an "
        "interval",
    )
    add(
        "--iterations",
        type=whole(1, 1000),
        default=5,
        metavar="K",
        help="rollouts that the method may spend, before those that check its answer (default: 5)",
    )
    add(
        "--initial",
        type=_vector,
        metavar="X[,Y,...]",
        help="restitution or mass [kg] to start from, one value a parameter (default with a "
        "network: 0, a ball that does not bounce; 0.5 kg; without: the middle of the range)",
    )
    add("--weights", type=Path, metavar="FILE", help="weights by tunenet-train (default: shipped)")
    jobs_option(parser, "logs at a time")
    add("--overwrite", action="store_true", help="replace results of other logs")
    add("--quiet", action="store_true", help="no progress bar")
    return parser


def _picture_options(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    add("--roi", type=_box, metavar="X,Y,W,H", help="look for the ball in this box only [px]")
    add(
        "--hsv",
        type=_hsv,
        metavar="RANGE",
        help="its colour as H,S,V:H,S,V, lowest and highest; hue 0 to 179 (170 to 10 is red), "
        "saturation and value 0 to 255",
    )
    add(
        "--ball-at",
        type=_place,
        metavar="X,Y,S",
        help="where it is seen moving [px], and when [s since the first picture]",
    )
    add(
        "--preview",
        action="store_true",
        help="show the pictures on a page of this machine, to mark the ball with a click; "
        "for one log",
    )


def _numbers(text: str, count: int, what: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(0 <= value < 1e6 for value in values):
        raise argparse.ArgumentTypeError(f"{text!r} is not {what}")
    return values


def _vector(text: str) -> tuple[float, ...]:
    return _numbers(text, text.count(",") + 1, "a number, or some with commas between them")


def _box(text: str) -> tuple[int, ...]:
    values = _numbers(text, 4, "a box X,Y,W,H of whole pixels, such as 400,0,500,1080")
    if any(value != int(value) for value in values) or not values[2] or not values[3]:
        raise argparse.ArgumentTypeError(f"{text!r} is not a box of whole pixels")
    return tuple(int(value) for value in values)


def _place(text: str) -> tuple[float, ...]:
    return _numbers(text, 3, "a place and time X,Y,S, such as 310,95.5,1.2")


def _hsv(text: str) -> tuple[tuple[int, ...], ...]:
    ends = text.split(":")
    what = "a range H,S,V:H,S,V, such as 5,120,80:20,255,255"
    if len(ends) != 2:
        raise argparse.ArgumentTypeError(f"{text!r} is not {what}")
    low, high = (_numbers(end, 3, what) for end in ends)
    most = (179, 255, 255)
    if any(value > top for end in (low, high) for value, top in zip(end, most, strict=True)):
        raise argparse.ArgumentTypeError(f"{text!r}: hue goes to 179, saturation and value to 255")
    return tuple(int(value) for value in low), tuple(int(value) for value in high)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `tunenet-tune`."""
    return run(build_parser(), in_engine(_tune), argv)


def _tune(arguments: argparse.Namespace) -> int:
    from analysis.batch import tune_all
    from analysis.report import table
    from analysis.selection import Hints, Options, Selection

    if None not in (arguments.start, arguments.end) and arguments.start >= arguments.end:
        raise UsageError(f"--start {arguments.start:g} is not before --end {arguments.end:g}")
    if arguments.hsv is not None and arguments.ball_at is not None:
        raise UsageError("--hsv does not go with --ball-at; leave one out")
    if arguments.preview:
        _check_preview(arguments)
    progress = Progress(quiet=arguments.quiet)
    reading, constants = of_efforts(arguments, read_options_of(arguments))
    tares = known_tares(arguments)
    selection = Selection(
        arguments.topic,
        arguments.start,
        arguments.end,
        Hints(arguments.roi, arguments.hsv, arguments.ball_at),
        known_ball(arguments),
        tares,
        known_arm(arguments),
        arguments.height,
        arguments.gravity,
        arguments.effort_sign,
        arguments.effort_unit,
        constants,
        known_card(arguments, tares),
        reading,
    )
    options = Options(
        task=arguments.task,
        preset=arguments.preset,
        iterations=arguments.iterations,
        initial=arguments.initial,
        method=arguments.method,
        weights=arguments.weights,
        selection=_marked(arguments.logs[0], selection, progress)
        if arguments.preview
        else selection,
    )
    jobs = arguments.jobs or len(os.sched_getaffinity(0))
    results = tune_all(
        arguments.logs,
        options,
        arguments.output,
        jobs,
        progress,
        overwrite=arguments.overwrite,
        also=_saving_card(arguments),
    )
    rows = [result.row for result in results]
    if any(row.is_read for row in rows):
        print(table([row for row in rows if row.is_read]))
    for result in results:
        record = result.row.record
        remarks = record.warnings if result.row.is_read else (record.reason, *record.warnings)
        for remark in () if result.trouble and not result.row.is_read else remarks:
            print(one_line(f"tunenet-tune: {result.row.log}: {remark}"), file=sys.stderr)
        if result.trouble:
            print(one_line(f"tunenet-tune: {result.trouble}"), file=sys.stderr)
    engines = {one.row.record.simulator["engine"] for one in results if one.row.record.simulator}
    if engines:
        print(f"\nsimulated by {', '.join(sorted(engines))}")
    reviews = [one_line(result.review) for result in results if result.review]
    if reviews:
        print("review: " + "\n        ".join(f"rerun {review}" for review in reviews))
    failed = [one.row.record.verdict == "rejected" or one.trouble for one in results]
    return int(any(failed))


def _saving_card(
    arguments: argparse.Namespace,
) -> Callable[[Tuning, Provenance], None] | None:
    """Writes what a tuning learns of its arm; None where nobody asks for it."""
    if arguments.save_arm_card is None:
        return None
    from analysis.payload.card_saving import save_arm_card

    return partial(save_arm_card, path=arguments.save_arm_card, overwrite=arguments.overwrite)


def _check_preview(arguments: argparse.Namespace) -> None:
    if len(arguments.logs) != 1:
        raise UsageError(f"--preview is for one log, not {len(arguments.logs)}; name one")
    for option, value in (("--ball-at", arguments.ball_at), ("--hsv", arguments.hsv)):
        if value is not None:
            raise UsageError(f"--preview does not go with {option}; leave one out")


def _marked(log: Path, selection: Selection, progress: Progress) -> Selection:
    """The selection with the ball as it is marked on a page; as it is without a mark."""
    from analysis.tracking.ball_picker import mark_ball
    from tunenet_logs.reader import read_episode

    episode = read_episode(log)
    topics = episode.picture_topics
    topic = selection.topic or next(iter(topics), None)
    if topic is None or topic not in topics:
        what = "no pictures" if selection.topic is None else f"no pictures in {selection.topic}"
        there = f"there are some in: {listed(topics)}" if topics else "leave --preview out"
        raise UsageError(f"{log}: holds {what} to mark the ball in; {there}")
    try:
        mark = mark_ball(
            episode,
            topic,
            start_s=selection.start_s,
            end_s=selection.end_s,
            progress=progress,
        )
    except (UsageError, NotFoundError) as error:
        raise UsageError(f"{log}: {error}") from error
    if mark is None:
        return selection
    return replace(selection, topic=topic, hints=replace(selection.hints, ball_at=mark))


if __name__ == "__main__":
    sys.exit(main())
