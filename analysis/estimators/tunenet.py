"""Iterative residual tuning: algorithm 1 of Allevato et al. 2019."""

from __future__ import annotations

from analysis.estimators.base import Problem, Step, Trace
from analysis.tunenet.network import Model


class TuneNet:
    """Adds the network's estimate of the parameter residual, K times (eq. 5), within bounds.

    Resample is part of the observations: both functions give them on the same axis.
    """

    name = "tunenet"

    def __init__(self, model: Model) -> None:
        self._model = model

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """One rollout an iteration; see `Estimator.estimate`."""
        values = problem.initial
        steps: list[Step] = []
        for _ in range(rollouts):
            spent = problem.rollouts
            evaluation = problem.evaluate(values)
            steps.append(Step(values, spent, evaluation))
            residual = self._model(
                evaluation.observation.values[None], problem.target.values[None]
            )[0]
            values = problem.clamp(values + residual)
        steps.append(Step(values, problem.rollouts))
        return Trace(tuple(steps))
