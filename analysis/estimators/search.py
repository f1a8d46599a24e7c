"""Budgeted black-box search: cost, rollout budget, best value so far."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from analysis.estimators.base import Evaluation, Problem, Step, Trace
from recorders.simulators.base import Parameter
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError


class _Spent(Exception):  # noqa: N818 (it ends a search; nothing is wrong)
    """No rollout is left."""


class Search:
    """Rollouts of one problem, each charged to a budget, with the best of them or the last answer.

    An external optimizer calls `cost` or `misfit` freely; `run` ends it when the budget is spent.

    Args:
        problem: The problem to match.
        rollouts: Maximum number of rollouts.
        keep_best: Whether the answer is the best rollout; else the last one given to `answer`.
        least: Smallest cost of earlier rollouts.
    """

    def __init__(
        self, problem: Problem, rollouts: int, *, keep_best: bool = True, least: float = np.inf
    ) -> None:
        self._problem = problem
        self._rollouts = rollouts
        self._keep_best = keep_best
        self._least = least
        self._steps = [Step(problem.initial, 0)]

    def run(self, optimize: Callable[[], object]) -> Trace:
        """Run an optimizer until it is done or the budget is spent."""
        with suppress(_Spent):
            optimize()
        return Trace(tuple(self._steps))

    @property
    def spent(self) -> int:
        """Number of rollouts so far."""
        return self._problem.rollouts

    @property
    def left(self) -> int:
        """Number of rollouts left."""
        return max(0, self._rollouts - self._problem.rollouts)

    @property
    def least(self) -> float:
        """Smallest cost so far; infinite before the first rollout."""
        return self._least

    def evaluate(self, values: Array) -> Evaluation:
        """See `Problem.evaluate`, at the nearest values to `values` within bounds."""
        if not self.left:
            raise _Spent
        values = self._problem.clamp(np.atleast_1d(np.asarray(values, dtype=np.float64)))
        evaluation = self._problem.evaluate(values)
        cost = float(np.linalg.norm(self._problem.misfit(evaluation)))
        if cost < self._least:
            self._least = cost
            if self._keep_best:
                own = values[: len(self._problem.parameters)]
                self._steps.append(Step(own, self._problem.rollouts, evaluation))
        return evaluation

    def misfit(self, values: Array) -> Array:
        """Return `Problem.misfit` at `values` of shape (P,) or (S,)."""
        return self._problem.misfit(self.evaluate(values))

    def cost(self, values: Array) -> float:
        """Return the L2 norm of the residual at `values`."""
        return float(np.linalg.norm(self.misfit(values)))

    def answer(self, values: Array) -> None:
        """Append the optimizer's present answer, shape (P,), to the trace if it is new."""
        values = self._problem.clamp(np.atleast_1d(np.asarray(values, dtype=np.float64)))
        if not np.array_equal(values, self._steps[-1].values):
            self._steps.append(Step(values, self._problem.rollouts))


def check_one_parameter(problem: Problem, method: str) -> Parameter:
    """Return the problem's only parameter.

    Raises:
        NotFoundError: It has several.
    """
    if len(problem.parameters) != 1:
        names = ", ".join(parameter.name for parameter in problem.parameters)
        what = f"the method {method} is for one parameter, not for {names}"
        raise NotFoundError(what, "leave --method out, or choose fit")
    return problem.parameters[0]
