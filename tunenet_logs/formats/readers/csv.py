"""Read tables of tracks or torques (.csv, .tsv, .txt), as spreadsheets and ROS tools write them.

`open_table` finds the header line, wherever it stands, and lays out its columns by their names; the
parts before it suggest options, apply units and the user's `--columns`, and count rows as frames.
`read_lines` then reads the rows, be they of a file or of a sheet.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain, islice
from math import isclose, isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import (
    UNREADABLE,
    Channel,
    Episode,
    EpisodeInfo,
    Signal,
    added,
    in_proportion,
)
from tunenet_logs.errors import CHECK_DISK, LogError
from tunenet_logs.formats.columns.cells import (
    CELLS_REMEDY,
    DAMAGED_REMEDY,
    LOOK_ROWS,
    MAX_LINE,
    NUMBER_REMEDY,
    SEPARATORS,
    TIME_REMEDY,
    Clock,
    DayTurns,
    Failures,
    KnownRows,
    Numbers,
    Thousands,
    TimeUnit,
    UnreadableError,
    cells_of,
    decimal_of,
    is_of_day,
    known_rows,
    lacks_zone,
    lines_of,
    says_its_unit,
    unit_of_times,
    unreadable,
)
from tunenet_logs.formats.columns.names import (
    LENGTHS,
    POWERS,
    UNKNOWN,
    CoordinateColumn,
    FrameColumn,
    ImpactColumn,
    JointColumn,
    Meaning,
    Reading,
    RunColumn,
    TimeColumn,
    UnusedColumn,
    by_name,
    lowered,
    meaning_of,
    runs_of,
    words_of,
)
from tunenet_logs.formats.columns.table import (
    MAX_COLUMNS,
    Group,
    RunNames,
    SignalSamples,
    TableLayout,
    table_layout_of,
    telling_column,
    with_torques,
)
from tunenet_logs.formats.options import AS_IT_SAYS, ReadOptions

_MAX_SHOWN = 8  # columns in a message
_MAX_OFFER_ROWS = 100_000  # read to describe columns without names
_MAX_LENGTH = 30  # of a name in a message
_MAX_READ = 200  # of a name that is interpreted
_PLAIN = re.compile(r"[^\W\d][\w.\-/]*")  # a name that needs no quotes


def offer_by_number(first: str, rest: Iterable[str | None], separator: str | None) -> str:
    """Describe unnamed columns by their first and last values, with an example of `--columns`."""
    rows = [_values(first, separator)]
    last, increases = rows[0], True
    for line in islice(rest, _MAX_OFFER_ROWS):
        row = _values(line or "", separator)
        if len(row) == len(rows[0]) and row[0] is not None:
            increases = increases and last[0] is not None and row[0] > last[0]
            last = row
    pairs = list(zip(rows[0], last, strict=True))[:_MAX_SHOWN]
    listed = ", ".join(f"{at}: {_number(a)} to {_number(b)}" for at, (a, b) in enumerate(pairs, 1))
    more = ", ..." if len(last) > _MAX_SHOWN else ""
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
    return text + "for example --columns t=1,z=2"


def offer_by_name(names: Sequence[str]) -> str:
    """Suggest a `--columns` line made of a table's own column names."""
    meanings = [meaning_of(name[:_MAX_READ]) for name in names]
    is_place = [isinstance(one, CoordinateColumn) for one in meanings]
    is_value = [isinstance(one, CoordinateColumn | JointColumn) for one in meanings]
    named = [at for at, name in enumerate(names) if name.strip()]
    clocks = [at for at in named if isinstance(meanings[at], TimeColumn | FrameColumn)]
    clock = next(chain(clocks, (at for at in named if not is_value[at])), None)
    if clock is None:
        return _offer_of_rows(names, meanings)
    target = "frame" if isinstance(meanings[clock], FrameColumn) else "t"
    said = f"say which they are, for example --columns {target}={_quoted(names, clock)}"
    other = next((at for at in named if at != clock), None)
    if any(is_place) or other is None:
        return said
    meaning = meanings[other]
    value = f"{meaning.quantity}_1" if isinstance(meaning, JointColumn) else "z"
    return f"{said},{value}={_quoted(names, other)}"


