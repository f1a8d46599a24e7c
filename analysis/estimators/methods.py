"""Estimation methods: TuneNet, the exact fit, secant steps through rollouts, and baselines.

Secant steps need no exact fit. Near the target the residual is linear in the parameter, at first:
the ball's first flight is exactly that, and each later impact bends it. So a line through two
rollouts, fitted to the longest beginning of the episode that it explains to within the noise, lands
on the target without another rollout. What is left of the budget goes to a local search.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from tunenet_logs.analysis.estimators.base import (
    Estimator,
    Problem,
    Search,
    Step,
    Trace,
    check_one_parameter,
)
from tunenet_logs.analysis.registry import needed
from tunenet_logs.analysis.statistics import noise_of
from tunenet_logs.analysis.tunenet.network import Model
from tunenet_logs.episode import Array
from tunenet_logs.errors import NotFoundError

# ---- Searches by an external optimizer: baselines.


class _SearchMethod(Estimator):
    """Optimizer that calls for the cost of rollouts; the answer is the best rollout."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__()
        self._seed = seed

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Return the best rollout so far; see `Estimator.estimate`."""
        search = Search(problem, rollouts)
        return search.run(lambda: self.optimize(search, problem))

    @abstractmethod
    def optimize(self, search: Search, problem: Problem) -> None:
        """Search until it is done or the budget is spent."""


class Brent(_SearchMethod):
    """Bounded Brent search (golden section and parabolic steps) over one parameter's range.

    It ignores the initial guess, and finds one local minimum of the cost: there are dozens.
    """

    name = "brent"
    takes_one_parameter = True

    def optimize(self, search: Search, problem: Problem) -> None:
        """See `_SearchMethod.optimize`."""
        from scipy.optimize import minimize_scalar

        check_one_parameter(problem, self.name)
        options = {"xatol": 1e-6, "maxiter": max(search.left, 1)}  # [parameter] at which it ends
        bounds = problem.ranges[0]
        minimize_scalar(search.cost, bounds=bounds, method="bounded", options=options)


class ScaledCmaEs(_SearchMethod):
    """CMA-ES (Hansen 2016) on the L2 norm of the residual, in shares of the ranges.

    It begins at the initial guess, which is evaluated first. Population size and bounds handling
    are pycma's. The answer is the best rollout; a budget's remainder is spent on part of a
    generation.
    """

    name = "cma-es"

    def optimize(self, search: Search, problem: Problem) -> None:
        """See `_SearchMethod.optimize`."""
        cma = needed("cma")

        size = len(problem.searched)
        rng = np.random.default_rng(self._seed)
        low, high = problem.ranges.T
        # pycma wants two dimensions: one parameter gets a second one, on which nothing depends.
        shares = np.full(max(size, 2), 0.5)
        shares[:size] = (problem.start - low) / (high - low)
        options = {
            "bounds": [0.0, 1.0],
            "randn": lambda *shape: rng.standard_normal(shape),
            "seed": np.nan,  # numpy's own generator stays as it is
            "verbose": -9,
            "verb_log": 0,
        }
        search.cost(problem.start)
        # The first population spreads over .3 of each range, around the initial guess.
        strategy = cma.CMAEvolutionStrategy(shares, 0.3, options)
        while not strategy.stop():
            points = strategy.ask()
            values = [low + (high - low) * point[:size] for point in points]
            strategy.tell(points, [search.cost(one) for one in values])


class LeastSquares(_SearchMethod):
    """Trust-region reflective least squares (scipy) on the residual, from one start after another.

    The first start is the initial guess; the others spread evenly over the ranges. Rollouts for
    derivatives are charged like any other.
    """

    name = "least-squares"

    def optimize(self, search: Search, problem: Problem) -> None:
        """See `_SearchMethod.optimize`."""
        from scipy.optimize import least_squares
        from scipy.stats import qmc

        bounds = tuple(np.array([one.bounds for one in problem.searched]).T)
        low, high = problem.ranges.T
        start = problem.start
        # then 1/2, 1/4, 3/4, 1/8, ... of the ranges (van der Corput), past its 0
        sequence = qmc.Halton(1, scramble=False).fast_forward(1)
        while True:
            least_squares(search.misfit, start, bounds=bounds, diff_step=0.06)
            if search.least == 0:
                return
            start = low + (high - low) * float(sequence.random(1)[0, 0])


class Tpe(_SearchMethod):
    """Tree-structured Parzen estimator (Bergstra et al. 2011), optuna's; the guess first."""

    name = "tpe"

    def optimize(self, search: Search, problem: Problem) -> None:
        """See `_SearchMethod.optimize`."""
        optuna = needed("optuna")

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=self._seed))
        names = [one.name for one in problem.searched]
        study.enqueue_trial(dict(zip(names, problem.start.tolist(), strict=True)))
        while search.left:
            trial = study.ask()
            values = [
                trial.suggest_float(name, low, high)
                for name, (low, high) in zip(names, problem.ranges.tolist(), strict=True)
            ]
            study.tell(trial, search.cost(np.array(values)))


