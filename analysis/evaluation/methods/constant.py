"""Answer with one value for every target: what any method has to beat."""

from __future__ import annotations

import numpy as np

from analysis.estimators.base import Estimator, Problem, Step, Trace


class Constant(Estimator):
    """Constant answer, without a rollout.

    The Mean of the paper's table 2 is given the mean of the test set's targets, which no method
    that has to find them could know.

    Args:
        value: of the problem's only parameter.
        name: what it is called.
    """

    def __init__(self, value: float, name: str = "mean") -> None:
        self._value = value
        self.name = name

    def estimate(self, problem: Problem, rollouts: int) -> Trace:  # noqa: ARG002 (needs none)
        """Answer without a rollout; see `Estimator.estimate`."""
        return Trace((Step(problem.clamp(np.array([self._value])), 0),))
