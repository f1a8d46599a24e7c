"""Read tables of tracks or torques (.csv, .tsv, .txt), as spreadsheets and ROS tools write them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain, islice
from math import isclose
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import CHECK_DISK, LogError
from tunenet_logs.formats.read_options import AS_IT_SAYS, ReadOptions
from tunenet_logs.formats.tables.failures import (
    CELLS_REMEDY,
    DAMAGED_REMEDY,
    NUMBER_REMEDY,
    TIME_REMEDY,
    Failures,
    UnreadableError,
    unreadable,
)
from tunenet_logs.formats.tables.group import Group
from tunenet_logs.formats.tables.header import OpenTable, open_table
from tunenet_logs.formats.tables.joints import with_torques
from tunenet_logs.formats.tables.layout import TableLayout
from tunenet_logs.formats.tables.lines import cells_of, lines_of
from tunenet_logs.formats.tables.meaning import LENGTHS
from tunenet_logs.formats.tables.numbers import Numbers, Thousands, decimal_of
from tunenet_logs.formats.tables.runs import RunNames, telling_column
from tunenet_logs.formats.tables.samples import SignalSamples
from tunenet_logs.formats.tables.times import (
    Clock,
    DayTurns,
    TimeUnit,
    is_of_day,
    lacks_zone,
    says_its_unit,
    unit_of_times,
)
from tunenet_logs.left_out import UNREADABLE, added, in_proportion

# Read ahead, to see how numbers are written and in which unit times are that name none.
_LOOK_ROWS = 100

_FEW_ROWS = 5  # in which numbers that are all others may still be of things
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
        stamps = {group.stamp for group in self._layout.groups if group.stamp is not None}
        clocks = {*self._clocks, *stamps}
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
