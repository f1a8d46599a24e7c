"""Restore the acquisition times of samples that were stamped on arrival.

A network or a busy machine only delays, and a sensor's clock is uniform. Some samples are held up:
a pause, and a burst that makes up for it, which is respaced (`smooth_bursts`). Or each is late by
its own jitter, as pictures over Wi-Fi are: `recover_uniform_clock` fits the clock behind all
arrivals, on its ticks by dynamic programming (Viterbi), at the period with the least entropy of the
delays. Stamps that do not show it stay: exact ones with holes, those of an uneven sensor, those of
a changing rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Array, median_step


def smooth_bursts(
    stamps_ns: NDArray[np.int64], steps: NDArray[np.float64], period: float
) -> NDArray[np.int64]:
    """Respace the stamps (T,) of a burst after a pause at the usual `period`, all in ns."""
    corrected, after = stamps_ns.copy(), 0
    # A pause lasts longer than half-way between the usual step and that over one missing sample.
    for pause in np.flatnonzero(steps > 1.5 * period):
        end = _caught_up(steps, int(pause), period)
        if end is None or pause < after:
            continue
        inside = slice(pause + 1, end)
        even = stamps_ns[pause] + np.round(period * np.arange(1, end - pause)).astype(np.int64)
        corrected[inside] = np.minimum(even, stamps_ns[inside])
        after = end
    return corrected


def is_grid(steps: NDArray[np.float64], period: float) -> bool:
    """Check whether stamps with these steps [ns] lie on one regular grid, up to rounding."""
    # Of the steps on a grid with holes a tenth, at least, go to the very next point.
    frame = float(np.quantile(steps, 0.1, method="lower"))
    if frame <= 0 or period > 3.5 * frame:  # more frames are how stamps are rounded
        return False
    near = steps[steps < 8 * period]  # longer ones tell nothing: the error of the period adds up
    counts = np.round(near / frame)
    if counts.min() < 1:
        return False
    frame = float(near.sum() / counts.sum())
    error = float(np.abs(near - counts * frame).max())
    return error <= max(1_100, 1e-3 * frame)  # between stamps of whole microseconds; of a frame


def _caught_up(steps: NDArray[np.float64], pause: int, period: float) -> int | None:
    """Return the index after the first step at which a burst is back on the clock, or None."""
    lateness, slow = steps[pause] - period, 0
    for at in range(pause + 1, len(steps)):
        # A shorter step belongs to a burst that catches up: an even clock jitters less.
        slow = 0 if steps[at] < 0.9 * period else slow + 1
        lateness += steps[at] - period
        if lateness <= 0.3 * period:  # it has made up for the pause
            return at + 1
        if slow == 3:  # in a row: what follows the pause is no burst
            return None
    return None


# ---- Change of the sampling rate, such as a camera's in the dark


def changing_rate(stamps_ns: NDArray[np.int64], lag: int = 1) -> str:
    """Describe a change of sampling rate, as "goes from 60.0 to 30.0 Hz"; "" if there is none.

    Compares the median step, over `lag` samples, of up to eight parts: neither pauses nor missing
    samples are a change, nor is what the scatter of the steps makes likely.
    """
    steps = 1e-6 * (stamps_ns[lag:] - stamps_ns[:-lag]) / lag
    parts = min(8, len(steps) // max(10, 2 * lag))  # of equal length, ten samples each at least
    if parts < 2:
        return ""
    # What waited on its way comes at once, and a part of which a fifth did tells no sensor's rate.
    at_once = 1e-6 * np.diff(stamps_ns)[: len(steps)] < 0.1 * float(np.median(steps))
    split = zip(*(np.array_split(values, parts) for values in (steps, at_once)), strict=True)
    pieces = [piece for piece, waited in split if np.mean(waited) < 0.2]
    if len(pieces) < 2:
        return ""
    medians = np.array([np.median(piece) for piece in pieces])
    # Between one step and the next, neither a slow change nor a sudden one counts.
    changes = np.diff(steps[::lag])
    scatter = float(np.median(np.abs(changes - np.median(changes)))) / np.sqrt(2)
    doubt = 8.0 * scatter / np.sqrt(len(pieces[0]) / lag)  # usual deviations of a part's rate
    low, high = float(medians.min()), float(medians.max())
    if low <= 0 or high - low <= 0.1 * high + doubt:
        return ""
    first, last = 1e3 / medians[[0, -1]]
    if abs(first - last) > 0.1 * max(first, last):
        return f"goes from {first:.1f} to {last:.1f} Hz"
    return f"changes between {1e3 / high:.1f} and {1e3 / low:.1f} Hz"


# ---- Ticks: maximum-likelihood assignment of arrivals by dynamic programming over their delays
# A sample belongs to no tick after its arrival, nor to an earlier one than the sample before. Times
# are in ms; C candidate clocks; T samples; S numbers of skipped ticks, the first of them `-before`.

EVEN, RARER = 0, 1  # laws of delays: uniform up to a longest one; exponential, by their mean
# Log likelihood that a loss costs: one sample in 700 is lost, and then often some in a row.
_FIRST_LOST, _NEXT_LOST = 6.5, 1.0
# Log likelihood that a delay beyond the longest costs, and how many times its logarithm more: a
# network that stalls has delays without bound.
_OUTLIER, _OUTLIERS_FALL = 3.0, 2.0
# Of an exponential law: medians up to which a delay counts for the mean, and means from which on a
# delay costs by its logarithm.
_TYPICAL = 8.0
_MIN_MS = 0.3  # of a law's scale
NEVER = 1e4  # cost of what is out of the question


class Clocks(NamedTuple):
    """Candidate uniform clocks."""

    periods: Array  # shape (C,)
    starts: Array  # time of the tick of the first sample if none was skipped, shape (C,)
    scales: Array  # of the delays' law, shape (C,)
    laws: NDArray[np.int64]  # which it is, shape (C,)

    def part(self, chosen: slice | NDArray[np.intp]) -> Clocks:
        """Return some of the candidates."""
        periods, starts, scales = (one[chosen] for one in (self.periods, self.starts, self.scales))
        return Clocks(periods, starts, scales, self.laws[chosen])


class TickAssignment(NamedTuple):
    """Samples assigned to ticks."""

    costs: Array  # negative log likelihood of each candidate, shape (C,)
    skipped: NDArray[np.int64]  # ticks left out up to each sample, shape (C, T)
    excess: Array  # what it costs more to have so many left out, shape (C, T, S)
    before: int  # S begins with `-before`


def delays(arrivals: Array, clocks: Clocks, skipped: NDArray[np.int64]) -> Array:
    """Return the delay of each sample if so many ticks were skipped, shape (C, T)."""
    ticks = np.arange(len(arrivals)) + skipped
    return arrivals - clocks.starts[:, None] - clocks.periods[:, None] * ticks


def assign_ticks(
    arrivals: Array, clocks: Clocks, before: int, held: tuple[int, int] | None = None
) -> TickAssignment:
    """Assign all arrivals, shape (T,), to their likeliest ticks, and return what others cost.

    The first may be `before` ticks earlier than `starts`; of a sample `held` it is known how many
    ticks are skipped up to it.
    """
    paid = _tick_costs(arrivals, clocks, before)
    if held is not None:
        paid[np.arange(len(paid)) != held[1] + before, :, held[0]] = NEVER
    return _solved(paid, before)


def likeliest_ticks(
    arrivals: Array, clocks: Clocks, before: int
) -> tuple[Array, NDArray[np.int64]]:
    """Assign arrivals by the Viterbi algorithm: costs and skipped ticks of a `TickAssignment`."""
    paid = _tick_costs(arrivals, clocks, before)
    own = paid.cumsum(axis=2, dtype=np.float64)
    least = _least_sums(own)  # to come to each tick up to each sample, less the sums of its own
    at_end = least[:, :, -1] + own[:, :, -1]
    rows, numbers, states = np.arange(paid.shape[1]), np.arange(len(arrivals)), np.arange(len(paid))
    state, end = at_end.argmin(axis=0), np.full(paid.shape[1], len(arrivals) - 1)
    skipped = np.empty(paid.shape[1:], np.int64)
    skipped[:] = state[:, None]
    while True:
        # Back to where each way came to its tick, and to the tick that it came from.
        along = least[state, rows]
        entry = (along <= along[rows, end][:, None]).argmax(axis=1)
        if not entry.any():
            return at_end.min(axis=0), skipped - before
        end = np.maximum(entry - 1, 0)
        came = least[:, rows, end] + own[:, rows, end]
        came += _NEXT_LOST * (state - 1 - states[:, None])
        came[states[:, None] >= state] = np.inf
        state = np.where(entry > 0, came.argmin(axis=0), state)
        np.copyto(skipped, state[:, None], where=numbers < entry[:, None])


def _tick_costs(arrivals: Array, clocks: Clocks, before: int) -> NDArray[np.float32]:
    """Return what each arrival costs at each number of skipped ticks, shape (S, C, T)."""
    above = delays(arrivals, clocks, np.zeros(len(arrivals), np.int64))
    most = int(np.ceil((above.max(axis=1) / clocks.periods).min()))
    skipped = np.arange(before + 2 + min(max(most, 1), 150)) - float(before)
    late = (
        above.astype(np.float32) - np.outer(skipped, clocks.periods).astype(np.float32)[..., None]
    )
    # The negative log likelihood of each delay: of what is early, as the clock is not known exactly
    # [ms], and by the law, up to the limit of it and beyond.
    scales, is_even = (one[:, None] for one in (clocks.scales, clocks.laws == EVEN))
    costs = np.minimum(late, 0.0)
    costs *= (1 / (np.sqrt(2) * np.clip(0.05 * scales, 0.3, 2.0))).astype(np.float32)
    costs *= costs
    costs += np.log(scales).astype(np.float32)
    share = late
    share *= (1 / (np.where(is_even, 1.0, _TYPICAL) * scales)).astype(np.float32)
    far = np.maximum(share, 1.0)
    np.log(far, out=far)
    far *= np.float32(_OUTLIERS_FALL)
    costs += far
    costs += np.where(is_even, _OUTLIER, 0.0).astype(np.float32) * (share > 1.0)
    np.minimum(share, 1.0, out=share)
    np.maximum(share, 0.0, out=share)
    share *= np.where(is_even, 0.0, _TYPICAL).astype(np.float32)
    costs += share
    return np.minimum(costs, NEVER, out=costs)


def cheapest(costs: Array, before: int) -> TickAssignment:
    """Solve the assignment by dynamic programming from the cost of each tick, shape (C, T, S)."""
    return _solved(np.ascontiguousarray(np.moveaxis(costs, 2, 0)), before)


def _solved(paid: NDArray[np.floating], before: int) -> TickAssignment:
    """Solve the assignment from the cost of each number of skipped ticks, shape (S, C, T)."""
    onward, backward = (
        (own := part.cumsum(axis=2, dtype=np.float64)) + _least_sums(own)
        for part in (paid, paid[::-1, :, ::-1])
    )
    # Of all ways through a sample and tick.
    total = np.moveaxis(onward + backward[::-1, :, ::-1] - paid, 0, 2)
    least = total[:, 0].min(axis=1)
    excess = total - least[:, None, None]
    # Of ways that cost the same the lowest is taken everywhere: they would else be mixed.
    return TickAssignment(least, (excess < 1e-6).argmax(axis=2) - before, excess, before)


def _least_sums(own: Array) -> Array:
    """Compute the least cost of all ways to each tick up to each sample, by min-sum, (S, C, T).

    Less the sums of the tick's `own` costs: ticks are only ever skipped, and a way that comes to
    one number of these at a sample pays all samples from it on, so the least of all such ways is a
    running minimum.
    """
    sums = np.empty_like(own)
    comes = np.full(own.shape[1:], np.inf)  # the least cost of coming there, without the sample's
    for least, whole in zip(sums, own, strict=True):
        np.subtract(comes[:, 1:], whole[:, :-1], out=least[:, 1:])
        least[:, 0] = 0.0  # it may begin there
        np.minimum.accumulate(least, axis=1, out=least)
        comes += _NEXT_LOST
        np.minimum(comes[:, 1:], least[:, :-1] + whole[:, :-1] + _FIRST_LOST, out=comes[:, 1:])
    return sums


def _scales(late: Array, laws: NDArray[np.int64]) -> Array:
    """Return the maximum-likelihood scale of each candidate's delays, shape (C,)."""
    tried = np.geomspace(_MIN_MS, 10_000.0, 80)
    ordered = np.sort(np.maximum(late, _MIN_MS), axis=1)
    count, scales = ordered.shape[1], np.empty(len(late))
    rarer = ordered[laws == RARER]
    usual = rarer <= _TYPICAL * np.median(rarer, axis=1, keepdims=True)
    scales[laws == RARER] = np.mean(rarer, axis=1, where=usual)
    even = ordered[laws == EVEN]
    # How many are longer than each scale that is tried, and the sum of their logarithms.
    outliers = np.array([count - np.searchsorted(one, tried, side="right") for one in even])
    logs = np.cumsum(np.log(even[:, ::-1]), axis=1)
    rows = np.arange(len(even))[:, None]
    if len(even):
        beyond = np.where(outliers > 0, logs[rows, outliers - 1] - outliers * np.log(tried), 0.0)
        costs = count * np.log(tried) + _OUTLIER * outliers + _OUTLIERS_FALL * beyond
        scales[laws == EVEN] = tried[costs.argmin(axis=1)]
    return scales