def _offer_of_rows(names: Sequence[str], meanings: Sequence[object]) -> str:
    """Suggest options where there are positions alone: a row may be a frame."""
    text = "add a column of times (t) or of the numbers of frames (frame)"
    axes = {
        one.axis: _quoted(names, at)
        for at, one in reversed(list(enumerate(meanings)))
        if isinstance(one, CoordinateColumn)
    }
    said = ",".join(f"{'xyz'[axis]}={name}" for axis, name in sorted(axes.items()))
    if not said:
        return f"{text}; where rows have an even rate, say it: --fps 100"
    return f"{text}; where a row is a picture: --columns {said} --fps 30"


def short_list(names: Sequence[str]) -> str:
    """List the first few names."""
    shown = [repr(name.strip()[:_MAX_LENGTH]) for name in names if name.strip()]
    more = f", ... ({len(shown)} in all)" if len(shown) > _MAX_SHOWN else ""
    return ", ".join(shown[:_MAX_SHOWN]) + more


def _quoted(names: Sequence[str], at: int) -> str:
    """Return a column's name as it can be typed, or its number."""
    name = names[at].strip()
    if _PLAIN.fullmatch(name) and len(name) <= _MAX_LENGTH:
        return name
    if (
        not name
        or len(name) > _MAX_LENGTH
        or not name.isprintable()
        or set("'\"\\`$,=") & set(name)
    ):
        return str(at + 1)
    return f"'{name}'"


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


# ---- Units that a table states beside its names: in a row of them, or in its preamble.

# Words of units, also of those that are not read: a row of them is no row of numbers.
_WORDS = frozenset(
    (
        *LENGTHS,
        *POWERS,
        *("rad", "radian", "radians", "deg", "degree", "degrees", "n", "nm", "mnm", "kn"),
        *("px", "pix", "pixel", "pixels", "um", "km", "dm", "ma", "yd"),
        *("min", "mins", "minute", "minutes", "h", "hr", "hour", "hours", "day", "days"),
    )
)

_NONE = frozenset(("", "-", "1"))  # cells of a row of units that say none
# A preamble's "Length Units,Millimeters" or "units: mm".
_SAID = re.compile(r"\b(length[ _])?units?\b\W{1,5}(\w+)", re.IGNORECASE)

_REMEDY = "convert it to m, cm, mm, in or ft (times: s, ms, us or ns)"  # of a unit that is not read


def with_row(
    header: Sequence[str], cells: Sequence[str], reading: Reading = by_name
) -> list[str] | None:
    """Add the units of a row below a header to its names; None where it is no row of units.

    Args:
        header: the names.
        cells: the row's.
        reading: interpreter of the columns.

    Raises:
        ValueError: a unit is unknown, or contradicts the one in the name.
    """
    if any(map(str.strip, cells[len(header) :])):
        return None
    names = [name for _, name in runs_of(header)]
    said = {
        at: unit
        for at, (name, cell) in enumerate(zip(names, cells, strict=False))
        if (unit := cell.strip(" \t()[]")) not in _NONE and _size(reading(at, name)) is not None
    }
    texts = said.values()
    if any(map(str.isdecimal, "".join(texts))) or not any(map(_is_unit, texts)):
        return None
    return [
        _units_named(name, names[at], said[at], lambda text, at=at: reading(at, text))
        if at in said
        else name
        for at, name in enumerate(header)
    ]


def length_in(line: str) -> str:
    """Return the length unit that a line of a preamble states; "" where it states none.

    Raises:
        ValueError: the unit is unknown.
    """
    for is_length, unit in _SAID.findall(line):
        if unit.lower() in LENGTHS:
            return unit
        if is_length:
            raise ValueError(f"lengths are in {unit[:40]!r}, which is not read; {_REMEDY}")
    return ""


def with_lengths(header: Sequence[str], unit: str, reading: Reading = by_name) -> list[str]:
    """Add a length unit to the names of positions that state none."""
    return [
        f"{name} ({unit})"
        if isinstance(reading(at, rest), CoordinateColumn) and _without_unit(rest) is None
        else name
        for at, (name, (_, rest)) in enumerate(zip(header, runs_of(header), strict=True))
    ]


