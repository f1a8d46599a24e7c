"""Collect the samples that a table's rows give each of its signals."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import UNSTATED, Channel, Signal
from tunenet_logs.formats.exports.build import frame_stamps
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.failures import NUMBER_REMEDY, unreadable
from tunenet_logs.formats.tables.group import Group
from tunenet_logs.formats.tables.numbers import Numbers
from tunenet_logs.formats.tables.runs import check_one_thing, restarts_note, rows_of_runs
from tunenet_logs.left_out import INCOMPLETE, added, in_proportion
from tunenet_logs.sample_order import order_samples


class SignalSamples:
    """Samples of one group of columns, stored flat: a table of an hour must fit.

    Attributes:
        group: of columns.
        columns: names of the signal's.
        arrivals: times of the rows [ns]; counted frames are one second apart.
    """

    def __init__(self, group: Group, header: Sequence[str], options: ReadOptions) -> None:
        self.group = group
        self.columns = group.columns
        self.arrivals = array("q")
        self._stamps = array("q")
        self._runs = array("q")
        self._header = header
        self._options = options
        self._incomplete = 0
        self._values = array("d")
        self._empty = [0.0 if group.needs_all else float("nan")] * len(group.columns)

    def read(self, cells: Sequence[str], numbers: Numbers) -> list[float] | None:
        """Return the values of a row; None where it has none, or lacks a coordinate.

        Raises:
            UnreadableError: a cell holds no number.
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
        """Append a sample."""
        self._stamps.append(stamp_ns)
        self.arrivals.append(arrival_ns)
        self._values.extend(row)

    def add_run(self, run: int) -> None:
        """Set the run of the last sample, numbered in order of appearance."""
        self._runs.append(run)

    def signals(
        self, offset_ns: int, run_names: Sequence[str]
    ) -> tuple[list[Signal], list[Channel], list[str]]:
        """Return one signal per run, their channels, and notes on what was left out or repaired.

        Args:
            offset_ns: added to all times.
            run_names: by the numbers of runs.

        Raises:
            ValueError: there are too many runs, or impacts out of order.
        """
        counts_frames = self.group.clock.counts_frames
        arrivals = np.frombuffer(self.arrivals, np.int64) + offset_ns
        if counts_frames:
            arrivals, counts_frames = frame_stamps(arrivals * 1e-9, None, self._options)
        stamps = np.frombuffer(self._stamps, np.int64)
        values, unit = self._in_unit(np.frombuffer(self._values).reshape(-1, len(self.columns)))
        if self.group.is_impacts:
            return self._impacts(arrivals, counts_frames)
        runs = np.frombuffer(self._runs, np.int64)
        signals: list[Signal] = []
        channels: list[Channel] = []
        parts = rows_of_runs(arrivals, runs, run_names)
        notes = [f"{self.group.name}: {note}" for note in restarts_note(parts)]
        for run, rows in parts:
            name = self.group.name_of_run(run) if run else self.group.name
            own, of_run = arrivals[rows], stamps[rows]
            check_one_thing(own, values[rows])
            keep, ordered, repairs, left_out = order_samples(
                of_run if len(own) > 1 else own, own, (values[rows],)
            )
            incomplete = in_proportion(len(own), self._incomplete, len(arrivals))
            signals.append(
                Signal(
                    name,
                    ordered,
                    values[rows][keep],
                    self.columns,
                    unit,
                    counts_frames=counts_frames,
                    left_out=added(left_out, {INCOMPLETE: incomplete}),
                )
            )
            channels.append(Channel(name, self._type(unit), "csv", own))
            notes += [f"{name}: {repair}" for repair in repairs]
        if self._incomplete:
            lacking = f"{self._incomplete} samples without all coordinates were left out"
            notes.append(f"{self.group.name}: {lacking}")
        return signals, channels, notes

    def _in_unit(self, values: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
        """Convert values to the user's length unit, where the table states none."""
        unit, options = self.group.unit, self._options
        if unit not in (UNSTATED, "px") or not options.length_unit:
            return values, unit
        return (values, "px") if options.length_m is None else (values * options.length_m, "m")

    def _impacts(
        self, arrivals: NDArray[np.int64], counts_frames: bool
    ) -> tuple[list[Signal], list[Channel], list[str]]:
        wrong = np.flatnonzero(np.diff(arrivals) <= 0)
        if len(wrong):
            at = int(wrong[0])
            raise ValueError(
                f"times of impacts do not increase: {arrivals[at] * 1e-9:.13g} s is followed by "
                f"{arrivals[at + 1] * 1e-9:.13g} s; give times since a start, not intervals"
            )
        ones = np.ones((len(arrivals), 1))
        signal = Signal(
            self.group.name, arrivals, ones, self.columns, "1", counts_frames=counts_frames
        )
        channel = Channel(self.group.name, self._type("1"), "csv", arrivals)
        return [signal], [channel], []

    def _type(self, unit: str) -> str:
        columns = ", ".join(self.columns) if len(self.columns) <= 8 else "joints"
        note = f": {self.group.note}" if self.group.note else ""
        return f"{columns} [{unit or '?'}]{note}"
