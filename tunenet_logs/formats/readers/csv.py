"""Read tables of tracks or torques (.csv, .tsv, .txt), as spreadsheets and ROS tools write them.

`open_table` finds the header line, wherever it stands, and plans its columns by their names; the
parts before it suggest options, and split cells that are lists. `TextRows` reads the rows of any
plan, be they of a file or of a sheet, into the columns that the engine takes.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain, islice
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Episode
from tunenet_logs.errors import CHECK_DISK, LogError
from tunenet_logs.formats.columns.cells import (
    CELLS_REMEDY,
    DAMAGED_REMEDY,
    LOOK_ROWS,
    MAX_COLUMNS,
    MAX_LINE,
    NUMBER_REMEDY,
    SEPARATORS,
    TIME_REMEDY,
    UNIT_ROWS,
    Clock,
    Failures,
    KnownRows,
    Numbers,
    TextClock,
    Thousands,
    UnreadableError,
    cells_of,
    decimal_of,
    is_missing,
    known_rows,
    lines_of,
    unreadable,
)
from tunenet_logs.formats.columns.names import (
    MAX_SHOWN,
    MAX_SHOWN_LENGTH,
    UNKNOWN,
    CoordinateColumn,
    FrameColumn,
    JointColumn,
    Meaning,
    Reading,
    TimeColumn,
    contradiction_of,
    index_of,
    length_in,
    meaning_of,
    places_of,
    reasons_of,
    said_reading,
    short_list,
    spread_names,
    unit_alone,
    with_row,
    with_units,
)
from tunenet_logs.formats.columns.plan import (
    ROWS,
    ColumnPlan,
    fitted,
    layout_of,
    said_by,
)
from tunenet_logs.formats.columns.signals import (
    ColumnRows,
    RunNames,
    Times,
    episode_of_rows,
    told_apart,
)
from tunenet_logs.formats.columns.table import (
    MAX_ROWS,
    MAX_WIDTH,
)
from tunenet_logs.formats.options import AS_IT_SAYS, ReadOptions

# ---- Suggest a line to type, where the names say too little.

_PLAIN = re.compile(r"[^\W\d][\w.\-/]*")  # a name that needs no quotes


def offer_by_number(first: str, rest: Iterable[str | None], separator: str | None) -> str:
    """Describe unnamed columns by their first and last values, with an example of `--columns`."""
    rows = [_values(first, separator)]
    last, increases = rows[0], True
    for line in islice(rest, 100_000):
        row = _values(line or "", separator)
        if len(row) == len(rows[0]) and row[0] is not None:
            increases = increases and last[0] is not None and row[0] > last[0]
            last = row
    pairs = list(zip(rows[0], last, strict=True))[:MAX_SHOWN]
    listed = ", ".join(f"{at}: {_number(a)} to {_number(b)}" for at, (a, b) in enumerate(pairs, 1))
    more = ", ..." if len(last) > MAX_SHOWN else ""
    text = f"its columns by number are {listed}{more}; say which they are, "
    if increases and len(last) == 4:
        return text + "perhaps --columns t=1,x=2,y=3,z=4"
    if increases and len(last) == 2:
        return text + "perhaps --columns t=1,z=2"
    if len(last) == 1:
        return text + "for example --columns times=1 if they are times of impacts"
    if not increases and len(last) in (2, 3):
        text += "for example --columns t=1,z=2, or, where a row is a picture, "
        return text + "--columns x=1,y=2 --fps 30"
    joints = ", or, of a robot's joints, t=1,position=2:7" if len(last) > MAX_SHOWN else ""
    return text + f"for example --columns t=1,z=2{joints}"


def _values(line: str, separator: str | None) -> list[float | None]:
    numbers = Numbers(separator)
    values: list[float | None] = []
    for cell in cells_of(line, separator):
        values.append(None)
        with suppress(ValueError):
            values[-1] = numbers.read(cell)
    return values


def _number(value: float | None) -> str:
    return "?" if value is None or value != value else f"{value:.4g}"  # noqa: PLR0124 (NaN)


def offer_by_name(names: Sequence[str]) -> str:
    """Suggest a `--columns` line made of a table's own column names."""
    meanings = [meaning_of(name) for name in names]
    named = [at for at, name in enumerate(names) if name.strip()]
    clocks = [at for at in named if isinstance(meanings[at], TimeColumn | FrameColumn)]
    clock = next(chain(clocks, (at for at in named if meanings[at] == UNKNOWN)), None)
    axes = {
        one.axis: _quoted(names, at)
        for at, one in reversed(list(enumerate(meanings)))
        if isinstance(one, CoordinateColumn)
    }
    even = "; where rows have an even rate, say it: --fps 100"
    if clock is None:  # positions alone: a row may be a frame
        text = "add a column of times (t) or of the numbers of frames (frame)"
        said = ",".join(f"{'xyz'[axis]}={name}" for axis, name in sorted(axes.items()))
        if not said:
            return f"{text}{even}"
        return f"{text}; where a row is a picture: --columns {said} --fps 30"
    target = "frame" if isinstance(meanings[clock], FrameColumn) else "t"
    said = f"say which they are, for example --columns {target}={_quoted(names, clock)}"
    even = "" if clocks else even
    is_joint = [isinstance(one, JointColumn) and not one.is_command for one in meanings]
    other = max((at for at in named if at != clock), key=lambda at: is_joint[at], default=None)
    if axes or other is None:
        return said + even
    meaning = meanings[other]
    name = _quoted(names, other)
    if isinstance(meaning, JointColumn) and is_joint[other]:
        return f"{said},{meaning.quantity}_1={name}{even}"
    return f"{said},z={name} for a height, position_1={name} for a joint{even}"


