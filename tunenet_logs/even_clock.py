"""Fit the uniform clock of a camera to the arrival times of its pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.lateness import NEVER, Clocks, candidates, cheapest, fitted, placed
from tunenet_logs.tick_period import APART, period_below, period_of, usual_periods

Array = NDArray[np.float64]
Ticks = NDArray[np.int64]

MIN_COUNT = 20  # samples; fewer tell no clock
_TYPICAL_GAIN = 15.0  # log likelihood that a usual rate is worth
_SLOWER, _FASTER = 0.05, 0.14
# Samples over which a rate is taken where each is late by its own time: delays spread over so many
# as they ever do.
LAG = 24

# Samples that a rate is first sought in, by how much they grow, and rates on each side that are
# tried then.
_BEGIN, _GROW, _NEIGHBOURS = 64, 3, 4

# Samples that one straight line is for, and those that it shares with the next: rates drift.
_BLOCK, _SHARED = 512, 128

_POSSIBLE = 6.0  # log likelihood up to which another tick than the likeliest is possible


@dataclass(frozen=True, eq=False)
class EvenClock:
    """Uniform clock, and which of its ticks each of T samples was taken at.

    Attributes:
        arrivals_ns: of the samples, shape (T,) [ns].
        ticks: likeliest, increasing strictly, shape (T,).
        earliest: first tick that the arrivals leave possible for each, shape (T,).
        latest: last one, shape (T,).
        stamps: of `ticks`, since the first arrival, shape (T,) [ms].
        periods: between ticks, around each sample, shape (T,) [ms].
        rms_ms: standard deviation of the stamps, beside what they are all off by.
        cost: negative log likelihood of the arrivals.
    """

    arrivals_ns: NDArray[np.int64]
    ticks: Ticks
    earliest: Ticks
    latest: Ticks
    stamps: Array
    periods: Array
    rms_ms: float
    cost: float

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Acquisition times, shape (T,) [ns], up to an unknown constant delay."""
        return self.arrivals_ns[0] + np.round(1e6 * self.stamps).astype(np.int64)

    @property
    def lateness(self) -> Array:
        """Delay of each sample relative to the most punctual one, shape (T,) [ms]."""
        late = 1e-6 * (self.arrivals_ns - self.arrivals_ns[0]) - self.stamps
        return late - late.min()

    @property
    def rate_hz(self) -> float:
        """Tick rate [Hz]."""
        return 1e3 / float(np.median(self.periods))

    @property
    def unsure(self) -> NDArray[np.bool_]:
        """Whether each sample may belong to another tick than its likeliest, shape (T,)."""
        return self.earliest < self.latest

    @property
    def lost(self) -> int:
        """Number of ticks between the first and the last sample that have none."""
        return int(self.ticks[-1] - self.ticks[0]) + 1 - len(self.ticks)

    def runs(self) -> Iterator[slice]:
        """Yield the runs of consecutive samples whose tick is ambiguous."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], self.unsure, [False]])))
        for first, end in edges.reshape(-1, 2).tolist():
            yield slice(first, end)

    def placed_by(self, cost: Callable[[NDArray[np.intp], Array], Array]) -> EvenClock:
        """Reassign samples of ambiguous tick by a cost other than that of their arrival.

        Args:
            cost: negative log likelihood of samples (numbers, shape (N,)) that are taken at times
                as `stamps` has them, shape (N, S) [ms]; shape (N, S).
        """
        ticks, earliest, latest = self.ticks.copy(), self.earliest.copy(), self.latest.copy()
        for run in self.runs():
            numbers = np.arange(run.start, run.stop)
            low = int((earliest[run] - numbers).min())
            skipped = np.arange(low, int((latest[run] - numbers).max()) + 1)
            tried = numbers[:, None] + skipped
            times = self.stamps[run, None] + self.periods[run, None] * (
                tried - self.ticks[run, None]
            )
            paid = np.asarray(cost(numbers, times), np.float64)
            out = (tried < earliest[run, None]) | (tried > latest[run, None])
            placing = cheapest(np.where(out, NEVER, paid)[None], -low)
            ticks[run] = numbers + placing.skipped[0]
            earliest[run], latest[run] = _possible(placing.excess[0], numbers, -low)
        moved = self.stamps + self.periods * (ticks - self.ticks)
        return replace(self, ticks=ticks, earliest=earliest, latest=latest, stamps=moved)


def even_clock(arrivals_ns: NDArray[np.int64]) -> EvenClock | None:
    """Fit the likeliest uniform clock to arrivals; None if they are too few or simultaneous.

    Whether they come from a uniform clock at all is another question.

    Args:
        arrivals_ns: not decreasing, shape (T,) [ns].
    """
    if len(arrivals_ns) < MIN_COUNT:
        return None
    arrivals = 1e-6 * (arrivals_ns - arrivals_ns[0])
    if np.median(arrivals[_lag(arrivals) :] - arrivals[: -_lag(arrivals)]) <= 0:
        return None
    clock: EvenClock | None = None
    for first in range(0, max(1, len(arrivals) - _SHARED), _BLOCK - _SHARED):
        block = slice(first, first + _BLOCK)
        known = None if clock is None else float(clock.periods[-1])
        part = _straight(arrivals[block], known)
        part = replace(part, stamps=part.stamps + arrivals[first])
        clock = part if clock is None else _joined(clock, part, first)
    assert clock is not None
    return replace(clock, arrivals_ns=arrivals_ns)


def _lag(arrivals: Array) -> int:
    return max(1, min(LAG, len(arrivals) // 2))


def _straight(arrivals: Array, known: float | None) -> EvenClock:
    """Fit a clock whose rate does not drift.

    Args:
        arrivals: shape (T,) [ms].
        known: period of what came before [ms]; None where nothing did.
    """
    since = arrivals - arrivals[0]
    clock, skipped = _likeliest(since, known)
    numbers = np.arange(len(since))
    for _ in range(2):
        period, start, error = period_of(numbers + skipped, since, clock)
        clock = clock._replace(periods=np.array([period]), starts=np.array([start]))
        skipped = placed(since, clock, _before(skipped)).skipped[0]
    placing = placed(since, clock, _before(skipped))
    skipped = placing.skipped[0]
    # The same clock shifted by a tick tells the same times, so the surest sample stays.
    sure = int(np.partition(placing.excess[0], 1, axis=1)[:, 1].argmax())
    placing = placed(since, clock, placing.before, held=(sure, int(skipped[sure])))
    ticks = numbers + placing.skipped[0]
    earliest, latest = _possible(placing.excess[0], numbers, placing.before)
    period, start, error = period_of(ticks, since, clock)
    return EvenClock(
        arrivals_ns=np.zeros(0, np.int64),
        ticks=ticks,
        earliest=earliest,
        latest=latest,
        stamps=start + period * ticks,
        periods=np.full(len(ticks), period),
        rms_ms=error * float(np.std(ticks)),
        cost=float(placing.costs[0]),
    )


def _before(skipped: Ticks) -> int:
    """Return how many ticks earlier than it seems the first sample may be."""
    return max(0, -int(skipped.min())) + 3


def _likeliest(arrivals: Array, known: float | None) -> tuple[Clocks, Ticks]:
    """Return the likeliest of many rates, and how many ticks it skips up to each sample."""
    count, lag = len(arrivals), _lag(arrivals)
    own = float(np.median(arrivals[lag:] - arrivals[:-lag])) / lag
    windows = range(0, max(1, count - LAG + 1), LAG // 2)
    spreads = [
        np.ptp(arrivals[at : at + LAG] - own * np.arange(len(arrivals[at : at + LAG])))
        for at in windows
    ]
    scale = max(1.0, float(np.median(spreads)))
    size = count if known else min(count, _BEGIN)
    beside = np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1)
    periods = own * np.exp(np.arange(-_FASTER, _SLOWER, APART / size))
    if known:
        periods = known * np.exp(np.array([-APART, 0.0, APART]) / size)
    while True:
        best, cost, skipped = _best(arrivals[:size], candidates(periods, scale))
        if size == count:
            break
        hull = period_below(np.arange(size) + skipped, arrivals[:size])
        size = min(count, _GROW * size)
        periods = np.append(best.periods[0] * np.exp(beside * APART / size), hull)
    mean = float(arrivals[-1]) / (count - 1)
    usual = usual_periods(min(mean, own), max(mean, own) + 1.2 * scale / count)
    if known is None and len(usual):
        other, other_cost, other_skipped = _best(arrivals, candidates(usual, scale))
        if other_cost - _TYPICAL_GAIN < cost:
            return other, other_skipped
    return best, skipped


def _best(arrivals: Array, clocks: Clocks) -> tuple[Clocks, float, Ticks]:
    """Return the likeliest candidate, its cost, and how many ticks it skips up to each sample."""
    clocks, placing = fitted(arrivals, clocks)
    best = int(placing.costs.argmin())
    return clocks.only(best), float(placing.costs[best]), placing.skipped[best]


def _possible(excess: Array, numbers: NDArray[np.intp], before: int) -> tuple[Ticks, Ticks]:
    """Return the first and the last tick that is possible for each sample."""
    can_be = excess < _POSSIBLE
    last = can_be.shape[1] - 1 - can_be[:, ::-1].argmax(axis=1)
    return numbers + can_be.argmax(axis=1) - before, numbers + last - before


def _joined(one: EvenClock, other: EvenClock, first: int) -> EvenClock:
    """Join two clocks of which the second begins at sample `first` of the first."""
    shared = len(one.ticks) - first
    shift = int(np.median(one.ticks[first:] - other.ticks[:shared]))
    half = shared // 2
    cut, own = first + half, slice(half, None)
    moved = {name: getattr(other, name)[own] + shift for name in ("ticks", "earliest", "latest")}
    joined = {
        name: np.concatenate([getattr(one, name)[:cut], values]) for name, values in moved.items()
    }
    return replace(
        one,
        **joined,
        stamps=np.concatenate([one.stamps[:cut], other.stamps[own]]),
        periods=np.concatenate([one.periods[:cut], other.periods[own]]),
        rms_ms=max(one.rms_ms, other.rms_ms),
        cost=one.cost + other.cost,
    )
