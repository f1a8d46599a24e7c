"""Tables of tracks or torques (.csv, .tsv, .txt), as spreadsheets and tools of ROS write them."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import LogError
from tunenet_logs.formats.tables.failures import (
    CELLS_REMEDY,
    DAMAGED_REMEDY,
    NUMBER_REMEDY,
    TIME_REMEDY,
    Failures,
    UnreadableError,
    unreadable,
)
from tunenet_logs.formats.tables.header import OpenTable, open_table
from tunenet_logs.formats.tables.layout import Group, TableLayout
from tunenet_logs.formats.tables.lines import cells_of
from tunenet_logs.formats.tables.numbers import Numbers, decimal_of
from tunenet_logs.formats.tables.times import Clock, lacks_zone, power_by_size, says_its_unit
from tunenet_logs.timestamp_correction import order_samples

_LOOK_ROWS = 100
"""Read ahead, to see how numbers are written and in which unit times are that name none."""

_SLOW_S = 0.5
"""From row to row; what is sampled more slowly was timed in another unit than seconds, perhaps."""


def read_csv(path: Path) -> Episode:
    """A table as an episode: a signal for each thing that moves, and for each joints' quantity.

    Raises:
        LogError: it has no header that is understood, no row that can be read, or many
            that cannot.
    """
    try:
        table = open_table(path)
        rows = _TableReading(table)
        rows.read()
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error
    return rows.episode(path)


class _TableReading:
    """One pass over the rows of a table."""

    def __init__(self, table: OpenTable) -> None:
        self._table = table
        self._layout: TableLayout = table.layout
        self._samples = [
            _SignalSamples(group, table.layout.header) for group in table.layout.groups
        ]
        self._numbers = Numbers(table.layout.separator)
        self._powers: dict[Clock, int] = {}
        self._dated: dict[str, bool] = {}
        self._count = 0
        self._failures = Failures()

    def read(self) -> None:
        """All rows; those that cannot be read are counted."""
        rows = self._cells()
        first = list(islice(rows, _LOOK_ROWS))
        self._look([cells for _, cells in first if cells and len(cells) == self._layout.width])
        for line, cells in chain(first, rows):
            try:
                self._add(cells)
            except UnreadableError as error:
                self._failures.add(line, error)
            self._count += 1

    def _cells(self) -> Iterator[tuple[int, list[str] | None]]:
        """The number of each row's line and its cells; None where it is too long."""
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
        """How numbers are written, units of times that have none, names of joints."""
        stamps = {group.stamp for group in self._layout.groups if group.stamp is not None}
        clocks = {self._layout.clock, *stamps}
        used = {column.index for group in self._layout.groups for column in group.used}
        used.update(index for clock in clocks for index in clock.indices)
        decimal = decimal_of(cells[index] for cells in whole for index in used)
        separator = self._layout.separator
        self._numbers = Numbers(separator, "" if decimal == separator else decimal)
        for clock in clocks:
            self._find_unit(clock, [cells[clock.indices[0]] for cells in whole])
        for samples in self._samples:
            samples.columns = _named(samples.group, self._layout, whole)

    def _find_unit(self, clock: Clock, texts: Sequence[str]) -> None:
        """The unit of a clock, by the cells of the first rows."""
        numbers: list[str] = []
        for text in texts:
            with suppress(ValueError):
                numbers.append(self._numbers.plain(text))
        self._powers[clock] = power_by_size(numbers) if clock.power is None else clock.power
        if any(map(says_its_unit, numbers)):
            self._dated[clock.name] = any(map(lacks_zone, numbers))

    def _add(self, cells: Sequence[str] | None) -> None:
        """Raises UnreadableError: it is no row of the table, as a whole."""
        if cells is None:
            raise UnreadableError("it is longer than any table's", DAMAGED_REMEDY)
        if (count := len(cells)) < (width := self._layout.width):
            raise UnreadableError(f"it has {count} of {width} cells", DAMAGED_REMEDY)
        if count > width:
            raise UnreadableError(f"it has {count} cells, the header {width}", CELLS_REMEDY)
        read = [(samples, samples.read(cells, self._numbers)) for samples in self._samples]
        found = [(samples, row) for samples, row in read if row is not None]
        if not found:
            return
        arrival_ns = self._time(self._layout.clock, cells)
        stamps = (samples.group.stamp for samples, _ in found)
        taken = [0 if stamp is None else self._time(stamp, cells) for stamp in stamps]
        for stamp_ns, (samples, row) in zip(taken, found, strict=True):
            samples.add(stamp_ns, arrival_ns, row)

    def _time(self, clock: Clock, cells: Sequence[str]) -> int:
        texts: list[str] = []
        for index in clock.indices:
            try:
                texts.append(self._numbers.plain(cells[index]))
            except ValueError as why:
                name = self._layout.header[index]
                raise unreadable(name, cells[index], why, NUMBER_REMEDY) from None
        try:
            return clock.read(texts, self._powers[clock])
        except ValueError:
            raise unreadable(clock.name, " ".join(texts), "is no time", TIME_REMEDY) from None

    def episode(self, path: Path) -> Episode:
        """What was read.

        Raises:
            LogError: that is nothing, or too little of it.
        """
        filled = [samples for samples in self._samples if samples.arrivals]
        if not filled:
            raise LogError(f"{path}: {self._failures.nothing(self._count)}")
        if why := self._failures.refusal(self._count):
            raise LogError(f"{path}: {why}")
        first_ns = min(min(samples.arrivals) for samples in filled)
        notes = self._notes(first_ns)
        signals: dict[str, Signal] = {}
        for samples in filled:
            signals[samples.group.name], repairs = samples.signal(max(0, -first_ns))
            notes += repairs
        notes += self._doubts(signals)
        channels = [
            Channel(samples.group.name, _type(samples), "csv", np.array(samples.arrivals, np.int64))
            for samples in self._samples
        ]
        none: NDArray[np.int64] = np.empty(0, np.int64)
        channels += [
            Channel(name[:200], "", "csv", none, skipped=reason)
            for name, reason in self._layout.unused.items()
        ]
        lost = (self._failures.lost(self._count),) if self._failures else ()
        info = EpisodeInfo(source=f"table {path.name}")
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

    def _doubts(self, signals: dict[str, Signal]) -> list[str]:
        """Times that may be in another unit than was guessed."""
        clock = self._layout.clock
        rates = [signal.rate_hz for signal in signals.values() if signal.rate_hz]
        is_known = clock.power is not None or clock.name in self._dated or self._powers[clock]
        if is_known or not rates or max(rates) > 1 / _SLOW_S:
            return []
        return [
            f"{clock.name!r} names no unit and was taken as seconds, {1 / max(rates):g} from row "
            "to row; if it is not, name it t_ms, t_us or t_ns"
        ]


