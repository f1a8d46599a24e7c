"""Train our networks for the second experiment: on the paper's budget, and calibrated.

Each height of release hits the plane at another phase of the engine's steps, which moves the
rebound by more than a network may err (docs/physics.md). When tuning, both sides have one height.
So rollouts are made in groups of one height, and pairs are drawn within them: as in the paper,
where each height has one pair; but here each rollout is in many.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from analysis.drop.presets import OUR_TRAINING, PAPER_HEIGHT_M, TRAININGS, observe_paper_drops
from analysis.tunenet.network import AntisymmetricNetwork, Model
from analysis.tunenet.pairs import PairSet
from analysis.tunenet.training import train
from recorders.simulators.drop import RESTITUTION
from tunenet_logs.terminal import Progress

HEIGHTS = 160
RESTITUTIONS = 10  # 1600 rollouts, as many as the paper's 800 pairs take
_PAIRS = 51_200  # drawn from those rollouts: each is in many
# Fraction of the pairs that are neighbours in restitution: fine corrections are learnt too.
_NEAR_SHARE = 0.3

_NOISE_M = 0.02  # of training: twice that of the noisy cells
_TRAINING = replace(OUR_TRAINING, noise=_NOISE_M, cut_share=0.0)


def train_on_papers(
    seed: int, jobs: int | None, progress: Progress, epochs: int | None = None
) -> Model:
    """Train our network on the paper's simulator; `epochs` in place of the recipe's."""
    pairs = grouped_pairs(seed, jobs, progress)
    recipe = replace(_TRAINING, epochs=epochs or _TRAINING.epochs)
    return train(AntisymmetricNetwork(), pairs, recipe, seed, progress)


def train_on_calibrated(
    seed: int, jobs: int | None, progress: Progress, epochs: int | None = None
) -> Model:
    """Train what the package ships (preset `default`), with another seed."""
    ours = TRAININGS["default"]
    recipe = replace(ours.recipe, epochs=epochs or ours.recipe.epochs)
    return train(ours.network, ours.make_pairs(None, seed, jobs, progress), recipe, seed, progress)


def grouped_pairs(seed: int, jobs: int | None, progress: Progress) -> PairSet:
    """Simulate pairs within groups of one height; restitutions uniform over [0, 1] in each."""
    rng = np.random.default_rng(seed)
    low, high = RESTITUTION.training_range
    heights = np.repeat(rng.uniform(*PAPER_HEIGHT_M, HEIGHTS), RESTITUTIONS)
    ranks = np.tile(np.arange(RESTITUTIONS), HEIGHTS)
    values = low + (high - low) * (ranks + rng.random(len(ranks))) / RESTITUTIONS
    observations = observe_paper_drops(heights, values, jobs, progress)
    return PairSet(observations, values[:, None], *_pairs_within_groups(rng))


def _pairs_within_groups(
    rng: np.random.Generator,
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Draw any two of a group, and some that are neighbours in restitution."""
    first_of_group = RESTITUTIONS * rng.integers(HEIGHTS, size=_PAIRS)
    proposed, anywhere = rng.integers(RESTITUTIONS, size=(2, _PAIRS))
    beside = np.clip(proposed + rng.choice([-1, 1], _PAIRS), 0, RESTITUTIONS - 1)
    target = np.where(rng.random(_PAIRS) < _NEAR_SHARE, beside, anywhere)
    return first_of_group + proposed, first_of_group + target
