"""CMA-ES (Hansen 2016) with the parameters scaled to their ranges: a baseline."""

from __future__ import annotations

import numpy as np

from analysis.estimators.base import Estimator, Problem, Setup, Trace
from analysis.estimators.search import Search
from analysis.optional_dependencies import needed

_SIGMA = 0.3  # of each range, around the initial guess
# Of pycma; one parameter gets a second coordinate beside it, on which nothing depends.
_MIN_DIMENSIONS = 2


class ScaledCmaEs(Estimator):
    """CMA-ES on the L2 norm of the residual, from the initial guess, which is evaluated first.

    Population size and bounds handling are pycma's. The answer is the best rollout; a budget's
    remainder is spent on part of a generation.

    Args:
        seed: Of its sampling.
    """

    name = "cma-es"

    def __init__(self, seed: int) -> None:
        self._seed = seed

    @classmethod
    def build(cls, setup: Setup) -> ScaledCmaEs:
        """See `Estimator.build`."""
        return cls(setup.seed)

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Return the best rollout so far; see `Estimator.estimate`."""
        search = Search(problem, rollouts)
        return search.run(lambda: self._optimize(search, problem))

    def _optimize(self, search: Search, problem: Problem) -> None:
        cma = needed("cma")

        count = len(problem.searched)
        rng = np.random.default_rng(self._seed)
        low, high = problem.ranges.T
        shares = np.full(max(count, _MIN_DIMENSIONS), 0.5)
        shares[:count] = (problem.start - low) / (high - low)
        options = {
            "bounds": [0.0, 1.0],
            "randn": lambda *shape: rng.standard_normal(shape),
            "seed": np.nan,  # numpy's own generator stays as it is
            "verbose": -9,
            "verb_log": 0,
        }
        search.cost(problem.start)
        strategy = cma.CMAEvolutionStrategy(shares, _SIGMA, options)
        while not strategy.stop():
            points = strategy.ask()
            values = [low + (high - low) * point[:count] for point in points]
            strategy.tell(points, [search.cost(one) for one in values])
