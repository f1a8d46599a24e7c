"""Least squares with normal priors, whose scales the samples themselves decide on.

A group of terms (all joints' offsets, say) may be absent, as large as usual, or larger. Each
combination is a model whose evidence is Gaussian, in closed form (type II maximum likelihood,
MacKay 1992). The answer is their Bayesian model average (Hoeting et al. 1999): what samples cannot
tell widens it, and what is not there costs nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array

_LEAST_WEIGHT = 1e-4
"""Models with less posterior probability are left out: they change no digit that is shown."""

_BATCH = 128
"""Models that are solved at once: many enough for numpy to be fast, few enough for memory."""


@dataclass(frozen=True)
class Level:
    """How large a group of terms may be.

    Attributes:
        scale: of its priors' standard deviations; 0 where it is absent.
        weight: prior probability; those of a group add up to 1.
    """

    scale: float
    weight: float


@dataclass(frozen=True)
class Ideal:
    """That none of some groups is there, as in a simulation.

    Attributes:
        groups: which.
        weight: prior probability.
    """

    groups: tuple[str, ...]
    weight: float


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """What weighted samples say of linear terms: all that least squares needs of them.

    Attributes:
        precision: slopes' sum of squares A^T W A, shape (N, N).
        gradient: A^T W y, of the log likelihood at 0, shape (N,).
    """

    precision: Array
    gradient: Array


@dataclass(frozen=True, eq=False)
class WeightedModel:
    """One combination of levels.

    Attributes:
        levels: scale of each group.
        weight: posterior probability; those of all models add up to 1.
        means: of all terms, shape (N,).
        covariance: of the terms of interest, shape (I, I).
    """

    levels: Mapping[str, float]
    weight: float
    means: Array
    covariance: Array


def posterior(normal: NormalEquations, sds: Array) -> tuple[Array, Array]:
    """Means and covariance of the terms under priors of these standard deviations, shape (N,).

    Solved in units of the priors, so that a prior of width 0 is no special case.
    """
    inner = np.eye(len(sds)) + sds[:, None] * normal.precision * sds
    covariance = sds[:, None] * np.linalg.inv(inner) * sds
    return covariance @ normal.gradient, covariance


def weighted_models(
    normal: NormalEquations,
    sds: Array,
    groups: Mapping[str, NDArray[np.int64]],
    levels: Mapping[str, Sequence[Level]],
    interest: NDArray[np.int64],
    ideal: Ideal | None = None,
) -> tuple[WeightedModel, ...]:
    """Every combination of levels that matters, the likeliest first.

    Args:
        normal: the samples.
        sds: priors at scale 1, shape (N,).
        groups: indices of the terms of each.
        levels: of each group.
        interest: indices of the terms whose covariance is wanted, shape (I,).
        ideal: groups that may be absent together.
    """
    count, names = len(sds), tuple(levels)
    right_sides = np.concatenate([normal.gradient[:, None], np.eye(count)[:, interest]], axis=1)
    combinations = list(product(*(levels[name] for name in names)))
    log_weights = np.empty(len(combinations))
    means = np.empty((len(combinations), count))
    covariances = np.empty((len(combinations), len(interest), len(interest)))
    for first in range(0, len(combinations), _BATCH):
        batch = slice(first, first + _BATCH)
        scaled = np.tile(sds, (len(combinations[batch]), 1))
        for position, name in enumerate(names):
            scales = np.array([levels_of[position].scale for levels_of in combinations[batch]])
            scaled[:, groups[name]] *= scales[:, None]
        inner = np.eye(count) + scaled[:, :, None] * normal.precision * scaled[:, None, :]
        solved = np.linalg.solve(inner, scaled[:, :, None] * right_sides)
        solved = scaled[:, :, None] * solved
        means[batch], covariances[batch] = solved[:, :, 0], solved[:, interest, 1:]
        log_dets = np.linalg.slogdet(inner)[1]
        # The exact Gaussian evidence, up to what all models share.
        log_weights[batch] = 0.5 * solved[:, :, 0] @ normal.gradient - 0.5 * log_dets
    choices = [dict(zip(names, levels_of, strict=True)) for levels_of in combinations]
    log_weights += [_log_prior(choice, ideal) for choice in choices]
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    order = [index for index in np.argsort(-weights) if weights[index] > _LEAST_WEIGHT]
    total = float(weights[order].sum())
    return tuple(
        WeightedModel(
            {name: level.scale for name, level in choices[index].items()},
            float(weights[index]) / total,
            means[index],
            covariances[index],
        )
        for index in order
    )


def _log_prior(choice: Mapping[str, Level], ideal: Ideal | None) -> float:
    """Of a combination: a mixture of the ideal one and of groups that are independent."""
    if ideal is None:
        return float(np.log([level.weight for level in choice.values()]).sum())
    linked = [choice[name] for name in ideal.groups if name in choice]
    others = [level.weight for name, level in choice.items() if name not in ideal.groups]
    absent = ideal.weight * all(level.scale == 0 for level in linked)
    independent = (1 - ideal.weight) * float(np.prod([level.weight for level in linked]))
    return float(np.log(others).sum() + np.log(absent + independent))
