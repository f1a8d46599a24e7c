"""tunenet-tune: from logs to tuned parameters, and a review of each."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from tunenet_logs.commandline import Parser, number, run, whole
from tunenet_logs.errors import UsageError

_DESCRIPTION = """\
Find the physical parameters that make a simulator move as a log shows: for a
dropped ball, its coefficient of restitution. Reads MCAP logs that hold the ball's
position (geometry_msgs/msg/PoseStamped, any topic), ours or not.

Writes NAME.json (the result) and NAME.rrd (the review, for `rerun NAME.rrd`)
beside each log, and prints a table. Exit code 1 if a log was rejected."""

_EXAMPLES = """\
  tunenet-tune drop.mcap
  tunenet-tune sample_logs/*.mcap -o tuned --jobs 2
  tunenet-tune mocap.mcap --topic /vrpn/ball/pose --start 3.5 --end 8
  tunenet-tune drop.mcap --iterations 10 --initial 0.5
  tunenet-tune drop.mcap --weights my-drop.safetensors"""


def build_parser() -> Parser:
    """The command's arguments."""
    parser = Parser("tunenet-tune", _DESCRIPTION, _EXAMPLES)
    add = parser.add_argument
    add("logs", nargs="+", type=Path, metavar="LOG", help="log to tune from")
    add("-o", "--output", type=Path, metavar="DIR", help="folder for the results")
    add("--task", choices=["drop"], help="what the log shows (default: what it says itself)")
    add(
        "--topic",
        help="channel with the ball's position (default: /ball/pose, one named like a "
        "ball, else the first in which a ball drops)",
    )
    add("--start", type=number(0, 1e9, "s"), metavar="S", help="leave out what comes before [s]")
    add("--end", type=number(0, 1e9, "s"), metavar="S", help="leave out what comes after [s]")
    add(
        "--preset",
        choices=["default", "paper", "paper-code"],
        default="default",
        help="simulator, observation and network: ours, or those of the paper's text or code",
    )
    add(
        "--iterations",
        type=whole(1, 1000),
        default=5,
        metavar="K",
        help="steps of the network, one rollout each (default: 5)",
    )
    add(
        "--initial",
        type=number(0, 1),
        metavar="X",
        help="restitution to start from (default: 0, a ball that does not bounce)",
    )
    add("--weights", type=Path, metavar="FILE", help="weights by tunenet-train (default: shipped)")
    add("--jobs", type=whole(1, 256), metavar="N", help="logs at a time (default: all cores)")
    add("--quiet", action="store_true", help="no progress bar")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `tunenet-tune`."""
    return run(build_parser(), _tune, argv)


def _tune(arguments: argparse.Namespace) -> int:
    from analysis.batch import tune_all
    from analysis.report import table
    from analysis.tasks.base import Selection
    from analysis.tuning import Options
    from tunenet_logs.progress import Progress

    if None not in (arguments.start, arguments.end) and arguments.start >= arguments.end:
        raise UsageError(f"--start {arguments.start:g} is not before --end {arguments.end:g}")
    options = Options(
        task=arguments.task,
        preset=arguments.preset,
        iterations=arguments.iterations,
        initial=arguments.initial,
        weights=arguments.weights,
        selection=Selection(arguments.topic, arguments.start, arguments.end),
    )
    jobs = arguments.jobs or len(os.sched_getaffinity(0))
    progress = Progress(quiet=arguments.quiet)
    results = tune_all(arguments.logs, options, arguments.output, jobs, progress)
    rows = [result.row for result in results]
    if any(row.read for row in rows):
        print(table([row for row in rows if row.read]))
    for row in rows:
        remarks = row.warnings if row.read else (row.reason, *row.warnings)
        for remark in remarks:
            print(f"tunenet-tune: {row.log}: {remark}", file=sys.stderr)
    for result in results:
        if result.trouble:
            print(f"tunenet-tune: {result.trouble}", file=sys.stderr)
    reviews = [result.review for result in results if result.review]
    if reviews:
        print("\nreview: " + "\n        ".join(f"rerun {review}" for review in reviews))
    failed = any(one.row.verdict == "rejected" or one.trouble for one in results)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
