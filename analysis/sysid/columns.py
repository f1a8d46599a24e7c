"""Pair the columns of a log with those of a rollout; tell their noise, and how errors grow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.statistics import surer_noise_of
from tunenet_logs.episode import Array, Episode
from tunenet_logs.errors import NotFoundError

# ---- Columns of a log and of a rollout, paired by name, at the log's stamps

_MIN_SAMPLES = 20  # of one column


@dataclass(frozen=True, eq=False)
class Column:
    """One column of one signal in the log."""

    signal: str  # its signal's name
    name: str  # its own
    unit: str  # of its values
    seconds: Array  # since the first stamp that is compared, shape (T,), increasing
    values: Array  # shape (T,), finite
    noise: float  # standard deviation of what is faster than any motion
    spread: float  # standard deviation of its values

    @property
    def label(self) -> str:
        """Title of the column."""
        return f"{self.signal} {self.name}"

    @property
    def is_place(self) -> bool:
        """Whether it is a position or an angle, as which alone a motion goes astray."""
        return self.unit in ("m", "rad", "1")

    @property
    def is_jumpy(self) -> bool:
        """Whether it jumps with each sample, as a servo's efforts do, or is noise."""
        return self.noise > 0.25 * self.spread


@dataclass(frozen=True, eq=False)
class ComparedColumns:
    """All columns that a log and the rollouts share."""

    start_ns: int  # stamp that seconds count from
    columns: tuple[Column, ...]  # at least one

    @cached_property
    def end_s(self) -> float:
        """Last stamp."""
        return max(float(column.seconds[-1]) for column in self.columns)

    @cached_property
    def seconds(self) -> Array:
        """Stamps of all values, column by column, shape (N,)."""
        return np.concatenate([column.seconds for column in self.columns])

    @cached_property
    def values(self) -> Array:
        """All observed values, column by column, shape (N,)."""
        return np.concatenate([column.values for column in self.columns])

    @cached_property
    def which(self) -> NDArray[np.intp]:
        """Column index of each value, shape (N,)."""
        counts = [len(column.values) for column in self.columns]
        return np.repeat(np.arange(len(counts), dtype=np.intp), counts)

    def per_value(self, by_column: Sequence[float] | Array) -> Array:
        """Repeat one number per column for each of its values, shape (N,)."""
        return np.asarray(by_column, dtype=np.float64)[self.which]

    def clock_of(self, rollout: Episode) -> int:
        """Return the stamp of a rollout's that the seconds count from: the log's, or its first.

        A simulator may have a clock of its own.
        """
        shown = {column.signal for column in self.columns}
        stamps = [one.stamps_ns for name, one in rollout.signals.items() if name in shown]
        stamps = [one for one in stamps if len(one)]
        first_ns = min((int(one[0]) for one in stamps), default=self.start_ns)
        last_ns = max((int(one[-1]) for one in stamps), default=self.start_ns)
        return self.start_ns if first_ns <= self.start_ns <= last_ns else first_ns

    def seen_in(self, rollout: Episode) -> Array:
        """Interpolate a rollout at the same stamps, shape (N,); NaN where it has nothing."""
        found: list[Array] = []
        start_ns = self.clock_of(rollout)
        for column in self.columns:
            signal, track = rollout.signals.get(column.signal), np.full(len(column.seconds), np.nan)
            if signal is not None and column.name in signal.columns and len(signal.stamps_ns):
                at_s, values = (signal.stamps_ns - start_ns) * 1e-9, signal.values
                track = values[:, signal.columns.index(column.name)]
                track = np.interp(column.seconds, at_s, track, left=np.nan, right=np.nan)
            found.append(track)
        return np.concatenate(found)

    def between(self, from_s: float, until_s: float) -> NDArray[np.bool_]:
        """Return which values lie in a part of the log, its end excluded, shape (N,)."""
        return (self.seconds >= from_s) & (self.seconds < until_s)

    def part(self, from_s: float, until_s: float) -> ComparedColumns:
        """Cut out a part, whose seconds count from its own first stamp; NotFoundError if empty."""
        kept = [(one.seconds >= from_s) & (one.seconds < until_s) for one in self.columns]
        cut = [(one, keep) for one, keep in zip(self.columns, kept, strict=True) if keep.any()]
        if not cut:
            raise NotFoundError(f"nothing is seen from {from_s:.2f} to {until_s:.2f} s")
        first_ns = min(round(float(one.seconds[keep][0]) * 1e9) for one, keep in cut)
        columns = tuple(
            replace(
                one,
                seconds=1e-9 * (np.round(one.seconds[keep] * 1e9) - first_ns),
                values=one.values[keep],
            )
            for one, keep in cut
        )
        return ComparedColumns(self.start_ns + first_ns, columns)

    def columns_at(self, chosen: NDArray[np.bool_]) -> ComparedColumns:
        """Return whole columns, by which values they have, shape (N,); seconds from their first."""
        numbers = np.unique(self.which[chosen])
        first_s = min(float(self.columns[number].seconds[0]) for number in numbers)
        columns = [self.columns[number] for number in numbers]
        kept = tuple(replace(one, seconds=one.seconds - first_s) for one in columns)
        return ComparedColumns(self.start_ns + round(first_s * 1e9), kept)

    def rms(self, residuals: Array, chosen: Array | NDArray[np.bool_] | None = None) -> Array:
        """Return the root mean square by column, shape (C,), of values of shape (N,).

        `chosen` tells which count, or how much each counts.
        """
        good = np.isfinite(residuals)
        counts = np.where(good, 1.0 if chosen is None else chosen, 0.0)
        squares = counts * np.where(good, residuals, 0.0) ** 2
        sums = np.bincount(self.which, squares, minlength=len(self.columns))
        weights = np.bincount(self.which, counts, minlength=len(self.columns))
        return np.sqrt(sums / np.where(weights > 0, weights, 1.0))


