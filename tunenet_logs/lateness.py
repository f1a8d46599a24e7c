"""How late samples are, and which ticks of an even clock they were taken at, by arrivals alone.

A camera ticks evenly; a network only delays, and keeps the order. So a sample belongs to no tick
after its arrival, and to no earlier tick than the one before it. Of the ways to put samples on
ticks, the likeliest is found by dynamic programming: delays have a law (spread evenly up to a
longest one, or ever rarer), and a lost sample has its price.

Times are in ms. C candidates for a clock are weighed at once; T samples; S numbers of ticks that
were skipped since the first sample, the first of them `-before`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EVEN, RARER = 0, 1
"""Laws of delays: as likely up to a longest one; exponential, by their mean."""

_FIRST_LOST, _NEXT_LOST = 6.5, 1.0
"""Log likelihood that a loss costs: one sample in 700 is lost, and then often some in a row."""

_OUTLIER, _OUTLIERS_FALL = 3.0, 2.0
"""Log likelihood that a delay costs which is longer than the longest, and how often its logarithm
more: a network that stalls has delays without measure."""

_USUAL = 8.0
"""Medians up to which a delay tells the mean of an exponential law, and means from which on its
logarithm is what it costs."""

_EARLY, _EARLY_MS = 0.05, (0.3, 2.0)
"""Of a law's scale, within bounds: how much too early is one standard deviation of what the clock
is not known by."""

_SHORTEST_MS, _LONGEST_MS = 0.3, 10_000.0
_MOST_SKIPPED, _MOST_BEFORE = 150, 100
_USUAL_EARLIEST = 0.02
"""Quantile of the delays that a clock is moved by: a few may be wrong."""

_SAME = 1e-6
NEVER = 1e4
"""Cost of what is out of the question."""


class Clocks(NamedTuple):
    """Candidates for an even clock.

    Attributes:
        periods: shape (C,).
        starts: time of the tick of the first sample if none was skipped, shape (C,).
        scales: of the delays' law, shape (C,).
        laws: which it is, shape (C,).
    """

    periods: Array
    starts: Array
    scales: Array
    laws: NDArray[np.int64]

    def only(self, one: int) -> Clocks:
        """That candidate alone."""
        part = slice(one, one + 1)
        return Clocks(self.periods[part], self.starts[part], self.scales[part], self.laws[part])


class OnTicks(NamedTuple):
    """Samples on ticks.

    Attributes:
        costs: of each candidate, shape (C,); a log likelihood's negative.
        skipped: ticks left out up to each sample, shape (C, T).
        excess: what it costs more to have so many left out, shape (C, T, S).
        before: S begins with `-before`.
    """

    costs: Array
    skipped: NDArray[np.int64]
    excess: Array
    before: int


def candidates(periods: Array, scale: float) -> Clocks:
    """Each period with each law, to be made better by `fitted`."""
    count = len(periods)
    return Clocks(
        np.tile(periods, 2),
        np.zeros(2 * count),
        np.repeat([scale, scale / 3], count),
        np.repeat([EVEN, RARER], count),
    )


def fitted(arrivals: Array, clocks: Clocks, rounds: int = 2) -> tuple[Clocks, OnTicks]:
    """The candidates with start and scale as the samples have them, and where they put those.

    Args:
        arrivals: not decreasing, shape (T,).
        clocks: their starts are not looked at.
        rounds: how often both are found anew.
    """
    above = arrivals - clocks.periods[:, None] * np.arange(len(arrivals))
    starts = above[:, :20].min(axis=1)
    room = ((starts - above.min(axis=1)) / clocks.periods).min()
    before = int(np.clip(np.ceil(room), 0, _MOST_BEFORE)) + 1
    clocks = clocks._replace(starts=starts)
    placing = placed(arrivals, clocks, before)
    for _ in range(rounds):
        late = delays(arrivals, clocks, placing.skipped)
        moved = np.quantile(late, _USUAL_EARLIEST, axis=1)
        late -= moved[:, None]
        clocks = clocks._replace(
            starts=clocks.starts + moved, scales=_scales(late.clip(0), clocks.laws)
        )
        placing = placed(arrivals, clocks, before)
    return clocks, placing


def delays(arrivals: Array, clocks: Clocks, skipped: NDArray[np.int64]) -> Array:
    """How late each sample is if so many ticks were skipped, shape (C, T)."""
    ticks = np.arange(len(arrivals)) + skipped
    return arrivals - clocks.starts[:, None] - clocks.periods[:, None] * ticks


def placed(
    arrivals: Array, clocks: Clocks, before: int, held: tuple[int, int] | None = None
) -> OnTicks:
    """The likeliest ticks of all samples, and what others cost.

    Args:
        arrivals: shape (T,).
        clocks: whole candidates.
        before: how many ticks earlier than `starts` the first sample may be.
        held: a sample, and how many ticks are skipped up to it for sure.
    """
    above = delays(arrivals, clocks, np.zeros(len(arrivals), np.int64))
    most = int(np.ceil((above.max(axis=1) / clocks.periods).min()))
    skipped = np.arange(before + 2 + min(max(most, 1), _MOST_SKIPPED)) - float(before)
    late = above[:, :, None] - clocks.periods[:, None, None] * skipped
    costs = _costs(late, clocks.scales[:, None, None], clocks.laws[:, None, None])
    if held is not None:
        costs[:, held[0], skipped != held[1]] = NEVER
    return cheapest(costs, before)


def cheapest(costs: Array, before: int) -> OnTicks:
    """The same from what each tick costs each sample, shape (C, T, S)."""
    skipped = np.arange(costs.shape[2]) - float(before)
    onward = _sums(costs, skipped, onward=True)
    total = onward + _sums(costs, skipped, onward=False) - costs
    least = total[:, 0].min(axis=1)
    excess = total - least[:, None, None]
    # Of ways that cost the same the lowest is taken everywhere: they would else be mixed.
    return OnTicks(least, (excess < _SAME).argmax(axis=2) - before, excess, before)


def _sums(paid: Array, skipped: Array, *, onward: bool) -> Array:
    """Cost of the cheapest way up to and with each sample and tick, from the first or the last."""
    sums = np.empty_like(paid)
    order = range(paid.shape[1]) if onward else range(paid.shape[1] - 1, -1, -1)
    way = skipped if onward else -skipped
    best: Array | None = None
    for at in order:
        if best is not None:
            best = _with_losses(best, way, onward=onward)
        best = paid[:, at] if best is None else best + paid[:, at]
        sums[:, at] = best
    return sums


def _with_losses(sums: Array, way: Array, *, onward: bool) -> Array:
    """The same one sample on: none is lost between them, or some are."""
    side = slice(None) if onward else slice(None, None, -1)
    ahead, far = sums[:, side], way[side]
    after = ahead.copy()
    cheapest = np.minimum.accumulate(ahead - _NEXT_LOST * far, axis=1)[:, :-1]
    lost = cheapest + _NEXT_LOST * far[1:] + (_FIRST_LOST - _NEXT_LOST)
    np.minimum(after[:, 1:], lost, out=after[:, 1:])
    return after[:, side]


def _costs(late: Array, scales: Array, laws: NDArray[np.int64]) -> Array:
    """A log likelihood's negative for each delay."""
    early = np.clip(_EARLY * scales, *_EARLY_MS)
    share = late.clip(0) / scales
    far = np.log(np.maximum(share, 1.0))
    even = np.where(share > 1, _OUTLIER + _OUTLIERS_FALL * far, 0.0)
    rarer = np.minimum(share, _USUAL + _OUTLIERS_FALL * np.maximum(far - np.log(_USUAL), 0.0))
    cost = np.log(scales) + np.where(laws == EVEN, even, rarer)
    cost += 0.5 * (late.clip(max=0) / early) ** 2
    return np.minimum(cost, NEVER, out=cost)


def _scales(late: Array, laws: NDArray[np.int64]) -> Array:
    """The likeliest scale of each candidate's delays, shape (C,)."""
    tried = np.geomspace(_SHORTEST_MS, _LONGEST_MS, 80)
    ordered = np.sort(np.maximum(late, _SHORTEST_MS), axis=1)
    logs = np.cumsum(np.log(ordered[:, ::-1]), axis=1)  # of the longest ones
    scales = np.empty(len(late))
    for row, (one, total) in enumerate(zip(ordered, logs, strict=True)):
        if laws[row] == RARER:
            scales[row] = one[one <= _USUAL * np.median(one)].mean()
            continue
        outliers = len(one) - np.searchsorted(one, tried, side="right")
        beyond = np.where(outliers > 0, total[outliers - 1] - outliers * np.log(tried), 0.0)
        cost = len(one) * np.log(tried) + _OUTLIER * outliers + _OUTLIERS_FALL * beyond
        scales[row] = tried[int(cost.argmin())]
    return scales
