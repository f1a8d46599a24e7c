"""Multi-start trust-region least squares: a baseline."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from analysis.estimators.base import Estimator, Problem, Trace
from analysis.estimators.search import Search
from tunenet_logs.arrays import Array


class LeastSquares(Estimator):
    """Trust-region reflective least squares (scipy) on the residual, from one start after another.

    The first start is the initial guess; the others spread evenly over the ranges. Rollouts for
    derivatives are charged like any other.

    Args:
        step: Relative step of the finite differences. A narrow one measures the slope of the local
            minimum it lies in, one of dozens; one wider than those measures the underlying slope,
            which leads further.
    """

    name = "least-squares"

    def __init__(self, step: float = 0.06) -> None:
        self._step = step

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Return the best rollout so far; see `Estimator.estimate`."""
        search = Search(problem, rollouts)
        return search.run(lambda: self._optimize(search, problem))

    def _optimize(self, search: Search, problem: Problem) -> None:
        from scipy.optimize import least_squares

        bounds = np.array([one.bounds for one in problem.searched]).T
        for start in _starts(problem.start, problem.ranges):
            least_squares(search.misfit, start, bounds=tuple(bounds), diff_step=self._step)
            if search.least == 0:
                return


def _starts(first: Array, ranges: Array) -> Iterator[Array]:
    """Yield the first start, then 1/2, 1/4, 3/4, 1/8, ... of the ranges (van der Corput)."""
    yield first
    low, high = ranges.T
    index = 1
    while True:
        yield low + (high - low) * _reversed_bits(index)
        index += 1


def _reversed_bits(index: int) -> float:
    """Return the van der Corput radical inverse in base 2: 1, 2, 3 gives 1/2, 1/4, 3/4."""
    value, share = 0.0, 0.5
    while index:
        value += share * (index & 1)
        index, share = index >> 1, share / 2
    return value
