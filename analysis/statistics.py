"""Statistics that every fit shares: noise, correlation, and the average of several models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tunenet_logs.arrays import Array

TWO_SIDED = 1.96
"""Standard deviations of a normal distribution to either end of its 95 % interval."""

_USUAL_SDS, _TRIMMED = 3.0, 1.0137
"""Standard deviations beyond which a third difference is an impact's, and by how much what is left
of a normal distribution is narrower."""

_NOTHING = 1e-12
"""Weight in a mixture that moves no quantile."""

_TAILS = (0.025, 0.975)
"""Probabilities at the ends of a 95 % interval."""


@dataclass(frozen=True)
class ModelEstimate:
    """One model's.

    Attributes:
        middle: the value.
        sds: standard deviations to below and above.
        weight: of the model, beside those of the others: they need not add up to 1.
    """

    middle: float
    sds: tuple[float, float]
    weight: float


def average(
    estimates: Sequence[ModelEstimate], least: float = 0.0, most: float = 1.0
) -> tuple[float, tuple[float, float]]:
    """Bayesian model averaging (Hoeting et al. 1999) of normal distributions.

    Args:
        estimates: one a model.
        least: smallest value that physics allows.
        most: largest.

    Returns:
        The mean, and the 95 % interval of the mixture, both within `least` and `most`.
    """
    from scipy.optimize import brentq
    from scipy.special import ndtr

    weights = np.array([estimate.weight for estimate in estimates])
    weights /= weights.sum()
    middles = np.array([estimate.middle for estimate in estimates])
    total = sum(estimate.weight for estimate in estimates)
    mean = sum(estimate.weight * estimate.middle for estimate in estimates) / total
    mean = float(np.clip(mean, least, most))
    ends: list[float] = []
    for side, tail in enumerate(_TAILS):
        sds = np.array([estimate.sds[side] for estimate in estimates])
        low, high = float(np.min(middles - 9 * sds)), float(np.max(middles + 9 * sds))
        end: Any = brentq(
            lambda value, sds=sds, tail=tail: float(weights @ ndtr((value - middles) / sds)) - tail,
            low,
            high,
            xtol=1e-9,
        )
        ends.append(float(end))
    return mean, (min(max(ends[0], least), mean), max(min(ends[1], most), mean))


def correlation_time(residuals: Array, unknowns: int) -> float:
    """How many neighbouring samples carry as much as one: 1 for white noise, more for smoothed.

    The integrated autocorrelation time up to the first lag within chance, or that of a first-order
    autoregression where that is longer.

    Args:
        residuals: of a fit, in order, shape (T,).
        unknowns: how many were fitted: that takes some of the correlation away.
    """
    count, power = len(residuals), float(residuals @ residuals)
    if not power:
        return 1.0
    lags = [float(residuals[lag:] @ residuals[:-lag]) / power for lag in range(1, count // 4)]
    chance = 2 / np.sqrt(count)
    if not lags or lags[0] < chance:
        return 1.0
    lasting = next((lag for lag, value in enumerate(lags) if value < chance), len(lags))
    first = min(lags[0] + unknowns * (1 + lags[0]) / count, 0.98)
    return max(1 + 2 * sum(lags[:lasting]), (1 + first) / (1 - first) if lasting > 2 else 1.0)


def noise_of(heights: Array) -> float:
    """Standard deviation of the noise of heights, shape (T,), in their unit.

    By third differences, which a parabola does not have: sqrt(20) is what they make of white noise,
    .6745 the median of a normal distribution's modulus.
    """
    return float(np.median(np.abs(np.diff(heights, 3)))) / (0.6745 * np.sqrt(20.0))


def surer_noise_of(heights: Array) -> float:
    """The same by the mean square of those third differences that are no impact's.

    It takes a third of the samples for the same certainty.
    """
    bends = np.diff(heights, 3) / np.sqrt(20.0)
    usual = noise_of(heights)
    noise = bends[np.abs(bends) <= _USUAL_SDS * usual]
    if not len(noise):
        return usual
    return float(np.sqrt(np.mean(noise**2))) * _TRIMMED


def mixture_quantile(probability: float, middles: Array, sds: Array, weights: Array) -> float:
    """Of a mixture of normal distributions.

    Args:
        probability: from 0 to 1.
        middles: shape (M,).
        sds: standard deviations, shape (M,).
        weights: adding up to 1, shape (M,).
    """
    from scipy.optimize import brentq
    from scipy.special import ndtr

    heavy = weights > _NOTHING
    middles, sds, weights = middles[heavy], sds[heavy], weights[heavy] / weights[heavy].sum()
    low, high = float((middles - 9 * sds).min()), float((middles + 9 * sds).max())
    end: Any = brentq(
        lambda value: float(weights @ ndtr((value - middles) / sds)) - probability,
        low,
        high,
        xtol=1e-9,
    )
    return float(end)
