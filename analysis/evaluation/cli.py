"""Run `tunenet-eval`: the paper's experiments and the product's promises, measured anew."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from tunenet_logs.analysis.evaluation.study import (
    METHODS,
    OWN,
    STUDIES,
    Order,
    Part,
    Study,
    chosen_names,
    figure_place,
    write_figures,
)
from tunenet_logs.analysis.options import TuneOptions, jobs_option, json_option, options_of
from tunenet_logs.console import Parser, add_options, given, is_stdout, options_in, run, whole
from tunenet_logs.errors import UsageError, pip_install
from tunenet_logs.files import real_path
from tunenet_logs.terminal import Progress, one_line
from tunenet_logs.writing.owned_path import OutputPlace

_DESCRIPTION = """\
Repeat an experiment of the TuneNet paper from nothing, training and test targets drawn
anew for each seed, and print its figures beside the paper's.

{studies}

Needs the libraries of the extra 'eval': {install}."""

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
  tunenet-eval own run.mcap --model robot.xml --tune joint/elbow.damping=0:5
  tunenet-eval sound --targets 20 --sections alone,negatives   (a few minutes)
  tunenet-eval sound                                 (over an hour on two cores)"""


def build_parser() -> Parser:
    """Build the parser of the command's arguments."""
    studies = "\n".join(
        f"  {name:12} " + study.summary.replace("\n", "\n" + 15 * " ")
        for name, study in STUDIES.items()
    )
    parser = Parser(
        "tunenet-eval",
        _DESCRIPTION.format(studies=studies, install=pip_install("eval")),
        _EXAMPLES,
        failed="a figure could not be made or written",
    )
    add = parser.add_argument
    add("experiment", choices=list(STUDIES), help="which experiment")
    add(
        "log",
        nargs="?",
        type=Path,
        metavar="LOG",
        help="own only: the log that drives the model (default: a motion made for it)",
    )
    add(
        "--seeds",
        type=whole(1, 1000),
        metavar="N",
        help=f"how many, each with its own training and targets (default: {_sizes('seeds')})",
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
        help=f"test targets for each seed and set (default: {_sizes('targets')}; sections: "
        f"{_own_sizes()}; payload, but masses: logs in all, of logs two thirds as many)",
    )
    jobs_option(parser, "processes")
    parts = parser.add_argument_group(
        "studies with sections",
        "\n".join(
            f"sections of {name}: {', '.join(study.sections)}"
            for name, study in STUDIES.items()
            if study.sections
        ),
    )
    parts.add_argument(
        "--sections",
        metavar="A,B,...",
        help=f"only these tables (default: all; {_left_out()})",
    )
    drop = parser.add_argument_group(
        "drop only", "\n".join(f"{kind}: {', '.join(names)}" for kind, names in METHODS.items())
    )
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
    parser.add_argument_group("bounce-shot only").add_argument(
        "--campaign",
        type=Path,
        metavar="DIR",
        help="keep the first seed's logs, tunings and outcomes in this folder (1 GB)",
    )
    own = parser.add_argument_group("own only, as of tunenet-tune")
    add_options(TuneOptions, lambda _: own, OWN)
    files = parser.add_argument_group("files (replaced if they exist)")
    json_option(files, "every figure, and the curves,")
    files.add_argument("--csv", type=Path, metavar="FILE", help="one row for each figure")
    add("--overwrite", action="store_true", help="replace figures of another experiment")
    add("--quiet", action="store_true", help="no progress bar")
    for name in ("--pairs", "--epochs"):  # of training, to try things out
        add(name, type=whole(1, 1_000_000), help=argparse.SUPPRESS)
    return parser


def _sizes(what: str) -> str:
    """List the default of most studies, and those that differ: "3; payload: 5"."""
    usual = getattr(Study, what)
    others: dict[int, list[str]] = {}
    for name, study in STUDIES.items():
        if getattr(study, what) != usual:
            others.setdefault(getattr(study, what), []).append(name)
    return "; ".join([str(usual), *(f"{', '.join(who)}: {n}" for n, who in others.items())])


def _own_sizes() -> str:
    """List the sizes of sections that are not their study's."""
    return ", ".join(
        f"{section} {size}"
        for study in STUDIES.values()
        for section, size in study.sections.items()
        if size != study.targets
    )


