"""Statistics shared by all fits: noise, autocorrelation, and Bayesian model averaging."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tunenet_logs.episode import Array

TWO_SIDED = 1.96  # standard deviations of a normal distribution to either end of its 95 % interval
# Standard deviations beyond which a third difference is an impact's, and by how much what is left
# of a normal distribution is narrower.
_TYPICAL_SDS, _TRIMMED = 3.0, 1.0137

_NOTHING = 1e-12  # weight in a mixture that moves no quantile
_TAILS = (0.025, 0.975)  # probabilities at the ends of a 95 % interval


@dataclass(frozen=True)
class ModelEstimate:
    """Estimate of one model."""

    middle: float  # the value
    sds: tuple[float, float]  # standard deviations to below and above
    weight: float  # of the model, relative to those of the others


def average(
    estimates: Sequence[ModelEstimate], least: float = 0.0, most: float = 1.0
) -> tuple[float, tuple[float, float]]:
    """Average normal distributions by Bayesian model averaging (Hoeting et al. 1999).

    Returns:
        The mean, and the 95 % interval of the mixture, both within `least` and `most`.
    """
    weights = np.array([estimate.weight for estimate in estimates])
    weights /= weights.sum()
    middles = np.array([estimate.middle for estimate in estimates])
    total = sum(estimate.weight for estimate in estimates)
    mean = sum(estimate.weight * estimate.middle for estimate in estimates) / total
    mean = float(np.clip(mean, least, most))
    ends = [
        _quantile(tail, middles, np.array([one.sds[side] for one in estimates]), weights)
        for side, tail in enumerate(_TAILS)
    ]
    return mean, (min(max(ends[0], least), mean), max(min(ends[1], most), mean))


def correlation_time(residuals: Array, unknowns: int) -> float:
    """Return the integrated autocorrelation time in samples: 1 for white noise, more for smoothed.

    Summed up to the first lag within chance, or that of an AR(1) process if longer.

    Args:
        residuals: Of a fit, in order, shape (T,).
        unknowns: Number that was fitted: that removes some of the correlation.
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
    """Estimate the noise's standard deviation of heights, shape (T,), by third differences.

    A parabola has none: they multiply white noise by sqrt(20), and 0.6745 is the median absolute
    value of a normal distribution.
    """
    return float(np.median(np.abs(np.diff(heights, 3)))) / (0.6745 * np.sqrt(20.0))


def surer_noise_of(heights: Array) -> float:
    """Estimate the same by the trimmed mean square of third differences, impacts left out.

    It takes a third of the samples for the same certainty.
    """
    bends = np.diff(heights, 3) / np.sqrt(20.0)
    usual = noise_of(heights)
    noise = bends[np.abs(bends) <= _TYPICAL_SDS * usual]
    if not len(noise):
        return usual
    return float(np.sqrt(np.mean(noise**2))) * _TRIMMED


def mixture_quantile(probability: float, middles: Array, sds: Array, weights: Array) -> float:
    """Return a quantile of a Gaussian mixture, without the components that move none."""
    heavy = weights > _NOTHING
    shares = weights[heavy] / weights[heavy].sum()
    return _quantile(probability, middles[heavy], sds[heavy], shares)


def _quantile(probability: float, middles: Array, sds: Array, weights: Array) -> float:
    """Return a quantile of a Gaussian mixture (Brent's method)."""
    from scipy.optimize import brentq
    from scipy.special import ndtr

    low, high = float((middles - 9 * sds).min()), float((middles + 9 * sds).max())
    end: Any = brentq(
        lambda value: float(weights @ ndtr((value - middles) / sds)) - probability,
        low,
        high,
        xtol=1e-9,
    )
    return float(end)
