"""Write figures as files for a paper: one, or a folder of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from analysis.comparison import compare
from analysis.report.compared_figures import comparison_drawings
from analysis.report.drawn import drawings_of, reviewed
from analysis.report.embedded import Kind, write_figure
from analysis.report.style import Drawing
from analysis.result_files import Logs, check_place, in_words, logs_of, mark, marked
from analysis.tuning_files import TuningFile
from tunenet_logs.errors import UsageError
from tunenet_logs.output.owned_file import OutputPlace

_FIGURE = "figure"  # as its mark has it
_MAX_TUNINGS = 100  # whose figures are written to one folder at a time


@dataclass(frozen=True)
class FigureOrder:
    """Figures to write.

    Attributes:
        place: A file with the kind's suffix for the main figure, else a folder for all.
        inputs: Files that are read, which nothing replaces.
        overwrite: Whether figures of other logs may be replaced.
    """

    place: Path
    kind: Kind
    inputs: Sequence[Path]
    overwrite: bool


def write_figures(order: FigureOrder, tunings: Sequence[TuningFile]) -> list[Path]:
    """Write the figures of tunings, and return the files in order.

    Raises:
        UsageError: There is nothing to draw, or it cannot be written.
        OSError: It cannot be written.
    """
    suffix, option = f".{order.kind}", f"--{order.kind}"
    if len(tunings) > _MAX_TUNINGS:
        raise UsageError(f"{len(tunings)} tunings: draw at most {_MAX_TUNINGS} at a time")
    logs = logs_of(one.record for one in tunings)

    def checked(path: Path) -> OutputPlace:
        place = figure_place(path, order.kind, logs, overwrite=order.overwrite)
        check_place(place, option, (suffix,), order.inputs)
        return place

    is_folder = order.place.is_dir() and not order.place.is_symlink()
    if order.place.suffix.lower() == suffix and not is_folder:
        files = [(checked(order.place), _main(order, tunings))]
    else:
        drawn = _all(tunings)
        if order.place.suffix and not order.place.is_dir():
            raise UsageError(f"{order.place}: give {option} a folder, or a name that ends {suffix}")
        if not drawn:
            raise UsageError(f"{order.place}: these tunings have nothing to draw")
        order.place.mkdir(exist_ok=True)
        files = [(checked(order.place / f"{name}{suffix}"), one) for name, one in drawn.items()]
    for place, drawing in files:
        with place.replacing() as partial:
            write_figure(drawing.figure, partial, order.kind, mark(_FIGURE, logs))
    return [place.path for place, _ in files]


def figure_place(path: Path, kind: Kind, logs: Logs, *, overwrite: bool) -> OutputPlace:
    """Return the output place of a figure of some logs."""
    knows = marked(kind, _FIGURE, logs)
    elsewhere = f"give --{kind} another file"
    return OutputPlace(path, "figure", knows, in_words(logs), elsewhere, overwrite=overwrite)


def _main(order: FigureOrder, tunings: Sequence[TuningFile]) -> Drawing:
    drawings = _compared(tunings) if len(tunings) > 1 else _own(tunings[0])
    if not drawings:
        raise UsageError(f"{order.place}: these tunings have nothing to draw")
    return drawings[0]


def _all(tunings: Sequence[TuningFile]) -> dict[str, Drawing]:
    """Map the name of each figure's file, without the suffix, to the figure."""
    found: dict[str, Drawing] = {}
    for tuning in tunings:
        for drawing in _own(tuning):
            found[_free(found, f"{tuning.path.stem}_{drawing.name}")] = drawing
    if len(tunings) > 1:
        for drawing in _compared(tunings):
            found[_free(found, f"comparison_{drawing.name}")] = drawing
    return found


def _free(taken: dict[str, Drawing], name: str) -> str:
    """Number a name that is taken: two tunings may have the same."""
    number, free = 1, name
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    return free


def _own(tuning: TuningFile) -> list[Drawing]:
    seen, _ = reviewed(tuning.record, tuning.path)
    return drawings_of(tuning.record, seen)


def _compared(tunings: Sequence[TuningFile]) -> list[Drawing]:
    records = [tuning.record for tuning in tunings]
    return comparison_drawings(compare(records, [tuning.label for tuning in tunings]))
