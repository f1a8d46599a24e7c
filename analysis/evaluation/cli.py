"""Run `tunenet-eval`: the paper's experiments, its figures beside ours.

Each experiment has a function that runs it, yields its tables as they are done, and names the
writers of the files that it can write. The command's options follow.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.analysis.evaluation.study import (
    FULL_CONVENTIONS,
    FULL_ENGINES,
    FULL_PAYLOAD,
    FULL_REAL,
    FULL_SHOT,
    FULL_SOUND,
    FULL_STRANGERS,
    FULL_SYSID,
    FULL_VIDEO,
    METHODS,
    PAYLOAD_SECTIONS,
    REAL_SECTIONS,
    SECTIONS,
    SHOT_SECTIONS,
    SOUND_SECTIONS,
    SYSID_SECTIONS,
    TYPICAL_PAYLOAD_SECTIONS,
    FigurePlace,
    chosen_names,
    chosen_sections,
    write_json_to,
    write_text_to,
)
from tunenet_logs.analysis.options import jobs_option, json_option
from tunenet_logs.console import Parser, is_stdout, run, whole
from tunenet_logs.errors import UsageError
from tunenet_logs.files import real_path
from tunenet_logs.terminal import Progress, one_line

if TYPE_CHECKING:
    from tunenet_logs.analysis.evaluation.studies.drop_methods import Effort


# What an experiment can write, once all of its text is printed.
Writers = dict[str, Callable[[FigurePlace], None]]

# Runs with options and seeds; gives blocks of text as they are done, and the files' writers.
Experiment = Callable[
    [argparse.Namespace, tuple[int, ...], Progress], tuple[Iterable[str], Writers]
]


def _drop(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    """Run table 2, its figure and the intervals."""
    from tunenet_logs.analysis.evaluation.studies.drop import (
        DropExperiment,
        drop_csv,
        drop_json,
        drop_tables,
        run_drop,
        write_figure,
    )
    from tunenet_logs.analysis.evaluation.studies.drop_methods import choose_methods
    from tunenet_logs.analysis.registry import needed

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
        from tunenet_logs.analysis.evaluation.studies.review import write_convergence

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
    from tunenet_logs.analysis.evaluation.studies.motion import (
        motion_csv,
        motion_json,
        motion_lines,
        run_motion,
    )
    from tunenet_logs.analysis.registry import needed

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
    from tunenet_logs.analysis.evaluation.studies.drop import (
        coverage_table,
        intervals_csv,
        intervals_json,
    )
    from tunenet_logs.analysis.evaluation.studies.drop_methods import interval_coverages

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
    from tunenet_logs.analysis.evaluation.studies.payload import (
        ConventionRow,
        LogRow,
        MassOrder,
        MassRow,
        StrangerRow,
        convention_rows,
        convention_table,
        log_rows,
        log_table,
        mass_rows,
        mass_table,
        payload_csv,
        payload_json,
        stranger_rows,
        stranger_table,
    )
    from tunenet_logs.analysis.registry import needed

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

    from tunenet_logs.analysis.evaluation.studies.bounce_shot import (
        DROPS,
        JudgedDrop,
        TrialResult,
        acceptance_table,
        campaign_table,
        judged_drops,
        run_campaign,
        shot_csv,
        shot_json,
    )
    from tunenet_logs.analysis.registry import needed

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

    from tunenet_logs.analysis.evaluation.studies.video import (
        COUNT,
        TRACK_SECTIONS,
        TRANSFORMED,
        ClipResult,
        Section,
        TransformedClip,
        VideoOrder,
        VideoRow,
        clip_results,
        clip_table,
        track_sections,
        transformed_results,
        transformed_table,
        video_blocks,
        video_csv,
        video_json,
    )

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
    from tunenet_logs.analysis.evaluation.studies.real_balls import (
        RealLine,
        RealOrder,
        ball_lines,
        film_lines,
        position_lines,
        protocol,
        real_csv,
        real_json,
        section_blocks,
    )

    wanted = chosen_sections(arguments, REAL_SECTIONS)
    order = RealOrder(seeds, arguments.targets, arguments.jobs)
    lines: list[RealLine] = []

    def blocks() -> Iterator[str]:
        yield protocol(order)
        runs = zip(REAL_SECTIONS, (position_lines, ball_lines, film_lines), strict=True)
        for section, measured in runs:
            if section in wanted:
                found = measured(order, progress)
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
    from tunenet_logs.analysis.evaluation.studies.engines import (
        EngineOrder,
        engine_lines,
        engine_tables,
        engines_csv,
        engines_json,
    )

    order = EngineOrder(seeds, arguments.targets, arguments.jobs)
    lines = engine_lines(order, progress)
    return [engine_tables(lines, order)], {
        "json": lambda to: write_json_to(to, engines_json(lines, order)),
        "csv": lambda to: write_text_to(to, engines_csv(lines)),
    }


def _sysid(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    """Tune users' models from logs of machines that no engine simulated; see `Experiment`."""
    from tunenet_logs.analysis.evaluation.studies.sysid import (
        SysidOrder,
        SysidOutcome,
        sysid_csv,
        sysid_json,
        sysid_sections,
        sysid_table,
    )

    wanted = chosen_sections(arguments, SYSID_SECTIONS)
    order = SysidOrder(seeds, arguments.targets, wanted, arguments.jobs)
    all_of_them: list[SysidOutcome] = []

    def blocks() -> Iterator[str]:
        for section, outcomes in sysid_sections(order, progress):
            all_of_them.extend(outcomes)
            yield sysid_table(section, outcomes, order)

    return blocks(), {
        "json": lambda to: write_json_to(to, sysid_json(all_of_them, order)),
        "csv": lambda to: write_text_to(to, sysid_csv(all_of_them)),
    }


