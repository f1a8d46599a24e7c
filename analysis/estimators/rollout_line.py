"""Secant steps through pairs of rollouts, after the network's steps or without; then local search.

The network finds the basin of a cost that has dozens of them, in two steps. Near the target the
residual is linear in the parameter, at first: the ball's first flight is exactly that, and each
later impact bends it. So a line through two rollouts, fitted to the longest beginning of the
episode that it explains to within the noise, lands on the target without another rollout.
The rest of the budget scans the neighbourhood and ends with Brent's method.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.estimators.base import Estimator, Problem, Setup, Step, Trace
from analysis.estimators.search import Search, check_one_parameter
from analysis.estimators.tunenet import residual_of
from analysis.statistics import noise_of
from analysis.tunenet.network import Model
from tunenet_logs.arrays import Array

# Rollouts: two steps reach the basin; where eight lines do not end, more of them will not.
_NETWORK_STEPS, _LINE_STEPS = 2, 8

# Points of the local scan, and its half width in standard errors of the last line.
_SCAN, _SCAN_SDS = 13, 4.0

# Half width of the scan [parameter]: at least, and where no line was found.
_MIN_REACH, _BLIND_REACH = 1e-4, 0.03

_MIN_COUNT = 4  # samples that a line needs: twice its unknowns
_PROBE = 0.01  # step [parameter] to a second point: inside the basin, and well above rounding
# Standard errors within which longer beginnings must agree with shorter ones (Lepski's rule).
_CONSISTENT_SDS = 3.0

# With 16 samples or more, chance hardly leaves a third of the noise's variance.
_ENOUGH, _CHANCE = 16, 3.0

_SAME = 1e-10  # differences [parameter, or of a curve] below it are rounding


Visit = tuple[float, Array]  # a value and the misfit of its rollout


@dataclass(frozen=True, eq=False)
class Line:
    """Secant through two rollouts, solved for the target.

    Attributes:
        value: The parameter there.
        sd: Its standard error.
        samples: Length of the beginning of the episode that was fitted; 0 if none was.
        before: The rollout that it starts from.
    """

    value: float
    sd: float
    samples: int
    before: Visit


class RolloutLine(Estimator):
    """Secant steps through two rollouts, for one parameter.

    Args:
        model: The network that takes the first steps; None to start without one.
    """

    name = "line"
    takes_one_parameter = True

    def __init__(self, model: Model | None = None) -> None:
        self._model = model

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """See `Estimator.estimate`."""
        check_one_parameter(problem, self.name)
        values = problem.initial
        visited: list[Visit] = []
        steps = [Step(values, 0)]
        line: Line | None = None
        network_steps = _NETWORK_STEPS if self._model else 0
        for k in range(min(rollouts, network_steps + _LINE_STEPS)):
            evaluation = problem.evaluate(values)
            visited.append((float(values[0]), problem.misfit(evaluation)))
            steps[-1] = Step(values, steps[-1].rollouts, evaluation)
            if self._model and k < network_steps:
                simulated, target = evaluation.observation.values, problem.target.values
                values = problem.clamp(
                    values + residual_of(self._model, problem, simulated, target)
                )
            else:
                line = _next(visited, line, problem)
                values = problem.clamp(np.array([line.value if line else _best(visited)[0]]))
            steps.append(Step(values, problem.rollouts))
            if k >= network_steps and line is None:
                break
        if rollouts > problem.rollouts:
            reach = max(_SCAN_SDS * line.sd, _MIN_REACH) if line else _BLIND_REACH
            search = Search(problem, rollouts, least=_cost(_best(visited)))
            steps += _local_search(search, problem, values, reach)
        return Trace(tuple(steps))


class TuneNetThenLine(RolloutLine):
    """Two of TuneNet's steps, then secant steps, for one parameter."""

    name = "tunenet+line"
    uses_network = True

    def __init__(self, model: Model) -> None:
        super().__init__(model)

    @classmethod
    def build(cls, setup: Setup) -> TuneNetThenLine:
        """See `Estimator.build`."""
        assert setup.model is not None
        return cls(setup.model)