def compared(observed: Episode, rollout: Episode) -> ComparedColumns:
    """Pair the columns that a log and a rollout of the simulator share."""
    shared: list[tuple[str, str]] = []
    for name, signal in rollout.signals.items():
        seen = observed.signals.get(name)
        if seen is not None:
            shared += [(name, column) for column in signal.columns if column in seen.columns]
    if not shared:
        there, wanted = sorted(observed.signals), sorted(rollout.signals)
        raise NotFoundError(
            f"the log and the simulator share no signal (log: {', '.join(there[:5]) or 'none'}; "
            f"simulator: {', '.join(wanted[:5]) or 'none'})",
            "name the simulator's signals and columns as the log's",
        )
    start_ns = min(int(observed.signals[name].stamps_ns[0]) for name, _ in shared)
    columns: list[Column] = []
    for name, column in shared:
        signal = observed.signals[name]
        values = signal.values[:, signal.columns.index(column)]
        good = np.flatnonzero(np.isfinite(values))
        noise = noise_of(values[good])
        spread = float(np.std(values[good])) if len(good) else 0.0
        # More are thinned: neighbours tell the same.
        good = good[:: max(-(-len(good) // 20_000), 1)]
        seconds = 1e-9 * (signal.stamps_ns[good] - start_ns).astype(np.float64)
        columns.append(Column(name, column, signal.unit, seconds, values[good], noise, spread))
    kept = tuple(column for column in columns if len(column.values) >= _MIN_SAMPLES)
    if not kept:
        most = max(len(column.values) for column in columns)
        raise NotFoundError(
            f"{shared[0][0]}: {most} samples are too few to tune from",
            f"record {_MIN_SAMPLES} or more",
        )
    return ComparedColumns(start_ns, kept)


def noise_of(values: Array) -> float:
    """Estimate the standard deviation of white noise in a sampled curve, by third differences.

    What is smooth over four samples has none; a step of the values' resolution is the least.
    """
    if len(values) < 5:
        return 0.0
    steps = np.abs(np.diff(np.unique(values)))
    resolution = float(steps.min()) / np.sqrt(12.0) if len(steps) else 0.0
    return max(surer_noise_of(values), resolution)


def noises_of(target: ComparedColumns, residuals: Array) -> Array:
    """Return the noise of each column, shape (C,), by what a simulator leaves of it, shape (M,).

    A servo's efforts jump with each command: by themselves they look like noise, of a size at which
    any simulator would match. So of a column that jumps it is that of its residual.
    """
    found: list[float] = []
    for number, column in enumerate(target.columns):
        own = residuals[target.which == number]
        noise = noise_of(own[np.isfinite(own)]) if column.is_jumpy else column.noise
        found.append(min(noise, column.noise))
    return np.array(found)


# ---- How a small error of the start grows

GROWTH = 10.0  # of an error of the start, from which on little is predicted
GROWN = 30.0  # from which on a fit begins anew
BINS = 200  # of time, over which growth is told
_CHANGES = 10  # that a log has at least, of a part that is compared with what follows


def bins_of(target: ComparedColumns) -> NDArray[np.intp]:
    """Return the bin of time of each value, shape (N,)."""
    return np.minimum((target.seconds / max(target.end_s, 1e-9) * BINS).astype(np.intp), BINS - 1)


def growth(target: ComparedColumns, changes: Array) -> tuple[Array, Array]:
    """Return how many times as large errors of a start are, by bins of time: all, and the worst.

    `changes` is what an error of each number of the start changes, in spreads, shape (S, N). It is
    measured against the largest that it is until the motion has changed by its own size: an error
    of a speed is none of a place at first.
    """
    place = bins_of(target)
    counts = np.maximum(np.bincount(place, minlength=BINS), 1)
    squares = [np.bincount(place, row**2, minlength=BINS) for row in changes]
    error = np.sqrt(np.array(squares).reshape(-1, BINS) / counts)
    first = max(int(BINS * _changes_s(target) / max(target.end_s, 1e-9)), 1)
    begins = np.maximum(error[:, :first].max(axis=1, initial=0.0), 1e-12)
    every = np.linalg.norm(error, axis=0)
    every /= max(float(every[:first].max()), 1e-12)
    return every, (error / begins[:, None]).max(axis=0, initial=0.0)


def _changes_s(target: ComparedColumns) -> float:
    """Return the time in which the fastest column changes by its standard deviation, rms."""
    found = [target.end_s / _CHANGES]
    for one in target.columns:
        spread = float(np.std(one.values))
        if spread < 3.0 * one.noise:
            continue
        for lag in range(1, max(len(one.values) // _CHANGES, 2)):
            if np.mean((one.values[lag:] - one.values[:-lag]) ** 2) >= spread**2:
                found.append(float(np.median(one.seconds[lag:] - one.seconds[:-lag])))
                break
    return min(found)
