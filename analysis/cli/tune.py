"""tunenet-tune: tune parameters from logs, and write a review of each."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.analysis import options as tuning_options
from tunenet_logs.analysis.options import jobs_option, json_option, options_of, ray_option
from tunenet_logs.console import Parser, Topic, add_options, given, is_stdout, run
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.files import real_path
from tunenet_logs.recorders.simulators.known import engine_option, in_engine
from tunenet_logs.terminal import Progress, listed

if TYPE_CHECKING:
    from tunenet_logs.analysis.batch.logs import FoundLog, FoundLogs
    from tunenet_logs.analysis.batch.run import Writing
    from tunenet_logs.analysis.experiment import Tuning
    from tunenet_logs.analysis.options import TuneOptions

_DESCRIPTION = """\
Find the physical parameters that make a simulator move as a log shows: for a
dropped ball, its coefficient of restitution; for an arm that moves and holds something,
its mass. Reads videos, sound, tables, exports of labs and logs (MCAP, ROS bags). Writes
NAME.json (the result) and NAME.rrd (for `rerun NAME.rrd`) beside each log."""

_EXAMPLES = """\
  tunenet-tune drop.mcap
  tunenet-tune phone.mp4
  tunenet-tune bounce.wav                          (a ball by its sound)
  tunenet-tune payload.bag --tare empty.bag        (what a Jaco holds)
  tunenet-tune recordings/ -o tuned                (a folder with all that lies below it)"""

TOPICS = {
    "drop": Topic(
        "a ball in pictures, sound or positions",
        """\
  tunenet-tune bounce.wav                          (a ball by its sound)
  tunenet-tune phone.mp4 --preview                 (mark the ball on a page)
  tunenet-tune phone.mp4 --roi 400,0,500,1080 --start 2.5
  tunenet-tune phone.mp4 --ball table-tennis       (takes the air's drag into account)
  tunenet-tune phone.mp4 --ball-diameter 0.04 --ball-mass 0.0027
  tunenet-tune mocap.mcap --topic /vrpn/ball/pose --start 3.5 --end 8""",
    ),
    "payload": Topic(
        "what an arm holds",
        """\
  tunenet-tune payload.bag --tare empty.bag        (what a Jaco holds)
  tunenet-tune payload.bag --arm ur5e
  tunenet-tune run.mcap --tare empty.mcap --save-arm-card arm.json
  tunenet-tune next.mcap --arm-card arm.json       (no tare needed)
  tunenet-tune run.mcap --gravity included --effort-unit A --torque-constants 9.5
  tunenet-tune run.mcap --urdf arm.urdf --tool-link flange""",
    ),
    "model": Topic(
        "a MuJoCo model of your own",
        """\
  tunenet-tune run.mcap --model robot.xml --tune joint/elbow.damping=0:5 --dry-run
  tunenet-tune run.mcap --model robot.xml --tune body/tool.mass=0:2 --tune delay/commands
  tunenet-tune run.mcap --model robot.urdf --tune tuned.yaml --map /arm/j1=joint/elbow
  tunenet-tune a.mcap b.mcap --model robot.xml --tune tuned.yaml --together
  tunenet-tune a.mcap b.mcap --model robot.xml --tune tuned.yaml --together --hold-out c.mcap
  tunenet-tune my_dataset/ --model so101.xml --tune actuators --together --hold-out episode:7""",
    ),
    "files": Topic(
        "what a file does not say itself",
        """\
  tunenet-tune Take_07.csv                         (OptiTrack, Vicon, Qualisys, ...)
  tunenet-tune ball.csv --columns t=Zeit,z='Hoehe (cm)'
  tunenet-tune spots.csv --fps 240                 (frames and no times)
  tunenet-tune claps.csv --columns times=1         (times of impacts alone)""",
    ),
    "method": Topic(
        "how the parameters are estimated",
        """\
  tunenet-tune drop.mcap --iterations 10 --initial 0.5
  tunenet-tune drop.mcap --weights my-drop.safetensors""",
    ),
    "batch": Topic(
        "many logs, for scripts; -o DIR keeps a ledger, a row a log",
        """\
  tunenet-tune drop.mcap --json - | jq .parameters.restitution
  tunenet-tune sample_logs/*.mcap -o tuned --jobs 2
  tunenet-tune recordings/ -o tuned --resume       (what is new, or was not done)
  tunenet-tune 'runs/**/ball*.mcap' -o tuned --review-only suspect --csv tuned.csv""",
    ),
}