def with_degrees(header: Sequence[str], reading: Reading = by_name) -> list[str]:
    """Add degrees to the names of joint angles and velocities that state no unit."""
    return [
        f"{name} (deg{'/s' if meaning.quantity == 'velocity' else ''})"
        if isinstance(meaning := reading(at, rest), JointColumn)
        and meaning.quantity in ("position", "velocity")
        and _without_unit(rest) is None
        else name
        for at, (name, (_, rest)) in enumerate(zip(header, runs_of(header), strict=True))
    ]


def unit_behind(name: str) -> str:
    """Return the unit at the end of a name, in brackets or as last word; "" for none."""
    found = re.search(r"[(\[]([^()\[\]]{1,40})[)\]]\s*$", name)
    words = lowered(words_of(found[1] if found else name, camel=False))
    if found:
        return found[1] if _WORDS.intersection(words) or words in (("a",), ("ma",)) else ""
    return words[-1] if len(words) > 1 and words[-1] in _WORDS else ""


def unit_alone(text: str) -> str | None:
    """Return the unit that a cell consists of, in brackets or not; None where it is no unit."""
    stripped = text.strip(" \t()[]")
    return stripped if stripped in _NONE or _is_unit(stripped) else None


def _is_unit(text: str) -> bool:
    words = lowered(words_of(text, camel=False))
    return bool(words) and _WORDS.issuperset(words)


def _without_unit(name: str) -> str | None:
    """Strip a name of its unit; None where it has none."""
    words = words_of(name, camel=False)
    rest = list(words)
    while rest and rest[-1].lower() in _WORDS:
        rest.pop()
    return (" ".join(rest) or "time") if len(rest) < len(words) else None


def _units_named(name: str, plain: str, unit: str, reading: Callable[[str], Meaning]) -> str:
    """Return a column's name with its unit; `plain` is the name without its run."""
    rest = _without_unit(plain)
    meaning = reading(f"{rest or plain} ({unit})")
    if meaning == UNKNOWN:
        raise ValueError(f"{name[:60]!r} is in {unit[:40]!r}, which is not read; {_REMEDY}")
    if rest is None:
        return f"{name} ({unit})"
    if _size(meaning) != _size(reading(plain)):
        raise ValueError(f"{name[:60]!r} is said to be in {unit[:40]!r}; say one unit")
    return name


def _size(meaning: Meaning) -> float | None:
    """Return the size of a meaning's unit; None where it has no values."""
    if isinstance(meaning, TimeColumn):
        return meaning.power or 0
    return meaning.scale if isinstance(meaning, CoordinateColumn | JointColumn) else None


# ---- Columns that the user names with `--columns`.

CLOCKS = ("t", "frame", "times")  # targets that are times; one of them is enough
_AXES = {"x": 0, "y": 1, "z": 2}  # of targets that are coordinates
_UNSAID = UnusedColumn("--columns does not name it")  # the meaning of all others


def contradiction_of(columns: Mapping[str, str]) -> str:
    """Return why `--columns` contradicts itself; "" where it does not."""
    clocks = [one for one in CLOCKS if one in columns]
    if len(clocks) > 1:
        return f"--columns says {clocks[0]} and {clocks[1]}; say one of them"
    if "times" in columns and len(columns) > 1:
        return "--columns says times, which are impacts, and other columns; say times alone"
    return ""


def is_name(place: str, names: Sequence[str]) -> bool:
    """Return whether a column has this name."""
    return _index_of(place, names) is not None


def places_of(columns: Mapping[str, str], names: Sequence[str]) -> tuple[dict[int, str], list[str]]:
    """Find the user's columns in a table; return targets by index, and the missing ones.

    Args:
        columns: names, or numbers from 1, by target.
        names: of the table's columns.
    """
    found: dict[int, str] = {}
    missing: list[str] = []
    for target, place in columns.items():
        at = _index_of(place, names)
        if at is None and re.fullmatch(r"[1-9]\d{0,3}", place, re.ASCII):
            at = int(place) - 1 if int(place) <= len(names) else None
        if at is None:
            missing.append(place)
        else:
            found[at] = target
    return found, missing


def _index_of(place: str, names: Sequence[str]) -> int | None:
    place = place.strip()
    stripped = [name.strip() for name in names]
    if place in stripped:
        return stripped.index(place)
    folded, wanted = [name.casefold() for name in stripped], place.casefold()
    if wanted in folded:
        return folded.index(wanted)
    without = [re.sub(r"(?<!\s)\s*[(\[][^()\[\]]*[)\]]$", "", name) for name in folded]
    return without.index(wanted) if without.count(wanted) == 1 else None


