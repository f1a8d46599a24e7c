"""Tree-structured Parzen estimator (Bergstra et al. 2011): a baseline."""

from __future__ import annotations

import numpy as np

from analysis.estimators.base import Estimator, Problem, Setup, Trace
from analysis.estimators.search import Search
from analysis.optional_dependencies import needed


class Tpe(Estimator):
    """optuna's TPE sampler on the cost, over the ranges, the initial guess first.

    Args:
        seed: Of its sampling.
    """

    name = "tpe"

    def __init__(self, seed: int) -> None:
        self._seed = seed

    @classmethod
    def build(cls, setup: Setup) -> Tpe:
        """See `Estimator.build`."""
        return cls(setup.seed)

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Return the best rollout so far; see `Estimator.estimate`."""
        search = Search(problem, rollouts)
        return search.run(lambda: self._optimize(search, problem))

    def _optimize(self, search: Search, problem: Problem) -> None:
        optuna = needed("optuna")

        optuna.logging.set_verbosity(optuna.logging.WARNING)
        study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=self._seed))
        names = [one.name for one in problem.searched]
        study.enqueue_trial(dict(zip(names, problem.start.tolist(), strict=True)))
        while search.left:
            trial = study.ask()
            values = [
                trial.suggest_float(name, low, high)
                for name, (low, high) in zip(names, problem.ranges.tolist(), strict=True)
            ]
            study.tell(trial, search.cost(np.array(values)))
