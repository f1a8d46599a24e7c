"""Arrays by the names of their columns, as an episode: what files of arrays share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Episode, Signal
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.formats.exports.arrays.column_plan import ColumnPlan, PlannedSignal
from tunenet_logs.formats.exports.arrays.column_times import column_stamps
from tunenet_logs.formats.exports.build import export_episode, frame_stamps, position_signal
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.times import Clock
from tunenet_logs.sample_order import sorted_stamps

MOST_ROWS = 2_000_000
"""Of a file: an hour at 500 Hz."""

_MOST_PLACES = 500_000
"""Of a track: 8 minutes at 1 kHz; tuning takes over half a kilobyte of memory for each."""

_MOST_VALUES = 16_000_000
"""Of all its signals."""

_MOST_RUNS = 500
"""Things or runs in one file."""

_FEWEST_ROWS = 3
"""Of each, on average: a number that is another in every row says not what a row is of."""

_SLOW_S = 0.5
"""From row to row; what is sampled more slowly was timed in another unit than seconds, perhaps."""

Arrays = Mapping[int, NDArray[Any]]
"""Columns by their index, shape (T,) each."""


@dataclass(frozen=True, eq=False)
class _Times:
    """When rows were.

    Attributes:
        stamps_ns: shape (T,).
        known: which rows have one, shape (T,).
        counts_frames: see `Signal`.
    """

    stamps_ns: NDArray[np.int64]
    known: NDArray[np.bool_]
    counts_frames: bool = False

    def taken(self, rows: NDArray[np.intp]) -> _Times:
        """Those of some rows."""
        return replace(self, stamps_ns=self.stamps_ns[rows], known=self.known[rows])


def columns_episode(
    path: Path,
    what: str,
    plan: ColumnPlan,
    arrays: Arrays,
    options: ReadOptions,
    *,
    rate_hz: float | None = None,
    unused: Mapping[str, str] | None = None,
    warnings: Sequence[str] = (),
    losses: Sequence[str] = (),
) -> Episode:
    """The episode of a file's columns.

    Args:
        path: of the file.
        what: it is, in words.
        plan: what its columns mean.
        arrays: the columns that the plan needs.
        options: the user's.
        rate_hz: of rows, where the file says it; None where it does not.
        unused: what else it holds, with the reason.
        warnings: of reading it.
        losses: what of it is damaged.

    Raises:
        LogError: it is too large, or no row has a time and a value.
    """
    check_rows(path, max(map(len, arrays.values()), default=0), plan)
    notes = list(warnings)
    signals: list[Signal] = []
    if plan.impacts is not None:
        signals.append(_impacts(plan.impacts, arrays))
    if plan.signals:
        reading = _Reading(plan, arrays, options, rate_hz)
        notes += reading.notes
        runs, said = _runs(plan, arrays)
        notes += said
        for prefix, rows in runs:
            for planned in plan.signals:
                signal, repairs = reading.signal(f"{prefix}{planned.name}", planned, rows)
                signals.append(signal)
                notes += repairs
    signals, moved = _from_zero([signal for signal in signals if len(signal.stamps_ns)])
    if not signals:
        named = ", ".join(signal.name for signal in plan.signals) or "impacts"
        raise LogError(f"{path}: no row has a time and a value of {named}", EXPORT_AGAIN)
    return export_episode(
        path,
        what,
        signals,
        unused={**plan.unused, **(unused or {})},
        warnings=[*notes, *moved],
        losses=losses,
    )


def check_rows(path: Path, count: int, plan: ColumnPlan) -> None:
    """Raises LogError: so many rows are more than is read of a file."""
    width = sum(len(signal.columns) for signal in plan.signals)
    is_track = any(signal.columns == ("x", "y", "z") for signal in plan.signals)
    rows = _MOST_PLACES if is_track else MOST_ROWS
    if count > rows or count * width > _MOST_VALUES:
        most = min(rows, _MOST_VALUES // max(width, 1))
        raise LogError(f"{path}: has over {most} rows, the limit; split it")


class _Reading:
    """The rows of a file, with their times."""

    def __init__(
        self, plan: ColumnPlan, arrays: Arrays, options: ReadOptions, rate_hz: float | None
    ) -> None:
        self._arrays = arrays
        self._options = options
        self.notes: list[str] = []
        self._clocks: dict[Clock, _Times] = {}
        self._times = self._main_times(plan, rate_hz)

    def _main_times(self, plan: ColumnPlan, rate_hz: float | None) -> _Times:
        if plan.clock is not None:
            times = self._of(plan.clock)
            lost = int(np.count_nonzero(~times.known))
            if lost:
                self.notes.append(f"{lost} rows without a time were left out")
            self._doubt(plan.clock, times)
            return times
        count = len(next(iter(self._arrays.values())))
        numbers = np.arange(count, dtype=np.float64)
        if plan.frames is not None:
            numbers = _floats(self._arrays[plan.frames])
        elif not (self._options.rate_hz or rate_hz):
            self.notes.append(
                "nothing says when; rows were counted as frames (--fps, or --columns t=NAME)"
            )
        known = np.isfinite(numbers) & (np.abs(numbers) < 2.0**50)
        stamps, counts_frames = frame_stamps(np.where(known, numbers, 0), rate_hz, self._options)
        return _Times(stamps, known, counts_frames)

    def _of(self, clock: Clock) -> _Times:
        if clock not in self._clocks:
            columns = [self._arrays[at] for at in clock.indices]
            self._clocks[clock] = _Times(*column_stamps(clock, columns))
        return self._clocks[clock]

    def _doubt(self, clock: Clock, times: _Times) -> None:
        steps = np.diff(times.stamps_ns[times.known])
        steps = steps[steps > 0]
        is_number = self._arrays[clock.indices[0]].dtype.kind in "iuf"
        if clock.power is None and is_number and len(steps) and np.median(steps) >= _SLOW_S * 1e9:
            self.notes.append(
                f"{clock.name!r} names no unit and was taken as seconds, "
                f"{np.median(steps) * 1e-9:g} from row to row; if it is not, name it t_ms or t_us"
            )

    def signal(
        self, name: str, planned: PlannedSignal, rows: NDArray[np.intp]
    ) -> tuple[Signal, list[str]]:
        """A signal of some rows, and what was repaired."""
        times = self._times if planned.clock is None else self._of(planned.clock)
        times = times.taken(rows)
        values = np.full((len(rows), len(planned.columns)), 0.0 if planned.is_track else np.nan)
        for at, place, scale in planned.used:
            values[:, place] = _floats(self._arrays[at])[rows] * scale
        values[~np.isfinite(values)] = np.nan
        values, stamps = values[times.known], times.stamps_ns[times.known]
        if planned.is_track:
            return position_signal(
                name, stamps, values, planned.unit, self._options, counts_frames=times.counts_frames
            )
        some = np.isfinite(values).any(axis=1)
        keep, ordered, notes = sorted_stamps(stamps[some])
        signal = Signal(name, ordered, values[some][keep], planned.columns, planned.unit)
        return signal, [f"{name}: {note}" for note in notes]


def _floats(values: NDArray[Any]) -> NDArray[np.float64]:
    """Numbers of a column, NaN where there is none, shape (T,)."""
    if values.dtype.kind in "iufb":
        return values.astype(np.float64)
    found = np.full(len(values), np.nan)
    for row, value in enumerate(values.tolist()):
        try:
            found[row] = float(value)
        except (TypeError, ValueError, OverflowError):
            continue
    return found


def _runs(plan: ColumnPlan, arrays: Arrays) -> tuple[list[tuple[str, NDArray[np.intp]]], list[str]]:
    """The rows of each run or thing with what its signals' names begin with; and what is said."""
    count = len(next(iter(arrays.values())))
    every = [("", np.arange(count))]
    if plan.run is None:
        return every, []
    labels = np.array([_label(value) for value in arrays[plan.run].tolist()], dtype=object)
    places: dict[str, list[int]] = {}
    for row, label in enumerate(labels.tolist()):
        places.setdefault(label, []).append(row)
    if len(places) == 1 or len(places) > count // _FEWEST_ROWS:
        return every, []
    stem = plan.names[plan.run].removesuffix("_index")
    runs = [
        (f"{stem}_{label}." if label.isdecimal() else f"{label}.", np.array(rows, np.intp))
        for label, rows in list(places.items())[:_MOST_RUNS]
    ]
    more = len(places) - len(runs)
    return runs, [f"{more} more of {len(places)} were left out; split the file"] if more else []


def _label(value: object) -> str:
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return str(value)[:60]


def _impacts(clock: Clock, arrays: Arrays) -> Signal:
    """The times of impacts."""
    stamps, known = column_stamps(clock, [arrays[at] for at in clock.indices])
    _, ordered, _ = sorted_stamps(stamps[known])
    return Signal("impacts", ordered, np.ones((len(ordered), 1)), ("impact",), "1")


def _from_zero(signals: list[Signal]) -> tuple[list[Signal], list[str]]:
    """Signals whose stamps are not below 0, and a note where they were moved."""
    first = min((int(signal.stamps_ns[0]) for signal in signals), default=0)
    if first >= 0:
        return signals, []
    moved = [replace(signal, stamps_ns=signal.stamps_ns - first) for signal in signals]
    return moved, [f"times begin at {first / 1e9:.9g} s; they were moved to begin at 0"]
