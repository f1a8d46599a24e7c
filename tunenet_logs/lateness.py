"""Assign arrivals to the ticks of a uniform clock by dynamic programming over their delays.

A camera ticks evenly; a network only delays, and keeps the order. So a sample belongs to no tick
after its arrival, and to no earlier tick than the one before it. Dynamic programming finds the
maximum-likelihood assignment: delays have a law (uniform up to a longest one, or exponential), and
a lost sample has its price.

Times are in ms. C candidates for a clock are weighed at once; T samples; S numbers of ticks that
were skipped since the first sample, the first of them `-before`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EVEN, RARER = 0, 1  # laws of delays: as likely up to a longest one; exponential, by their mean
# Log likelihood that a loss costs: one sample in 700 is lost, and then often some in a row.
_FIRST_LOST, _NEXT_LOST = 6.5, 1.0

# Log likelihood that a delay costs which is longer than the longest, and how often its logarithm
# more: a network that stalls has delays without measure.
_OUTLIER, _OUTLIERS_FALL = 3.0, 2.0

# Medians up to which a delay tells the mean of an exponential law, and means from which on its
# logarithm is what it costs.
_TYPICAL = 8.0

# Of a law's scale, within bounds: how much too early is one standard deviation of what the clock is
# not known by.
_EARLY, _EARLY_MS = 0.05, (0.3, 2.0)

_MIN_MS, _MAX_MS = 0.3, 10_000.0
_MAX_SKIPPED, _MAX_BEFORE = 150, 100
_TYPICAL_EARLIEST = 0.02  # quantile of the delays that a clock is moved by: a few may be wrong
_SAME = 1e-6
NEVER = 1e4  # cost of what is out of the question


class Clocks(NamedTuple):
    """Candidate uniform clocks.

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
        """Return one candidate alone."""
        part = slice(one, one + 1)
        return Clocks(self.periods[part], self.starts[part], self.scales[part], self.laws[part])


class OnTicks(NamedTuple):
    """Samples assigned to ticks.

    Attributes:
        costs: negative log likelihood of each candidate, shape (C,).
        skipped: ticks left out up to each sample, shape (C, T).
        excess: what it costs more to have so many left out, shape (C, T, S).
        before: S begins with `-before`.
    """

    costs: Array
    skipped: NDArray[np.int64]
    excess: Array
    before: int


def candidates(periods: Array, scale: float) -> Clocks:
    """Return each period with each law of delays, to be refined by `fitted`."""
    count = len(periods)
    return Clocks(
        np.tile(periods, 2),
        np.zeros(2 * count),
        np.repeat([scale, scale / 3], count),
        np.repeat([EVEN, RARER], count),
    )


def fitted(arrivals: Array, clocks: Clocks, rounds: int = 2) -> tuple[Clocks, OnTicks]:
    """Refine start and scale of the candidates, alternating with the assignment to ticks."""
    above = arrivals - clocks.periods[:, None] * np.arange(len(arrivals))
    starts = above[:, :20].min(axis=1)
    room = ((starts - above.min(axis=1)) / clocks.periods).min()
    before = int(np.clip(np.ceil(room), 0, _MAX_BEFORE)) + 1
    clocks = clocks._replace(starts=starts)
    placing = placed(arrivals, clocks, before)
    for _ in range(rounds):
        late = delays(arrivals, clocks, placing.skipped)
        moved = np.quantile(late, _TYPICAL_EARLIEST, axis=1)
        late -= moved[:, None]
        clocks = clocks._replace(
            starts=clocks.starts + moved, scales=_scales(late.clip(0), clocks.laws)
        )
        placing = placed(arrivals, clocks, before)
    return clocks, placing


def delays(arrivals: Array, clocks: Clocks, skipped: NDArray[np.int64]) -> Array:
    """Return the delay of each sample if so many ticks were skipped, shape (C, T)."""
    ticks = np.arange(len(arrivals)) + skipped
    return arrivals - clocks.starts[:, None] - clocks.periods[:, None] * ticks


