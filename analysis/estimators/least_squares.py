"""Least squares from many starts: what a user tries who has heard of local minima."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from analysis.estimators.base import Estimator, Problem, Trace
from analysis.estimators.search import Search
from tunenet_logs.arrays import Array


class LeastSquares(Estimator):
    """scipy's trust-region least squares on the misfit, from one start after another.

    The first start is the initial guess; the others spread evenly over the ranges. Rollouts for
    derivatives are charged like any other.

    Args:
        step: of the finite differences, relative to a parameter's size. A narrow one measures the
            slope of the local minimum it lies in, one of dozens; one wider than those measures the
            slope of what they ride on, which leads further.
    """

    name = "least-squares"

    def __init__(self, step: float = 0.06) -> None:
        self._step = step

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """The best place so far; see `Estimator.estimate`."""
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
    """The first one, then 1/2, 1/4, 3/4, 1/8, ... of the way from low to high, without end."""
    yield first
    low, high = ranges.T
    index = 1
    while True:
        yield low + (high - low) * _reversed_bits(index)
        index += 1


def _reversed_bits(index: int) -> float:
    """The bits of an index mirrored at the point: 1, 2, 3, ... gives 1/2, 1/4, 3/4, ..."""
    value, share = 0.0, 0.5
    while index:
        value += share * (index & 1)
        index, share = index >> 1, share / 2
    return value