def said_reading(places: Mapping[int, str]) -> Reading:
    """Return the interpreter of columns that a user names, by index.

    A clock that is named excludes all other clocks; values that are named, all other values. The
    interpreter raises ValueError where a column's unit does not fit its target.
    """
    targets = set(places.values()) - {"object"}
    has_clock = not targets.isdisjoint(CLOCKS)
    has_values = "times" in targets or not targets.issubset(CLOCKS)

    def read(at: int, name: str) -> Meaning:
        if at in places:
            return _meaning_as(places[at], name)
        found = meaning_of(name)
        if isinstance(found, RunColumn | UnusedColumn):
            return found
        is_clock = isinstance(found, TimeColumn | FrameColumn)
        return _UNSAID if (has_clock if is_clock else has_values) else found

    return read


def _meaning_as(target: str, name: str) -> Meaning:
    """Return the meaning of a column named as a target; its name may state the unit."""
    if target in ("frame", "object"):
        return FrameColumn() if target == "frame" else RunColumn("object")
    unit = unit_behind(name)
    if target in _AXES:
        found = meaning_of(f"{target} ({unit})" if unit else target)
        if isinstance(found, CoordinateColumn):
            return found
    elif target in ("t", "times"):
        found = meaning_of(f"t ({unit})" if unit else "t")
        own = meaning_of(name)
        if target == "times" and isinstance(own, FrameColumn):
            return ImpactColumn(0, counts_frames=True)
        if not unit and isinstance(own, TimeColumn):
            found = TimeColumn(own.power)
        if isinstance(found, TimeColumn):
            return ImpactColumn(found.power) if target == "times" else found
    else:
        quantity, _, number = target.partition("_")
        found = meaning_of(f"joint{number}_{quantity}" + (f" ({unit})" if unit else ""))
        if isinstance(found, JointColumn):
            return found
    raise ValueError(
        f"--columns says that {name[:60]!r} is {target}, but it is in {unit[:40]!r}, which is no "
        "unit of that; name another column"
    )


# ---- Tables without a clock: a row is a frame where the user states the frame rate.

ROW = "frame"  # the column of row numbers, behind the others


def said_layout(
    places: Mapping[int, str], names: Sequence[str], separator: str | None, counts_rows: bool
) -> tuple[TableLayout, bool]:
    """Lay out the columns that a user names; also return whether rows are frames.

    Args:
        places: meaning of the columns, by index.
        names: of all columns.
        separator: of cells.
        counts_rows: whether a row may be a frame.

    Raises:
        ValueError: no column is a time, or a unit does not fit its target.
    """
    layout = table_layout_of(names, separator, said_reading(places))
    if layout is not None:
        return layout, False
    if counts_rows and set(CLOCKS).isdisjoint(places.values()):
        more = {**places, len(names): "frame"}
        layout = table_layout_of([*names, ROW], separator, said_reading(more))
    if layout is None:
        raise ValueError(
            "none of its columns is known as a time; say it as well: t=COLUMN, or frame=COLUMN; "
            "where a row is a frame, say how many there are in a second, for example --fps 30"
        )
    return layout, True


def numbered(
    rows: Iterable[tuple[int, str | None]], layout: TableLayout
) -> Iterator[tuple[int, str | None]]:
    """Append to each row its number from 0 as a cell; lines without a row have none."""
    separator = layout.separator or " "
    count = 0
    for line_number, line in rows:
        if line is None or (line.strip() and not line.startswith(("#", "%"))):
            yield line_number, None if line is None else f"{line.rstrip()}{separator}{count}"
            count += 1
        else:
            yield line_number, line


# ---- Find the header line and its units.

_MAX_BEFORE = 200  # lines of a preamble
_MAX_NAMES = 20_000  # of columns, in all lines of a preamble
# Headers that are understood, for error messages.
_EXAMPLE = "for example t,x,y,z or time_ms;height_mm or t,joint1_effort,joint1_position"

_FEW_COLUMNS = 3  # a table of so few may hold impact times
_NAMELESS = "has no line that names its columns"  # it begins with a row
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
            if before.accepted_options(number, line):
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

    def accepted_options(self, number: int, line: str | None) -> bool:
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


