"""Finding the line of a table that names its columns, wherever it stands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from math import isfinite
from pathlib import Path

from tunenet_logs.errors import LogError
from tunenet_logs.formats.tables.layout import Layout, layout_of
from tunenet_logs.formats.tables.lines import SEPARATORS, cells_of, lines_of, number_of

_MOST_BEFORE = 200
"""Lines of a preamble."""

_EXAMPLE = "for example t,x,y,z or time_ms;height_mm or t,joint1_effort,joint1_position"


@dataclass(frozen=True, eq=False)
class Table:
    """A table that is open.

    Attributes:
        rows: the lines behind the header; None for one that is too long.
    """

    layout: Layout
    rows: Iterator[str | None]


def open_table(path: Path) -> Table:
    """A table, read up to its first row.

    Raises:
        LogError: it has no header that says when and what, or is too large.
        OSError: it cannot be read.
    """
    lines = lines_of(path)
    commented: Layout | None = None
    seen = ""
    for _, line in zip(range(_MOST_BEFORE), lines, strict=False):
        if line is None or not line.strip():
            continue
        if line.startswith(("#", "%")):  # as numpy.savetxt and rostopic write their headers
            commented = _layout(line.removeprefix("#").strip()) or commented
            continue
        layout = _layout(line)
        if layout is not None:
            return _checked(path, Table(layout, lines))
        if _is_row(line):
            if commented is None:
                break
            return _checked(path, Table(commented, chain([line], lines)))
        seen = seen or line
    if seen:
        raise LogError(f"{path}: no line names a column of times; put one on top, {_EXAMPLE}")
    raise LogError(f"{path}: has no line that names its columns; put one on top, {_EXAMPLE}")


def _layout(line: str) -> Layout | None:
    """What a line says as a header, with the separator that makes most of it."""
    has_marks = any(mark in line for mark in SEPARATORS if mark)
    found = [
        layout
        for separator in SEPARATORS
        if separator or not has_marks  # "Time (s),X" has a space too
        if (layout := layout_of([one.strip() for one in cells_of(line, separator)], separator))
    ]
    return next((one for one in found if one.groups), found[0] if found else None)


def _is_row(line: str) -> bool:
    """Whether a line begins with a number, and half of its cells are such."""
    for separator in SEPARATORS:
        cells = cells_of(line, separator)
        numbers = [_is_number(cell, separator) for cell in cells]
        if len(cells) > 1 and numbers[0] and sum(numbers) * 2 >= len(cells):
            return True
    return False


def _is_number(cell: str, separator: str | None) -> bool:
    try:
        return isfinite(number_of(cell, separator))
    except ValueError:
        return False


def _checked(path: Path, table: Table) -> Table:
    if table.layout.groups:
        return table
    reasons = [f"{name[:60]!r}: {why}" for name, why in table.layout.unused.items()]
    told = "; ".join(reasons[:4]) or "it has times alone"
    raise LogError(f"{path}: holds no track and no torques that can be used ({told})")