# ---- Period: from samples on ticks, and from usual frame rates

Ticks = NDArray[np.int64]
_HZ = (5, 6, 10, 12, 12.5, 15, 20, 24, 25, 30, 40, 48, 50, 60, 72, 75, 80, 90, 100, 120)
_HZ += (144, 150, 180, 200, 240, 250, 300, 360, 400, 480, 500, 1000)
# [ms]: what cameras are built for, and the same as television has it (59.94 Hz for 60).
_NOMINAL_PERIODS = 1e3 / np.array(_HZ)
_TYPICAL_PERIODS = np.concatenate([_NOMINAL_PERIODS, 1.001 * _NOMINAL_PERIODS])
_TYPICAL_GAIN = 15.0  # log likelihood that a usual rate is worth, exactly or at all
APART = 0.3  # of a period: by so much neighbouring rates differ at the last sample
_NARROWEST_MS = 0.15  # kernel of a density of delays
_RATES = -0.14, 0.05  # logs of periods that are sought over the usual step
_FEWEST = 64  # samples in which a rate is sought first
_REFINED = 4  # likeliest candidates, twice


def period_of(ticks: Ticks, arrivals: Array, clock: Clocks) -> tuple[float, float, float]:
    """Estimate period, time of tick 0, and the period's standard deviation, by least entropy."""
    kernel = max(_NARROWEST_MS, float(clock.scales[0]) / 25.0)
    span, middle = float(np.ptp(ticks)), ticks - ticks.mean()

    def costs_of(periods: Array) -> Array:
        late = arrivals - periods[:, None] * middle
        late -= late.min(axis=1, keepdims=True)
        if clock.laws[0] == RARER:  # of exponential delays, decided by those hardly late
            return late.shape[1] * np.log(np.maximum(late.mean(axis=1), _NARROWEST_MS))
        # The negative log likelihood under their leave-one-out density, of Gaussians.
        shape = np.exp(-0.5 * (np.arange(-9, 10) / 3.0) ** 2)
        costs = np.empty(len(late))
        for row, own in enumerate((late * (3.0 / kernel)).astype(np.int64)):
            density = np.convolve(np.bincount(own), shape)[own + 9] - shape[9]
            costs[row] = -np.log(np.maximum(density, 0.05)).sum()
        return costs

    period, error, least = float(clock.periods[0]), 0.0, np.inf
    for width in (1.0, 0.25):
        tried = period * (1 + np.linspace(-APART, APART, 41) * width / span)
        costs = costs_of(tried)
        least = min(least, float(costs.min()))
        weights = np.exp(costs.min() - costs)
        weights /= weights.sum()
        period = float(weights @ tried)
        error = float(np.sqrt(weights @ (tried - period) ** 2))
    usual = _TYPICAL_PERIODS[np.abs(_TYPICAL_PERIODS - period) < APART / span * period]
    if len(usual):
        # Worth more is the rate that put the samples on ticks, and one beside the same as
        # television has it: in the few seconds of a drop, delays hardly tell them apart.
        costs = costs_of(usual) - 4.0 * (usual == clock.periods[0])
        costs -= 4.0 * np.isin(usual, _NOMINAL_PERIODS)
        if costs.min() < least + _TYPICAL_GAIN:
            period = float(usual[costs.argmin()])
    return period, float((arrivals - period * ticks).min()), error