# ---- Read the rows.

_LOOK_ROWS = 100  # read ahead, which tell the number format and the unit of times that name none
_FEW_ROWS = 5  # in which numbers that all differ may still be those of objects
_MAX_ROWS = 2_000_000  # of a table: its cells are read one by one, in Python; 2 hours at 240 Hz


def read_csv(path: Path, options: ReadOptions = AS_IT_SAYS) -> Episode:
    """Read a table as an episode: one signal per tracked object and per joint quantity.

    Raises:
        LogError: no header that is understood, no readable row, or too many unreadable ones.
    """
    try:
        return read_lines(path, lines_of(path), options)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error


def read_lines(path: Path, lines: Iterable[str | None], options: ReadOptions) -> Episode:
    """Read lines of text as a table, be they of a file or of a sheet's tab-separated cells.

    Args:
        path: of the file, for messages.
        lines: without line ends; None for one that is too long.
        options: the user's.

    Raises:
        LogError: see `read_csv`.
    """
    table = open_table(path, lines, options.columns, options.rate_hz is not None)
    if why := _contradiction(table.layout, options):
        raise LogError(f"{path}: {why}")
    try:
        groups = with_torques(table.layout.groups, options.torque_constants)
    except ValueError as error:
        raise LogError(f"{path}: {error}") from error
    table = replace(table, layout=replace(table.layout, groups=tuple(groups)))
    rows = _TableReading(table, options)
    rows.read(path)
    return rows.episode(path)