def _quoted(names: Sequence[str], at: int) -> str:
    """Return a column's name as it can be typed, or its number."""
    name = names[at].strip()
    if _PLAIN.fullmatch(name) and len(name) <= MAX_SHOWN_LENGTH:
        return name
    cannot = not name or len(name) > MAX_SHOWN_LENGTH or not name.isprintable()
    return str(at + 1) if cannot or set("'\"\\`$,=") & set(name) else f"'{name}'"


# ---- Cells that are lists: `0.1,"[1.0, 2.0, 3.0]"`, as pandas writes a column of arrays.

_LIST = re.compile(r"\[\s*([-+.\deE,;\sna]*)\]")


def with_lists_split(lines: Iterable[str | None]) -> Iterator[str | None]:
    """Make a column of each place of a list; `ball` of three places is `ball x`, `ball y`, ..."""
    rest = iter(lines)
    ahead = list(islice(rest, LOOK_ROWS))
    every = chain(ahead, rest)
    row = next((at for at, line in enumerate(ahead) if line and _LIST.search(line[:MAX_LINE])), 0)
    widths: dict[int, int] = {}
    mark = ","
    for mark in "\t;," if row else "":
        names, cells = (cells_of(ahead[at] or "", mark) for at in (row - 1, row))
        if len(cells) > 1 and len(names) == len(cells):
            widths = {at: len(_parts(one)) for at, one in enumerate(cells) if _is_list(one)}
        if widths:
            break
    if not widths or max(widths.values()) > MAX_WIDTH:
        yield from every
        return
    for number, line in enumerate(every):
        if line is None or number < row - 1:
            yield line
            continue
        split: list[str] = []
        for at, cell in enumerate(cells_of(line, mark)):
            if at in widths and number == row - 1:
                split += spread_names(cell.strip(), widths[at])[1]
            else:
                split += _parts(cell) if at in widths and _is_list(cell) else [cell]
        out = io.StringIO()
        csv.writer(out, delimiter=mark, lineterminator="").writerow(split)
        yield out.getvalue()


def _is_list(cell: str) -> bool:
    return _LIST.fullmatch(cell.strip()) is not None


