"""Build episodes from arrays with named columns: the part that array formats share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Episode, Signal
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.formats.exports.arrays.column_plan import JOINT_UNITS, ColumnPlan, PlannedSignal
from tunenet_logs.formats.exports.arrays.column_times import column_stamps
from tunenet_logs.formats.exports.build import export_episode, frame_stamps, position_signal
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.group import name_of_run
from tunenet_logs.formats.tables.runs import RunNames, check_one_thing, restarts_note, rows_of_runs
from tunenet_logs.formats.tables.times import Clock
from tunenet_logs.left_out import UNREADABLE, added
from tunenet_logs.sample_order import sorted_stamps

MAX_ROWS = 2_000_000  # of a file: an hour at 500 Hz
# Of a track: 8 minutes at 1 kHz; tuning takes over half a kilobyte of memory for each.
_MAX_PLACES = 500_000

_MAX_VALUES = 16_000_000  # of all its signals
Arrays = Mapping[int, NDArray[Any]]  # columns by their index, shape (T,) each


@dataclass(frozen=True, eq=False)
class _Times:
    """Stamps of a file's rows.

    Attributes:
        stamps_ns: shape (T,).
        known: which rows have one, shape (T,).
        counts_frames: see `Signal`.
    """

    stamps_ns: NDArray[np.int64]
    known: NDArray[np.bool_]
    counts_frames: bool = False

    def taken(self, rows: NDArray[np.intp]) -> _Times:
        """Return the times of some rows."""
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
    """Build the episode of a file's columns.

    Args:
        path: of the file.
        what: kind of file, in words.
        plan: meaning of its columns.
        arrays: the columns that the plan needs.
        options: the user's.
        rate_hz: row rate stated by the file; None where it is unstated.
        unused: what else it holds, with the reason.
        warnings: of reading it.
        losses: damage found in it.

    Raises:
        LogError: it is too large, or no row has a time and a value.
    """
    check_rows(path, max(map(len, arrays.values()), default=0), plan)
    notes = list(warnings)
    signals: list[Signal] = []
    if plan.impacts is not None:
        signals.append(_impacts(plan.impacts, arrays))
    if plan.signals:
        reading = _Reading(path, plan, arrays, options, rate_hz)
        for run, rows in reading.runs():
            for planned in plan.signals:
                name = name_of_run(planned.name, run, is_joints=_is_joints(planned.name))
                signal, repairs = reading.signal(name, planned, rows)
                signals.append(signal)
                notes += repairs
        notes += reading.notes
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
    """Refuse a file of too many rows with a LogError."""
    width = sum(len(signal.columns) for signal in plan.signals)
    is_track = any(signal.columns == ("x", "y", "z") for signal in plan.signals)
    rows = _MAX_PLACES if is_track else MAX_ROWS
    if count > rows or count * width > _MAX_VALUES:
        most = min(rows, _MAX_VALUES // max(width, 1))
        raise LogError(f"{path}: has over {most} rows, the limit; split it")


class _Reading:
    """Rows of a file with their stamps."""

    def __init__(
        self,
        path: Path,
        plan: ColumnPlan,
        arrays: Arrays,
        options: ReadOptions,
        rate_hz: float | None,
    ) -> None:
        self._path = path
        self._plan = plan
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
            try:
                stamps, known, doubt = column_stamps(clock, columns)
            except ValueError as error:
                raise LogError(f"{self._path}: {error}") from error
            self.notes += [doubt] if doubt else []
            self._clocks[clock] = _Times(stamps, known)
        return self._clocks[clock]

    def runs(self) -> list[tuple[str, NDArray[np.intp]]]:
        """Return the name and rows of each run or object; rows without a stamp are left out.

        Raises:
            LogError: there are too many runs.
        """
        rows = np.flatnonzero(self._times.known)
        columns = [self._arrays[at].tolist() for at, _ in self._plan.runs]
        found = RunNames([kind for _, kind in self._plan.runs])
        cells = [[_label(column[row]) for column in columns] for row in rows.tolist() if columns]
        numbers = np.array([found.number(texts) for texts in cells], np.int64)
        try:
            parts = rows_of_runs(self._times.stamps_ns[rows], numbers, found.names)
        except ValueError as error:
            raise LogError(f"{self._path}: {error}") from error
        self.notes += [found.note] if len(parts) > 1 and found.note else restarts_note(parts)
        return [(name, rows[of_run]) for name, of_run in parts]

    def signal(
        self, name: str, planned: PlannedSignal, rows: NDArray[np.intp]
    ) -> tuple[Signal, list[str]]:
        """Return the signal of some rows, and notes on what was repaired."""
        times = self._times if planned.clock is None else self._of(planned.clock)
        times = times.taken(rows)
        values = np.full((len(rows), len(planned.columns)), 0.0 if planned.is_track else np.nan)
        for at, place, scale in planned.used:
            values[:, place] = _floats(self._arrays[at])[rows] * scale
        values[~np.isfinite(values)] = np.nan
        untimed = {UNREADABLE: int(np.count_nonzero(~times.known))}
        values, stamps = values[times.known], times.stamps_ns[times.known]
        some = np.isfinite(values).any(axis=1)
        try:
            check_one_thing(stamps[some], values[some])
        except ValueError as error:
            raise LogError(f"{self._path}: {error}") from error
        if planned.is_track:
            signal, notes = position_signal(
                name, stamps, values, planned.unit, self._options, counts_frames=times.counts_frames
            )
            return replace(signal, left_out=added(signal.left_out, untimed)), notes
        some = np.isfinite(values).any(axis=1)
        keep, ordered, notes, left_out = sorted_stamps(stamps[some], (values[some],))
        columns, unit = planned.columns, planned.unit
        left_out = added(left_out, untimed)
        signal = Signal(name, ordered, values[some][keep], columns, unit, left_out=left_out)
        return signal, [f"{name}: {note}" for note in notes]


def _floats(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return a column as floats, NaN where it is no number, shape (T,)."""
    if values.dtype.kind in "iufb":
        return values.astype(np.float64)
    found = np.full(len(values), np.nan)
    for row, value in enumerate(values.tolist()):
        try:
            found[row] = float(value)
        except (TypeError, ValueError, OverflowError):
            continue
    return found


def _is_joints(name: str) -> bool:
    return name.rpartition(".")[2] in JOINT_UNITS


def _label(value: object) -> str:
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return str(value)


def _impacts(clock: Clock, arrays: Arrays) -> Signal:
    """Return the impact times as a signal."""
    columns = [arrays[at] for at in clock.indices]
    stamps, known, _ = column_stamps(clock, columns, is_sampled=False)
    ordered = sorted_stamps(stamps[known]).stamps_ns
    return Signal("impacts", ordered, np.ones((len(ordered), 1)), ("impact",), "1")


def _from_zero(signals: list[Signal]) -> tuple[list[Signal], list[str]]:
    """Shift signals so that no stamp is negative, and note the shift."""
    first = min((int(signal.stamps_ns[0]) for signal in signals), default=0)
    if first >= 0:
        return signals, []
    moved = [replace(signal, stamps_ns=signal.stamps_ns - first) for signal in signals]
    return moved, [f"times begin at {first / 1e9:.9g} s; they were moved to begin at 0"]
