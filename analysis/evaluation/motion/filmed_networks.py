"""Train networks for the paper's drops before its cameras, on the paper's budget.

The 1600 rollouts of `our_networks`, in groups of one height. In each pair the target is filmed by a
camera of its own, drawn as the paper draws it, and the other rollout is what it would look like to
the camera that suits it most: what is left between the two is not the camera's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.drop import observations as views
from analysis.drop.film_presets import TRAININGS, paper_rows
from analysis.drop.presets import OUR_TRAINING
from analysis.evaluation.drop.our_networks import grouped_pairs
from analysis.evaluation.motion.filmed_targets import as_seen, places_in_view
from analysis.tunenet.network import AntisymmetricNetwork, Model
from analysis.tunenet.pairs import PairSet, consecutive_pairs, observe_all
from analysis.tunenet.training import train
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress

_TRAINING = replace(OUR_TRAINING, weight_decay=0.1, cut_share=0.0)


def train_papers_on_films(
    seed: int,
    jobs: int | None,
    progress: Progress,
    pairs: int | None = None,
    epochs: int | None = None,
) -> Model:
    """Train the paper's network by its text; `pairs` and `epochs` override the preset."""
    paper = TRAININGS["paper"]
    recipe = replace(paper.recipe, epochs=epochs or paper.recipe.epochs)
    return train(
        paper.network, paper.make_pairs(pairs, seed, jobs, progress), recipe, seed, progress
    )


def train_ours_on_films(
    seed: int,
    jobs: int | None,
    progress: Progress,
    pairs: int | None = None,
    epochs: int | None = None,
) -> Model:
    """Train ours; `pairs` and `epochs` override the recipe, to try things."""
    recipe = replace(_TRAINING, epochs=epochs or _TRAINING.epochs)
    data = filmed_pairs(pairs, seed, jobs, progress)
    return train(AntisymmetricNetwork(), data, recipe, seed, progress)


@dataclass(frozen=True, eq=False)
class _Take:
    """Pair to film: heights of the ball's centre [m], each of shape (T,); the camera's seed."""

    proposed_m: Array
    target_m: Array
    seed: int


def filmed_pairs(count: int | None, seed: int, jobs: int | None, progress: Progress) -> PairSet:
    """Film pairs as `FilmedProblems.pose_ours` does; `count` None for all of `grouped_pairs`."""
    pairs = grouped_pairs(seed, jobs, progress)
    rng = np.random.default_rng([seed, 2])
    chosen = slice(count)
    proposed, target = pairs.proposed[chosen], pairs.target[chosen]
    heights_m = pairs.observations[:, :, 0]
    cameras = rng.integers(2**62, size=len(target))
    takes = [
        _Take(heights_m[one], heights_m[other], int(camera))
        for one, other, camera in zip(proposed, target, cameras, strict=True)
    ]
    curves = observe_all(_film, takes, jobs, progress)
    values = np.stack([pairs.values[proposed], pairs.values[target]], axis=1)
    return PairSet(
        curves.reshape(2 * len(takes), -1, 1), values.reshape(-1, 1), *consecutive_pairs(len(takes))
    )


def _film(takes: Sequence[_Take]) -> NDArray[Any]:
    """Film both sides of each pair, shape (N, 2, T), in float32 to halve the memory."""
    return np.array([_both(take) for take in takes], dtype=np.float32)


def _both(take: _Take) -> tuple[Array, Array]:
    positions_m = np.zeros((len(take.target_m), 3))
    positions_m[:, 2] = take.target_m
    seen = places_in_view(paper_rows(positions_m, np.random.default_rng(take.seed)))
    drop_m = take.proposed_m - views.PAPER_RADIUS_M
    return as_seen(drop_m / drop_m.max(), seen), seen