def _parts(cell: str) -> list[str]:
    return [one for one in re.split(r"[,;\s]+", cell.strip().strip("[]").strip()) if one]


# ---- Find the header line and its units.

_MAX_BEFORE = 200  # lines of a preamble
Separator = str | None  # between cells; None is white space
Layout = tuple[ColumnPlan, Separator]
Lines = Iterator[tuple[int, str | None]]  # with their numbers from 1; None for one too long


def _open(
    path: Path, text: Iterable[str | None], options: ReadOptions
) -> tuple[ColumnPlan, Separator, Lines, _Before]:
    """Read a table up to its first row; return its columns, rows and what stood before them."""
    said = options.columns
    if why := contradiction_of(said):
        raise LogError(f"{path}: {why}")
    lines: Lines = enumerate(with_lists_split(text), 1)
    before = _Before(options)
    first: str | None = None
    for number, line in islice(lines, _MAX_BEFORE):
        try:
            if (
                line is not None
                and not line.startswith(("#", "%"))
                and any(len(cells) > 1 or said for _, cells in _row_readings(line))
            ):
                lines, first = chain([(number, line)], lines), line
                break
            if before.is_header(number, line):
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
        known = before.known
        why = f"is {known.what}; {known.remedy}" if known else before.refusal(first, rest)
        raise LogError(f"{path}: {why}")
    # Add the units of a row below the header, and of the preamble, to the columns.
    for number, line in lines:
        is_comment = line is not None and line.startswith("#")
        try:
            found = line and _named_by(layout, line.removeprefix("#") if is_comment else line)
        except ValueError as error:
            raise LogError(f"{path}: line {number}: {error}") from error
        if found:
            layout = found
            break
        if line is None or (line.strip() and not is_comment):
            lines = chain([(number, line)], lines)
            break
    plan, separator = layout
    if before.length or before.says("indegrees") == "yes":
        plan = _again(plan, with_units(plan.names, before.unit_of, plan.reading))
    if not plan.groups:
        raise LogError(f"{path}: {_unusable(plan)}")
    return plan, separator, before.known.of_one(path, lines) if before.known else lines, before


