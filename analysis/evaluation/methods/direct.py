"""Predict the parameters directly: the network sees the target alone."""

from __future__ import annotations

import numpy as np

from analysis.estimators.base import Estimator, Problem, Step, Trace
from analysis.tunenet.network import Model
from analysis.tunenet.pairs import PairSet


class Direct(Estimator):
    """Paper's network with its proposed input zeroed, so that its output is the parameter.

    "Zeroed" is meant before the scaling. With the raw scaling of the preset `paper-code`, which the
    paper's authors use for it, the network sees exact zeros. With another one it sees a constant,
    which its first layer's bias absorbs.
    """

    name = "direct"

    def __init__(self, model: Model) -> None:
        self._model = model

    def estimate(self, problem: Problem, rollouts: int) -> Trace:  # noqa: ARG002 (needs none)
        """Predict without a rollout; see `Estimator.estimate`."""
        target = problem.target.values[None]
        found = self._model(np.zeros_like(target), target)[0]
        return Trace((Step(problem.clamp(found), 0),))


def direct_pairs(pairs: PairSet) -> PairSet:
    """Pair each target with one observation of zeros whose parameters are 0.

    The residual of such a pair is the parameter itself, so training needs nothing of its own.
    """
    nothing = np.zeros_like(pairs.observations[:1])
    return PairSet(
        observations=np.concatenate([pairs.observations, nothing]),
        values=np.concatenate([pairs.values, np.zeros_like(pairs.values[:1])]),
        proposed=np.full_like(pairs.proposed, len(pairs.values)),
        target=pairs.target,
    )
