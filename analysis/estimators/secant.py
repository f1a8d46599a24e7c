"""Secant on the first flight's duration: what somebody does who knows balls."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.estimators.base import Problem, Trace
from analysis.estimators.search import Search
from analysis.observe.base import Observation
from analysis.observe.drop import CANONICAL_PER_FALL, canonical_axis
from analysis.observe.flight import first_flight_s

Array = NDArray[np.float64]

_CLOSE = 1e-9


class Secant:
    """Changes the restitution until the simulated ball flies as long as the target's.

    The duration is nearly proportional to the restitution: the first step goes by that, the others
    by the secant through the last two rollouts. A ball that is not seen to leave the table flies
    for 0 s, so a target that never bounces leads to the lowest restitution; where no rollout is
    seen to fly there is no step to make and the answer stays. One parameter.
    """

    name = "secant"

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """The next place to look at, after each rollout; see `Estimator.estimate`."""
        search = Search(problem, rollouts, keep_best=False)
        return search.run(lambda: _optimize(search, problem))


def _optimize(search: Search, problem: Problem) -> None:
    wanted = _duration(problem.target)
    (bounds,) = (one.bounds for one in problem.parameters)
    value, last = float(problem.initial[0]), None
    while True:
        flown = _duration(search.look(np.array([value])).observation)
        slope = _slope((value, flown), last)
        if slope > 0:
            following = float(np.clip(value + (wanted - flown) / slope, *bounds))
        elif last is None and wanted > 0:
            following = sum(bounds) / 2  # a ball that did not fly says nothing of how far to go
        else:
            return
        if abs(following - value) < _CLOSE:
            return
        last, value = (value, flown), following
        search.answer(np.array([value]))


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
