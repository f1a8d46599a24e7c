"""What every search by trial has in common: a cost, a budget, the best place so far."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from analysis.estimators.base import Problem, Step, Trace

Array = NDArray[np.float64]


class _Spent(Exception):  # noqa: N818 (it ends a search; nothing is wrong)
    """No rollout is left."""


class Search:
    """Rollouts of one problem, each charged, the best of them kept as the answer.

    An optimizer of somebody else's calls `cost` or `misfit` as it likes; `run` ends it when the
    budget is spent.

    Args:
        problem: what to match.
        rollouts: most rollouts to spend.
    """

    def __init__(self, problem: Problem, rollouts: int) -> None:
        self._problem = problem
        self._rollouts = rollouts
        self._least = np.inf
        self._steps = [Step(problem.initial, 0)]

    def run(self, optimize: Callable[[], object]) -> Trace:
        """Let an optimizer search until it is done or the budget is spent."""
        with suppress(_Spent):
            optimize()
        return Trace(tuple(self._steps))

    @property
    def spent(self) -> int:
        """Rollouts so far."""
        return self._problem.rollouts

    def misfit(self, values: Array) -> Array:
        """See `Problem.misfit`, at `values` of shape (P,)."""
        if self._problem.rollouts >= self._rollouts:
            raise _Spent
        values = self._problem.clamp(np.atleast_1d(np.asarray(values, dtype=np.float64)))
        look = self._problem.look(values)
        misfit = self._problem.misfit(look)
        cost = float(np.linalg.norm(misfit))
        if cost < self._least:
            self._least = cost
            self._steps.append(Step(values, self._problem.rollouts, look))
        return misfit

    def cost(self, values: Array) -> float:
        """The L2 norm of the misfit at `values`."""
        return float(np.linalg.norm(self.misfit(values)))