def _sound(
    arguments: argparse.Namespace, seeds: tuple[int, ...], progress: Progress
) -> tuple[Iterable[str], Writers]:
    """Run bounces by ear, alone and beside pictures; see `Experiment`."""
    from tunenet_logs.analysis.evaluation.studies.audio import (
        SoundOrder,
        SoundOutcome,
        sound_csv,
        sound_json,
        sound_sections,
        sound_table,
    )

    wanted = chosen_sections(arguments, SOUND_SECTIONS)
    order = SoundOrder(seeds, arguments.targets, wanted, arguments.jobs)
    found: list[tuple[str, SoundOutcome]] = []

    def blocks() -> Iterator[str]:
        for section, outcomes in sound_sections(order, progress):
            if section != "phyphox" or "alone" not in wanted:
                found.extend((section, one) for one in outcomes)
            yield sound_table(section, outcomes, order)

    return blocks(), {
        "json": lambda to: write_json_to(to, sound_json(found, order)),
        "csv": lambda to: write_text_to(to, sound_csv(found)),
    }


def _effort(arguments: argparse.Namespace) -> Effort:
    from tunenet_logs.analysis.evaluation.studies.drop_methods import Effort

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
    "sysid": _sysid,
    "sound": _sound,
}


# ---- Command line: options, and what is refused before any work.


_DESCRIPTION = """\
Repeat an experiment of the TuneNet paper from nothing, training and test targets drawn
anew for each seed, and print its figures beside the paper's.

  payload    the mass in an arm's gripper from its torques: the paper's masses (table 1), and
             logs like a real driver's, with a bound; only where they are named, its sections
             "strangers": arms that share no code with the fit, beside what one would write in
             an hour, and "conventions": what their drivers mean by torque
  drop       restitution of a bouncing ball from its height: every method of the paper,
             what a user would pick instead, and ours, by rollouts spent (table 2, figure)
  motion     where the ball will be: tuned simulators and one-step predictors (table 3)
  intervals  how often the 95 % intervals of recorded drops contain the truth; part of drop
  video      restitution from tracks of filmed drops, good and bad ones: errors, intervals,
             verdicts
  real-balls  balls in air whose restitution falls with speed, as positions and as films: each
             parameter, its interval, and whether the tuned simulator moves like the ball
  bounce-shot  drop, record, tune, plan, shoot, in a hidden world with air, spin, balls out of
             round and drops that leave the table: the paper's policy and ours
  engines    drops made by each physics engine and by an exact integrator, tuned in each:
             effective restitutions and motions beside each other
  sysid      users' own models: a pendulum, an arm with a payload and late commands, a block that
             slides, as SciPy integrates them: errors, intervals, what a log cannot tell, models
             of other machines, the network's first step, and mujoco.sysid beside it
  sound      bounces by ear: sounds that are made by code, alone and beside films, with speech,
             music and noise behind them; phyphox's way beside it, and sounds that are no bounce

Needs the libraries of the extra 'eval': pip install 'tunenet-logs[eval]'."""

