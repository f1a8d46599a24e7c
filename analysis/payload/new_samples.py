"""Find which samples of a driver are new, and when they were measured.

A driver that publishes faster than it measures repeats samples, in runs that end in a step as large
as the motion beside them is fast. While the arm rests, samples repeat too, but nothing moved
meanwhile: the step after them is small for their time. These were measured, and count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.payload.driver_quirks import even_clock
from tunenet_logs.arrays import Array

# Of runs that repeat a sample while the arm moves, from which on a driver publishes faster than it
# measures: two measured values are equal now and then, a driver is stuck once.
_STALE_FRACTION, _MIN_STALE_RUNS = 0.03, 3

# Of the way that the speed beside a run, and that of the whole motion, would make in its time: a
# step after it that is smaller is none of a motion that went on.
_STILL_FRACTION, _SLOW_FRACTION = 0.4, 0.1

# Of the smallest change of a joint: a value that changes by less was only rounded meanwhile.
_COARSE_STEPS = 1.5

# Before and after a run, where its speed is looked for: the longer of both.
_BESIDE_S, _BESIDE_MESSAGES = 0.15, 4

# Of a driver that repeats samples: the same for longer was measured several times.
_REST_PERIODS = 2.5

_TURNS = (0.0, 2 * np.pi, 360.0)  # by which angles jump that are cut to a turn, in rad or degrees


@dataclass(frozen=True, eq=False)
class NewSamples:
    """New samples of a signal.

    Attributes:
        seconds: When each was measured [s], shape (T,), increasing.
        rows: Of the signal, shape (T,).
        repeated: Fraction of recorded samples that only repeat one, rests aside.
        late_s: Maximum delay from measurement to stamp; 0 if its time is known.
        rests: First and last time of each rest [s], shape (R, 2).
    """

    seconds: Array
    rows: NDArray[np.int64]
    repeated: float
    late_s: float
    rests: Array


@dataclass(frozen=True, eq=False)
class _Runs:
    """Runs of equal samples.

    Attributes:
        begins: Index of the first of each, shape (R,).
        ends: Index behind the last of each, shape (R,).
        still: Whether a run of several is of an arm at rest, shape (R,).
    """

    begins: NDArray[np.int64]
    ends: NDArray[np.int64]
    still: NDArray[np.bool_]

    @property
    def lengths(self) -> NDArray[np.int64]:
        """Number of samples of each, shape (R,)."""
        return self.ends - self.begins

    @property
    def owner(self) -> NDArray[np.int64]:
        """Index of the run of each sample, shape (N,)."""
        return np.repeat(np.arange(len(self.begins)), self.lengths)


def new_samples(seconds: Array, values: Array, rests: Array | None = None) -> NewSamples:
    """Find the new samples of a signal, and when they were measured.

    Args:
        seconds: Of its messages [s], shape (N,), increasing; two or more.
        values: Shape (N, J).
        rests: When the arm rests [s], shape (R, 2): only then does a value that stays the same
            count. None if the signal itself shows it: positions do.
    """
    runs = _runs_of(seconds, values)
    repeats = runs.lengths - 1
    moving = ~runs.still
    stale_runs = np.count_nonzero(repeats[moving])
    stale = int(repeats[moving].sum())
    repeated = stale / (stale + len(runs.begins))
    if stale_runs < max(_MIN_STALE_RUNS, _STALE_FRACTION * len(runs.begins)):
        owner = runs.owner
        keep = runs.still[owner] & _within(seconds, rests)
        keep[runs.begins] = True
        rows = np.flatnonzero(keep)
        spans = _spans(seconds, runs, runs.still)
        return NewSamples(seconds[rows], rows, repeated, 0.0, spans)
    begins, before = seconds[runs.begins], seconds[np.maximum(runs.begins - 1, 0)]
    lasts = np.diff(np.append(begins, seconds[-1]))
    clock = even_clock(before, begins)
    late_s = 0.0 if clock else float(np.median(np.diff(seconds)))
    measured, period_s = clock or (begins, float(np.mean(lasts[moving])))
    resting = runs.still & (lasts > _REST_PERIODS * period_s)
    more, rows = _in_rests(seconds, runs, resting, measured, period_s)
    inside = _within(more, rests)
    times = np.concatenate([measured, more[inside]])
    order = np.argsort(times)
    rows = np.concatenate([runs.begins, rows[inside]])
    return NewSamples(times[order], rows[order], repeated, late_s, _spans(seconds, runs, resting))


def _runs_of(seconds: Array, values: Array) -> _Runs:
    """Find runs of equal samples, and which of them are rests."""
    changes = np.any(values[1:] != values[:-1], axis=1)
    begins = np.concatenate([[0], np.flatnonzero(changes) + 1])
    ends = np.append(begins[1:], len(values))
    lengths = ends - begins
    steps = _within_a_turn(np.diff(values[begins], axis=0))
    places = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(steps, axis=0)])
    places = places[np.repeat(np.arange(len(begins)), lengths)]
    # The step after each run: the last one has none.
    after = np.append(np.abs(steps).max(axis=1), 0.0)
    nonzero = np.where(steps == 0, np.inf, np.abs(steps))
    smallest = np.min(nonzero, axis=0, initial=np.inf)
    coarse = np.append(np.all(np.abs(steps) <= _COARSE_STEPS * smallest, axis=1), True)
    period_s = float(np.median(np.diff(seconds)))
    reach = max(_BESIDE_MESSAGES, int(np.ceil(_BESIDE_S / period_s)))
    left, right = np.maximum(begins - 1, 0), np.minimum(ends, len(values) - 1)
    first, last = np.maximum(left - reach, 0), np.minimum(right + reach, len(values) - 1)
    ways = np.abs(places[left] - places[first]).max(axis=1)
    ways += np.abs(places[last] - places[right]).max(axis=1)
    beside = ways / np.maximum(left - first + last - right, 1)
    usual = _weighted_median(after / lengths, after)
    most = lengths * np.maximum(_STILL_FRACTION * beside, _SLOW_FRACTION * usual)
    return _Runs(begins, ends, (lengths > 1) & (coarse | (after <= most)))


def _within_a_turn(steps: Array) -> Array:
    """Remove the jumps of wrapped angles from steps."""
    ways = np.stack([np.abs(np.abs(steps) - turn) for turn in _TURNS])
    nearest = np.array(_TURNS)[np.argmin(ways, axis=0)]
    return steps - np.sign(steps) * nearest


def _weighted_median(values: Array, weights: Array) -> float:
    """Return the weighted median; 0 without weights."""
    order = np.argsort(values)
    sums = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(sums, sums[-1] / 2)])


def _spans(seconds: Array, runs: _Runs, chosen: NDArray[np.bool_]) -> Array:
    """Return first and last time of some runs [s], shape (R, 2)."""
    return np.column_stack([seconds[runs.begins[chosen]], seconds[runs.ends[chosen] - 1]])


def _within(seconds: Array, rests: Array | None) -> NDArray[np.bool_]:
    """Return whether each time is in one of the rests; all are if none are given."""
    if rests is None or not len(rests):
        return np.full(len(seconds), rests is None)
    at = np.searchsorted(rests[:, 0], seconds, side="right") - 1
    return (at >= 0) & (seconds <= rests[np.maximum(at, 0), 1])


def _in_rests(
    seconds: Array,
    runs: _Runs,
    resting: NDArray[np.bool_],
    measured: Array,
    period_s: float,
) -> tuple[Array, NDArray[np.int64]]:
    """Return times [s] and rows that a sample-repeating driver measured while the arm rested.

    Args:
        seconds: Of the messages [s], shape (N,).
        runs: Of equal samples.
        resting: Which of them are rests, shape (R,).
        measured: When the first of each run was measured [s], shape (R,).
        period_s: Between measurements [s].
    """
    owner = runs.owner
    ticks = np.floor((seconds - measured[owner]) / period_s).astype(np.int64)
    ticks[runs.begins] = 0
    is_first = np.diff(ticks, prepend=0) > 0
    times = measured[owner] + period_s * ticks
    behind = np.append(measured[1:], np.inf)[owner]
    keep = resting[owner] & is_first & (ticks > 0) & (times < behind - period_s / 2)
    return times[keep], np.flatnonzero(keep)