class _Before:
    """Parser of the lines before the first row."""

    def __init__(self, options: ReadOptions) -> None:
        self.header: Layout | None = None  # without groups where no better line is found
        # the same of a comment, as numpy.savetxt and rostopic write it
        self.commented: Layout | None = None
        self.length = ""  # the unit of lengths; "" where it is unstated
        self.known: KnownRows | None = None  # format of the rows, where no line names their columns
        self._options = options
        self._said = options.columns
        self._counts_rows = options.fps is not None
        self._texts: list[str] = []
        self._names_left = 20_000  # of columns, in all lines
        self._too_large = ""

    def is_header(self, number: int, line: str | None) -> bool:
        """Parse a line; return whether it is the header. Raise ValueError for an unknown unit."""
        columns = 0 if line is None else max(len(cells) for _, cells in _readings(line))
        if line is None or columns > MAX_COLUMNS:
            what = f"a header of {columns} columns, over the limit of {MAX_COLUMNS}"
            if line is None:
                what = f"longer than {MAX_LINE >> 20} MiB, the limit of a line (a table may have "
                what += f"{MAX_COLUMNS} columns)"
            self._too_large = self._too_large or f"line {number} is {what}"
            return False
        self._names_left -= columns
        if self._names_left < 0:
            return False
        is_comment = line.startswith(("#", "%"))
        text = line.removeprefix("#").strip() if is_comment else line
        if text.strip():
            self._texts.append(text)
        if self._said:
            for separator, cells in _readings(text):
                places, missing = places_of(self._said, cells)
                are_names = any(index_of(one, cells) is not None for one in self._said.values())
                if not missing and are_names:
                    self.header = self._said_layout(said_reading(places), cells, separator)
                    return True
            self.length = length_in(text) or self.length
        elif is_comment:
            found = self.commented and _named_by(self.commented, text)
            self.commented = found or _layout(text) or self.commented
            self.length = length_in(text) or self.length
        elif line.strip():
            layout = _layout(line)
            if layout is not None and layout[0].groups:
                self.header = layout
                return True
            self.header = self.header or layout
            self.length = length_in(line) or self.length
        return False

    def _said_layout(self, reading: Reading, names: Sequence[str], separator: Separator) -> Layout:
        """Lay out the columns that a user names; ValueError if none is a time."""
        plan = layout_of(names, reading, counts_rows=self._counts_rows)
        if plan is None:
            raise ValueError(
                "none of its columns is known as a time; say it as well: t=COLUMN, or "
                "frame=COLUMN; where a row is a frame, say how many there are in a second, for "
                "example --fps 30"
            )
        return plan, separator

    def layout(self, row: str | None, ahead: Sequence[str]) -> Layout | None:
        """Return the columns of the table; None where they cannot be determined."""
        first = self._texts[0].strip(" \t,;") if self._texts else ""
        if self.is_opensim and re.search("velocit|accelerat|speed", first, re.I):
            raise ValueError(
                f"is OpenSim's table of {first[:60]!r}, and positions are read; name the table of "
                "positions that the same analysis wrote (..._pos_global.sto)"
            )
        layouts = (self.header, self.commented)
        found = next((made for made in layouts if made is not None and made[0].groups), None)
        if found is not None:
            return found
        separator, names = self._names(row)
        named = {name.lower() for name in names}
        is_trajectory = {"tx", "ty", "tz"} <= named or {"px", "py", "pz"} <= named
        if is_trajectory or all(meaning_of(name) == UNKNOWN for name in names):
            self.known = known_rows(ahead)
        if not self._said:
            if self.known is not None or not self._counts_rows or any(layouts):
                # The columns of rows whose format is recognized.
                if self.known is None or self.known.remedy:
                    return None
                plan = layout_of(self.known.names, counts_rows=not self.known.has_clock)
                return None if plan is None else (plan, self.known.separator)
            plan = layout_of(names, counts_rows=True) if any(names) else None
            return self._below_names((plan, separator)) if plan and plan.groups else None
        if self.header is not None:
            raise ValueError(_unusable(self.header[0]))
        if row is None or not names:
            place = next(iter(self._said.values()))[:60]
            raise ValueError(
                f"has no column {place!r} in its first {_MAX_BEFORE} lines; name one that it has"
            )
        known = names if any(names) else [f"column {at}" for at in range(1, len(names) + 1)]
        if self.known is not None:
            known = list(self.known.names)
        reading = said_by(self._options, known)
        return self._below_names(self._said_layout(reading, known, separator))

    def _below_names(self, layout: Layout) -> Layout:
        """Add the units of a row between the names and the first row, if there is one."""
        return _named_by(layout, self._texts[-1] if self._texts else "") or layout

    def _names(self, row: str | None) -> tuple[Separator, list[str]]:
        """Return a row's separator, and the names of the last line of equal width, if any."""
        for separator, cells in _row_readings(row or ""):
            for text in reversed(self._texts):
                names = [cell.strip() for cell in cells_of(text, separator)]
                while len(names) > len(cells) and not names[-1]:
                    names.pop()
                if len(names) == len(cells) and any(
                    name and unit_alone(name) is None for name in names
                ):
                    return separator, names
            return separator, [""] * len(cells)
        return None, []

    @property
    def is_opensim(self) -> bool:
        """Whether OpenSim wrote it: .sto and .mot."""
        return any(text.strip().lower() == "endheader" for text in self._texts)

    def says(self, key: str) -> str:
        """Return the lower-case value of a key in OpenSim's header; "" where it is absent."""
        lines = (text.partition("=") for text in self._texts if "=" in text)
        said = {one.strip().lower(): value.strip(" \t,;").lower() for one, _, value in lines}
        return said.get(key, "") if self.is_opensim else ""

    def unit_of(self, meaning: Meaning) -> str:
        """Return the unit of a column whose name states none; "" where these lines do neither."""
        if isinstance(meaning, JointColumn) and self.says("indegrees") == "yes":
            return {"position": "deg", "velocity": "deg/s"}.get(meaning.quantity, "")
        return self.length if isinstance(meaning, CoordinateColumn) else ""

    def refusal(self, row: str | None, rest: Iterable[str | None]) -> str:
        """Return why there is no table below these lines, by first row and rest."""
        layout = self.header or self.commented
        separator, names = self._names(row)
        if layout is not None and (not any(names) or len(names) == len(layout[0].names)):
            return _unusable(layout[0])
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
            return _one_column(self._texts, numbers)
        nothing = "no line names a column of times"
        what = nothing if self._texts else "has no line that names its columns"
        examples = "t,x,y,z or time_ms;height_mm or t,joint1_effort,joint1_position"
        return f"{what}; put one on top, for example {examples}"