def period_below(ticks: Ticks, arrivals: Array) -> float:
    """Fit the line below all arrivals with the least sum of distances, by the lower convex hull."""
    hull: list[tuple[int, float]] = []
    for tick, arrival in zip(ticks.tolist(), arrivals.tolist(), strict=True):
        while len(hull) > 1:
            (before, low), (at, high) = hull[-2:]
            if (high - low) * (tick - at) < (arrival - high) * (at - before):
                break
            hull.pop()  # it lies on or above the line through those on its sides
        hull.append((tick, arrival))
    middle = float(ticks.mean())
    for (first, low), (last, high) in pairwise(hull):
        if last >= middle:
            return (high - low) / (last - first)
    return 0.0


# ---- Uniform clock behind arrivals, in blocks of samples since its rate drifts

MIN_COUNT = 20  # samples; fewer tell no clock
# Samples over which a rate is taken where each is late by its own time: delays spread over so many
# as they ever do.
LAG = 24
# Samples that one straight line is for, and those that it shares with the next.
_BLOCK, _SHARED = 512, 128


@dataclass(frozen=True, eq=False)
class UniformClock:
    """Uniform clock, and which of its ticks each of T samples was taken at."""

    arrivals_ns: NDArray[np.int64]  # of the samples, shape (T,) [ns]
    ticks: Ticks  # likeliest, increasing strictly, shape (T,)
    earliest: Ticks  # first tick that the arrivals leave possible for each, shape (T,)
    latest: Ticks  # last one, shape (T,)
    stamps: Array  # of `ticks`, since the first arrival, shape (T,) [ms]
    periods: Array  # between ticks, around each sample, shape (T,) [ms]
    rms_ms: float  # standard deviation of the stamps, beside what they are all off by
    cost: float  # negative log likelihood of the arrivals

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

    def placed_by(self, cost: Callable[[NDArray[np.intp], Array], Array]) -> UniformClock:
        """Reassign samples of ambiguous tick by a cost other than that of their arrival.

        `cost` gives the negative log likelihood, shape (N, S), of samples (numbers, shape (N,))
        that are taken at times as `stamps` has them, shape (N, S) [ms].
        """
        ticks, earliest, latest = self.ticks.copy(), self.earliest.copy(), self.latest.copy()
        edges = np.flatnonzero(np.diff(np.concatenate([[False], self.unsure, [False]])))
        for first, end in edges.reshape(-1, 2).tolist():
            run, numbers = slice(first, end), np.arange(first, end)
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