# ---- TuneNet: iterative residual tuning (algorithm 1 of Allevato et al. 2019), and the exact fit.


class TuneNet(Estimator):
    """Iterative residual tuning: K times the network's estimate of the residual (eq. 5), in bounds.

    Resample is part of the observations, which share one axis.
    """

    name = "tunenet"
    uses_network = True

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Spend one rollout per iteration; see `Estimator.estimate`."""
        model = self.model or (problem.train and problem.train())
        assert model is not None
        values = problem.initial
        steps: list[Step] = []
        for _ in range(rollouts):
            spent = problem.rollouts
            evaluation = problem.evaluate(values)
            steps.append(Step(values, spent, evaluation))
            values = next_values(model, problem, values, evaluation.observation.values)
        steps.append(Step(values, problem.rollouts))
        return Trace(tuple(steps))


class ExactFit(Estimator):
    """Closed-form model fitted to every sample, from the middle of the parameters' ranges."""

    name = "fit"
    takes_steps = False

    def estimate(self, problem: Problem, rollouts: int) -> Trace:  # noqa: ARG002 (needs none)
        """Fit without a rollout; see `Estimator.estimate`."""
        trace = fitted(Trace((Step(problem.initial, problem.rollouts),)), problem)
        if trace.fit is None:
            raise NotFoundError("the log shows too little for the exact fit; try --method tunenet")
        return trace


class TuneNetThenFit(TuneNet):
    """TuneNet's steps, then the exact fit from where they end."""

    name = "tunenet+refine"

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Spend all rollouts on the network, then fit; see `Estimator.estimate`."""
        trace = fitted(super().estimate(problem, rollouts), problem)
        return trace if trace.fit is not None else replace(trace, method=TuneNet.name)


def next_values(model: Model, problem: Problem, values: Array, simulated: Array) -> Array:
    """Add the network's residual by an observation, shape (L, C), to values, (P,), in bounds."""
    found = model(simulated[None], problem.target.values[None])[0]
    return problem.clamp(values + found[: len(problem.parameters)] * problem.residual_units)


