"""tunenet-eval: the paper's experiments, its figures beside ours."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.cli.options import jobs_option
from tunenet_logs.commandline import Parser, run, whole
from tunenet_logs.errors import UsageError
from tunenet_logs.wording import one_line

if TYPE_CHECKING:
    from analysis.experiments.drop_networks import Effort
    from tunenet_logs.progress import Progress

_DESCRIPTION = """\
Repeat an experiment of the TuneNet paper from nothing, training and test targets drawn
anew for each seed, and print its figures beside the paper's.

  drop       restitution of a bouncing ball from its height: every method of the paper,
             what a user would pick instead, and ours, by rollouts spent (table 2, figure)
  motion     where the ball will be: tuned simulators and one-step predictors (table 3)
  intervals  how often the 95 % intervals of recorded drops hold the truth; part of drop
  video      restitution from tracks of filmed drops, good and bad ones: errors, intervals,
             verdicts

Needs the libraries of the extra 'eval': pip install 'tunenet-logs[eval]'."""

_EXAMPLES = """\
  tunenet-eval drop                                  (half an hour on two cores)
  tunenet-eval drop --seeds 1 --targets 20           (a few minutes)
  tunenet-eval drop --methods mean,secant,tunenet-paper-code --seeds 1
  tunenet-eval drop --json drop.json --csv drop.csv --png drop.png --rrd drop.rrd
  tunenet-eval motion --json motion.json
  tunenet-eval video --targets 20 --sections set-B,bad"""

METHODS = (
    *("mean", "entropy-search", "cma-es", "direct", "tunenet-paper", "tunenet-paper-code"),
    *("secant", "brent", "least-squares", "tpe"),
    *("network", "ours"),
    *("concatenation", "difference", "antisymmetric"),
)
"""Those of `drop_roster`, which takes a second to load."""

SECTIONS = ("set-A", "set-B", "set-C", "slope", "drag", "bad", "clips", "transformed")
"""Those of `video_cells`, which takes a second to load, and of `clips`."""

_METHODS_HELP = f"""\
methods of the paper: {", ".join(METHODS[:6])}
what a user would pick: {", ".join(METHODS[6:10])}
ours: {", ".join(METHODS[10:12])}
the ablation, which has no curve in the figure: {", ".join(METHODS[12:])}"""

_FILES = ("json", "csv", "png", "rrd")
_ONLY_DROP = ("methods", "png", "rrd")
_TARGETS = {"video": 200}
_PAPER_TARGETS = 100


def build_parser() -> Parser:
    """The command's arguments."""
    parser = Parser("tunenet-eval", _DESCRIPTION, _EXAMPLES)
    add = parser.add_argument
    add("experiment", choices=["drop", "motion", "intervals", "video"], help="which experiment")
    add(
        "--seeds",
        type=whole(1, 1000),
        default=3,
        metavar="N",
        help="how many, each with its own training and targets (default: 3)",
    )
    add(
        "--first-seed",
        type=whole(0, 1_000_000),
        default=1,
        metavar="N",
        help="the first of them (default: 1)",
    )
    add(
        "--targets",
        type=whole(1, 100_000),
        metavar="N",
        help="test targets for each seed and set (default: 100, as in the paper; video: 200)",
    )
    jobs_option(parser, "processes")
    drop = parser.add_argument_group("drop only", _METHODS_HELP)
    drop.add_argument(
        "--methods", metavar="A,B,...", help="only these, and no intervals (default: all)"
    )
    drop.add_argument(
        "--png", type=Path, metavar="FILE", help="the figure: error against rollouts, as a picture"
    )
    drop.add_argument(
        "--rrd", type=Path, metavar="FILE", help="the figure for Rerun, with the tables"
    )
    video = parser.add_argument_group("video only", f"tables: {', '.join(SECTIONS)}")
    video.add_argument("--sections", metavar="A,B,...", help="only these tables (default: all)")
    files = parser.add_argument_group("files (replaced if they exist)")
    files.add_argument("--json", type=Path, metavar="FILE", help="every figure, and the curves")
    files.add_argument(
        "--csv", type=Path, metavar="FILE", help="one row for each method, budget and seed, or line"
    )
    add("--quiet", action="store_true", help="no progress bar")
    for name in ("--pairs", "--epochs"):  # of training, to try things out
        add(name, type=whole(1, 1_000_000), help=argparse.SUPPRESS)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `tunenet-eval`."""
    return run(build_parser(), _eval, argv)


def _eval(arguments: argparse.Namespace) -> int:
    _check(arguments)

    from tunenet_logs.progress import Progress

    progress = Progress(quiet=arguments.quiet)
    seeds = tuple(range(arguments.first_seed, arguments.first_seed + arguments.seeds))
    evaluate = {"drop": _drop, "motion": _motion, "intervals": _intervals, "video": _video}
    if arguments.targets is None:
        arguments.targets = _TARGETS.get(arguments.experiment, _PAPER_TARGETS)
    blocks, writers = evaluate[arguments.experiment](arguments, seeds, progress)
    for block in blocks:
        print(block + "\n", flush=True)
    for name in _FILES:
        path = getattr(arguments, name)
        if path is not None:
            writers[name](path)
            print(f"{name}: {'rerun ' if name == 'rrd' else ''}{one_line(path)}")
    return 0


Writers = dict[str, Callable[[Path], None]]
"""What an experiment can write, once all of its text is printed."""


def _drop(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    from analysis.experiments.drop import DropOrder, run_drop
    from analysis.experiments.drop_roster import roster
    from analysis.experiments.figure import write_figure
    from analysis.experiments.records import drop_csv, drop_json
    from analysis.experiments.tables import drop_tables
    from analysis.extras import needed

    methods = _named(arguments, "methods", METHODS)
    chosen = roster(methods)
    for name in ("png", "rrd"):
        if getattr(arguments, name) is not None and not chosen.has_curves:
            raise UsageError(f"--{name}: no method chosen has a curve to draw; leave it out")
    if arguments.png is not None:
        needed("matplotlib")
    order = DropOrder(seeds, arguments.targets, methods, arguments.jobs, _effort(arguments))
    results = run_drop(order, progress)

    def write_rrd(path: Path) -> None:
        from analysis.review.convergence import write_convergence

        write_convergence(results, path)

    return [drop_tables(results)], {
        "json": lambda path: _write(path, drop_json(results)),
        "csv": lambda path: _write(path, drop_csv(results)),
        "png": lambda path: write_figure(results, path),
        "rrd": write_rrd,
    }


def _motion(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    from analysis.experiments.motion_run import run_motion
    from analysis.experiments.motion_tables import motion_lines
    from analysis.experiments.records import motion_csv, motion_json

    targets = arguments.targets
    rows = run_motion(seeds, targets, arguments.jobs, progress, _effort(arguments))
    return [motion_lines(rows, seeds, targets)], {
        "json": lambda path: _write(path, motion_json(rows, seeds, targets)),
        "csv": lambda path: _write(path, motion_csv(rows, seeds)),
    }


def _intervals(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    from analysis.experiments.intervals import interval_coverages
    from analysis.experiments.records import intervals_csv, intervals_json
    from analysis.experiments.tables import coverage_table

    targets = arguments.targets
    rows = interval_coverages(seeds, targets, arguments.jobs, progress)
    return [coverage_table(rows)], {
        "json": lambda path: _write(path, intervals_json(rows, seeds, targets)),
        "csv": lambda path: _write(path, intervals_csv(rows)),
    }


def _video(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    from math import ceil as round_up

    from analysis.experiments.clip_tables import clip_table, transformed_table
    from analysis.experiments.clips import (
        COUNT,
        TRANSFORMED,
        ClipResult,
        TransformedClip,
        clip_results,
        transformed_results,
    )
    from analysis.experiments.video import VideoOrder, VideoRow, track_sections
    from analysis.experiments.video_cells import TRACK_SECTIONS, Section
    from analysis.experiments.video_records import video_csv, video_json
    from analysis.experiments.video_tables import video_blocks

    wanted = _named(arguments, "sections", SECTIONS) or SECTIONS
    for name in wanted:
        if name not in SECTIONS:
            raise UsageError(f"no section {name!r}; there is: {', '.join(SECTIONS)}")
    chosen = tuple(one for one in TRACK_SECTIONS if one.name in wanted)
    order = VideoOrder(seeds, arguments.targets, arguments.jobs)
    rows: list[VideoRow] = []

    def sections() -> Iterator[tuple[Section, tuple[VideoRow, ...]]]:
        for section, found in track_sections(order, progress, chosen):
            rows.extend(found)
            yield section, found

    clips: list[ClipResult] = []
    transformed: list[TransformedClip] = []

    def blocks() -> Iterator[str]:
        if chosen:
            yield from video_blocks(order, sections())
        seed, share = seeds[0], min(arguments.targets / _TARGETS["video"], 1.0)
        if "clips" in wanted:
            clips.extend(clip_results(seed, round_up(COUNT * share), order.jobs, progress))
            yield clip_table(clips)
        if "transformed" in wanted:
            count = round_up(TRANSFORMED * share)
            transformed.extend(transformed_results(seed, count, order.jobs, progress))
            yield transformed_table(transformed)

    return blocks(), {
        "json": lambda path: _write(path, video_json(rows, order, clips, transformed)),
        "csv": lambda path: _write(path, video_csv(rows)),
    }


def _named(
    arguments: argparse.Namespace, option: str, there_is: Sequence[str]
) -> tuple[str, ...] | None:
    """The names that an option lists; None where it is not given."""
    listed = getattr(arguments, option)
    if listed is None:
        return None
    names = tuple(filter(None, (name.strip() for name in listed.split(","))))
    if not names:
        raise UsageError(f"--{option} names none; there is: {', '.join(there_is)}")
    return names


def _effort(arguments: argparse.Namespace) -> Effort:
    from analysis.experiments.drop_networks import Effort

    return Effort(arguments.pairs, arguments.epochs)


def _check(arguments: argparse.Namespace) -> None:
    """Refuse at once what would fail after the work."""
    if arguments.experiment != "drop":
        for name in _ONLY_DROP:
            if getattr(arguments, name) is not None:
                raise UsageError(f"--{name} is for drop, not {arguments.experiment}; leave it out")
    if arguments.experiment != "video" and arguments.sections is not None:
        raise UsageError(f"--sections is for video, not {arguments.experiment}; leave it out")

    from analysis.files import check_writable

    taken: dict[Path, str] = {}
    for name in _FILES:
        path = getattr(arguments, name)
        if path is None:
            continue
        if str(path) == "-":
            raise UsageError(f"--{name} -: is no file; give the name of one")
        other = taken.setdefault(path.resolve(), name)
        if other != name:
            raise UsageError(f"{path}: both --{other} and --{name} name it; give each its own")
        check_writable(path, f"--{name}")
        if name in ("png", "rrd") and path.suffix != f".{name}":
            raise UsageError(f"{path}: --{name} writes .{name}; give the file a name that ends so")


def _write(path: Path, text: str) -> None:
    from analysis.files import replacing

    with replacing(path) as partial:
        partial.write_text(text, "utf-8")


if __name__ == "__main__":
    sys.exit(main())
