"""Find the header line of a table, wherever it stands."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from math import isfinite
from pathlib import Path

from tunenet_logs.errors import LogError
from tunenet_logs.formats.tables.column_names import UNKNOWN, meaning_of
from tunenet_logs.formats.tables.known_rows import LOOK_ROWS, KnownRows, known_rows
from tunenet_logs.formats.tables.layout import MAX_COLUMNS, TableLayout, table_layout_of
from tunenet_logs.formats.tables.lines import MAX_LINE, SEPARATORS, cells_of
from tunenet_logs.formats.tables.numbers import Numbers
from tunenet_logs.formats.tables.offers import offer_by_name, offer_by_number, short_list
from tunenet_logs.formats.tables.row_numbers import ROW, numbered, said_layout
from tunenet_logs.formats.tables.said import contradiction_of, is_name, places_of
from tunenet_logs.formats.tables.units import (
    length_in,
    unit_alone,
    with_degrees,
    with_lengths,
    with_row,
)

_MAX_BEFORE = 200  # lines of a preamble
_MAX_NAMES = 20_000  # of columns that are looked at in all lines of a preamble
# Headers that are understood, for error messages.
_EXAMPLE = "for example t,x,y,z or time_ms;height_mm or t,joint1_effort,joint1_position"

_FEW_COLUMNS = 3  # a table of so few may hold impact times
_NAMELESS = "has no line that names its columns"  # what a table lacks that begins at once
# Lines with their numbers from 1; None for one that is too long.
Lines = Iterator[tuple[int, str | None]]


@dataclass(frozen=True, eq=False)
class OpenTable:
    """A table read up to its first row.

    Attributes:
        rows: the lines behind the header and its units.
        what: kind of table; "" where it is unstated.
        said_rows: number of rows stated; None where it is unstated.
    """

    layout: TableLayout
    rows: Lines
    what: str = ""
    said_rows: int | None = None


def open_table(
    path: Path,
    text: Iterable[str | None],
    columns: Mapping[str, str] | None = None,
    counts_rows: bool = False,
) -> OpenTable:
    """Read a table up to its first row.

    Args:
        path: for messages.
        text: its lines.
        columns: named by the user.
        counts_rows: whether a row is a frame where the columns have no clock.

    Raises:
        LogError: it has no header with a clock and values, or is too large.
        OSError: it cannot be read.
    """
    said = columns or {}
    if why := contradiction_of(said):
        raise LogError(f"{path}: {why}")
    lines: Lines = enumerate(text, 1)
    before = _Before(said, counts_rows)
    first: str | None = None
    for number, line in islice(lines, _MAX_BEFORE):
        try:
            if line is not None and not line.startswith(("#", "%")) and _is_row(line, said):
                lines, first = chain([(number, line)], lines), line
                break
            if before.takes(number, line):
                break
        except ValueError as error:
            raise LogError(f"{path}: line {number}: {error}") from error
    ahead = list(islice(lines, LOOK_ROWS))
    lines = chain(ahead, lines)
    try:
        layout = before.layout(first, [line for _, line in ahead if line and line[0] not in "#%"])
    except ValueError as error:
        raise LogError(f"{path}: {error}") from error
    if layout is None:
        rest = (line for _, line in islice(lines, 1, None))
        why = before.known.refusal if before.known else before.refusal(first, rest)
        raise LogError(f"{path}: {why}")
    table = _with_units(path, OpenTable(layout, lines), before)
    if before.known is not None:
        rows = before.known.of_one(path, table.rows)
        table = replace(table, rows=rows, what=before.known.what)
    return replace(table, rows=numbered(table.rows, layout)) if before.rows_are_frames else table


class _Before:
    """Parser of the lines before the first row.

    Attributes:
        header: the names of the columns; without groups where no better one is found.
        commented: the same of a comment, as numpy.savetxt and rostopic write it.
        length: the unit of lengths; "" where it is unstated.
        rows_are_frames: whether the last column of the layout is that of the row numbers.
        known: format of the rows, where no line names their columns.
    """

    def __init__(self, said: Mapping[str, str], counts_rows: bool) -> None:
        self.header: TableLayout | None = None
        self.commented: TableLayout | None = None
        self.length = ""
        self.rows_are_frames = False
        self.known: KnownRows | None = None
        self._said = said
        self._counts_rows = counts_rows
        self._texts: list[str] = []
        self._names_left = _MAX_NAMES
        self._too_large = ""

    def takes(self, number: int, line: str | None) -> bool:
        """Parse a line; return whether it is the header. Raise ValueError for an unknown unit."""
        if line is None or any(len(cells) > MAX_COLUMNS for _, cells in _readings(line)):
            self._too_large = self._too_large or f"line {number} is {_size_of(line)}"
            return False
        self._names_left -= max(len(cells) for _, cells in _readings(line))
        if self._names_left < 0:
            return False
        is_comment = line.startswith(("#", "%"))
        text = line.removeprefix("#").strip() if is_comment else line
        if text.strip():
            self._texts.append(text)
        if self._said:
            self.header = self._named(text)
            if self.header is None:
                self.length = length_in(text) or self.length
            return self.header is not None
        if is_comment:
            self._comment(text)
        elif line.strip():
            layout = _layout(line)
            if layout is not None and layout.groups:
                self.header = layout
                return True
            self.header = self.header or layout
            self.length = length_in(line) or self.length
        return False

    def _comment(self, text: str) -> None:
        found = self.commented and _named_by(self.commented, text)
        self.commented = found or _layout(text) or self.commented
        self.length = length_in(text) or self.length

    def _named(self, line: str) -> TableLayout | None:
        """Return the layout of a line that holds the user's column names."""
        for separator, cells in _readings(line):
            places, missing = places_of(self._said, cells)
            if not missing and any(is_name(place, cells) for place in self._said.values()):
                return self._said_layout(places, cells, separator)
        return None

    def _said_layout(
        self, places: Mapping[int, str], names: Sequence[str], separator: str | None
    ) -> TableLayout:
        made, self.rows_are_frames = said_layout(places, names, separator, self._counts_rows)
        return made

    def layout(self, row: str | None, ahead: Sequence[str]) -> TableLayout | None:
        """Return the columns of the table; None where they cannot be determined.

        Args:
            row: the first one; None where there is none.
            ahead: some of the rows.

        Raises:
            ValueError: the table lacks the user's columns.
        """
        layouts = (self.header, self.commented)
        found = next((made for made in layouts if made is not None and made.groups), None)
        self._check()
        if found is None and self._is_nameless(row):
            self.known = known_rows(ahead)
        if found is not None:
            return found
        if not self._said:
            if self.known is not None or not self._counts_rows or any(layouts):
                return self._known_layout()
            return self._counted(row)
        if self.header is not None:
            raise ValueError(_unusable(self.header))
        separator, names = self._names(row)
        if row is None or not names:
            place = next(iter(self._said.values()))
            raise ValueError(
                f"has no column {place[:60]!r} in its first {_MAX_BEFORE} lines; "
                "name one that it has"
            )
        known = names if any(names) else [f"column {at}" for at in range(1, len(names) + 1)]
        if self.known is not None:
            known = list(self.known.names)
        places, missing = places_of(self._said, known)
        if missing:
            listed = short_list(known) or "none"
            raise ValueError(
                f"has no column {missing[0][:60]!r}; its columns are {listed}; name one of them"
            )
        return self._below_names(self._said_layout(places, known, separator))

    def _is_nameless(self, row: str | None) -> bool:
        """Return whether no line names the row's columns, or only as trajectories do."""
        names = self._names(row)[1]
        named = {name.lower() for name in names}
        is_trajectory = {"tx", "ty", "tz"} <= named or {"px", "py", "pz"} <= named
        return is_trajectory or all(meaning_of(name) == UNKNOWN for name in names)

    def _known_layout(self) -> TableLayout | None:
        """Return the columns of rows whose format is recognized."""
        if self.known is None or self.known.remedy:
            return None
        self.rows_are_frames = not self.known.has_clock
        names = (*self.known.names, "frame") if self.rows_are_frames else self.known.names
        return table_layout_of(names, self.known.separator)

    @property
    def is_opensim(self) -> bool:
        """Whether OpenSim wrote it: .sto and .mot."""
        return any(text.strip().lower() == "endheader" for text in self._texts)

    def says(self, key: str) -> str:
        """Return the lower-case value of a key in OpenSim's header; "" where it is absent."""
        lines = (text.partition("=") for text in self._texts if "=" in text)
        said = {one.strip().lower(): value.strip(" \t,;").lower() for one, _, value in lines}
        return said.get(key, "") if self.is_opensim else ""

    def _check(self) -> None:
        """Raise ValueError where the header says that the table holds no positions."""
        first = self._texts[0].strip(" \t,;") if self._texts else ""
        if self.is_opensim and re.search("velocit|accelerat|speed", first, re.I):
            raise ValueError(
                f"is OpenSim's table of {first[:60]!r}, and positions are read; name the table of "
                "positions that the same analysis wrote (..._pos_global.sto)"
            )

    def _counted(self, row: str | None) -> TableLayout | None:
        """Return the layout of columns without a clock, rows counted as frames; else None."""
        separator, names = self._names(row)
        layout = table_layout_of([*names, ROW], separator) if any(names) else None
        self.rows_are_frames = layout is not None and bool(layout.groups)
        return self._below_names(layout) if layout is not None and layout.groups else None

    def _below_names(self, layout: TableLayout) -> TableLayout:
        """Add the units of a row between the names and the first row, if there is one."""
        last = self._texts[-1] if self._texts else ""
        return _named_by(layout, last) or layout

    def _names(self, row: str | None) -> tuple[str | None, list[str]]:
        """Return a row's separator, and the names of the last line of equal width, if any."""
        for separator, cells in _row_readings(row or ""):
            for text in reversed(self._texts):
                names = [cell.strip() for cell in cells_of(text, separator)]
                while len(names) > len(cells) and not names[-1]:
                    names.pop()
                if len(names) == len(cells) and any(map(_is_name, names)):
                    return separator, names
            return separator, [""] * len(cells)
        return None, []

    def refusal(self, row: str | None, rest: Iterable[str | None]) -> str:
        """Return why there is no table below these lines, by first row and rest."""
        layout = self.header or self.commented
        separator, names = self._names(row)
        if layout is not None and (not any(names) or len(names) == layout.width):
            return _unusable(layout)
        if self._too_large:
            return f"{self._too_large}; leave out the columns that are not needed"
        if any(names):
            return (
                f"none of its columns is a time or counts frames ({short_list(names)}); "
                f"{offer_by_name(names)}"
            )
        if row is not None and names:
            return f"has no line that names its columns; {offer_by_number(row, rest, separator)}"
        numbers = [text for text in self._texts if _is_number(text, None)]
        if row is None and len(numbers) * 2 > len(self._texts):
            return (
                f"holds one column of numbers ({numbers[0][:20]} to {numbers[-1][:20]}); if they "
                "are times of impacts [s], say so with --columns times=1"
            )
        what = "no line names a column of times" if self._texts else _NAMELESS
        return f"{what}; put one on top, {_EXAMPLE}"


