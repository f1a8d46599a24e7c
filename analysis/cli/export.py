"""tunenet-export: write a tuning as a model file of another engine."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.analysis.export.registry import (
    FORMATS,
    MODEL_FORMATS,
    usual_suffix,
)
from tunenet_logs.console import Parser, number, run
from tunenet_logs.errors import TuneNetError, UsageError
from tunenet_logs.files import real_path
from tunenet_logs.terminal import one_line

if TYPE_CHECKING:
    from tunenet_logs.analysis.export.exported import ExportedBall
    from tunenet_logs.analysis.export.registry import ExportFormat
    from tunenet_logs.analysis.record import Record

_DESCRIPTION = """\
Write what was tuned as a file for a physics engine: a ball's contact, or a payload's
inertia. Each line of the file says why it is there, and its head whose numbers they are.
Most engines know one restitution for all speeds and no air: they get the one with which
the first rebound is as high as the recorded one (--speed V: the tuned law's at V). MuJoCo
gets the tuned one, and the air's drag.

Where the engine is installed, the file is loaded and the ball dropped again from the
recorded height; how it bounces stands beside what was tuned.

Of a model of your own (tunenet-tune --model): mjcf or urdf is its own file with nothing but
the numbers changed, loaded and rolled out again; yaml and json are values with ranges and
a joint sample (.npz) for randomising a simulator."""


_EXAMPLES = """\
  tunenet-export drop.json --to pybullet
  tunenet-export drop.json --to sdf -o ball.sdf --radius 0.0335 --mass 0.0577
  tunenet-export drop.json --to drake --speed 3.0
  tunenet-export payload.json --to urdf --overwrite
  tunenet-export run.json --to mjcf                (robot.tuned.xml beside robot.xml)
  tunenet-export run.json --to yaml"""


_CHOICES = sorted({*FORMATS, *MODEL_FORMATS})


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
        choices=_CHOICES,
        metavar="ENGINE",
        help=f"one of {', '.join(_CHOICES)} (gazebo is sdf)",
    )
    add(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="default: NAME.ENGINE.* beside it; of a model MODEL.tuned.* beside that",
    )
    add("--overwrite", action="store_true", help="replace exports of other logs")
    add(
        "--model",
        type=Path,
        metavar="FILE",
        help="where the tuned model lies (default: where it was, or beside TUNING.json)",
    )
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
    from tunenet_logs.analysis.export.model import TASK
    from tunenet_logs.analysis.record import read_record

    record = read_record(arguments.tuning)
    if record.task == TASK and arguments.to in MODEL_FORMATS:
        return _export_model(arguments, record)
    return _export_object(arguments, record)


def _export_object(arguments: argparse.Namespace, record: Record) -> int:
    """Export a ball or a payload."""
    from tunenet_logs.analysis.export.exported import ExportedBall, ExportOptions
    from tunenet_logs.analysis.export.files import engine_format, export_texts, exported_for

    said = ExportOptions(arguments.speed, arguments.radius, arguments.mass, arguments.step)
    try:
        engine = engine_format(arguments.to)
        item = exported_for(engine, record, said)
    except TuneNetError as error:
        raise type(error)(f"{arguments.tuning}: {error}") from error
    if arguments.model is not None:
        raise UsageError("--model is about a tuned model, and this is none: leave it out")
    path = arguments.output
    if path is None:
        path = arguments.tuning.with_suffix(usual_suffix(engine))
    texts = export_texts(engine, item, path)
    _write(arguments, record, {path: text.encode() for path, text in texts.items()})
    if isinstance(item, ExportedBall):
        print(_check_words(engine, next(iter(texts)), item))
    return 0


def _export_model(arguments: argparse.Namespace, record: Record) -> int:
    """Export a simulator of the user's own: its model's file, or data."""
    from tunenet_logs.analysis.export.model import check_export, model_export, tuned_simulator

    for option in ("speed", "radius", "mass", "step"):
        if getattr(arguments, option) is not None:
            raise UsageError(f"--{option} is for a ball, and this is a model: leave it out")
    tuning = arguments.tuning
    item = tuned_simulator(record, str(tuning), arguments.model, tuning.parent)
    export = model_export(item, arguments.to, arguments.output, tuning)
    _write(arguments, record, export.texts)
    for line in export.lines:
        print(one_line(line))
    if export.written is not None:
        print(one_line(check_export(export, item)))
    return 0


def _write(arguments: argparse.Namespace, record: Record, texts: Mapping[Path, bytes]) -> None:
    """Write the files, all or none."""
    from tunenet_logs.analysis.result_files import exported_file
    from tunenet_logs.writing.owned_path import OutputPlace

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
            partial.write_bytes(texts[place.path])
    if record.verdict == "suspect":
        why = record.reason or "no reason is given"
        print(one_line(f"tunenet-export: the tuning is suspect: {why}"), file=sys.stderr)
    print("written: " + ", ".join(one_line(path) for path in texts))


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
