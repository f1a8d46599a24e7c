"""Answer with the best of the points visited by another method."""

from __future__ import annotations

import numpy as np

from analysis.estimators.base import Estimator, Problem, Step, Trace


class BestVisited(Estimator):
    """Another method's iterates, each judged by its own rollout; the last, unjudged one is left.

    Where noise lets a step lead away, the misfit of its rollout says so, and costs nothing: it was
    made anyway.
    """

    def __init__(self, method: Estimator) -> None:
        self._method = method
        self.name = f"best visited by {method.name}"

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """See `Estimator.estimate`."""
        least = np.inf
        steps = [Step(problem.initial, 0)]
        for step in self._method.estimate(problem, rollouts).steps:
            if step.evaluation is None:
                continue
            cost = float(np.linalg.norm(problem.misfit(step.evaluation)))
            if cost < least:
                least = cost
                judged = min(step.rollouts + 1, problem.rollouts)
                steps.append(Step(step.values, judged, step.evaluation))
        return Trace(tuple(steps))