class _TableReading:
    """One pass over the rows of a table."""

    def __init__(self, table: OpenTable, options: ReadOptions) -> None:
        self._table = table
        self._layout: TableLayout = table.layout
        self._runs = RunNames([kind for _, kind in table.layout.runs])
        self._clocks = tuple(dict.fromkeys(group.clock for group in table.layout.groups))
        self._samples = [
            SignalSamples(group, table.layout.header, options) for group in table.layout.groups
        ]
        has_stamps = any(group.stamp is not None for group in table.layout.groups)
        self._is_plain = len(self._clocks) == 1 and not has_stamps and not table.layout.runs
        self._numbers = Numbers(table.layout.separator)
        self._units: dict[Clock, TimeUnit] = {}
        self._turns: dict[Clock, DayTurns] = {}
        self._dated: dict[str, bool] = {}
        self._count = 0
        self._failures = Failures()
        self._thousands = Thousands(())

    def read(self, path: Path) -> None:
        """Read all rows, counting those that cannot be read.

        Raises:
            LogError: the table has too many rows.
        """
        rows = self._cells()
        first = list(islice(rows, _LOOK_ROWS))
        try:
            self._look([cells for _, cells in first if cells and len(cells) == self._layout.width])
        except ValueError as error:
            raise LogError(f"{path}: {error}") from error
        for line, cells in chain(first, rows):
            try:
                self._add(cells)
            except UnreadableError as error:
                if cells and _is_heading(cells, self._layout.header):
                    continue
                self._failures.add(line, error)
            self._count += 1
            if self._count > _MAX_ROWS:
                raise LogError(f"{path}: is a table of over {_MAX_ROWS} rows, the limit; split it")

    def _cells(self) -> Iterator[tuple[int, list[str] | None]]:
        """Yield each row's line number and cells; None where the line is too long."""
        separator, width = self._layout.separator, self._layout.width
        for number, line in self._table.rows:
            if line is None:
                yield number, None
                continue
            cells = cells_of(line, separator)
            if line.startswith("#") or not any(map(str.strip, cells or [line])):
                continue
            if len(cells) > width and not any(map(str.strip, cells[width:])):
                cells = cells[:width]
            yield number, cells

    def _look(self, whole: Sequence[Sequence[str]]) -> None:
        """Determine number format, time units and joint names from the first rows."""
        stamps = [group.stamp for group in self._layout.groups if group.stamp is not None]
        clocks = tuple(dict.fromkeys((*self._clocks, *stamps)))
        used = {column.index for group in self._layout.groups for column in group.used}
        used.update(index for clock in clocks for index in clock.indices)
        decimal = decimal_of(cells[index] for cells in whole for index in used)
        separator = self._layout.separator
        self._numbers = Numbers(separator, "" if decimal == separator else decimal)
        self._thousands = Thousands(used)
        for clock in clocks:
            self._find_unit(clock, whole)
        self._tell_apart(whole, used)
        for samples in self._samples:
            samples.columns = _named(samples.group, self._layout, whole)

    def _tell_apart(self, rows: Sequence[Sequence[str]], used: set[int]) -> None:
        """Find the column that identifies objects, where several rows share a stamp."""
        runs = tuple(
            one
            for one in self._layout.runs
            if len(rows) < _FEW_ROWS or len({row[one[0]] for row in rows}) < len(rows)
        )  # not those that count the rows
        told = (*self._clocks[0].indices, *(at for at, _ in runs))
        stamps = [[row[at] for at in told] for row in rows]
        taken = {*used, *(at for at, _ in runs), *self._layout.names.values()}
        columns = {
            at: [row[at] for row in rows] for at in range(self._layout.width) if at not in taken
        }
        found = telling_column(stamps, columns) if len(self._clocks) == 1 else None
        if found is None:
            self._count_runs(runs)
            return
        name = re.sub(r"\W+", "_", self._layout.header[found].strip()).strip("_").lower()
        self._count_runs((*runs, (found, name[:20] or "object")))

    def _count_runs(self, runs: tuple[tuple[int, str], ...]) -> None:
        self._layout = replace(self._layout, runs=runs)
        self._runs = RunNames([kind for _, kind in runs])
        self._is_plain &= not runs

    def _find_unit(self, clock: Clock, rows: Sequence[Sequence[str]]) -> None:
        """Determine the unit of a clock from the cells of the first rows.

        Raises:
            ValueError: no unit of a log fits.
        """
        numbers: list[str] = []
        at = clock.indices[-1 if clock.has_date else 0]
        for cells in rows:
            with suppress(ValueError):
                numbers.append(self._numbers.plain(cells[at]))
        if any(map(says_its_unit, numbers)):
            self._units[clock] = TimeUnit(10 ** (9 + (clock.power or 0)))
            self._dated[clock.name] = any(map(lacks_zone, numbers))
            of_day = next(filter(is_of_day, numbers), None)
            if of_day is not None and not clock.has_date:
                self._turns[clock] = DayTurns(of_day)
            return
        is_sum = len(clock.indices) > 1 and not clock.has_date
        power = 0 if is_sum or clock.counts_frames else clock.power
        timed = [group for group in self._layout.groups if clock in (group.clock, group.stamp)]
        is_sampled = not all(group.is_impacts for group in timed)
        self._units[clock] = unit_of_times(clock.name, numbers, power, is_sampled=is_sampled)

    def _add(self, cells: Sequence[str] | None) -> None:
        """Add a row; raise UnreadableError where the row as a whole is malformed."""
        if cells is None:
            raise UnreadableError("it is longer than any table's", DAMAGED_REMEDY)
        if (count := len(cells)) < (width := self._layout.width):
            raise UnreadableError(f"it has {count} of {width} cells", DAMAGED_REMEDY)
        if count > width:
            raise UnreadableError(f"it has {count} cells, the header {width}", CELLS_REMEDY)
        self._thousands.look(cells)
        read = [(samples, samples.read(cells, self._numbers)) for samples in self._samples]
        found = [(samples, row) for samples, row in read if row is not None]
        if not found:
            return
        if self._is_plain:
            arrival_ns = self._time(self._clocks[0], cells)
            for samples, row in found:
                samples.add(0, arrival_ns, row)
            return
        if len(self._clocks) == 1:
            arrivals = [self._time(self._clocks[0], cells)] * len(found)
        else:
            arrivals = [self._time(samples.group.clock, cells) for samples, _ in found]
        stamps = (samples.group.stamp for samples, _ in found)
        taken = [0 if stamp is None else self._time(stamp, cells) for stamp in stamps]
        runs = [cells[at] for at, _ in self._layout.runs]
        run = self._runs.number(runs) if runs else None
        for stamp_ns, arrival_ns, (samples, row) in zip(taken, arrivals, found, strict=True):
            samples.add(stamp_ns, arrival_ns, row)
            if run is not None:
                samples.add_run(run)

    def _time(self, clock: Clock, cells: Sequence[str]) -> int:
        texts: list[str] = []
        for index in clock.indices:
            try:
                texts.append(self._numbers.plain(cells[index]))
            except ValueError as why:
                name = self._layout.header[index]
                raise unreadable(name, cells[index], why, NUMBER_REMEDY) from None
        try:
            time_ns = clock.read(texts, self._units[clock].ns)
        except ValueError:
            raise unreadable(clock.name, " ".join(texts), "is no time", TIME_REMEDY) from None
        return self._turns[clock](time_ns) if clock in self._turns else time_ns

    def episode(self, path: Path) -> Episode:
        """Return the rows read as an episode.

        Raises:
            LogError: no row, or too few of them, can be read.
        """
        filled = [samples for samples in self._samples if samples.arrivals]
        if not filled:
            raise LogError(f"{path}: {self._failures.nothing(self._count)}")
        if why := self._failures.refusal(self._count):
            raise LogError(f"{path}: {why}")
        if why := self._thousands.doubt(self._layout.header):
            raise LogError(f"{path}: {why}", NUMBER_REMEDY)
        first_ns = min(min(samples.arrivals) for samples in filled)
        notes = self._notes(first_ns)
        signals: dict[str, Signal] = {}
        channels: list[Channel] = []
        for samples in self._samples:
            try:
                made, own, repairs = samples.signals(max(0, -first_ns), self._runs.names)
            except ValueError as error:
                raise LogError(f"{path}: {error}") from error
            signals.update({signal.name: signal for signal in made if len(signal.stamps_ns)})
            channels += own
            notes += repairs
        if len(signals) > len(filled) and self._runs.note:
            notes.append(self._runs.note)
        notes += dict.fromkeys(unit.doubt for unit in self._units.values() if unit.doubt)
        none: NDArray[np.int64] = np.empty(0, np.int64)
        channels += [
            Channel(name[:200], "", "csv", none, skipped=reason)
            for name, reason in self._layout.unused.items()
        ]
        lost = (self._failures.lost(self._count),) if self._failures else ()
        if lost:
            failed = len(self._failures), self._count - len(self._failures)
            for name, signal in signals.items():
                unread = {UNREADABLE: in_proportion(len(signal.stamps_ns), *failed)}
                signals[name] = replace(signal, left_out=added(signal.left_out, unread))
        if self._table.said_rows is not None and self._count < self._table.said_rows:
            lost += (f"it says that it has {self._table.said_rows} rows, and has {self._count}",)
        what = f", {self._table.what}" if self._table.what else ""
        info = EpisodeInfo(source=f"table {path.name}{what}")
        return Episode(info, signals, tuple(channels), (*lost, *notes), lost)

    def _notes(self, first_ns: int) -> list[str]:
        notes = [
            f"{name!r} names no time zone and was taken as UTC"
            for name, is_zoneless in self._dated.items()
            if is_zoneless
        ]
        if first_ns < 0:
            notes.append(f"times begin at {first_ns / 1e9:.9g} s; they were moved to begin at 0")
        return notes