_EXAMPLES = """\
  tunenet-eval drop                                  (over half an hour on two cores)
  tunenet-eval drop --seeds 1 --targets 20           (a few minutes)
  tunenet-eval drop --first-seed 11 --seeds 10 --rollouts 5   (the documents' headline)
  tunenet-eval drop --methods mean,secant,tunenet-paper-code --seeds 1
  tunenet-eval drop --json drop.json --csv drop.csv --png drop.png --rrd drop.rrd
  tunenet-eval motion --json motion.json
  tunenet-eval payload --sections logs
  tunenet-eval payload --sections strangers          (over an hour on two cores)
  tunenet-eval video --targets 20 --sections set-B,bad
  tunenet-eval real-balls --seeds 1 --targets 40     (a few minutes)
  tunenet-eval bounce-shot --seeds 1 --targets 12    (a few minutes)
  tunenet-eval bounce-shot --seeds 1 --campaign shots   (keeps logs, tunings, outcomes)
  tunenet-eval engines --seeds 1                     (a few minutes)
  tunenet-eval sysid --targets 10 --sections tuned   (ten logs of each machine)
  tunenet-eval sysid                                 (hours on two cores)
  tunenet-eval sound --targets 20 --sections alone,negatives   (a few minutes)
  tunenet-eval sound                                 (over an hour on two cores)"""

_METHODS_HELP = f"""\
methods of the paper: {", ".join(METHODS[:6])}
what a user would pick: {", ".join(METHODS[6:11])}
ours: {", ".join(METHODS[11:13])}
the ablation, which has no curve in the figure: {", ".join(METHODS[13:])}"""

_FILES = ("json", "csv", "png", "rrd")  # options that name a file to write, in that order
_ONLY_DROP = ("methods", "rollouts", "png", "rrd")
_TARGETS = {
    "video": FULL_VIDEO,
    "payload": None,
    "real-balls": FULL_REAL,
    "bounce-shot": FULL_SHOT,
    "engines": FULL_ENGINES,
    "sysid": FULL_SYSID,
    "sound": FULL_SOUND,
}
_WITH_SECTIONS = ("video", "payload", "real-balls", "bounce-shot", "sysid", "sound")
_WITH_SECTIONS_IN_WORDS = f"{', '.join(_WITH_SECTIONS[:-1])} and {_WITH_SECTIONS[-1]}"
_SEEDS = {"payload": 5, "sysid": 1, "sound": 1}
_DEFAULT_SEEDS = 3
# Unless an experiment has its own above, or its sections have; 100 targets as in the paper.
_DEFAULT_TARGETS = 100


def build_parser() -> Parser:
    """Build the parser of the command's arguments."""
    parser = Parser(
        "tunenet-eval", _DESCRIPTION, _EXAMPLES, failed="a figure could not be made or written"
    )
    add = parser.add_argument
    add("experiment", choices=list(EXPERIMENTS), help="which experiment")
    add(
        "--seeds",
        type=whole(1, 1000),
        metavar="N",
        help="how many, each with its own training and targets (default: 3; payload: 5; sysid, "
        "sound: 1)",
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
        help="test targets for each seed and set (default: 100; video, real-balls: 200; payload: "
        "300, and two thirds as many logs in all, strangers: 400 logs a cell, conventions: 1000 "
        "logs; bounce-shot: 60 trials a campaign; engines: 10; sysid: 200 logs a machine; "
        "sound: 200)",
    )
    jobs_option(parser, "processes")
    _options_of_some(parser)
    files = parser.add_argument_group("files (replaced if they exist)")
    json_option(files, "every figure, and the curves,")
    files.add_argument(
        "--csv", type=Path, metavar="FILE", help="one row for each method, budget and seed, or line"
    )
    add("--overwrite", action="store_true", help="replace figures of another experiment")
    add("--quiet", action="store_true", help="no progress bar")
    for name in ("--pairs", "--epochs"):  # of training, to try things out
        add(name, type=whole(1, 1_000_000), help=argparse.SUPPRESS)
    return parser


