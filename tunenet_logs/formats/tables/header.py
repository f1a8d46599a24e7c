"""Finding the line of a table that names its columns, wherever it stands."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from math import isfinite
from pathlib import Path

from tunenet_logs.errors import LogError
from tunenet_logs.formats.tables.layout import MOST_COLUMNS, TableLayout, table_layout_of
from tunenet_logs.formats.tables.lines import MOST_LINE, SEPARATORS, cells_of, lines_of
from tunenet_logs.formats.tables.numbers import Numbers
from tunenet_logs.formats.tables.units import length_in, with_lengths, with_row

_MOST_BEFORE = 200
"""Lines of a preamble."""

_EXAMPLE = "for example t,x,y,z or time_ms;height_mm or t,joint1_effort,joint1_position"
"""Headers that are understood, for error messages."""

Lines = Iterator[tuple[int, str | None]]
"""Lines with their numbers from 1; None for one that is too long."""


@dataclass(frozen=True, eq=False)
class OpenTable:
    """A table that is open.

    Attributes:
        rows: the lines behind the header and its units.
    """

    layout: TableLayout
    rows: Lines


def open_table(path: Path) -> OpenTable:
    """A table, read up to its first row.

    Raises:
        LogError: it has no header that says when and what, or is too large.
        OSError: it cannot be read.
    """
    lines: Lines = enumerate(lines_of(path), 1)
    before = _Before()
    for number, line in islice(lines, _MOST_BEFORE):
        try:
            if line is not None and not line.startswith(("#", "%")) and _is_row(line):
                lines = chain([(number, line)], lines)
                break
            if before.takes(number, line):
                break
        except ValueError as error:
            raise LogError(f"{path}: line {number}: {error}") from error
    layouts = (before.header, before.commented)
    layout = next((made for made in layouts if made is not None and made.groups), None)
    if layout is None:
        raise LogError(f"{path}: {before.refusal()}")
    return _with_units(path, OpenTable(layout, lines), before.length)


class _Before:
    """What the lines before the first row say.

    Attributes:
        header: the names of the columns; without groups where no better one is found.
        commented: the same of a comment, as numpy.savetxt and rostopic write it.
        length: the unit of lengths; "" where none is said.
    """

    def __init__(self) -> None:
        self.header: TableLayout | None = None
        self.commented: TableLayout | None = None
        self.length = ""
        self._is_text = False
        self._too_large = ""

    def takes(self, number: int, line: str | None) -> bool:
        """Whether a line is the header; what else it says is kept.

        Raises:
            ValueError: a unit in it is not known.
        """
        if line is None or any(len(cells) > MOST_COLUMNS for _, cells in _readings(line)):
            self._too_large = self._too_large or f"line {number} is {_size_of(line)}"
            return False
        if line.startswith(("#", "%")):
            self._comment(line.removeprefix("#").strip())
        elif line.strip():
            layout = _layout(line)
            if layout is not None and layout.groups:
                self.header = layout
                return True
            self.header = self.header or layout
            self.length = length_in(line) or self.length
            self._is_text = True
        return False

    def _comment(self, text: str) -> None:
        found = self.commented and _named_by(self.commented, text)
        self.commented = found or _layout(text) or self.commented
        self.length = length_in(text) or self.length

    def refusal(self) -> str:
        """Why there is no table below these lines."""
        layout = self.header or self.commented
        if layout is not None:
            return _unusable(layout)
        if self._too_large:
            return f"{self._too_large}; leave out the columns that are not needed"
        if self._is_text:
            return f"no line names a column of times; put one on top, {_EXAMPLE}"
        return f"has no line that names its columns; put one on top, {_EXAMPLE}"


def _unusable(layout: TableLayout) -> str:
    """Why there is nothing in a table's columns."""
    reasons = [f"{name[:60]!r}: {why}" for name, why in layout.unused.items()]
    listed = "; ".join(reasons[:4]) or "it has times alone"
    return f"holds no track and no torques that can be used ({listed})"


def _size_of(line: str | None) -> str:
    """How large a line is that is too large."""
    if line is None:
        return (
            f"longer than {MOST_LINE >> 20} MiB, the limit of a line "
            f"(a table may have {MOST_COLUMNS} columns)"
        )
    columns = max(len(cells) for _, cells in _readings(line))
    return f"a header of {columns} columns, over the limit of {MOST_COLUMNS}"


def _with_units(path: Path, table: OpenTable, length: str) -> OpenTable:
    """A table whose columns have the units of a row below the header, and of the preamble."""
    layout, rows = table.layout, table.rows
    for number, line in rows:
        is_comment = line is not None and line.startswith("#")
        try:
            found = line and _named_by(layout, line.removeprefix("#") if is_comment else line)
        except ValueError as error:
            raise LogError(f"{path}: line {number}: {error}") from error
        if found:
            layout = found
            break
        if line is None or (line.strip() and not is_comment):
            rows = chain([(number, line)], rows)
            break
    if length:
        layout = _again(layout, with_lengths(layout.header, length))
    if not layout.groups:
        raise LogError(f"{path}: {_unusable(layout)}")
    return OpenTable(layout, rows)


def _named_by(layout: TableLayout, line: str) -> TableLayout | None:
    """The layout with the units of a line; None where it is no row of units."""
    header = with_row(layout.header, cells_of(line, layout.separator))
    return _again(layout, header) if header else None


def _again(layout: TableLayout, header: Sequence[str]) -> TableLayout:
    return table_layout_of(header, layout.separator) or layout


def _readings(line: str) -> Iterator[tuple[str | None, list[str]]]:
    """The cells of a line by each separator that it may have."""
    has_marks = any(mark in line for mark in SEPARATORS if mark)
    for separator in SEPARATORS:
        if separator or not has_marks:  # "Time (s),X" has a space too
            yield separator, [cell.strip() for cell in cells_of(line, separator)]


def _layout(line: str) -> TableLayout | None:
    """What a line says as a header, with the separator that makes most of it."""
    found = [
        layout
        for separator, cells in _readings(line)
        if (layout := table_layout_of(cells, separator)) is not None
    ]
    return next((layout for layout in found if layout.groups), found[0] if found else None)


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
        return isfinite(Numbers(separator).read(cell))
    except ValueError:
        return False
