"""tunenet-tune: tune parameters from logs, and write a review of each."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.analysis.options import (
    ball_doubts,
    build_parser,
    check_card_place,
    options_of,
    parse_mapping,
)
from tunenet_logs.console import is_stdout, run
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.recorders.simulators.known import in_engine
from tunenet_logs.terminal import Progress, listed

if TYPE_CHECKING:
    from tunenet_logs.analysis.batch.logs import FoundLog
    from tunenet_logs.analysis.batch.run import Order, Writing
    from tunenet_logs.analysis.experiment import Tuning
    from tunenet_logs.analysis.options import TuneOptions
    from tunenet_logs.analysis.selection import Options, Selection
    from tunenet_logs.writing.owned_path import OutputPlace


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet-tune`."""
    return run(build_parser(), in_engine(_tune), argv)


def _tune(arguments: argparse.Namespace) -> int:
    from tunenet_logs.analysis.batch.logs import find_logs
    from tunenet_logs.analysis.batch.run import (
        Order,
        closing,
        on_ray,
        print_details,
        print_remarks,
        print_table,
        result_lines,
        run_batch,
        summary,
    )

    _check_places(arguments)
    shows_table = arguments.json is None or not is_stdout(arguments.json)
    progress = Progress(quiet=arguments.quiet, has_bars=shows_table)
    given = given_options(arguments)
    options = options_of(given, arguments.logs)
    for doubt in ball_doubts(given, options.selection.ball):
        progress.say(f"tunenet-tune: {doubt}")
    if arguments.preview:
        selection = _marked(arguments.logs[0], options.selection, progress)
        options = replace(options, selection=selection)
    found = find_logs(arguments.logs)
    if arguments.dry_run:
        return _plan(found.logs, options)
    wants_ledger = arguments.resume or arguments.csv is not None
    if wants_ledger and arguments.output is None:
        raise UsageError("--resume and --csv are about the ledger in -o DIR; give it")
    if found.left_out:
        progress.say(f"tunenet-tune: {found.left_out} files of folders are no logs; left out")
    order = Order(
        found.logs,
        options,
        _writing(arguments),
        arguments.output,
        arguments.output is not None and (found.are_many or wants_ledger),
        arguments.resume,
    )
    csv, lines = _table_places(arguments, order)
    stream = None
    if arguments.ray is not None:
        from tunenet_logs.analysis.parallel import Cluster

        stream = partial(on_ray, Cluster(arguments.ray, arguments.jobs))
    after = partial(closing, order, csv)
    with result_lines(lines) as each:
        batch = run_batch(order, progress, stream, arguments.jobs, after=after, each=each)
    if arguments.verbose:
        print_details(batch.results)
    if shows_table:
        print_table(batch.results)
    print_remarks(batch.results)
    if shows_table:
        print(summary(batch, len(found.logs)), end="")
    return int(batch.failed > 0)


def _plan(logs: Sequence[FoundLog], options: Options) -> int:
    """Print which of each log's signals would drive the user's model, and which be fitted."""
    from tunenet_logs.analysis.sysid.experiment import print_plan

    if options.source is None:
        raise UsageError("--dry-run shows how a log drives a model of one's own; add --model")
    for found in logs:
        if not isinstance(found.log, Path):
            raise UsageError(f"{found.log}: --dry-run is for a log on this machine")
        print_plan(found.log, options)
    return 0


def _table_places(
    arguments: argparse.Namespace, order: Order
) -> tuple[OutputPlace | None, OutputPlace | None]:
    """Return the output places of --csv and --json, checked before the work."""
    csv, lines, overwrite = None, None, arguments.overwrite
    if arguments.csv is not None:
        from tunenet_logs.analysis.batch.ledger import check_csv, csv_place

        csv = csv_place(arguments.csv, arguments.output, overwrite=overwrite)
        check_csv(csv, arguments.output, order.logs)
    if arguments.json is not None:
        from tunenet_logs.analysis.batch.run import check_lines, lines_place

        check_lines(arguments.json, order, overwrite=overwrite)
        lines = lines_place(arguments.json, order, overwrite=overwrite)
    return csv, lines


def given_options(arguments: argparse.Namespace) -> TuneOptions:
    """Return the command line's options under their Python names."""
    return {
        "task": arguments.task,
        "preset": arguments.preset,
        "method": arguments.method,
        "iterations": arguments.iterations,
        "initial": arguments.initial,
        "weights": arguments.weights,
        "topic": arguments.topic,
        "start_s": arguments.start,
        "end_s": arguments.end,
        "height_m": arguments.height,
        "roi": arguments.roi,
        "hsv": arguments.hsv,
        "ball_at": arguments.ball_at,
        "ball": arguments.ball,
        "ball_diameter_m": arguments.ball_diameter,
        "ball_mass_kg": arguments.ball_mass,
        "tares": arguments.tare or (),
        "arm": arguments.arm,
        "urdf": arguments.urdf,
        "tool_link": arguments.tool_link,
        "gravity": arguments.gravity,
        "effort_sign": arguments.effort_sign,
        "effort_unit": arguments.effort_unit,
        "arm_card": arguments.arm_card,
        "model": arguments.model,
        "parameters": arguments.tune or (),
        "mapping": parse_mapping(arguments.map or ()),
        "columns": arguments.columns,
        "fps": arguments.fps,
        "length_unit": arguments.length_unit,
        "torque_constants": arguments.torque_constants,
    }


def _writing(arguments: argparse.Namespace) -> Writing:
    """Return what is written for each log."""
    from tunenet_logs.analysis.batch.run import Writing

    reviewed = Writing().reviewed
    if arguments.no_review:
        reviewed = frozenset[str]()
    elif arguments.review_only is not None:
        reviewed = frozenset([arguments.review_only])
    return Writing(arguments.overwrite, reviewed, _saving_card(arguments))


def _saving_card(arguments: argparse.Namespace) -> Callable[[Tuning], None] | None:
    """Return a callback that saves the arm card; None if nobody asks for it."""
    if arguments.save_arm_card is None:
        return None
    from tunenet_logs.analysis.payload.experiment import save_arm_card

    return partial(save_arm_card, path=arguments.save_arm_card, overwrite=arguments.overwrite)


def _check_places(arguments: argparse.Namespace) -> None:
    """Refuse at once what could not be shown or written."""
    if arguments.preview:
        _check_preview(arguments)
    check_card_place(arguments)


def _check_preview(arguments: argparse.Namespace) -> None:
    if len(arguments.logs) != 1:
        raise UsageError(f"--preview is for one log, not {len(arguments.logs)}; name one")
    for option, value in (("--ball-at", arguments.ball_at), ("--hsv", arguments.hsv)):
        if value is not None:
            raise UsageError(f"--preview does not go with {option}; leave one out")


def _marked(log: Path | str, selection: Selection, progress: Progress) -> Selection:
    """Return the selection with the ball that the user marks in a preview page."""
    from tunenet_logs.analysis.tracking.picker import mark_ball
    from tunenet_logs.reader import read_episode

    if not isinstance(log, Path):
        raise UsageError(f"{log}: --preview is for a log on this machine; copy it here first")
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