def _unusable(layout: TableLayout) -> str:
    """Return why none of a table's columns is of use."""
    reasons = [f"{name[:60]!r}: {why}" for name, why in layout.unused.items() if name.strip()]
    listed = "; ".join(reasons[:4]) or "it has times alone"
    offer = f"; {offer_by_name(layout.header)}" if reasons or layout.width == 1 else ""
    if len(layout.header) <= _FEW_COLUMNS:
        offer += "; name times of impacts, if it has them: --columns times=..."
    return f"holds no track and no torques that can be used ({listed}){offer}"


def _size_of(line: str | None) -> str:
    """Describe the size of a line that is too large."""
    if line is None:
        return (
            f"longer than {MAX_LINE >> 20} MiB, the limit of a line "
            f"(a table may have {MAX_COLUMNS} columns)"
        )
    columns = max(len(cells) for _, cells in _readings(line))
    return f"a header of {columns} columns, over the limit of {MAX_COLUMNS}"


def _with_units(path: Path, table: OpenTable, before: _Before) -> OpenTable:
    """Add the units of a row below the header, and of the preamble, to the columns."""
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
    if before.length:
        layout = _again(layout, with_lengths(layout.header, before.length, layout.reading))
    if before.says("indegrees") == "yes":
        layout = _again(layout, with_degrees(layout.header, layout.reading))
    if not layout.groups:
        raise LogError(f"{path}: {_unusable(layout)}")
    said = before.says("nrows")
    return OpenTable(
        layout,
        rows,
        "of OpenSim" if before.is_opensim else "",
        int(said) if said.isdecimal() and len(said) < 10 else None,
    )


