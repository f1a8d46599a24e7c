"""Iterative residual tuning (algorithm 1 of Allevato et al. 2019), and the exact fit after it."""

from __future__ import annotations

from dataclasses import replace

from analysis.estimators.base import Estimator, Problem, Setup, Step, Trace
from analysis.tunenet.network import Model
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError

_MOST_SHOWN = 5
"""Steps of a fit that goes step by step, of which each has a rollout to be shown."""


class TuneNet(Estimator):
    """Adds the network's estimate of the parameter residual, K times (eq. 5), within bounds.

    Resample is part of the observations: both functions give them on the same axis.
    """

    name = "tunenet"
    uses_network = True

    def __init__(self, model: Model | None) -> None:
        self._model = model

    @classmethod
    def build(cls, setup: Setup) -> TuneNet:
        """See `Estimator.build`."""
        return cls(setup.model)

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """One rollout an iteration; see `Estimator.estimate`."""
        model = self._model or (problem.train and problem.train())
        assert model is not None
        values = problem.initial
        steps: list[Step] = []
        for _ in range(rollouts):
            spent = problem.rollouts
            evaluation = problem.evaluate(values)
            steps.append(Step(values, spent, evaluation))
            simulated, target = evaluation.observation.values, problem.target.values
            values = problem.clamp(values + residual_of(model, problem, simulated, target))
        steps.append(Step(values, problem.rollouts))
        return Trace(tuple(steps))


class ExactFit(Estimator):
    """Fits the closed-form model to every sample, from the middle of the parameters' ranges."""

    name = "fit"
    takes_steps = False

    def estimate(self, problem: Problem, rollouts: int) -> Trace:  # noqa: ARG002 (needs none)
        """No rollout; see `Estimator.estimate`."""
        trace = fitted(Trace((Step(problem.initial, problem.rollouts),)), problem)
        if trace.fit is None:
            raise NotFoundError("the log shows too little for the exact fit; try --method tunenet")
        return trace


class TuneNetThenFit(TuneNet):
    """TuneNet's steps, then the exact fit from where they end."""

    name = "tunenet+refine"

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """All rollouts are the network's; see `Estimator.estimate`."""
        trace = fitted(super().estimate(problem, rollouts), problem)
        return trace if trace.fit is not None else replace(trace, method=TuneNet.name)


def residual_of(model: Model, problem: Problem, simulated: Array, target: Array) -> Array:
    """What the network adds to the parameters, shape (P,), of two observations of shape (L, C)."""
    found = model(simulated[None], target[None])[0]
    return found[: len(problem.parameters)] * problem.residual_units


def fitted(trace: Trace, problem: Problem) -> Trace:
    """A trace that goes on to the exact fit near its estimate; the same where the fit fails.

    Raises:
        NotFoundError: the problem has no exact fit.
    """
    if problem.exact_fit is None:
        raise NotFoundError("no exact fit exists under this preset; use --method tunenet")
    fit = problem.exact_fit(trace.estimate)
    if fit is None:
        return trace
    on_the_way = [
        Step(values[: len(fit.values)], problem.rollouts) for values in _thinned(fit.path[1:-1])
    ]
    return Trace((*trace.steps, *on_the_way, Step(fit.values, problem.rollouts)), fit)


def _thinned(path: tuple[Array, ...]) -> tuple[Array, ...]:
    """A few of the values on the way of a fit, in their order."""
    return path[:: len(path) // _MOST_SHOWN + 1]
