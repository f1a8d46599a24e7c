"""CMA-ES (Hansen 2016) by the set-up of the paper's table 2."""

from __future__ import annotations

from analysis.estimators.base import Estimator, Problem, Trace
from analysis.estimators.search import Search

_SIGMA = 0.1
_TOLERANCE = 0.1


class CmaEs(Estimator):
    """pycma on the L2 norm of the misfit, population 10, sigma 0.1, tolfun 0.1.

    It needs two parameters: the paper's authors let it look for the height of release as well,
    whose first guess is right. After each generation the answer is the distribution's mean, as they
    read it, and not the best place visited; before the first generation is complete it is the
    initial guess, and a budget's remainder that makes no generation is not spent. A point out of
    bounds costs what the nearest one within costs.

    The paper's columns for 1, 5 and 10 rollouts are all the value after the first generation.

    Args:
        seed: of its sampling.
        population: points in a generation.
    """

    name = "cma-es"

    def __init__(self, seed: int, population: int = 10) -> None:
        self._seed = seed
        self._population = population

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Run whole generations; see `Estimator.estimate`."""
        search = Search(problem, rollouts, keep_best=False)
        return search.run(lambda: self._optimize(search, problem))

    def _optimize(self, search: Search, problem: Problem) -> None:
        import cma

        options = {
            "popsize": self._population,
            "seed": self._seed + 1,  # pycma takes 0 as "by the clock"
            "tolfun": _TOLERANCE,
            "verbose": -9,
            "verb_log": 0,
        }
        strategy = cma.CMAEvolutionStrategy(problem.initial, _SIGMA, options)
        while search.left >= self._population and not strategy.stop():
            points = strategy.ask()
            strategy.tell(points, [search.cost(point) for point in points])
            search.answer(strategy.result.xfavorite)
