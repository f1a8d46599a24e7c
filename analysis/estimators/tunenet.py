"""Iterative residual tuning (algorithm 1 of Allevato et al. 2019), and the exact fit after it."""

from __future__ import annotations

from dataclasses import replace

from analysis.estimators.base import Estimator, Problem, Setup, Step, Trace
from analysis.tunenet.network import Model
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError

_MAX_SHOWN = 5  # steps of a fit that goes step by step, of which each has a rollout to be shown


class TuneNet(Estimator):
    """Iterative residual tuning: K times the network's estimate of the residual (eq. 5), in bounds.

    Resample is part of the observations, which share one axis.
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
        """Spend one rollout per iteration; see `Estimator.estimate`."""
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


def residual_of(model: Model, problem: Problem, simulated: Array, target: Array) -> Array:
    """Predict the parameter residual, shape (P,), from two observations of shape (L, C)."""
    found = model(simulated[None], target[None])[0]
    return found[: len(problem.parameters)] * problem.residual_units


def fitted(trace: Trace, problem: Problem) -> Trace:
    """Append the exact fit near its estimate to a trace; return the trace itself if the fit fails.

    Raises:
        NotFoundError: The problem has no exact fit.
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
    """Decimate the iterates of a fit."""
    return path[:: len(path) // _MAX_SHOWN + 1]
