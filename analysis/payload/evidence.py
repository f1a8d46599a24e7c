"""Least squares with normal priors, whose scales the samples themselves decide on.

A group of terms (all joints' offsets, say) may be absent, as large as usual, or larger. Each
combination is a model with an evidence in closed form (type II maximum likelihood, MacKay 1992);
the answer is the average of all, so what samples cannot tell widens it, and what is not there costs
nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array

_LEAST_WEIGHT = 1e-4
_AT_ONCE = 128


@dataclass(frozen=True)
class Level:
    """How large a group of terms may be.

    Attributes:
        scale: of its priors' standard deviations; 0 where it is absent.
        weight: before the samples are looked at; those of a group add up to 1.
    """

    scale: float
    weight: float


@dataclass(frozen=True)
class Ideal:
    """That none of some groups is there, as in a simulation.

    Attributes:
        groups: which.
        weight: how likely that is before the samples are looked at.
    """

    groups: tuple[str, ...]
    weight: float


@dataclass(frozen=True, eq=False)
class Normal:
    """What weighted samples say of linear terms: all that least squares needs of them.

    Attributes:
        precision: shape (N, N).
        pull: shape (N,).
    """

    precision: Array
    pull: Array


@dataclass(frozen=True, eq=False)
class Model:
    """One combination of levels.

    Attributes:
        levels: scale of each group.
        weight: after the samples; those of all models add up to 1.
        means: of all terms, shape (N,).
        watched: covariance of the terms that are asked for, shape (W, W).
    """

    levels: Mapping[str, float]
    weight: float
    means: Array
    watched: Array


def posterior(normal: Normal, sds: Array) -> tuple[Array, Array]:
    """Means and covariance of the terms under priors of these standard deviations, shape (N,)."""
    inner = np.eye(len(sds)) + sds[:, None] * normal.precision * sds
    covariance = sds[:, None] * np.linalg.inv(inner) * sds
    return covariance @ normal.pull, covariance


def weighed_models(
    normal: Normal,
    sds: Array,
    groups: Mapping[str, NDArray[np.int64]],
    levels: Mapping[str, Sequence[Level]],
    watched: NDArray[np.int64],
    ideal: Ideal | None = None,
) -> tuple[Model, ...]:
    """Every combination of levels that matters, the likeliest first.

    Args:
        normal: the samples.
        sds: priors at scale 1, shape (N,).
        groups: places of the terms of each.
        levels: of each group.
        watched: terms whose covariance is asked for.
        ideal: groups that may be absent together.
    """
    names = tuple(levels)
    combined = list(product(*(levels[name] for name in names)))
    log_weights = np.empty(len(combined))
    means = np.empty((len(combined), len(sds)))
    covariances = np.empty((len(combined), len(watched), len(watched)))
    for first in range(0, len(combined), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        scaled = np.tile(sds, (len(combined[some]), 1))
        for at, name in enumerate(names):
            scaled[:, groups[name]] *= np.array([one[at].scale for one in combined[some]])[:, None]
        found = _solved(normal, scaled, watched)
        means[some], covariances[some], log_weights[some] = found
    log_weights += [_log_prior(dict(zip(names, one, strict=True)), ideal) for one in combined]
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    order = [at for at in np.argsort(-weights) if weights[at] > _LEAST_WEIGHT]
    total = float(weights[order].sum())
    return tuple(
        Model(
            {name: level.scale for name, level in zip(names, combined[at], strict=True)},
            float(weights[at]) / total,
            means[at],
            covariances[at],
        )
        for at in order
    )


def _solved(normal: Normal, sds: Array, watched: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """Means, watched covariances and log evidences under priors of shape (M, N)."""
    count = sds.shape[1]
    inner = np.eye(count) + sds[:, :, None] * normal.precision * sds[:, None, :]
    asked = np.concatenate([normal.pull[:, None], np.eye(count)[:, watched]], axis=1)
    solved = sds[:, :, None] * np.linalg.solve(inner, sds[:, :, None] * asked)
    log_dets = np.linalg.slogdet(inner)[1]
    means = solved[:, :, 0]
    return means, solved[:, watched, 1:], 0.5 * means @ normal.pull - 0.5 * log_dets


def _log_prior(choice: Mapping[str, Level], ideal: Ideal | None) -> float:
    if ideal is None:
        return float(np.log([one.weight for one in choice.values()]).sum())
    linked = [choice[name] for name in ideal.groups if name in choice]
    apart = [one.weight for name, one in choice.items() if name not in ideal.groups]
    absent = ideal.weight * all(one.scale == 0 for one in linked)
    each = (1 - ideal.weight) * float(np.prod([one.weight for one in linked]))
    return float(np.log(apart).sum() + np.log(absent + each))
