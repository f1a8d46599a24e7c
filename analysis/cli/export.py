"""tunenet-export: write a tuning as a model file of another engine."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.analysis.export.registry import FORMATS, export_format, usual_suffix
from tunenet_logs.console import Parser, number, run
from tunenet_logs.errors import TuneNetError, UsageError
from tunenet_logs.files import real_path
from tunenet_logs.terminal import one_line

if TYPE_CHECKING:
    from tunenet_logs.analysis.export.exported import ExportedBall
    from tunenet_logs.analysis.export.registry import ExportFormat

_DESCRIPTION = """\
Write what was tuned as a file for a physics engine: a ball's contact, or a payload's
inertia. Each line of the file says why it is there, and its head whose numbers they are.
Most engines know one restitution for all speeds and no air: they get the one with which
the first rebound is as high as the recorded one (--speed V: the tuned law's at V). MuJoCo
gets the tuned one, and the air's drag.

Where the engine is installed, the file is loaded and the ball dropped again from the
recorded height; how it bounces stands beside what was tuned."""


_EXAMPLES = """\
  tunenet-export drop.json --to pybullet
  tunenet-export drop.json --to sdf -o ball.sdf --radius 0.0335 --mass 0.0577
  tunenet-export drop.json --to drake --speed 3.0
  tunenet-export payload.json --to urdf --overwrite"""


def build_parser() -> Parser:
    """Build the argument parser."""
    parser = Parser(
        "tunenet-export",
        _DESCRIPTION,
        _EXAMPLES,
        failed="the tuning was rejected or cannot be read",
    )
    add = parser.add_argument
    add("tuning", type=Path, metavar="TUNING.json", help="what tunenet-tune wrote")
    add(
        "--to",
        required=True,
        type=lambda name: "sdf" if name == "gazebo" else name,
        choices=sorted(FORMATS),
        metavar="ENGINE",
        help=f"one of {', '.join(sorted(FORMATS))} (gazebo is sdf)",
    )
    add("-o", "--output", type=Path, metavar="FILE", help="default: NAME.ENGINE.* beside it")
    add("--overwrite", action="store_true", help="replace exports of other logs")
    ball = parser.add_argument_group("of a ball")
    ball.add_argument(
        "--speed",
        type=number(0.05, 100, "m/s"),
        metavar="M_S",
        help="impact for which the restitution is to be right, by the tuned law over speed",
    )
    ball.add_argument(
        "--radius",
        type=number(1e-3, 10, "m"),
        metavar="M",
        help="default: of the ball that was named when recording, else 0.02",
    )
    ball.add_argument(
        "--mass",
        type=number(1e-5, 1000, "kg"),
        metavar="KG",
        help="default: of the ball that was named when recording, else as dense as water",
    )
    ball.add_argument(
        "--step", type=number(1e-6, 0.1, "s"), metavar="S", help="the engine's time step"
    )
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tunenet-export`."""
    return run(build_parser(), _export, argv)


def _export(arguments: argparse.Namespace) -> int:
    from tunenet_logs.analysis.export.exported import ExportedBall, ExportOptions
    from tunenet_logs.analysis.export.files import export_texts, exported_for
    from tunenet_logs.analysis.record import read_record
    from tunenet_logs.analysis.result_files import exported_file
    from tunenet_logs.writing.owned_path import OutputPlace

    engine = export_format(arguments.to)
    said = ExportOptions(arguments.speed, arguments.radius, arguments.mass, arguments.step)
    record = read_record(arguments.tuning)
    try:
        item = exported_for(engine, record, said)
    except TuneNetError as error:
        raise type(error)(f"{arguments.tuning}: {error}") from error
    path = arguments.output
    if path is None:
        path = arguments.tuning.with_suffix(usual_suffix(engine))
    texts = export_texts(engine, item, path)
    knows, elsewhere = exported_file(record), "give -o another file"
    places = [
        OutputPlace(path, "export", knows, record.log, elsewhere, arguments.overwrite)
        for path in texts
    ]
    for place in places:
        if real_path(place.path) == real_path(arguments.tuning):
            raise UsageError(f"{place.path}: is the tuning itself; {elsewhere}")
        place.check()
    for place in places:
        with place.replacing() as partial:
            partial.write_text(texts[place.path], "utf-8")
    if item.origin.verdict == "suspect":
        why = item.origin.reason or "no reason is given"
        print(one_line(f"tunenet-export: the tuning is suspect: {why}"), file=sys.stderr)
    print("written: " + ", ".join(one_line(path) for path in texts))
    if isinstance(item, ExportedBall):
        print(_check_words(engine, next(iter(texts)), item))
    return 0


def _check_words(engine: ExportFormat, path: Path, ball: ExportedBall) -> str:
    """Format as a table how the engine drops the exported ball."""
    from tunenet_logs.analysis.export.files import checked

    check = checked(engine, path, ball)
    if isinstance(check, str):
        return f"not run: {check}"
    lines = [
        f"dropped again in {engine.NAME}, from {ball.drop_height_m.value:.3f} m:",
        "bounce  in the file  effective      off",
        *(
            f"{index:6d}  {ball.restitution:11.4f}  {found:9.4f}  {found - ball.restitution:+7.4f}"
            for index, found in enumerate(check.effective, 1)
        ),
    ]
    if check.rms_percent is not None:
        lines.append(f"off the recording: {check.rms_percent:.2f} % of the drop height, rms")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