def placed(
    arrivals: Array, clocks: Clocks, before: int, held: tuple[int, int] | None = None
) -> OnTicks:
    """Assign all samples to their likeliest ticks, and return what others cost.

    Args:
        arrivals: shape (T,).
        clocks: whole candidates.
        before: how many ticks earlier than `starts` the first sample may be.
        held: a sample, and how many ticks are skipped up to it for sure.
    """
    above = delays(arrivals, clocks, np.zeros(len(arrivals), np.int64))
    most = int(np.ceil((above.max(axis=1) / clocks.periods).min()))
    skipped = np.arange(before + 2 + min(max(most, 1), _MAX_SKIPPED)) - float(before)
    late = above[:, :, None] - clocks.periods[:, None, None] * skipped
    costs = _costs(late, clocks.scales[:, None, None], clocks.laws[:, None, None])
    if held is not None:
        costs[:, held[0], skipped != held[1]] = NEVER
    return cheapest(costs, before)


def cheapest(costs: Array, before: int) -> OnTicks:
    """Solve the assignment by dynamic programming from the cost of each tick, shape (C, T, S)."""
    skipped = np.arange(costs.shape[2]) - float(before)
    onward = _sums(costs, skipped, onward=True)
    total = onward + _sums(costs, skipped, onward=False) - costs
    least = total[:, 0].min(axis=1)
    excess = total - least[:, None, None]
    # Of ways that cost the same the lowest is taken everywhere: they would else be mixed.
    return OnTicks(least, (excess < _SAME).argmax(axis=2) - before, excess, before)


def _sums(paid: Array, skipped: Array, *, onward: bool) -> Array:
    """Accumulate the least cost up to each sample and tick, forward or backward (min-sum)."""
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
    """Propagate those sums by one sample: none is lost in between, or some are."""
    side = slice(None) if onward else slice(None, None, -1)
    ahead, far = sums[:, side], way[side]
    after = ahead.copy()
    cheapest = np.minimum.accumulate(ahead - _NEXT_LOST * far, axis=1)[:, :-1]
    lost = cheapest + _NEXT_LOST * far[1:] + (_FIRST_LOST - _NEXT_LOST)
    np.minimum(after[:, 1:], lost, out=after[:, 1:])
    return after[:, side]


def _costs(late: Array, scales: Array, laws: NDArray[np.int64]) -> Array:
    """Return the negative log likelihood of each delay."""
    early = np.clip(_EARLY * scales, *_EARLY_MS)
    share = late.clip(0) / scales
    far = np.log(np.maximum(share, 1.0))
    even = np.where(share > 1, _OUTLIER + _OUTLIERS_FALL * far, 0.0)
    rarer = np.minimum(share, _TYPICAL + _OUTLIERS_FALL * np.maximum(far - np.log(_TYPICAL), 0.0))
    cost = np.log(scales) + np.where(laws == EVEN, even, rarer)
    cost += 0.5 * (late.clip(max=0) / early) ** 2
    return np.minimum(cost, NEVER, out=cost)


def _scales(late: Array, laws: NDArray[np.int64]) -> Array:
    """Return the maximum-likelihood scale of each candidate's delays, shape (C,)."""
    tried = np.geomspace(_MIN_MS, _MAX_MS, 80)
    ordered = np.sort(np.maximum(late, _MIN_MS), axis=1)
    logs = np.cumsum(np.log(ordered[:, ::-1]), axis=1)  # of the longest ones
    scales = np.empty(len(late))
    for row, (one, total) in enumerate(zip(ordered, logs, strict=True)):
        if laws[row] == RARER:
            scales[row] = one[one <= _TYPICAL * np.median(one)].mean()
            continue
        outliers = len(one) - np.searchsorted(one, tried, side="right")
        beyond = np.where(outliers > 0, total[outliers - 1] - outliers * np.log(tried), 0.0)
        cost = len(one) * np.log(tried) + _OUTLIER * outliers + _OUTLIERS_FALL * beyond
        scales[row] = tried[int(cost.argmin())]
    return scales