def build_parser() -> Parser:
    """Build the argument parser."""
    parser = Parser(
        "tunenet-tune", _DESCRIPTION, _EXAMPLES, called="LOG... [options]", topics=TOPICS
    )
    add = parser.add_argument
    add(
        "logs",
        nargs="+",
        type=lambda text: text if "://" in text else Path(text),
        metavar="LOG",
        help="log, film or sound to tune from, a folder that holds logs, or a pattern such as "
        "'runs/**/*.mcap'",
    )
    add("-o", "--output", type=Path, metavar="DIR", help="folder for the results")
    for topic in ("files", "drop", "payload"):  # whose options stand before the model's
        parser.topic(topic)
    words = tuning_options.TuneOptions.__dataclass_fields__["together"].metadata["option"].help
    parser.topic("model").add_argument(
        "--together", action="store_const", const=(), help=words.partition(" (in Python")[0]
    )
    add_options(tuning_options.TuneOptions, parser.place)
    parser.topic("drop").add_argument(
        "--preview",
        action="store_true",
        help="show the pictures on a page of this machine, to mark the ball with a click; "
        "for one log",
    )
    parser.topic("payload").add_argument(
        "--save-arm-card",
        type=Path,
        metavar="FILE",
        help="write what the log, its tares and the --arm-card say of the arm; for one log",
    )
    parser.topic("model").add_argument(
        "--dry-run",
        action="store_true",
        help="say what of the log would drive the model and be compared with it, and end",
    )
    engine_option(parser.topic("method"))
    many = parser.topic("batch")
    json_option(many, "for scripts: what each NAME.json holds but the curves, a line a log,")
    jobs_option(many, "logs at a time")
    add("--overwrite", action="store_true", help="replace results of other logs")
    many.add_argument(
        "--resume",
        action="store_true",
        help="leave out what the ledger of -o DIR has: logs that did not change, tuned with the "
        "same options",
    )
    many.add_argument(
        "--csv", type=Path, metavar="FILE", help="also write the ledger as a text table"
    )
    ray_option(many, "work")
    reviews = many.add_mutually_exclusive_group()
    reviews.add_argument("--no-review", action="store_true", help="write no NAME.rrd")
    reviews.add_argument(
        "--review-only",
        choices=("ok", "suspect", "rejected"),
        metavar="VERDICT",
        help="write NAME.rrd of logs with this verdict alone: ok, suspect or rejected",
    )
    add("--quiet", action="store_true", help="no progress bar")
    add(
        "-v",
        "--verbose",
        action="store_true",
        help="say where what was found, how it was estimated, how long each part took, and what "
        "each check saw",
    )
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet-tune`."""
    return run(build_parser(), in_engine(_tune), argv)


def _tune(arguments: argparse.Namespace) -> int:
    from tunenet_logs.analysis.batch.ledger import csv_place
    from tunenet_logs.analysis.batch.logs import find_logs
    from tunenet_logs.analysis.batch.run import (
        Order,
        closing,
        lines_place,
        result_lines,
        run_batch,
        show,
    )

    if arguments.preview:
        _check_preview(arguments)
    writing = _writing(arguments)
    shows_table = arguments.json is None or not is_stdout(arguments.json)
    progress = Progress(quiet=arguments.quiet, has_bars=shows_table)
    found = find_logs(arguments.logs)
    options = options_of(given(arguments, tuning_options.TuneOptions), arguments.logs)
    for doubt in options.ball_doubts:
        progress.say(f"tunenet-tune: {doubt}")
    if arguments.preview:
        options = _marked(arguments.logs[0], options, progress)
    if arguments.together is not None:
        options, found = _together(found, options, is_resumed=arguments.resume)
    if arguments.dry_run:
        return _plan(found.logs, options)
    wants_ledger = arguments.resume or arguments.csv is not None
    if wants_ledger and arguments.output is None:
        raise UsageError("--resume and --csv are about the ledger in -o DIR; give it")
    if found.left_out:
        progress.say(f"tunenet-tune: {found.left_out} files of folders are no logs; left out")
    csv, overwrite = None, arguments.overwrite
    if arguments.csv is not None:
        csv = csv_place(arguments.csv, arguments.output, found.logs, overwrite=overwrite)
    order = Order(
        found.logs,
        options,
        writing,
        arguments.output,
        keeps_ledger=arguments.output is not None and (found.are_many or wants_ledger),
        resumes=arguments.resume,
        csv=csv,
        jobs=arguments.jobs,
        ray=arguments.ray,
    )
    lines = arguments.json and lines_place(arguments.json, order, overwrite=overwrite)
    with result_lines(lines) as each:
        batch = run_batch(order, progress, after=closing, each=each)
    show(batch, len(found.logs), has_table=shows_table, is_verbose=arguments.verbose)
    return int(batch.failed > 0)


def _together(
    found: FoundLogs, options: TuneOptions, *, is_resumed: bool
) -> tuple[TuneOptions, FoundLogs]:
    """Return the options with all logs but the first, and that alone."""
    if options.source is None:
        raise UsageError("--together is about a model of one's own; name it with --model")
    if is_resumed:
        raise UsageError("--together does not go with --resume; leave one out")
    logs = [one.log for one in found.logs]
    if far := [log for log in logs if not isinstance(log, Path)]:
        raise UsageError(f"{far[0]}: --together is for logs on this machine; copy it here first")
    paths = [log for log in logs if isinstance(log, Path)]
    return replace(options, together=tuple(paths[1:])), replace(found, logs=found.logs[:1])


def _check_preview(arguments: argparse.Namespace) -> None:
    if len(arguments.logs) != 1:
        raise UsageError(f"--preview is for one log, not {len(arguments.logs)}; name one")
    for option, value in (("--ball-at", arguments.ball_at), ("--hsv", arguments.hsv)):
        if value is not None:
            raise UsageError(f"--preview does not go with {option}; leave one out")


def _plan(logs: Sequence[FoundLog], options: TuneOptions) -> int:
    """Print which of each log's signals would drive the user's model, and which be fitted."""
    from tunenet_logs.analysis.sysid.experiment import print_plan

    if options.source is None:
        raise UsageError("--dry-run shows how a log drives a model of one's own; add --model")
    for found in logs:
        if not isinstance(found.log, Path):
            raise UsageError(f"{found.log}: --dry-run is for a log on this machine")
        print_plan(found.log, options)
    return 0


def _writing(arguments: argparse.Namespace) -> Writing:
    """Return what is written for each log; refuse an arm card that could not be."""
    from tunenet_logs.analysis.batch.run import Writing

    reviewed, also = Writing().reviewed, None
    if arguments.no_review:
        reviewed = frozenset[str]()
    elif arguments.review_only is not None:
        reviewed = frozenset([arguments.review_only])
    if (card := arguments.save_arm_card) is not None:
        from tunenet_logs.analysis.payload.experiment import card_place

        if len({real_path(log) for log in arguments.logs}) != 1:
            count = len(arguments.logs)
            raise UsageError(f"--save-arm-card is for one log, not {count}; name one")
        card_place(card, None, overwrite=True).check()
        also = partial(_save_card, path=card, overwrite=arguments.overwrite)
    return Writing(arguments.overwrite, reviewed, also)


def _save_card(tuning: Tuning, path: Path, *, overwrite: bool) -> None:
    from tunenet_logs.analysis.payload.experiment import save_arm_card
    from tunenet_logs.analysis.result_files import writable

    with writable(path, "choose another place"):
        save_arm_card(tuning, path, overwrite=overwrite)


def _marked(log: Path | str, options: TuneOptions, progress: Progress) -> TuneOptions:
    """Return the options with the ball that the user marks in a preview page."""
    from tunenet_logs.analysis.tracking.picker import mark_ball
    from tunenet_logs.reader import read_episode

    if not isinstance(log, Path):
        raise UsageError(f"{log}: --preview is for a log on this machine; copy it here first")
    episode = read_episode(log)
    topics = episode.picture_topics
    topic = options.topic or next(iter(topics), None)
    if topic is None or topic not in topics:
        what = "no pictures" if options.topic is None else f"no pictures in {options.topic}"
        there = f"there are some in: {listed(topics)}" if topics else "leave --preview out"
        raise UsageError(f"{log}: holds {what} to mark the ball in; {there}")
    start_s, end_s = options.start_s, options.end_s
    try:
        mark = mark_ball(episode, topic, start_s=start_s, end_s=end_s, progress=progress)
    except (UsageError, NotFoundError) as error:
        raise UsageError(f"{log}: {error}") from error
    return options if mark is None else replace(options, topic=topic, ball_at=mark)


if __name__ == "__main__":
    sys.exit(main())