def _named(group: Group, layout: TableLayout, rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return a signal's columns, numbered ones renamed by the names in the first row."""
    if not rows:
        return group.columns
    names = {
        column: rows[0][layout.names[number]].strip()
        for column, number in group.numbers.items()
        if number in layout.names
    }
    named = tuple(names.get(column) or column for column in group.columns)
    return named if len(set(named)) == len(named) else group.columns


def _is_heading(cells: Sequence[str], header: Sequence[str]) -> bool:
    """Return whether a row between runs repeats the header or announces the next run."""
    stripped = [cell.strip() for cell in cells]
    if len(cells) == len(header) and stripped == [name.strip() for name in header]:
        return True
    text = " ".join(filter(None, stripped))
    return bool(re.fullmatch(r"(?:run|trial|drop|take|episode)\W{0,3}\d{1,6}\W?", text, re.I))


def _contradiction(layout: TableLayout, options: ReadOptions) -> str:
    """Return how the user's length unit contradicts the table's; "" where it does not."""
    for group in layout.groups if options.length_unit else ():
        for column in group.used if group.unit == "m" else ():
            if options.length_m is None or not isclose(column.scale, options.length_m):
                named = next(name for name, size in LENGTHS.items() if size == column.scale)
                return (
                    f"column {layout.header[column.index][:60]!r} is in {named}, and --length-unit "
                    f"says {options.length_unit}; leave it out"
                )
    return ""
