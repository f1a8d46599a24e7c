"""Tables of tracks or torques (.csv, .tsv, .txt), as spreadsheets and tools of ROS write them."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import LogError
from tunenet_logs.formats.tables.header import Table, open_table
from tunenet_logs.formats.tables.layout import Group, Layout
from tunenet_logs.formats.tables.lines import cells_of, number_of, plain
from tunenet_logs.formats.tables.times import Clock, power_by_size
from tunenet_logs.stamps import order_samples

_NAN = float("nan")
_LOOK = 100
"""Rows by which the unit of a time without one is told."""

_SLOW_S = 0.5


def read_csv(path: Path) -> Episode:
    """A table as an episode: a signal for each thing that moves, and for each joints' quantity.

    Raises:
        LogError: it has no header that is understood, or no row that can be read.
    """
    try:
        table = open_table(path)
        rows = _Rows(table)
        rows.read()
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error
    return rows.episode(path)


class _Samples:
    """What one group of columns has delivered: flat, a table of an hour must fit."""

    def __init__(self, group: Group) -> None:
        self.group = group
        self.columns = group.columns
        self.stamps = array("q")
        self.arrivals = array("q")
        self._values = array("d")
        self._empty = [0.0 if group.needs_all else _NAN] * len(group.columns)

    def read(self, cells: Sequence[str], separator: str | None) -> list[float] | None:
        """The values of a row; None where it has none.

        Raises:
            ValueError: what is there is no number, or is not all.
        """
        values = [number_of(cells[one.place], separator) for one in self.group.used]
        missing = sum(value != value for value in values)  # noqa: PLR0124 (NaN)
        if missing == len(values):
            return None
        if missing and self.group.needs_all:
            raise ValueError("a coordinate is missing")
        row = self._empty.copy()
        for one, value in zip(self.group.used, values, strict=True):
            row[one.row] = value * one.scale
        return row

    def add(self, stamp_ns: int, arrival_ns: int, row: list[float]) -> None:
        self.stamps.append(stamp_ns)
        self.arrivals.append(arrival_ns)
        self._values.extend(row)

    def signal(self, offset_ns: int) -> tuple[Signal, list[str]]:
        """The signal, and what was repaired."""
        arrivals = np.frombuffer(self.arrivals, np.int64) + offset_ns
        stamps = np.frombuffer(self.stamps, np.int64)
        values = np.frombuffer(self._values).reshape(-1, len(self.columns))
        if len(arrivals) < 2:  # too few to tell whether stamps were set
            stamps = arrivals
        keep, stamps_ns, notes = order_samples(stamps, arrivals)
        name = self.group.name
        signal = Signal(name, stamps_ns, values[keep], self.columns, self.group.unit)
        return signal, [f"{name}: {note}" for note in notes]


class _Rows:
    """One pass over the rows of a table."""

    def __init__(self, table: Table) -> None:
        self._table = table
        self._layout: Layout = table.layout
        self._samples = [_Samples(group) for group in table.layout.groups]
        self._powers: dict[Clock, int] = {}
        self._count = 0
        self._bad = 0
        self._first_bad = 0

    def read(self) -> None:
        """All rows; those that cannot be read are counted."""
        rows = self._cells()
        first = list(islice(rows, _LOOK))
        self._look(first)
        for cells in chain(first, rows):
            try:
                self._add(cells)
            except (ValueError, IndexError):
                self._bad += 1
                self._first_bad = self._first_bad or self._count
            self._count += 1

    def _cells(self) -> Iterator[list[str]]:
        """The cells of each row; too few of one that is no row of the table."""
        separator, width = self._layout.separator, self._layout.width
        for line in self._table.rows:
            cells = [] if line is None else cells_of(line, separator)
            if line is not None and (line.startswith("#") or not any(map(str.strip, cells))):
                continue
            more = cells[width:]
            yield cells if not any(map(str.strip, more)) else []

    def _look(self, first: list[list[str]]) -> None:
        """Units of times that have none, and names of joints, by the first rows."""
        separator = self._layout.separator
        whole = [cells for cells in first if len(cells) >= self._layout.width]
        for clock in {self._layout.clock, *(one.stamp for one in self._layout.groups)}:
            if clock is not None:
                texts = [plain(cells[clock.places[0]], separator) for cells in whole]
                power = power_by_size(texts) if clock.power is None else clock.power
                self._powers[clock] = power
        for samples in self._samples:
            samples.columns = _named(samples.group, self._layout, whole)

    def _add(self, cells: Sequence[str]) -> None:
        """Raises ValueError or IndexError: it is no row of the table, as a whole."""
        if len(cells) < self._layout.width:
            raise ValueError("cells are missing")
        arrival_ns = self._time(self._layout.clock, cells)
        separator = self._layout.separator
        read = [(one, one.read(cells, separator)) for one in self._samples]
        whole = [
            (one, 0 if one.group.stamp is None else self._time(one.group.stamp, cells), row)
            for one, row in read
            if row is not None
        ]
        for one, stamp_ns, row in whole:
            one.add(stamp_ns, arrival_ns, row)

    def _time(self, clock: Clock, cells: Sequence[str]) -> int:
        separator = self._layout.separator
        texts = [plain(cells[place], separator) for place in clock.places]
        return clock.read(texts, self._powers[clock])

    def episode(self, path: Path) -> Episode:
        """What was read.

        Raises:
            LogError: that is nothing.
        """
        filled = [one for one in self._samples if one.arrivals]
        if not filled:
            why = f"none of its {self._count} rows can be read" if self._count else "it has no row"
            raise LogError(f"{path}: {why}; is it whole?")
        first_ns = min(min(one.arrivals) for one in filled)
        notes = self._notes(first_ns)
        signals: dict[str, Signal] = {}
        for one in filled:
            signals[one.group.name], repairs = one.signal(max(0, -first_ns))
            notes += repairs
        notes += self._doubts(signals)
        channels = [
            Channel(one.group.name, _type(one), "csv", np.array(one.arrivals, np.int64))
            for one in self._samples
        ]
        none: NDArray[np.int64] = np.empty(0, np.int64)
        channels += [
            Channel(name[:200], "", "csv", none, skipped=reason)
            for name, reason in self._layout.unused.items()
        ]
        lost = (self._lost(),) if self._bad else ()
        info = EpisodeInfo(source=f"table {path.name}")
        return Episode(info, signals, tuple(channels), (*lost, *notes), lost)

    def _lost(self) -> str:
        return (
            f"{self._bad} of {self._count} rows could not be read and were left out "
            f"(the first is row {self._first_bad + 1})"
        )

    def _notes(self, first_ns: int) -> list[str]:
        if first_ns >= 0:
            return []
        return [f"times begin at {first_ns / 1e9:.9g} s; they were moved to begin at 0"]

    def _doubts(self, signals: dict[str, Signal]) -> list[str]:
        """Times that may be in another unit than was guessed."""
        clock = self._layout.clock
        rates = [one.rate_hz for one in signals.values() if one.rate_hz]
        if clock.power is not None or self._powers[clock] or not rates or max(rates) > 1 / _SLOW_S:
            return []
        return [
            f"{clock.name!r} names no unit and was taken as seconds, {1 / max(rates):g} from row "
            "to row; if it is not, name it t_ms, t_us or t_ns"
        ]


def _named(group: Group, layout: Layout, rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
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


def _type(samples: _Samples) -> str:
    columns = ", ".join(samples.columns) if len(samples.columns) <= 8 else "joints"
    return f"{columns} [{samples.group.unit}]"
