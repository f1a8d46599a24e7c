"""Secant method on the first flight's duration."""

from __future__ import annotations

import numpy as np

from analysis.drop.observations import CANONICAL_PER_FALL, canonical_axis
from analysis.estimators.base import Estimator, Observation, Problem, Trace
from analysis.estimators.search import Search, check_one_parameter
from analysis.statistics import noise_of
from recorders.simulators.drop import RESTITUTION
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError

_CLOSE = 1e-9  # change of the restitution that ends a search: far below what any recording tells
_LOW = 0.15  # below it a flight may be too short to be seen, and the cost has one minimum
_MIN_SAMPLES = 4  # of a fall, and of a flight: one more than a parabola has coefficients
_LOW_FRACTION = 0.3  # a flight is over below this fraction of its height: it is fitted up to there


class FlightSecant(Estimator):
    """Secant search for the restitution at which the simulated ball flies as long as the target's.

    The duration is nearly proportional to the restitution: the first step goes by that, the others
    by the secant through the last two rollouts. A ball that is not seen to leave the table flies
    for 0 s. Where the target does, or low durations come no closer, the cost takes their place:
    Brent's method between the restitutions that flew shorter and longer. One parameter.
    """

    name = "secant"
    takes_one_parameter = True

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Search for the restitution by the secant method; see `Estimator.estimate`."""
        if check_one_parameter(problem, self.name) != RESTITUTION:
            raise NotFoundError(
                "the method secant compares flights", "leave --method out: it is for drops"
            )
        search = Search(problem, rollouts, keep_best=False)
        return search.run(lambda: _optimize(search, problem))


def _optimize(search: Search, problem: Problem) -> None:
    """Run the secant method; Brent's on the cost where durations lead no further."""
    wanted = _duration(problem.target)
    (bounds,) = (parameter.bounds for parameter in problem.parameters)
    value, last = float(problem.initial[0]), None
    low, high = bounds[0], _LOW if wanted == 0 else 2 * _LOW
    while True:
        evaluation = search.evaluate(np.array([value]))
        flown = _duration(evaluation.observation)
        if flown > wanted:
            high = min(high, value)
        elif wanted > 0 and value < high:
            low = max(low, value)
        if _lost(wanted, (value, flown), last):
            cost = float(np.linalg.norm(problem.misfit(evaluation))) if value <= high else np.inf
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
    """Return whether durations lead no further: the target's is unseen, or low ones stall."""
    value, flown = here
    if wanted == 0:
        return True
    if last is None or value > _LOW:
        return False
    return flown == 0 or abs(flown - wanted) > abs(last[1] - wanted) / 2


def _least_cost(search: Search, bounds: tuple[float, float], least: float) -> None:
    """Minimise the cost by Brent's method, squared so that parabolas fit it."""
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
    """Return seconds of flight for a unit of restitution; 0 where that cannot be determined.

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
    """Return the first flight's duration, in the unit of the observation's axis."""
    seconds, heights = observation.axis, observation.values[:, 0]
    seen = np.isfinite(heights)
    seconds, heights = seconds[seen], heights[seen]
    if np.array_equal(observation.axis, canonical_axis()):  # falls are alike, and may be unseen
        after = seconds > 0
        fall = np.arange(-CANONICAL_PER_FALL, 1) / CANONICAL_PER_FALL
        seconds = np.concatenate([fall, seconds[after]])
        heights = np.concatenate([1 - (fall + 1) ** 2, heights[after]])
    return first_flight_s(seconds, heights)


def first_flight_s(seconds: Array, heights: Array) -> float:
    """Measure the duration of the flight between the first two impacts.

    The first impact is where the parabolas of fall and flight meet, the second one where the
    flight's is as low again. So the second impact itself, which falls anywhere in the step of an
    engine, plays no part: the duration changes evenly with the restitution. Drag biases it, alike
    in two curves that are compared.

    Args:
        seconds: times of the samples, shape (T,), increasing, from before the first impact.
        heights: heights there, shape (T,), finite, in any unit.

    Returns:
        In the unit of `seconds`; 0 where the ball is not seen to leave the table and come back.
    """
    low = heights < (heights.max() + heights.min()) / 2
    stops = np.flatnonzero(low[:-1] & (np.diff(heights) >= 0))
    if not len(stops) or stops[0] < _MIN_SAMPLES or len(heights) - stops[0] < _MIN_SAMPLES:
        return 0.0
    impact = int(stops[0])  # the lowest sample of the first fall
    rest = float(np.quantile(heights[impact:], 0.05))  # the table, where most samples rest on it
    least = 6 * noise_of(heights) + 1e-3 * float(np.ptp(heights))
    top = np.maximum.accumulate(heights[impact:])
    over = (top > rest + least) & (heights[impact:] < rest + _LOW_FRACTION * (top - rest))
    if not over.any():
        return 0.0
    flight = slice(impact + 1, impact + int(np.argmax(over)))
    if flight.stop - flight.start < _MIN_SAMPLES:
        return 0.0
    clock = seconds - seconds[impact]
    falling = heights[:impact] < rest + 0.98 * (heights[0] - rest)
    down = np.polyfit(clock[:impact][falling], heights[:impact][falling], 2)
    up = np.polyfit(clock[flight], heights[flight], 2)
    if not 0.5 * down[0] > up[0] > 2 * down[0]:  # noise about a ball at rest is no free flight
        return 0.0
    apex = -up[1] / (2 * up[0])
    crossings = np.roots(down - up)
    near = crossings[np.argmin(np.abs(crossings))]
    return float(max(0.0, 2 * (apex - near.real)))