def _options_of_some(parser: Parser) -> None:
    """Add the options that only some experiments have."""
    drop = parser.add_argument_group("drop only", _METHODS_HELP)
    drop.add_argument(
        "--methods", metavar="A,B,...", help="only these, and no intervals (default: all)"
    )
    drop.add_argument(
        "--rollouts",
        type=whole(1, 100),
        metavar="N",
        help="most that a method may spend on a target; columns beyond are left out (default: 100, "
        "with limits of the calibrated simulator and of noise)",
    )
    drop.add_argument(
        "--png", type=Path, metavar="FILE", help="the figure: error against rollouts, as a picture"
    )
    drop.add_argument(
        "--rrd", type=Path, metavar="FILE", help="the figure for Rerun, with the tables"
    )
    parts = parser.add_argument_group(
        f"{_WITH_SECTIONS_IN_WORDS} only",
        "\n".join(
            f"tables of {name}: {', '.join(sections)}"
            for name, sections in (
                ("video", SECTIONS),
                ("payload", PAYLOAD_SECTIONS),
                ("real-balls", REAL_SECTIONS),
                ("bounce-shot", SHOT_SECTIONS),
                ("sysid", SYSID_SECTIONS),
                ("sound", SOUND_SECTIONS),
            )
        ),
    )
    parts.add_argument(
        "--sections",
        metavar="A,B,...",
        help=f"only these tables (default: all; payload: {', '.join(TYPICAL_PAYLOAD_SECTIONS)})",
    )
    shot = parser.add_argument_group("bounce-shot only")
    shot.add_argument(
        "--campaign",
        type=Path,
        metavar="DIR",
        help="keep the first seed's logs, tunings and outcomes in this folder (1 GB)",
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet-eval`."""
    return run(build_parser(), _eval, argv)


def _eval(arguments: argparse.Namespace) -> int:
    places = _checked(arguments)

    progress = Progress(quiet=arguments.quiet)
    count = arguments.seeds or _SEEDS.get(arguments.experiment, _DEFAULT_SEEDS)
    seeds = tuple(range(arguments.first_seed, arguments.first_seed + count))
    if arguments.targets is None:
        arguments.targets = _TARGETS.get(arguments.experiment, _DEFAULT_TARGETS)
    blocks, writers = EXPERIMENTS[arguments.experiment](arguments, seeds, progress)
    to_stdout = arguments.json is not None and is_stdout(arguments.json)
    for block in blocks:
        if not to_stdout:
            print(block + "\n", flush=True)
    for name in _FILES:
        if name in places:
            writers[name](places[name])
            if not to_stdout:
                path = one_line(places[name].place.path)
                print(f"{name}: {'rerun ' if name == 'rrd' else ''}{path}")
    return 0


def _check_options(arguments: argparse.Namespace) -> None:
    """Refuse the options of another experiment."""
    what = arguments.experiment
    if what != "drop":
        for name in _ONLY_DROP:
            if getattr(arguments, name) is not None:
                raise UsageError(f"--{name} is for drop, not {what}; leave it out")
    if what not in _WITH_SECTIONS and arguments.sections is not None:
        others = _WITH_SECTIONS_IN_WORDS
        raise UsageError(f"--sections is for {others}, not {what}; leave it out")
    folder = arguments.campaign
    if folder is not None and what != "bounce-shot":
        raise UsageError(f"--campaign is for bounce-shot, not {what}; leave it out")
    if folder is not None and folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder}: is there already; give --campaign a new folder")


def _checked(arguments: argparse.Namespace) -> dict[str, FigurePlace]:
    """Refuse at once what would fail after the work; return where the files go, by option."""
    _check_options(arguments)
    taken: dict[Path, str] = {}
    places: dict[str, FigurePlace] = {}
    for name in _FILES:
        path = getattr(arguments, name)
        if path is None:
            continue
        what, overwrite = arguments.experiment, arguments.overwrite
        places[name] = FigurePlace.of(what, name, path, overwrite=overwrite)
        if name == "json" and is_stdout(path):
            continue
        if is_stdout(path):
            raise UsageError(f"--{name} -: only --json goes to standard output; name a file")
        other = taken.setdefault(real_path(path), name)
        if other != name:
            raise UsageError(f"{path}: both --{other} and --{name} name it; give each its own")
        places[name].place.check()
        if name in ("png", "rrd") and path.suffix != f".{name}":
            raise UsageError(f"{path}: --{name} writes .{name}; give the file a name that ends so")
    return places


if __name__ == "__main__":
    sys.exit(main())