def _left_out() -> str:
    """List the sections that run only where they are named."""
    return "; ".join(
        f"{name}: not {', '.join(one for one in study.sections if one not in study.usual)}"
        for name, study in STUDIES.items()
        if study.usual
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet-eval`."""
    return run(build_parser(), _eval, argv)


def _eval(arguments: argparse.Namespace) -> int:
    name = arguments.experiment
    places = _checked(arguments)
    study = STUDIES[name]
    sections = tuple(study.sections)
    if arguments.sections is not None:
        sections = chosen_names(arguments.sections, "sections", sections)
    methods = arguments.methods
    if methods is not None:
        methods = chosen_names(
            methods, "methods", [one for some in METHODS.values() for one in some]
        )
    first = arguments.first_seed
    order = Order(
        seeds=tuple(range(first, first + (arguments.seeds or study.seeds))),
        targets=arguments.targets or study.targets,
        sections=sections if arguments.sections is not None else study.usual or sections,
        jobs=arguments.jobs,
        is_full=arguments.targets is None,
        methods=methods,
        rollouts=arguments.rollouts,
        pairs=arguments.pairs,
        epochs=arguments.epochs,
        campaign=arguments.campaign,
        own=_own(arguments) if name == "own" else None,
        drawn=tuple(form for form in ("png", "rrd") if form in places),
    )
    module, _, function = study.module.partition(".")
    run_study = getattr(
        import_module(f"tunenet_logs.analysis.evaluation.studies.{module}"), function or "run"
    )
    to_stdout = arguments.json is not None and is_stdout(arguments.json)
    parts: list[Part] = []
    for part in run_study(order, Progress(quiet=arguments.quiet)):
        parts.append(part)
        if not to_stdout:
            print(part.text + "\n", flush=True)
    for form, place in places.items():
        write_figures(name, order, parts, form, place)
        if not to_stdout:
            print(f"{form}: {'rerun ' if form == 'rrd' else ''}{one_line(place.path)}")
    return 0


def _own(arguments: argparse.Namespace) -> tuple[TuneOptions, Path | None]:
    """Return the user's model with what is tuned of it, and the log; UsageError without one."""
    if arguments.model is None:
        raise UsageError("own is about a model of one's own; name it with --model")
    options, log = options_of(given(arguments, TuneOptions)), arguments.log
    assert options.source is not None
    _ = options.source.parameters  # what is wrong with them is told before any work
    return options, log


# Options that some studies have, by their names in Python, as a command spells them.
_OF_SOME = {
    **{name: f"--{name}" for name in ("sections", "methods", "rollouts", "png", "rrd", "campaign")},
    **{name: one.flag_of(name) for name, one in options_in(TuneOptions).items() if name in OWN},
    "log": "a LOG",
}


def _checked(arguments: argparse.Namespace) -> dict[str, OutputPlace]:
    """Refuse at once what would fail after the work; return where the files go, by their forms."""
    what = arguments.experiment
    for option, flag in _OF_SOME.items():
        having = [name for name, study in STUDIES.items() if _has(study, option)]
        if getattr(arguments, option) is not None and what not in having:
            *most, last = having
            raise UsageError(
                f"{flag} is for {', '.join(most)}{' and ' if most else ''}{last}, not {what}; "
                "leave it out"
            )
    folder = arguments.campaign
    if folder is not None and folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder}: is there already; give --campaign a new folder")
    taken: dict[Path, str] = {}
    places: dict[str, OutputPlace] = {}
    for form in STUDIES[what].files:
        path = getattr(arguments, form)
        if path is None:
            continue
        places[form] = figure_place(what, form, path, overwrite=arguments.overwrite)
        if form == "json" and is_stdout(path):
            continue
        if is_stdout(path):
            raise UsageError(f"--{form} -: only --json goes to standard output; name a file")
        other = taken.setdefault(real_path(path), form)
        if other != form:
            raise UsageError(f"{path}: both --{other} and --{form} name it; give each its own")
        places[form].check()
        if form in ("png", "rrd") and path.suffix != f".{form}":
            raise UsageError(f"{path}: --{form} writes .{form}; give the file a name that ends so")
    return places


def _has(study: Study, option: str) -> bool:
    return option in (*study.files, *study.options) or (
        option == "sections" and bool(study.sections)
    )


if __name__ == "__main__":
    sys.exit(main())