def _one_column(texts: Sequence[str], numbers: Sequence[str]) -> str:
    """Say what a column that has no other beside it would be taken as, and how to say so."""
    name = next((text.strip() for text in texts if text not in numbers), "")
    meaning = meaning_of(name) if name else None
    place = _quoted([name], 0) if name else "1"
    what = f"holds one column of numbers ({numbers[0][:20]} to {numbers[-1][:20]}) without times"
    rate = f"--columns z={place} --fps F"
    if isinstance(meaning, CoordinateColumn):
        return f"{what}; {name[:40]!r} would be taken as positions: say their rate, {rate}"
    times = f"--columns times={place}"
    return f"{what}; say what they are: {times} for times of impacts [s], or {rate} for heights"


def _unusable(plan: ColumnPlan) -> str:
    """Return why none of a table's columns is of use."""
    reasons = reasons_of(plan.unused)
    offer = f"; {offer_by_name(plan.names)}" if reasons or len(plan.names) == 1 else ""
    if len(plan.names) <= 3:
        offer += "; name times of impacts, if it has them: --columns times=..."
    return (
        f"holds no track and no torques that can be used ({reasons or 'it has times alone'}){offer}"
    )


def _named_by(layout: Layout, line: str) -> Layout | None:
    """Add the units of a line to a layout; None where it is no row of units."""
    plan, separator = layout
    header = with_row(plan.names, cells_of(line, separator), plan.reading)
    return (_again(plan, header), separator) if header else None


def _again(plan: ColumnPlan, header: Sequence[str]) -> ColumnPlan:
    counts_rows = any(group.clock is ROWS for group in plan.groups)
    return layout_of(header, plan.reading, counts_rows=counts_rows) or plan


def _readings(line: str) -> Iterator[tuple[Separator, list[str]]]:
    """Yield the cells of a line by each separator that it may have."""
    has_marks = any(mark in line for mark in SEPARATORS if mark)
    for separator in SEPARATORS:
        if separator or not has_marks:  # "Time (s),X" has a space too
            yield separator, [cell.strip() for cell in cells_of(line, separator)]


def _layout(line: str) -> Layout | None:
    """Parse a line as a header, with the separator that makes most of it."""
    found = [
        (plan, separator)
        for separator, cells in _readings(line)
        if (plan := layout_of(cells, counts_rows=False)) is not None
    ]
    return next((layout for layout in found if layout[0].groups), found[0] if found else None)


def _row_readings(line: str) -> Iterator[tuple[Separator, list[str]]]:
    """Yield the cells of a row by each separator by which it is one."""
    for separator in SEPARATORS:
        cells = cells_of(line, separator)
        if not cells or not _is_number(cells[0], separator):
            continue
        seen = cells[:MAX_COLUMNS]
        is_row = sum(_is_number(cell, separator) for cell in seen) * 2 >= len(seen)
        if is_row and (len(cells) > 1 or separator is None):
            yield separator, cells


def _is_number(cell: str, separator: Separator) -> bool:
    try:
        return isfinite(Numbers(separator).read(cell))
    except ValueError:
        return False


# ---- Read the rows.