def fitted(trace: Trace, problem: Problem) -> Trace:
    """Append the exact fit near its estimate to a trace, or nothing if the fit fails."""
    if problem.exact_fit is None:
        raise NotFoundError("no exact fit exists under this preset; use --method tunenet")
    fit = problem.exact_fit(trace.estimate)
    if fit is None:
        return trace
    # A few iterates of the fit, each of which gets a rollout to be shown.
    path = fit.path[1:-1]
    shown = path[:: len(path) // 5 + 1]
    on_the_way = [Step(values[: len(fit.values)], problem.rollouts) for values in shown]
    return Trace((*trace.steps, *on_the_way, Step(fit.values, problem.rollouts)), fit)


# ---- Secant steps through pairs of rollouts, after the network's steps or without.

# Two steps find the basin of a cost that has dozens; where eight lines do not end, no more will.
_NETWORK_STEPS, _LINE_STEPS = 2, 8
# Points of the local scan, and its half width in standard errors of the last line.
_SCAN, _SCAN_SDS = 13, 4.0
_PROBE = 0.01  # step [parameter] to a second point: inside the basin, and well above rounding
# Standard errors within which longer beginnings must agree with shorter ones (Lepski's rule).
_CONSISTENT_SDS = 3.0
# With 16 samples or more, chance hardly leaves a third of the noise's variance.
_ENOUGH, _CHANCE = 16, 3.0
_SAME = 1e-10  # differences [parameter, or of a curve] below it are rounding


Visit = tuple[float, Array]  # a value and the misfit of its rollout


@dataclass(frozen=True, eq=False)
class Line:
    """Secant through two rollouts, solved for the target."""

    value: float  # the parameter there
    sd: float  # its standard error
    samples: int  # length of the beginning of the episode that was fitted; 0 if none was
    before: Visit  # the rollout that it starts from


class RolloutLine(Estimator):
    """Secant steps through two rollouts, for one parameter."""

    name = "line"
    takes_one_parameter = True

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """See `Estimator.estimate`."""
        check_one_parameter(problem, self.name)
        values = problem.initial
        visited: list[Visit] = []
        steps = [Step(values, 0)]
        line: Line | None = None
        network_steps = _NETWORK_STEPS if self.model else 0
        for k in range(min(rollouts, network_steps + _LINE_STEPS)):
            evaluation = problem.evaluate(values)
            visited.append((float(values[0]), problem.misfit(evaluation)))
            steps[-1] = Step(values, steps[-1].rollouts, evaluation)
            if self.model and k < network_steps:
                values = next_values(self.model, problem, values, evaluation.observation.values)
            else:
                line = _next_line(visited, line, problem)
                values = problem.clamp(np.array([line.value if line else _best(visited)[0]]))
            steps.append(Step(values, problem.rollouts))
            if k >= network_steps and line is None:
                break
        if rollouts > problem.rollouts:
            # Half width of the scan [parameter]: its minimum, and that where no line was found
            reach = max(_SCAN_SDS * line.sd, 1e-4) if line else 0.03
            search = Search(problem, rollouts, least=_cost(_best(visited)))
            # Scan `reach` to either side, then run Brent's method about the best value.
            from scipy.optimize import minimize_scalar

            def cost(value: float) -> float:
                return search.cost(np.array([value]))

            def optimize() -> None:
                places = values[0] + np.linspace(-reach, reach, _SCAN)
                places = np.unique(problem.clamp(places[:, None])[:, 0])
                costs = [cost(place) for place in places]
                best = int(np.argmin(costs))
                low, high = places[max(best - 1, 0)], places[min(best + 1, len(places) - 1)]
                options = {"xatol": 1e-3 * (high - low)}
                minimize_scalar(cost, bounds=(low, high), method="bounded", options=options)

            steps += list(search.run(optimize).steps[1:])
        return Trace(tuple(steps))


class TuneNetThenLine(RolloutLine):
    """Two of TuneNet's steps, then secant steps, for one parameter."""

    name = "tunenet+line"
    uses_network = True


def _cost(visit: Visit) -> float:
    return float(np.linalg.norm(visit[1]))


def _best(visited: list[Visit]) -> Visit:
    return min(visited, key=_cost)


def _next_line(visited: list[Visit], line: Line | None, problem: Problem) -> Line | None:
    """Choose the next line: half way back if the last one increased the residual."""
    if line is not None and line.samples:
        here, before = visited[-1], line.before
        size = [float(np.linalg.norm(misfit[: line.samples])) for _, misfit in (here, before)]
        if size[0] > size[1]:
            return replace(line, value=(here[0] + before[0]) / 2)
    if all(abs(value - visited[-1][0]) <= _SAME for value, _ in visited):
        # A nearby value, for a second rollout where all so far were one.
        visit = visited[-1]
        here = visit[0]
        beside = float(problem.clamp(np.array([here + _PROBE]))[0])
        return Line(beside if beside > here else here - _PROBE, _PROBE, 0, visit)
    return line_through(visited, problem)


def line_through(visited: list[Visit], problem: Problem) -> Line | None:
    """Fit the secant through the last rollout and the one nearest to it in the parameter.

    Least squares of residual + slope x change = 0 over the first n samples, for the largest n whose
    answer is within 3 standard errors of every shorter beginning's (Lepski's rule): where the line
    bends, longer beginnings contradict shorter ones. `visited` (L * C,).
    """
    here, misfit = visited[-1]
    others = [one for one in visited[:-1] if abs(one[0] - here) > _SAME]
    if not others:
        return None
    there, other = min(others, key=lambda one: abs(one[0] - here))
    slope = (misfit - other) / (here - there)
    count = np.cumsum(np.abs(slope) > _SAME, dtype=np.intp)
    usable = np.flatnonzero(count >= 4)  # twice the unknowns of a line
    if not len(usable):
        return None
    power = np.cumsum(slope * slope)[usable]
    product = np.cumsum(slope * misfit)[usable]
    left = np.clip(np.cumsum(misfit * misfit)[usable] - product**2 / power, 0.0, None)
    values = here - product / power
    # The noise variance by third differences, or less if a line leaves less.
    columns = problem.target.values.T
    noise = float(np.mean([noise_of(one[np.isfinite(one)]) ** 2 for one in columns]))
    least = (left / count[usable])[count[usable] >= _ENOUGH].min(initial=np.inf)
    sds = np.sqrt(min(noise, _CHANCE * float(least)) / power)
    above = np.maximum.accumulate(values - _CONSISTENT_SDS * sds)
    below = np.minimum.accumulate(values + _CONSISTENT_SDS * sds)
    chosen = int(np.flatnonzero((above <= values) & (values <= below))[-1])
    samples = int(usable[chosen]) + 1
    return Line(float(values[chosen]), float(sds[chosen]), samples, visited[-1])