def _named_by(layout: TableLayout, line: str) -> TableLayout | None:
    """Add the units of a line to a layout; None where it is no row of units."""
    header = with_row(layout.header, cells_of(line, layout.separator), layout.reading)
    return _again(layout, header) if header else None


def _again(layout: TableLayout, header: Sequence[str]) -> TableLayout:
    return table_layout_of(header, layout.separator, layout.reading) or layout


def _readings(line: str) -> Iterator[tuple[str | None, list[str]]]:
    """Yield the cells of a line by each separator that it may have."""
    has_marks = any(mark in line for mark in SEPARATORS if mark)
    for separator in SEPARATORS:
        if separator or not has_marks:  # "Time (s),X" has a space too
            yield separator, [cell.strip() for cell in cells_of(line, separator)]


def _layout(line: str) -> TableLayout | None:
    """Parse a line as a header, with the separator that makes most of it."""
    found = [
        layout
        for separator, cells in _readings(line)
        if (layout := table_layout_of(cells, separator)) is not None
    ]
    return next((layout for layout in found if layout.groups), found[0] if found else None)


def _is_row(line: str, said: Mapping[str, str]) -> bool:
    """Return whether a line begins with a number, as do half of its cells; see `_row_readings`."""
    return any(len(cells) > 1 or said for _, cells in _row_readings(line))


def _row_readings(line: str) -> Iterator[tuple[str | None, list[str]]]:
    """Yield the cells of a row by each separator by which it is one."""
    for separator in SEPARATORS:
        cells = cells_of(line, separator)
        if not cells or not _is_number(cells[0], separator):
            continue
        seen = cells[:MAX_COLUMNS]
        is_row = sum(_is_number(cell, separator) for cell in seen) * 2 >= len(seen)
        if is_row and (len(cells) > 1 or separator is None):
            yield separator, cells


def _is_name(text: str) -> bool:
    """Return whether a cell names a column, rather than its unit alone."""
    return bool(text) and unit_alone(text) is None


def _is_number(cell: str, separator: str | None) -> bool:
    try:
        return isfinite(Numbers(separator).read(cell))
    except ValueError:
        return False