def _cost(visit: Visit) -> float:
    return float(np.linalg.norm(visit[1]))


def _best(visited: list[Visit]) -> Visit:
    return min(visited, key=_cost)


def _next(visited: list[Visit], line: Line | None, problem: Problem) -> Line | None:
    """Choose the next line: half way back if the last one increased the residual."""
    if line is not None and line.samples:
        here, before = visited[-1], line.before
        size = [float(np.linalg.norm(misfit[: line.samples])) for _, misfit in (here, before)]
        if size[0] > size[1]:
            return replace(line, value=(here[0] + before[0]) / 2)
    if all(abs(value - visited[-1][0]) <= _SAME for value, _ in visited):
        return _probe(visited[-1], problem)
    return line_through(visited, problem)


def line_through(visited: list[Visit], problem: Problem) -> Line | None:
    """Fit the secant through the last rollout and the one nearest to it in the parameter.

    Least squares of residual + slope x change = 0 over the first n samples, for the largest n whose
    answer is within 3 standard errors of every shorter beginning's (Lepski's rule): where the line
    bends, longer beginnings contradict shorter ones.

    Args:
        visited: Value and residual of each rollout so far, shape (L * C,).
        problem: For the target, whose noise is estimated by its third differences.

    Returns:
        None if two rollouts do not differ, or too little moves.
    """
    here, misfit = visited[-1]
    others = [one for one in visited[:-1] if abs(one[0] - here) > _SAME]
    if not others:
        return None
    there, other = min(others, key=lambda one: abs(one[0] - here))
    slope = (misfit - other) / (here - there)
    count = np.cumsum(np.abs(slope) > _SAME, dtype=np.intp)
    usable = np.flatnonzero(count >= _MIN_COUNT)
    if not len(usable):
        return None
    power = np.cumsum(slope * slope)[usable]
    product = np.cumsum(slope * misfit)[usable]
    left = np.clip(np.cumsum(misfit * misfit)[usable] - product**2 / power, 0.0, None)
    values = here - product / power
    sds = np.sqrt(_noise_variance(problem, left / count[usable], count[usable]) / power)
    above = np.maximum.accumulate(values - _CONSISTENT_SDS * sds)
    below = np.minimum.accumulate(values + _CONSISTENT_SDS * sds)
    chosen = int(np.flatnonzero((above <= values) & (values <= below))[-1])
    samples = int(usable[chosen]) + 1
    return Line(float(values[chosen]), float(sds[chosen]), samples, visited[-1])


def _probe(visit: Visit, problem: Problem) -> Line:
    """Return a nearby value, for a second rollout where all so far were one."""
    here = visit[0]
    beside = float(problem.clamp(np.array([here + _PROBE]))[0])
    return Line(beside if beside > here else here - _PROBE, _PROBE, 0, visit)


def _noise_variance(problem: Problem, left: Array, count: NDArray[np.intp]) -> float:
    """Estimate the noise variance by third differences, or less if a line leaves less."""
    columns = problem.target.values.T
    seen = [column[np.isfinite(column)] for column in columns]
    noise = float(np.mean([noise_of(one) ** 2 for one in seen]))
    least = left[count >= _ENOUGH].min(initial=np.inf)
    return min(noise, _CHANCE * float(least))


def _local_search(search: Search, problem: Problem, values: Array, reach: float) -> list[Step]:
    """Scan `reach` to either side, then run Brent's method about the best value."""
    from scipy.optimize import minimize_scalar

    def cost(value: float) -> float:
        return search.cost(np.array([value]))

    def optimize() -> None:
        places = values[0] + np.linspace(-reach, reach, _SCAN)
        places = np.unique(problem.clamp(places[:, None])[:, 0])
        costs = [cost(place) for place in places]
        best = int(np.argmin(costs))
        low, high = places[max(best - 1, 0)], places[min(best + 1, len(places) - 1)]
        minimize_scalar(
            cost, bounds=(low, high), method="bounded", options={"xatol": 1e-3 * (high - low)}
        )

    return list(search.run(optimize).steps[1:])