# What a motor's switch says; anything else does not tell.
_FLAGS = {
    **dict.fromkeys(("1", "1.0", "true", "yes", "on"), "1"),
    **dict.fromkeys(("0", "0.0", "false", "no", "off"), "0"),
}


class TextRows:
    """Rows of text, read into the columns that a plan needs.

    `least` is the number of cells that a row needs; None where it needs one for each column.
    """

    def __init__(
        self, path: Path, plan: ColumnPlan, separator: Separator, least: int | None = None
    ) -> None:
        self.plan = plan  # its meaning, as the first rows show it
        self.count = 0  # of rows
        self.failures = Failures()  # of these, those that cannot be read
        self.unlinked = 0  # of these, those of no object
        self._path = path
        self._separator = separator
        self._least = least
        self._numbers = Numbers(separator)
        self._thousands = Thousands(())
        self._clocks: dict[Clock, TextClock] = {}
        self._values: dict[int, list[NDArray[np.float64]]] = {}
        self._times: dict[Clock, list[tuple[NDArray[np.int64], NDArray[np.bool_]]]] = {}
        self._runs = RunNames(())
        self._run_numbers: list[int] = []
        self._passed = 0  # rows, and headings between them
        self._things: dict[str, int] = {}

    def read(self, lines: Lines) -> None:
        """Read all rows, counting those that cannot be read."""
        rows = self._cells(lines)
        first = list(islice(rows, UNIT_ROWS))
        try:
            self._look([cells for _, cells in first if cells and self._fault(cells) is None])
        except ValueError as error:
            raise LogError(f"{self._path}: {error}") from error
        every = chain(first, rows)
        # Rows at once, of 30,000 cells, before their texts are let go.
        at_once = max(64, 30_000 // max(len(self.plan.names), 1))
        while chunk := list(islice(every, at_once)):
            self._add(chunk)
            if self.count > MAX_ROWS:
                raise LogError(
                    f"{self._path}: is a table of over {MAX_ROWS} rows, the limit; split it"
                )

    def _cells(self, lines: Lines) -> Iterator[tuple[int, list[str] | None]]:
        """Yield each row's line number and cells; None where the line is too long."""
        separator, width = self._separator, len(self.plan.names)
        for number, line in lines:
            if line is None:
                yield number, None
                continue
            cells = cells_of(line, separator)
            is_empty = not (cells and cells[0].strip()) and not any(map(str.strip, cells or [line]))
            if is_empty or line.startswith("#"):
                continue
            if len(cells) > width and not any(map(str.strip, cells[width:])):
                cells = cells[:width]
            yield number, cells

    def _fault(self, cells: Sequence[str] | None) -> UnreadableError | None:
        """Return what is wrong with the number of a row's cells."""
        if cells is None:
            return UnreadableError("it is longer than any table's", DAMAGED_REMEDY)
        least = self._least or len(self.plan.names)
        if len(cells) < least:
            return UnreadableError(f"it has {len(cells)} of {least} cells", DAMAGED_REMEDY)
        if len(cells) > least and self._least is None:
            why = f"it has {len(cells)} cells, the header {least}"
            return UnreadableError(why, CELLS_REMEDY)
        return None

    def _look(self, whole: Sequence[Sequence[str]]) -> None:
        """Determine number format, time units, objects and joint names from the first rows."""
        plan = self.plan
        used = {*plan.numbers, *(at for clock in plan.clocks for at in clock.indices)}
        decimal = decimal_of(cells[index] for cells in whole for index in used)
        separator = self._separator
        self._numbers = Numbers(separator, "" if decimal == separator else decimal)
        self._thousands = Thousands(used)
        for clock in (one for one in plan.clocks if one.indices):
            texts: list[list[str]] = []
            for cells in whole:
                with suppress(ValueError):
                    texts.append([self._numbers.plain(cells[at]) for at in clock.indices])
            self._clocks[clock] = TextClock(clock, texts, plan.is_sampled(clock))
        if self._least is None:
            plan = told_apart(plan, whole)
        self.plan = plan.named_by(whole[0]) if whole else plan
        # Groups keep their clocks: only their columns' names may have changed.
        self._runs = RunNames([kind for _, kind in self.plan.runs])
        self._values = {at: [] for at in self.plan.numbers}
        self._times = {clock: [] for clock in self.plan.clocks}

    def _add(self, chunk: Sequence[tuple[int, list[str] | None]]) -> None:
        """Add some rows."""
        plan = self.plan
        bad = {at: why for at, (_, cells) in enumerate(chunk) if (why := self._fault(cells))}
        whole = [at for at in range(len(chunk)) if at not in bad]
        rows = [cells for at in whole if (cells := chunk[at][1]) is not None]
        wrong: dict[int, UnreadableError] = {}  # by their place in `rows`
        self._thousands.look(rows)
        numbers = {at: self._read(at, [cells[at] for cells in rows], wrong) for at in plan.numbers}
        some = np.zeros(len(rows), np.bool_)
        seen: dict[Clock, NDArray[np.bool_]] = {}
        for group in plan.groups:
            if group.is_impacts:
                at = group.clock.indices[-1]
                is_seen = np.array([not is_missing(cells[at]) for cells in rows], np.bool_)
            else:
                is_seen = group.seen(numbers)
                some |= group.seen(numbers, in_part=True)
            some |= is_seen
            for clock in (group.clock, group.stamp):
                if clock is not None:
                    seen[clock] = seen.get(clock, False) | is_seen
        times = {clock: self._read_times(clock, rows, seen[clock], wrong) for clock in plan.clocks}
        some[list(wrong)] = False
        for at, values in numbers.items():
            self._values[at].append(values[some])
        for clock, (stamps, known) in times.items():
            if clock is ROWS:
                stamps = (self._passed + np.array(whole, np.int64)) * 10**9  # noqa: PLW2901
            self._times[clock].append((stamps[some], known[some]))
        if plan.runs or plan.thing_of is not None:
            found = [rows[at] for at in np.flatnonzero(some).tolist()]
            cells_of_runs = ([cells[at] for at, _ in plan.runs] for cells in found)
            self._run_numbers += map(self._number_of, cells_of_runs)
        header = [name.strip() for name in plan.names]
        bad |= {whole[at]: error for at, error in wrong.items()}
        for at, error in sorted(bad.items()):
            line, cells = chunk[at]
            if cells and _is_heading(cells, header):
                self.count -= 1
            else:
                self.failures.add(line, error)
        self.count += len(chunk)
        self._passed += len(chunk)

    def _number_of(self, cells: Sequence[str]) -> int:
        if self.plan.thing_of is None:
            return self._runs.number(cells)
        name = self.plan.thing_of(cells)
        self.unlinked += not name
        return self._things.setdefault(name, len(self._things)) if name else -1

    def _read(
        self, at: int, texts: list[str], wrong: dict[int, UnreadableError]
    ) -> NDArray[np.float64]:
        """Read the cells of a column, shape (T,); NaN where they are missing or `wrong`."""
        numbers = self._numbers
        if at in self.plan.switches:
            texts = [_FLAGS.get(text.strip().lower(), "nan") for text in texts]
        try:
            plain = texts
            if numbers.decimal == ",":
                if any("." in text for text in texts):
                    raise ValueError("points may set thousands apart")
                plain = [text.replace(",", ".") for text in texts]
            values = np.array(list(map(float, plain)), np.float64)
        except ValueError:
            values = np.full(len(texts), np.nan)
            for row, text in enumerate(texts):
                try:
                    values[row] = numbers.read(text)
                except ValueError as why:
                    error = unreadable(self.plan.names[at], text, why, NUMBER_REMEDY)
                    wrong.setdefault(row, error)
        values[~np.isfinite(values)] = np.nan
        return values

    def _read_times(
        self,
        clock: Clock,
        rows: Sequence[Sequence[str]],
        needed: NDArray[np.bool_],
        wrong: dict[int, UnreadableError],
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Read the time of each row that needs one [ns], shape (T,), and which those are."""
        stamps = np.zeros(len(rows), np.int64)
        known = needed & np.ones(len(rows), np.bool_)
        known[list(wrong)] = False
        if not clock.indices:
            return stamps, known
        read, plain, indices = self._clocks[clock].read, self._numbers.plain, clock.indices
        for row in np.flatnonzero(known).tolist():
            texts: list[str] = []
            cells = rows[row]
            try:
                for index in indices:
                    texts.append(plain(cells[index]))  # noqa: PERF401 (the one that fails is named)
            except ValueError as why:
                index = indices[len(texts)]
                name = self.plan.names[index]
                wrong[row] = unreadable(name, cells[index], why, NUMBER_REMEDY)
                continue
            try:
                stamps[row] = read(texts)
            except ValueError:
                wrong[row] = unreadable(clock.name, " ".join(texts), "is no time", TIME_REMEDY)
        return stamps, known

    def episode(self, what: str, options: ReadOptions, **more: Any) -> Episode:
        """Build an episode of the rows; `more` as in `episode_of_rows`."""
        times = {
            clock: Times(
                np.concatenate([stamps for stamps, _ in parts] or [np.zeros(0, np.int64)]),
                np.concatenate([known for _, known in parts] or [np.zeros(0, np.bool_)]),
                self._clocks[clock].doubts if clock.indices else (),
            )
            for clock, parts in self._times.items()
        }
        failures, is_known = self.failures, any(one.known.any() for one in times.values())
        if why := failures.refusal(self.count) if is_known else failures.nothing(self.count):
            kind = "" if more.get("encoding") == "csv" else f"{what}: "
            raise LogError(f"{self._path}: {kind}{why}")
        if why := self._thousands.doubt(self.plan.names):
            raise LogError(f"{self._path}: {why}", NUMBER_REMEDY)
        rows = ColumnRows(
            {at: np.concatenate(parts) for at, parts in self._values.items()},
            times,
            np.array(self._run_numbers, np.int64),
            list(self._things) or self._runs.names,
            self._runs.note,
        )
        lost = [failures.lost(self.count)] if failures else []
        more["losses"] = [*lost, *more.get("losses", ())]
        more["unread"] = (len(failures), self.count - len(failures))
        return episode_of_rows(self._path, what, self.plan, rows, options, **more)


def _is_heading(cells: Sequence[str], header: Sequence[str]) -> bool:
    """Return whether a row between runs repeats the header or announces the next run."""
    stripped = [cell.strip() for cell in cells]
    if stripped == header:
        return True
    text = " ".join(filter(None, stripped))
    return bool(re.fullmatch(r"(?:run|trial|drop|take|episode)\W{0,3}\d{1,6}\W?", text, re.I))


def read_csv(path: Path, options: ReadOptions = AS_IT_SAYS) -> Episode:
    """Read a table as an episode: one signal per tracked object and per joint quantity."""
    try:
        return read_lines(path, lines_of(path), options)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error


def read_lines(path: Path, lines: Iterable[str | None], options: ReadOptions) -> Episode:
    """Read lines of text as a table, be they of a file or of a sheet's tab-separated cells."""
    plan, separator, below, before = _open(path, lines, options)
    rows = TextRows(path, fitted(path, plan, options), separator)
    rows.read(below)
    stated, losses = before.says("nrows"), list[str]()
    if stated.isdecimal() and len(stated) < 10 and rows.count < int(stated):
        losses.append(f"it says that it has {int(stated)} rows, and has {rows.count}")
    what = plan.kind or "table"
    episode = rows.episode(what, options, encoding="csv", losses=losses)
    kind = before.known.what if before.known else "of OpenSim" if before.is_opensim else ""
    if not kind:
        return episode
    source = f"{what} {path.name}, {kind}"
    return replace(episode, info=replace(episode.info, source=source))
