"""Iterative residual tuning: algorithm 1 of Allevato et al. 2019."""

from __future__ import annotations

from analysis.estimators.base import Estimator, Problem, Setup, Step, Trace
from analysis.tunenet.network import Model


class TuneNet(Estimator):
    """Adds the network's estimate of the parameter residual, K times (eq. 5), within bounds.

    Resample is part of the observations: both functions give them on the same axis.
    """

    name = "tunenet"
    uses_network = True

    def __init__(self, model: Model) -> None:
        self._model = model

    @classmethod
    def build(cls, setup: Setup) -> TuneNet:
        """See `Estimator.build`."""
        assert setup.model is not None
        return cls(setup.model)

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """One rollout an iteration; see `Estimator.estimate`."""
        values = problem.initial
        steps: list[Step] = []
        for _ in range(rollouts):
            spent = problem.rollouts
            evaluation = problem.evaluate(values)
            steps.append(Step(values, spent, evaluation))
            simulated, target = evaluation.observation.values, problem.target.values
            residual = self._model(simulated[None], target[None])[0]
            values = problem.clamp(values + residual)
        steps.append(Step(values, problem.rollouts))
        return Trace(tuple(steps))
