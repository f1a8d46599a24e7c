"""Pair the columns of a log with those of a rollout, by name, at the log's stamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.errors import NotFoundError

_MAX_SAMPLES = 20_000  # of one column; more are thinned, as neighbours then tell the same
_MIN_SAMPLES = 20

# What the variance of white noise grows by in third differences: 1 + 9 + 9 + 1.
_SIXTH_DIFFERENCES = 20.0

_MAD_TO_SD = 1.4826

# Of a column's spread: one that changes more from sample to sample jumps, as a servo's efforts with
# each command, or is noise.
_JUMPY = 0.25


@dataclass(frozen=True, eq=False)
class Column:
    """One column of one signal in the log.

    Attributes:
        signal: Its signal's name.
        name: Its own.
        unit: Of its values.
        seconds: Since the first stamp that is compared, shape (T,), increasing.
        values: Shape (T,), finite.
        noise: Standard deviation of what is faster than any motion.
        spread: Standard deviation of its values.
    """

    signal: str
    name: str
    unit: str
    seconds: Array
    values: Array
    noise: float
    spread: float

    @property
    def label(self) -> str:
        """Title of the column."""
        return f"{self.signal} {self.name}"

    @property
    def is_jumpy(self) -> bool:
        """Whether it jumps, so that its `noise` is not only noise."""
        return self.noise > _JUMPY * self.spread


@dataclass(frozen=True, eq=False)
class ComparedColumns:
    """All columns that a log and the rollouts share.

    Attributes:
        start_ns: Stamp that seconds count from.
        columns: At least one.
    """

    start_ns: int
    columns: tuple[Column, ...]

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

    def seen_in(self, rollout: Episode) -> Array:
        """Interpolate a rollout at the same stamps, shape (N,); NaN where it has nothing."""
        found: list[Array] = []
        for column in self.columns:
            signal = rollout.signals.get(column.signal)
            if signal is None or column.name not in signal.columns:
                found.append(np.full(len(column.seconds), np.nan))
                continue
            at_s = (signal.stamps_ns - _origin(signal.stamps_ns, self.start_ns)) * 1e-9
            track = signal.values[:, signal.columns.index(column.name)]
            found.append(np.interp(column.seconds, at_s, track, left=np.nan, right=np.nan))
        return np.concatenate(found)

    def rms(self, residuals: Array, chosen: NDArray[np.bool_] | None = None) -> Array:
        """Return the root mean square by column, shape (C,), of (chosen) values of shape (N,)."""
        kept = np.isfinite(residuals) if chosen is None else np.isfinite(residuals) & chosen
        squares = np.bincount(
            self.which, np.where(kept, residuals, 0.0) ** 2, minlength=len(self.columns)
        )
        counts = np.bincount(self.which, kept, minlength=len(self.columns))
        return np.sqrt(squares / np.maximum(counts, 1))


def _origin(stamps_ns: NDArray[np.int64], start_ns: int) -> int:
    """Return what a rollout's stamps count from: the log's start, or their own."""
    first, last = int(stamps_ns[0]), int(stamps_ns[-1])
    return start_ns if first <= start_ns <= last else first


def compared(observed: Episode, rollout: Episode) -> ComparedColumns:
    """Pair the columns that a log and a rollout of the simulator share.

    Raises:
        NotFoundError: There is none, or too few samples.
    """
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
    columns = [_column(observed, name, column, start_ns) for name, column in shared]
    kept = tuple(column for column in columns if len(column.values) >= _MIN_SAMPLES)
    if not kept:
        most = max(len(column.values) for column in columns)
        raise NotFoundError(
            f"{shared[0][0]}: {most} samples are too few to tune from",
            f"record {_MIN_SAMPLES} or more",
        )
    return ComparedColumns(start_ns, kept)


def _column(observed: Episode, name: str, column: str, start_ns: int) -> Column:
    signal = observed.signals[name]
    values = signal.values[:, signal.columns.index(column)]
    good = np.flatnonzero(np.isfinite(values))
    noise = noise_of(values[good])
    spread = float(np.std(values[good])) if len(good) else 0.0
    good = good[:: max(-(-len(good) // _MAX_SAMPLES), 1)]
    seconds = 1e-9 * (signal.stamps_ns[good] - start_ns).astype(np.float64)
    return Column(name, column, signal.unit, seconds, values[good], noise, spread)


def noise_of(values: Array) -> float:
    """Estimate the standard deviation of white noise in a sampled curve, by third differences.

    What is smooth over four samples has none; a step of the values' resolution is the least.
    """
    if len(values) < 5:
        return 0.0
    differences = np.abs(np.diff(values, 3))
    noise = _MAD_TO_SD * float(np.median(differences)) / np.sqrt(_SIXTH_DIFFERENCES)
    steps = np.abs(np.diff(np.unique(values)))
    resolution = float(steps.min()) / np.sqrt(12.0) if len(steps) else 0.0
    return max(noise, resolution)