class _SignalSamples:
    """What one group of columns has delivered: flat, a table of an hour must fit."""

    def __init__(self, group: Group, header: Sequence[str]) -> None:
        self.group = group
        self.columns = group.columns
        self.stamps = array("q")
        self.arrivals = array("q")
        self._header = header
        self._incomplete = 0
        self._values = array("d")
        self._empty = [0.0 if group.needs_all else float("nan")] * len(group.columns)

    def read(self, cells: Sequence[str], numbers: Numbers) -> list[float] | None:
        """The values of a row; None where it has none, or lacks a coordinate.

        Raises:
            UnreadableError: what is there is no number.
        """
        row = self._empty.copy()
        missing = 0
        for column in self.group.used:
            try:
                value = numbers.read(cells[column.index])
            except ValueError as why:
                name = self._header[column.index]
                raise unreadable(name, cells[column.index], why, NUMBER_REMEDY) from None
            row[column.row] = value * column.scale
            missing += value != value  # noqa: PLR0124 (NaN)
        if missing == len(self.group.used):
            return None
        if missing and self.group.needs_all:
            self._incomplete += 1
            return None
        return row

    def add(self, stamp_ns: int, arrival_ns: int, row: list[float]) -> None:
        """One more sample."""
        self.stamps.append(stamp_ns)
        self.arrivals.append(arrival_ns)
        self._values.extend(row)

    def signal(self, offset_ns: int) -> tuple[Signal, list[str]]:
        """The signal, and what was left out or repaired."""
        arrivals = np.frombuffer(self.arrivals, np.int64) + offset_ns
        stamps = np.frombuffer(self.stamps, np.int64)
        values = np.frombuffer(self._values).reshape(-1, len(self.columns))
        if len(arrivals) < 2:  # too few to tell whether stamps were set
            stamps = arrivals
        keep, stamps_ns, notes = order_samples(stamps, arrivals)
        if self._incomplete:
            notes.append(f"{self._incomplete} samples without all coordinates were left out")
        name = self.group.name
        signal = Signal(name, stamps_ns, values[keep], self.columns, self.group.unit)
        return signal, [f"{name}: {note}" for note in notes]


def _named(group: Group, layout: TableLayout, rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """The columns of a signal, those by number under the names that the first row gives."""
    if not rows:
        return group.columns
    names = {
        column: rows[0][layout.names[number]].strip()
        for column, number in group.numbers.items()
        if number in layout.names
    }
    named = tuple(names.get(column) or column for column in group.columns)
    return named if len(set(named)) == len(named) else group.columns


def _type(samples: _SignalSamples) -> str:
    columns = ", ".join(samples.columns) if len(samples.columns) <= 8 else "joints"
    return f"{columns} [{samples.group.unit}]"
