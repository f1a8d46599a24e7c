"""tunenet-plan: plan a robot's bounce shot from a tuned ball."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.analysis.options import json_option
from tunenet_logs.console import Parser, is_stdout, number, run, whole
from tunenet_logs.errors import UsageError
from tunenet_logs.files import real_path
from tunenet_logs.recorders.simulators.known import engine_option, in_engine
from tunenet_logs.terminal import one_line

if TYPE_CHECKING:
    from tunenet_logs.analysis.planning import KnownBall
    from tunenet_logs.recorders.simulators.shot import ShotRig
    from tunenet_logs.writing.owned_path import OutputPlace

_DESCRIPTION = """\
Choose the height from which to let a ball go above an inclined plane, so that it
bounces through a hoop (the paper's third experiment). 100 heights, evenly over what
the robot reaches, are tried in a simulator with air, friction, spin and a real rim;
of those that pass, the best is the one that forgives most: in restitution, height and
drag, each by how well it is known. Restitution, its slope over speed and drag are those
that were tuned; the restitution is that at the shot's own speed."""

_EXAMPLES = """\
  tunenet-plan drop.json
  tunenet-plan drop.json --rig myrig.yaml --json plan.json --rrd plan.rrd
  tunenet-plan --restitution 0.74
  tunenet-plan --restitution 0.74 --slope 0.08     (at 3 m/s; less at higher speeds)
  tunenet-plan --save-rig myrig.yaml               (the default rig, to edit)"""


def build_parser() -> Parser:
    """Build the argument parser."""
    parser = Parser(
        "tunenet-plan",
        _DESCRIPTION,
        _EXAMPLES,
        failed="no shot goes in, or the tuning was rejected or cannot be read",
    )
    add = parser.add_argument
    add("tuning", nargs="?", type=Path, metavar="TUNING.json", help="what tunenet-tune wrote")
    add("--restitution", type=number(0, 1), metavar="E", help="of the ball, in place of a tuning")
    add(
        "--slope",
        type=number(-1, 1),
        metavar="P",
        help="with --restitution: how it falls with speed, (v / 3 m/s)^-P (default: 0)",
    )
    add(
        "--drag",
        type=number(0, 10),
        metavar="K",
        help="with --restitution: of the air, the ball's deceleration over speed squared [1/m] "
        "(default: by size and mass of the rig's ball)",
    )
    add("--rig", type=Path, metavar="FILE.yaml", help="your rig (default: the built-in one)")
    add("--save-rig", type=Path, metavar="FILE.yaml", help="write the rig to edit, and stop")
    add(
        "--shots",
        type=whole(2, 10_000),
        default=100,
        metavar="N",
        help="heights to try (default: 100, as the paper)",
    )
    add(
        "--restitution-sd",
        type=number(0, 0.5),
        metavar="SD",
        help="with --restitution: its standard deviation (default: .01)",
    )
    engine_option(parser)
    files = parser.add_argument_group("files (a plan of the same log is replaced)")
    json_option(files, "the plan, with each shot that was tried,", "-o")
    files.add_argument("--rrd", type=Path, metavar="FILE", help="the shots, for Rerun")
    files.add_argument("--overwrite", action="store_true", help="replace plans of other logs")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet-plan`."""
    return run(build_parser(), in_engine(_plan), argv)


def _plan(arguments: argparse.Namespace) -> int:
    from tunenet_logs.analysis.result_files import write_json
    from tunenet_logs.recorders.simulators.shot import ShotRig, read_rig

    rig = ShotRig() if arguments.rig is None else read_rig(arguments.rig)
    if arguments.save_rig is not None:
        return _save_rig(arguments, rig)
    _refuse_own_input(arguments)
    ball = _ball(arguments, rig)
    places = _places(arguments, ball)
    for path, place in places.items():
        if not is_stdout(path):
            place.check()
    if arguments.rrd is not None and arguments.rrd.suffix != ".rrd":
        raise UsageError(f"{arguments.rrd}: Rerun opens .rrd; give --rrd a name that ends so")

    from tunenet_logs.analysis.planning import plan_json, plan_shot, plan_table, replayed

    plan = plan_shot(rig, ball, arguments.shots)
    replay = replayed(plan)
    shows_table = arguments.json is None or not is_stdout(arguments.json)
    if shows_table:
        print(plan_table(plan, replay))
    for warning in plan.warnings:
        print(one_line(f"tunenet-plan: {warning}"), file=sys.stderr)
    if arguments.json is not None:
        write_json(places[arguments.json], plan_json(plan, replay))
    if arguments.rrd is not None:
        from tunenet_logs.analysis.review.tuning import write_shots

        with places[arguments.rrd].replacing() as partial:
            write_shots(plan, partial)
        if shows_table:
            print(f"\nreview: rerun {one_line(arguments.rrd)}")
    return int(plan.best is None)


def _save_rig(arguments: argparse.Namespace, rig: ShotRig) -> int:
    """Write a new file; an existing one may have been edited and is not replaced."""
    from tunenet_logs.recorders.simulators.shot import rig_text
    from tunenet_logs.writing.owned_path import write_new

    for name in ("tuning", "restitution", "slope", "restitution_sd", "drag", "json", "rrd"):
        if getattr(arguments, name) is not None:
            option = name.replace("_", "-")
            raise UsageError(f"--save-rig plans nothing; leave {option} out")
    path = arguments.save_rig
    try:
        write_new(path, rig_text(rig).encode())
    except FileExistsError as error:
        raise UsageError(f"{path}: exists; give --save-rig another name") from error
    except OSError as error:
        raise UsageError(f"{path}: cannot be written ({error.strerror})") from error
    print(f"rig: {one_line(path)}; edit it, then give it to --rig")
    return 0


def _places(arguments: argparse.Namespace, ball: KnownBall) -> dict[Path, OutputPlace]:
    """Return the output places of the plan by the paths that were given."""
    from tunenet_logs.analysis.result_files import in_words, marked, recording, subject_of
    from tunenet_logs.writing.owned_path import OutputPlace

    kinds = {
        "json": ("plan", marked("json", "plan", ball.logs)),
        "rrd": ("recording of shots", recording("shot", subject_of(ball.logs))),
    }
    return {
        path: OutputPlace(
            path,
            what,
            knows,
            in_words(ball.logs) or "a ball that is told",
            f"give --{name} another file",
            overwrite=arguments.overwrite,
        )
        for name, (what, knows) in kinds.items()
        if (path := getattr(arguments, name)) is not None
    }


def _ball(arguments: argparse.Namespace, rig: ShotRig) -> KnownBall:
    from tunenet_logs.analysis.planning import TOLD_SD, contradiction, read_tuning, told_ball

    if (arguments.tuning is None) == (arguments.restitution is None):
        both = arguments.tuning is not None
        raise UsageError(
            "a tuning and --restitution: leave one out"
            if both
            else "which ball? give a tuning's .json, or --restitution"
        )
    if arguments.tuning is None:
        slope, sd = arguments.slope, arguments.restitution_sd
        sd = TOLD_SD if sd is None else sd
        return told_ball(arguments.restitution, slope or 0.0, sd, arguments.drag)
    for name in ("slope", "restitution_sd", "drag"):
        if getattr(arguments, name) is not None:
            option = name.replace("_", "-")
            raise UsageError(f"--{option} is for --restitution; a tuning tells it itself")
    ball = read_tuning(arguments.tuning)
    contradicted = contradiction(ball, rig.ball, is_told=arguments.rig is not None)
    return replace(ball, remarks=(*ball.remarks, contradicted)) if contradicted else ball


def _refuse_own_input(arguments: argparse.Namespace) -> None:
    """Refuse an output that would replace an input, or the other output."""
    kinds = {"tuning": "the tuning", "rig": "--rig", "json": "--json", "rrd": "--rrd"}
    given = [(name, getattr(arguments, name)) for name in kinds if getattr(arguments, name)]
    for (first, one), (second, other) in combinations(given, 2):
        if second in ("json", "rrd") and (
            one.samefile(other)
            if one.exists() and other.exists()
            else real_path(one) == real_path(other)
        ):
            raise UsageError(f"{other}: is {kinds[first]} too; give --{second} another file")


if __name__ == "__main__":
    sys.exit(main())