def recover_uniform_clock(arrivals_ns: NDArray[np.int64]) -> UniformClock | None:
    """Fit the likeliest uniform clock to arrivals; None if they are too few or simultaneous.

    Whether they come from a uniform clock at all is another question. They do not decrease, shape
    (T,) [ns].
    """
    if len(arrivals_ns) < MIN_COUNT:
        return None
    arrivals = 1e-6 * (arrivals_ns - arrivals_ns[0])
    if median_step(arrivals, _lag(arrivals)) <= 0:
        return None
    clock: UniformClock | None = None
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


def _straight(arrivals: Array, known: float | None) -> UniformClock:
    """Fit a clock whose rate does not drift; `known` is the period of what came before [ms]."""
    since = arrivals - arrivals[0]
    clock, skipped = _likeliest(since, known)
    numbers, last, placing = np.arange(len(since)), skipped, None
    for _ in range(2):
        period, start, error = period_of(numbers + skipped, since, clock)
        clock = clock._replace(periods=np.array([period]), starts=np.array([start]))
        last, placing = skipped, assign_ticks(since, clock, _before(skipped))
        skipped = placing.skipped[0]
    if placing is None or not np.array_equal(last, skipped):
        placing = assign_ticks(since, clock, _before(skipped))
        skipped = placing.skipped[0]
    # The same clock shifted by a tick tells the same times, so the surest sample stays.
    sure = int(np.partition(placing.excess[0], 1, axis=1)[:, 1].argmax())
    placing = assign_ticks(since, clock, placing.before, held=(sure, int(skipped[sure])))
    ticks = numbers + placing.skipped[0]
    earliest, latest = _possible(placing.excess[0], numbers, placing.before)
    period, start, error = period_of(ticks, since, clock)
    return UniformClock(
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


def _usual_step(arrivals: Array) -> tuple[float, float]:
    """Return the usual step, and by how much delays usually differ within a window, in ms."""
    own = median_step(arrivals, _lag(arrivals))
    starts = range(0, max(1, len(arrivals) - LAG + 1), LAG // 2)
    windows = [arrivals[at : at + LAG] for at in starts]
    spreads = [np.ptp(window - own * np.arange(len(window))) for window in windows]
    return own, max(1.0, float(np.median(spreads)))


def _likeliest(arrivals: Array, known: float | None) -> tuple[Clocks, Ticks]:
    """Return the likeliest of many rates, and how many ticks it skips up to each sample."""
    count = len(arrivals)
    own, scale = _usual_step(arrivals)
    # A rate beside the usual step is sought in few samples, and among its neighbours in ever more.
    size = count if known else min(count, _FEWEST)
    periods = own * np.exp(np.arange(*_RATES, APART / size))
    if known:
        periods = known * np.exp(np.array([-APART, 0.0, APART]) / size)
    while True:
        best, cost, skipped = _best(arrivals[:size], periods, scale)
        if size == count:
            break
        hull = period_below(np.arange(size) + skipped, arrivals[:size])
        size = min(count, 3 * size)
        near = best.periods[0] * np.exp(np.arange(-4, 5) * APART / size)
        periods = np.append(near, hull)
    # At a usual rate, up to 0.35 of all ticks may be lost.
    mean = float(arrivals[-1]) / (count - 1)
    is_near = (1 - 0.35) * min(mean, own) <= _TYPICAL_PERIODS
    is_near &= max(mean, own) + 1.2 * scale / count >= _TYPICAL_PERIODS
    usual = _TYPICAL_PERIODS[is_near]
    if known is None and len(usual):
        other, other_cost, other_skipped = _best(arrivals, usual, scale)
        if other_cost - _TYPICAL_GAIN < cost:
            return other, other_skipped
    return best, skipped


def _best(arrivals: Array, periods: Array, scale: float) -> tuple[Clocks, float, Ticks]:
    """Return the likeliest clock, its cost, and how many ticks it skips up to each sample.

    Of each period with each law of delays, whose start and scale are refined in turn with the
    assignment to ticks.
    """
    count = len(periods)
    periods, laws = np.tile(periods, 2), np.repeat([EVEN, RARER], count)
    above = arrivals - periods[:, None] * np.arange(len(arrivals))
    starts = above[:, :20].min(axis=1)
    room = ((starts - above.min(axis=1)) / periods).min()
    before = int(np.clip(np.ceil(room), 0, 100)) + 1
    clocks = Clocks(periods, starts, np.repeat([scale, scale / 3], count), laws)
    few = arrivals[: 3 * _FEWEST]  # most of the candidates are ruled out by these alone
    costs, skipped = likeliest_ticks(few, clocks, before)
    for kept, seen in ((2 * _REFINED, few), (_REFINED, arrivals)):
        chosen = np.sort(costs.argsort()[:kept])
        clocks = clocks.part(chosen)
        late = delays(seen, clocks, skipped[chosen])
        moved = np.quantile(late, 0.02, axis=1)  # the earliest, of which a few may be wrong
        late -= moved[:, None]
        scales = _scales(late.clip(0), clocks.laws)
        clocks = clocks._replace(starts=clocks.starts + moved, scales=scales)
        costs, skipped = likeliest_ticks(arrivals, clocks, before)
    best = int(costs.argmin())
    return clocks.part(slice(best, best + 1)), float(costs[best]), skipped[best]


def _possible(excess: Array, numbers: NDArray[np.intp], before: int) -> tuple[Ticks, Ticks]:
    """Return the first and the last tick that is possible for each sample."""
    can_be = excess < 6.0  # log likelihood that another tick than the likeliest may cost
    last = can_be.shape[1] - 1 - can_be[:, ::-1].argmax(axis=1)
    return numbers + can_be.argmax(axis=1) - before, numbers + last - before


def _joined(one: UniformClock, other: UniformClock, first: int) -> UniformClock:
    """Join two clocks of which the second begins at sample `first` of the first."""
    shared = len(one.ticks) - first
    shift = int(np.median(one.ticks[first:] - other.ticks[:shared]))
    half = shared // 2
    joined: dict[str, Any] = {}
    for name in ("ticks", "earliest", "latest", "stamps", "periods"):
        moved = getattr(other, name)[half:] + (0 if name in ("stamps", "periods") else shift)
        joined[name] = np.concatenate([getattr(one, name)[: first + half], moved])
    rms_ms = max(one.rms_ms, other.rms_ms)
    return replace(one, **joined, rms_ms=rms_ms, cost=one.cost + other.cost)


# ---- Films that were converted: shown at another rate than they were filmed, on even stamps
# Each moment shows the picture nearest to it, so pictures are missing or doubled in a pattern.

_FILMED_HZ = (24, 25, 30, 50, 60)  # at which films are made
_SHOWN_HZ = (10, 12, 12.5, 15, 20, *_FILMED_HZ)  # to which they are converted


@dataclass(frozen=True)
class Conversion:
    """Conversion of a film from one rate to another, by leaving out or doubling pictures."""

    source_hz: float  # at which it was filmed
    shown_hz: float  # at which it is stamped
    start_ns: int  # stamp of a picture
    phase: float  # how far into the time of its source picture that one is, 0 to 1

    def numbers(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return which picture of the source each stamp shows, shape (T,)."""
        moments = np.round((stamps_ns - self.start_ns) * 1e-9 * self.shown_hz)
        return np.floor(moments * self.source_hz / self.shown_hz + self.phase).astype(np.int64)

    def unexplained(self, stamps_ns: NDArray[np.int64]) -> int:
        """Count moments between these stamps, (T,), that show a new picture, but have no stamp."""
        first_ns, last_ns = (stamps_ns[[0, -1]] - self.start_ns).tolist()
        every = np.arange(first_ns, last_ns, 1e9 / self.shown_hz)
        every_ns = self.start_ns + np.round(every).astype(np.int64)
        is_new = np.diff(self.numbers(every_ns), prepend=-1) > 0
        steps = np.round((stamps_ns - stamps_ns[0]) * 1e-9 * self.shown_hz).astype(np.int64)
        is_new[steps[steps < len(is_new)]] = False
        return int(np.count_nonzero(is_new))

    def placed_ns(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return when the pictures were taken, shape (T,) [ns]; that of `start_ns` stays."""
        return self.start_ns + np.round(1e9 * self.numbers(stamps_ns) / self.source_hz).astype(
            np.int64
        )

    @property
    def leaves_out(self) -> float:
        """Fraction of the source's pictures that it leaves out, 0 where it doubles some."""
        return max(0.0, 1 - self.shown_hz / self.source_hz)

    @property
    def words(self) -> str:
        """Describe it: "from 30 to 24 pictures a second (1 of 5 is missing)"."""
        source, shown = (Fraction(hz).limit_denominator(2) for hz in self.rates_hz)
        ratio = source / shown
        lost = abs(ratio.numerator - ratio.denominator)
        of, what = ratio.numerator, "missing" if ratio > 1 else "shown twice"
        is_are = "is" if lost == 1 else "are"
        return (
            f"from {float(source):g} to {float(shown):g} pictures a second "
            f"({lost} of {of} {is_are} {what})"
        )

    @property
    def rates_hz(self) -> tuple[float, float]:
        """Rates at which it was filmed and is shown, to half a picture a second."""
        return round(2 * self.source_hz) / 2, round(2 * self.shown_hz) / 2


def conversions(stamps_ns: NDArray[np.int64]) -> list[Conversion]:
    """List the conversions, each in all its phases, that may have made even stamps, (T,) [ns].

    Pictures may be left out of these; none where they are not even.
    """
    steps_s = np.diff(stamps_ns) * 1e-9
    if len(steps_s) < MIN_COUNT or steps_s.min() <= 0:
        return []
    # The slowest rate of which all steps are whole periods, as even as a container has them.
    for nominal in _SHOWN_HZ:
        periods = np.round(steps_s * nominal)
        shown_hz = float(periods.sum() / steps_s.sum())
        off = np.quantile(np.abs(steps_s * shown_hz - periods), 0.95)
        every = np.gcd.reduce(periods.astype(np.int64))
        if every == 1 and periods.min() > 0 and abs(shown_hz / nominal - 1) < 0.006 and off < 0.05:
            break
    else:
        return []
    found: list[Conversion] = []
    for source in _FILMED_HZ:
        ratio = Fraction(source) / Fraction(nominal)
        if min(ratio.numerator, ratio.denominator) == 1:  # what is left is even
            continue
        source_hz, phases = source * shown_hz / nominal, ratio.denominator
        found += [
            Conversion(source_hz, shown_hz, int(stamps_ns[0]), (number + 0.5) / phases)
            for number in range(phases)
        ]
    return found


# ---- Late samples: put back on the clock behind them, where the stamps show one
# Delays add up to nothing, and what came late is followed by what comes close upon it.

STAMPS_NOTE = "stamps"  # note of a log's info record: whose clock a camera's stamps are of
BY_ARRIVALS = "even clock"  # how it begins where they were found from arrivals, the log's own times
ARRIVALS = (BY_ARRIVALS, "arrival")  # how it begins where the times that are read are arrivals
_TELLING = 0.4  # log likelihood of a sample that its place among the others is worth
_LATE = 0.02  # of a period: standard deviation of delays that are worth a correction
MAX_SAMPLES = 50_000  # of which a clock is sought: a quarter of an hour of a camera


@dataclass(frozen=True, eq=False)
class CorrectedStamps:
    """Recorded stamps, and the same with those of late samples corrected."""

    recorded_ns: NDArray[np.int64]  # shape (T,) [ns]
    stamps_ns: NDArray[np.int64]  # when the samples were taken, increasing, shape (T,) [ns]
    # the uniform clock that they are taken from; None where they are not
    clock: UniformClock | None = None
    rates: str = ""  # how the rate of the samples changes, in words; "" where it does not

    @property
    def taken_ns(self) -> dict[int, int]:
        """Acquisition time [ns] by recorded stamp [ns], of late samples only."""
        pairs = zip(self.recorded_ns.tolist(), self.stamps_ns.tolist(), strict=True)
        return {recorded: taken for recorded, taken in pairs if recorded != taken}

    def warnings(self, samples: str) -> list[str]:
        """Return warnings about late samples, which are called `samples`; empty if none is late."""
        said = [f"the rate of the {samples} {self.rates}"] if self.rates else []
        count = len(self.taken_ns)
        if not count:
            return said
        if self.clock is None:
            latest_ms = float(np.max(self.recorded_ns - self.stamps_ns)) * 1e-6
            late = f"{count} {samples} came in bursts, up to {latest_ms:.0f} ms late: their stamps"
            return [*said, f"{late} are taken as even"]
        return [
            *said,
            f"the {samples} came up to {self.clock.lateness.max():.0f} ms late: they are stamped "
            f"by the even clock behind their arrivals ({clock_in_words(self.clock)})",
        ]


def clock_in_words(clock: UniformClock) -> str:
    """Describe a clock and its accuracy: "60.00 Hz, known to 0.1 ms, 2 missing"."""
    words = f"{clock.rate_hz:.2f} Hz, known to {clock.rms_ms:.1f} ms"
    if clock.lost:
        words += f", {clock.lost} missing"
    if unsure := int(np.count_nonzero(clock.unsure)):
        words += f", {unsure} perhaps a place off"
    return words


def correct_late_stamps(
    stamps_ns: NDArray[np.int64], *, are_arrivals: bool = False
) -> CorrectedStamps:
    """Put late samples back on the uniform clock behind them, where the stamps show one.

    A burst that does not make up for its pause is left as it is, and so are stamps on an exact grid
    of which points are left out: no burst hits it. Where it is not known that the stamps, shape
    (T,) [ns], not decreasing, `are_arrivals`, they have to show it themselves.
    """
    if len(stamps_ns) < 10:  # which do not tell an even clock's period
        return CorrectedStamps(stamps_ns, stamps_ns)
    if are_arrivals and (clock := clock_behind(stamps_ns, are_arrivals=True)[0]):
        return CorrectedStamps(stamps_ns, clock.stamps_ns, clock)
    steps = np.diff(stamps_ns).astype(np.float64)
    period, lag = float(np.median(steps)), min(LAG, len(steps) // 2)
    mean_period = float(median_step(stamps_ns, lag))
    comes_singly = period > mean_period / 2
    # Where each sample is stamped when it was taken, most steps are like the next one.
    is_exact = comes_singly and np.mean(np.abs(np.diff(steps)) < 0.02 * period) > 0.5
    if comes_singly and is_grid(steps, period):
        rates = changing_rate(stamps_ns, 1 if is_exact else LAG)
        return CorrectedStamps(stamps_ns, stamps_ns, rates=rates)
    if is_exact or len(stamps_ns) > MAX_SAMPLES:
        even = smooth_bursts(stamps_ns, steps, period)
        return CorrectedStamps(stamps_ns, even, rates=changing_rate(even))
    if comes_singly and not _may_be_late(steps, mean_period):
        return CorrectedStamps(stamps_ns, stamps_ns, rates=changing_rate(stamps_ns, LAG))
    clock, rates = clock_behind(stamps_ns)
    if clock is not None:
        # Delays that exceed rounding, and what is as well left alone.
        late, least_ms = clock.lateness, _least_ms(float(np.median(clock.periods)))
        rounding_ms = np.gcd.reduce(np.diff(clock.arrivals_ns)) * 1e-6
        if np.ptp(late) >= 1.5 * rounding_ms and _spread(late - np.median(late)) > least_ms:
            return CorrectedStamps(stamps_ns, clock.stamps_ns, clock)
    return CorrectedStamps(stamps_ns, stamps_ns, rates=rates)


def _least_ms(period_ms: float) -> float:
    """Return the standard deviation of delays from which on they are corrected [ms]."""
    return max(_LATE * period_ms, 0.3)


def _may_be_late(steps: NDArray[np.float64], period: float) -> bool:
    """Check, without a clock, whether one may show delays worth a correction; all in ns.

    They differ no more than steps differ from whole periods, or `clock_behind` finds no clock; but
    what waited on its way comes at once.
    """
    off = steps - period * np.round(steps / period)
    is_hurried = np.mean(steps < 0.25 * period) > 0.03  # below what `clock_behind` has
    return bool(is_hurried or 1.5 * _spread(off) > 1e6 * _least_ms(1e-6 * period))


def clock_behind(
    arrivals_ns: NDArray[np.int64], *, are_arrivals: bool = False
) -> tuple[UniformClock | None, str]:
    """Fit the uniform clock behind samples each of which has its own delay.

    Returns it or None, and, where none can be determined, how the rate changes, in words.
    """
    if rates := changing_rate(arrivals_ns, LAG):
        return None, rates
    clock = recover_uniform_clock(arrivals_ns) if len(arrivals_ns) <= MAX_SAMPLES else None
    if clock is None or np.any(np.diff(clock.stamps_ns) <= 0):
        return None, ""
    # Its residuals are delays: they add up to nothing, few ticks are lost. With more than a fifth
    # of all ticks missing, an even clock explains whatever comes.
    late, period = clock.lateness, float(np.median(clock.periods))
    steps = 1e-6 * np.diff(arrivals_ns)
    is_hurried = np.mean(steps < 0.25 * period) > 0.05  # no sensor is, but what waited on its way
    # Delays of one sample each give 0.7 of the steps' own spread; a sensor whose steps differ by
    # themselves drifts far from any even clock.
    own = _spread(steps - period * np.diff(clock.ticks))
    adds_up = is_hurried or _spread(late - np.median(late)) <= max(1.1 * own, _LATE * period)
    if clock.lost > 0.2 * (clock.lost + len(late)) or not adds_up:
        return None, ""
    return (clock if are_arrivals or _is_telling(clock) else None), ""


def _is_telling(clock: UniformClock) -> bool:
    """Test by permutation whether shuffled steps are much less like a uniform clock.

    A few rates bound by how much from above; where that is not far beyond what tells, it is solved.
    """
    first_ns = clock.arrivals_ns[:_BLOCK]
    shuffled_ns = np.append(0, np.random.default_rng(0).permutation(np.diff(first_ns))).cumsum()
    few = slice(3 * _FEWEST)
    own, other = 1e-6 * (first_ns - first_ns[0])[few], 1e-6 * shuffled_ns[few]
    step, scale = _usual_step(other)
    periods = np.append(
        step * np.exp(np.linspace(*_RATES, 8)), [other[-1] / len(other), clock.periods[0]]
    )
    gain = _best(other, periods, scale)[1] - _best(own, clock.periods[:1], _usual_step(own)[1])[1]
    if gain > 2 * _TELLING * len(other):
        return True
    whole = clock if len(first_ns) == len(clock.arrivals_ns) else recover_uniform_clock(first_ns)
    solved = recover_uniform_clock(first_ns[0] + shuffled_ns)
    assert whole is not None
    assert solved is not None
    return solved.cost - whole.cost > _TELLING * len(first_ns)


def _spread(values: NDArray[np.float64]) -> float:
    """Return the winsorised root mean square: single large values are cut."""
    size = np.abs(values)
    return float(np.sqrt(np.mean(np.minimum(size, np.quantile(size, 0.9)) ** 2)))
