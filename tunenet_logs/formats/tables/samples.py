"""The samples of one signal of a table, row by row."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np

from tunenet_logs.episode import Signal
from tunenet_logs.formats.tables.failures import NUMBER_REMEDY, unreadable
from tunenet_logs.formats.tables.layout import Group
from tunenet_logs.formats.tables.numbers import Numbers
from tunenet_logs.stamps import order_samples

_NAN = float("nan")


class Samples:
    """What one group of columns has delivered: flat, a table of an hour must fit."""

    def __init__(self, group: Group, header: Sequence[str]) -> None:
        self.group = group
        self.columns = group.columns
        self.stamps = array("q")
        self.arrivals = array("q")
        self._header = header
        self._incomplete = 0
        self._values = array("d")
        self._empty = [0.0 if group.needs_all else _NAN] * len(group.columns)

    def read(self, cells: Sequence[str], numbers: Numbers) -> list[float] | None:
        """The values of a row; None where it has none, or lacks a coordinate.

        Raises:
            UnreadableError: what is there is no number.
        """
        row = self._empty.copy()
        missing = 0
        for one in self.group.used:
            try:
                value = numbers.read(cells[one.place])
            except ValueError as why:
                name = self._header[one.place]
                raise unreadable(name, cells[one.place], why, NUMBER_REMEDY) from None
            row[one.row] = value * one.scale
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
