"""Print the results of each `tunenet-eval` experiment, and list the files it can write."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING

from analysis.evaluation.choices import (
    FULL_CONVENTIONS,
    FULL_PAYLOAD,
    FULL_SHOT,
    FULL_STRANGERS,
    FULL_VIDEO,
    METHODS,
    PAYLOAD_SECTIONS,
    REAL_SECTIONS,
    SECTIONS,
    SHOT_SECTIONS,
    TYPICAL_PAYLOAD_SECTIONS,
    chosen_names,
    chosen_sections,
)
from analysis.evaluation.sound.printing import print_sound
from analysis.evaluation.sysid.printing import print_sysid
from analysis.evaluation.writing import FigurePlace, write_json_to, write_text_to
from tunenet_logs.errors import UsageError

if TYPE_CHECKING:
    from analysis.evaluation.drop.networks import Effort
    from tunenet_logs.terminal import Progress

# What an experiment can write, once all of its text is printed.
Writers = dict[str, Callable[[FigurePlace], None]]

# Runs with options and seeds; gives blocks of text as they are done, and the files' writers.
Experiment = Callable[
    [argparse.Namespace, tuple[int, ...], "Progress"], tuple[Iterable[str], Writers]
]


def _drop(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    """Run table 2, its figure and the intervals."""
    from analysis.evaluation.drop.figure import write_figure
    from analysis.evaluation.drop.method_registry import choose_methods
    from analysis.evaluation.drop.records import drop_csv, drop_json
    from analysis.evaluation.drop.run import DropExperiment, run_drop
    from analysis.evaluation.drop.tables import drop_tables
    from analysis.optional_dependencies import needed

    methods = chosen_names(arguments, "methods", METHODS)
    chosen = choose_methods(methods)
    for name in ("png", "rrd"):
        if getattr(arguments, name) is not None and not chosen.has_curves:
            raise UsageError(f"--{name}: no method chosen has a curve to draw; leave it out")
    if arguments.png is not None:
        needed("matplotlib")
    order = DropExperiment(
        *(seeds, arguments.targets, methods, arguments.jobs, _effort(arguments)),
        rollouts=arguments.rollouts,
    )
    results = run_drop(order, progress)

    def write_rrd(to: FigurePlace) -> None:
        from analysis.evaluation.drop.review.convergence import write_convergence

        with to.place.replacing() as partial:
            write_convergence(results, partial)

    def write_png(to: FigurePlace) -> None:
        with to.place.replacing() as partial:
            write_figure(results, partial, to.mark)

    return [drop_tables(results)], {
        "json": lambda to: write_json_to(to, drop_json(results)),
        "csv": lambda to: write_text_to(to, drop_csv(results)),
        "png": write_png,
        "rrd": write_rrd,
    }


def _motion(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    """Run table 3."""
    from analysis.evaluation.motion.records import motion_csv, motion_json
    from analysis.evaluation.motion.run import run_motion
    from analysis.evaluation.motion.tables import motion_lines
    from analysis.optional_dependencies import needed

    needed("torch")
    targets = arguments.targets
    rows = run_motion(seeds, targets, arguments.jobs, progress, _effort(arguments))
    return [motion_lines(rows, seeds, targets)], {
        "json": lambda to: write_json_to(to, motion_json(rows, seeds, targets)),
        "csv": lambda to: write_text_to(to, motion_csv(rows, seeds)),
    }


def _intervals(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    """Measure the coverage of the intervals of recorded drops."""
    from analysis.evaluation.drop.intervals import interval_coverages
    from analysis.evaluation.drop.records import intervals_csv, intervals_json
    from analysis.evaluation.drop.tables import coverage_table

    targets = arguments.targets
    rows = interval_coverages(seeds, targets, arguments.jobs, progress)
    return [coverage_table(rows)], {
        "json": lambda to: write_json_to(to, intervals_json(rows, seeds, targets)),
        "csv": lambda to: write_text_to(to, intervals_csv(rows)),
    }


def _payload(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    """Run table 1, and payloads in logs like a real driver's and of strangers' arms."""
    from analysis.evaluation.payload.logs import LogRow, log_rows
    from analysis.evaluation.payload.masses import MassOrder, MassRow, mass_rows
    from analysis.evaluation.payload.records import payload_csv, payload_json
    from analysis.evaluation.payload.stranger_conventions import ConventionRow, convention_rows
    from analysis.evaluation.payload.strangers import StrangerRow, stranger_rows
    from analysis.evaluation.payload.tables import (
        convention_table,
        log_table,
        mass_table,
        stranger_table,
    )
    from analysis.optional_dependencies import needed

    wanted = chosen_sections(arguments, PAYLOAD_SECTIONS, TYPICAL_PAYLOAD_SECTIONS)
    if "masses" in wanted:
        needed("torch")
    effort = (arguments.pairs, arguments.epochs)
    targets = arguments.targets
    order = MassOrder(seeds, targets or FULL_PAYLOAD, arguments.jobs, *effort)
    masses: list[MassRow] = []
    logs: list[LogRow] = []
    strangers: list[StrangerRow] = []
    conventions: list[ConventionRow] = []

    def blocks() -> Iterator[str]:
        if "masses" in wanted:
            masses.extend(mass_rows(order, progress))
            yield mass_table(masses, order)
        if "logs" in wanted:
            count = max(1, order.targets * 2 // 3)
            logs.extend(log_rows(seeds, count, order.jobs, progress))
            yield log_table(logs)
        if "strangers" in wanted:
            count = targets or FULL_STRANGERS
            strangers.extend(stranger_rows(seeds, count, order.jobs, progress))
            yield stranger_table(strangers)
        if "conventions" in wanted:
            count = targets or FULL_CONVENTIONS
            conventions.extend(convention_rows(seeds, count, order.jobs, progress))
            yield convention_table(conventions)

    return blocks(), {
        "json": lambda path: write_json_to(
            path, payload_json(masses, logs, order, strangers, conventions)
        ),
        "csv": lambda to: write_text_to(to, payload_csv(masses, order)),
    }


def _bounce_shot(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    """Run the third experiment, in a hidden world."""
    from math import ceil as round_up

    from analysis.evaluation.shots.acceptance import DROPS, JudgedDrop, judged_drops
    from analysis.evaluation.shots.campaign import TrialResult, run_campaign
    from analysis.evaluation.shots.records import shot_csv, shot_json
    from analysis.evaluation.shots.tables import acceptance_table, campaign_table
    from analysis.optional_dependencies import needed

    wanted = chosen_sections(arguments, SHOT_SECTIONS)
    if "campaigns" in wanted:
        needed("torch")
    results: list[TrialResult] = []
    bad: list[JudgedDrop] = []
    good: list[JudgedDrop] = []

    def blocks() -> Iterator[str]:
        if "campaigns" in wanted:
            for seed in seeds:
                folder = arguments.campaign if seed == seeds[0] else None
                done = run_campaign(
                    *(seed, arguments.targets, arguments.jobs, progress),
                    folder=folder,
                    effort=_effort(arguments),
                )
                results.extend(done)
            yield campaign_table(results)
        if "drops" in wanted:
            count = round_up(DROPS * min(arguments.targets / FULL_SHOT, 1.0))
            judged = judged_drops(seeds[0], count, arguments.jobs, progress)
            bad.extend(judged[0])
            good.extend(judged[1])
            yield acceptance_table(bad, good)

    return blocks(), {
        "json": lambda to: write_json_to(to, shot_json(results, bad, good)),
        "csv": lambda to: write_text_to(to, shot_csv(results)),
    }


def _video(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    """Run tracks and clips of filmed drops."""
    from math import ceil as round_up

    from analysis.evaluation.clips.run import (
        COUNT,
        TRANSFORMED,
        ClipResult,
        TransformedClip,
        clip_results,
        transformed_results,
    )
    from analysis.evaluation.clips.tables import clip_table, transformed_table
    from analysis.evaluation.video.records import video_csv, video_json
    from analysis.evaluation.video.run import VideoOrder, VideoRow, track_sections
    from analysis.evaluation.video.sections import TRACK_SECTIONS, Section
    from analysis.evaluation.video.tables import video_blocks

    wanted = chosen_sections(arguments, SECTIONS)
    chosen = tuple(section for section in TRACK_SECTIONS if section.name in wanted)
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
        seed, fraction = seeds[0], min(arguments.targets / FULL_VIDEO, 1.0)
        if "clips" in wanted:
            clips.extend(clip_results(seed, round_up(COUNT * fraction), order.jobs, progress))
            yield clip_table(clips)
        if "transformed" in wanted:
            count = round_up(TRANSFORMED * fraction)
            transformed.extend(transformed_results(seed, count, order.jobs, progress))
            yield transformed_table(transformed)

    return blocks(), {
        "json": lambda to: write_json_to(to, video_json(rows, order, clips, transformed)),
        "csv": lambda to: write_text_to(to, video_csv(rows)),
    }


def _real_balls(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    """Run balls in air, as positions and as videos."""
    from analysis.evaluation.real_balls.figures import RealLine
    from analysis.evaluation.real_balls.records import real_csv, real_json
    from analysis.evaluation.real_balls.run import (
        RealOrder,
        ball_lines,
        film_lines,
        position_lines,
    )
    from analysis.evaluation.real_balls.tables import protocol, section_blocks

    wanted = chosen_sections(arguments, REAL_SECTIONS)
    order = RealOrder(seeds, arguments.targets, arguments.jobs)
    lines: list[RealLine] = []

    def blocks() -> Iterator[str]:
        yield protocol(order)
        runs = zip(REAL_SECTIONS, (position_lines, ball_lines, film_lines), strict=True)
        for section, run in runs:
            if section in wanted:
                found = run(order, progress)
                lines.extend(found)
                yield from section_blocks(section, found)

    return blocks(), {
        "json": lambda to: write_json_to(to, real_json(lines, order)),
        "csv": lambda to: write_text_to(to, real_csv(lines)),
    }


def _engines(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    """Tune the targets of each engine in each."""
    from analysis.evaluation.engines.records import engines_csv, engines_json
    from analysis.evaluation.engines.run import EngineOrder, engine_lines
    from analysis.evaluation.engines.tables import engine_tables

    order = EngineOrder(seeds, arguments.targets, arguments.jobs)
    lines = engine_lines(order, progress)
    return [engine_tables(lines, order)], {
        "json": lambda to: write_json_to(to, engines_json(lines, order)),
        "csv": lambda to: write_text_to(to, engines_csv(lines)),
    }


def _effort(arguments: argparse.Namespace) -> Effort:
    from analysis.evaluation.drop.networks import Effort

    return Effort(arguments.pairs, arguments.epochs)


EXPERIMENTS: dict[str, Experiment] = {
    "payload": _payload,
    "drop": _drop,
    "motion": _motion,
    "intervals": _intervals,
    "video": _video,
    "real-balls": _real_balls,
    "bounce-shot": _bounce_shot,
    "engines": _engines,
    "sysid": print_sysid,
    "sound": print_sound,
}
