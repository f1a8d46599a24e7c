"""Secant on the first flight's duration: what somebody does who knows balls."""

from __future__ import annotations

import numpy as np

from analysis.drop.first_flight import first_flight_s
from analysis.drop.observations import CANONICAL_PER_FALL, canonical_axis
from analysis.estimators.base import Problem, Trace
from analysis.estimators.observation import Observation
from analysis.estimators.search import Search

_CLOSE = 1e-9
_LOW = 0.15
"""Below it a flight may be too short to be seen, and the cost has one minimum."""


class Secant:
    """Changes the restitution until the simulated ball flies as long as the target's.

    The duration is nearly proportional to the restitution: the first step goes by that, the others
    by the secant through the last two rollouts. A ball that is not seen to leave the table flies
    for 0 s. Where the target does, or low durations come no closer, the cost takes their place:
    Brent's method between the restitutions that flew shorter and longer. One parameter.
    """

    name = "secant"

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """The next place to look at, or the one of least cost; see `Estimator.estimate`."""
        search = Search(problem, rollouts, keep_best=False)
        return search.run(lambda: _optimize(search, problem))


def _optimize(search: Search, problem: Problem) -> None:
    wanted = _duration(problem.target)
    (bounds,) = (one.bounds for one in problem.parameters)
    value, last = float(problem.initial[0]), None
    low, high = bounds[0], _LOW if wanted == 0 else 2 * _LOW
    while True:
        look = search.evaluate(np.array([value]))
        flown = _duration(look.observation)
        if flown > wanted:
            high = min(high, value)
        elif wanted > 0 and value < high:
            low = max(low, value)
        if _lost(wanted, (value, flown), last):
            cost = float(np.linalg.norm(problem.misfit(look))) if value <= high else np.inf
            _least_cost(search, (low, high), cost)
            return
        slope = _slope((value, flown), last)
        if slope > 0:
            following = float(np.clip(value + (wanted - flown) / slope, *bounds))
        else:
            following = sum(bounds) / 2  # a ball that did not fly says nothing of how far to go
        if abs(following - value) < _CLOSE:
            return
        last, value = (value, flown), following
        search.answer(np.array([value]))


def _lost(wanted: float, here: tuple[float, float], last: tuple[float, float] | None) -> bool:
    """Whether durations lead no further: the target's is not seen, or low ones come no closer."""
    value, flown = here
    if wanted == 0:
        return True
    if last is None or value > _LOW:
        return False
    return flown == 0 or abs(flown - wanted) > abs(last[1] - wanted) / 2


def _least_cost(search: Search, bounds: tuple[float, float], least: float) -> None:
    """Brent's method on the cost, squared so that parabolas fit it.

    Args:
        search: what charges the rollouts.
        bounds: where to look.
        least: cost of the present answer; infinite where that is out of `bounds`.
    """
    from scipy.optimize import minimize_scalar

    if np.isinf(least):
        search.answer(np.array([sum(bounds) / 2]))

    def squared(value: float) -> float:
        nonlocal least
        cost = search.cost(np.array([value]))
        if cost < least:
            least = cost
            search.answer(np.array([value]))
        return cost**2

    options = {"xatol": _CLOSE, "maxiter": max(search.left, 1)}
    minimize_scalar(squared, bounds=bounds, method="bounded", options=options)


def _slope(here: tuple[float, float], last: tuple[float, float] | None) -> float:
    """Seconds of flight for a unit of restitution; 0 where that cannot be told.

    Sampling makes the duration uneven over very small changes: a slope that is far from the
    proportional one is none of the ball's.
    """
    value, flown = here
    proportional = flown / value if value > 0 else 0.0
    if last is None:
        return proportional
    slope = (flown - last[1]) / (value - last[0])
    if proportional == 0 or proportional / 2 < slope < 2 * proportional:
        return slope
    return proportional


def _duration(observation: Observation) -> float:
    seconds, heights = observation.axis, observation.values[:, 0]
    seen = np.isfinite(heights)
    seconds, heights = seconds[seen], heights[seen]
    if np.array_equal(observation.axis, canonical_axis()):  # it leaves out the fall, always alike
        fall = np.arange(-CANONICAL_PER_FALL, 1) / CANONICAL_PER_FALL
        seconds = np.concatenate([fall, seconds])
        heights = np.concatenate([1 - (fall + 1) ** 2, heights])
    return first_flight_s(seconds, heights)
