"""Statistics shared by all fits: noise, autocorrelation, and quantiles of mixtures."""

from __future__ import annotations

from typing import Any

import numpy as np

from tunenet_logs.episode import Array

TWO_SIDED = 1.96  # standard deviations of a normal distribution to either end of its 95 % interval
# Standard deviations beyond which a third difference is an impact's, and by how much what is left
# of a normal distribution is narrower.
_TYPICAL_SDS, _TRIMMED = 3.0, 1.0137


def correlation_time(residuals: Array, unknowns: int) -> float:
    """Return the integrated autocorrelation time in samples: 1 for white noise, more for smoothed.

    Summed up to the first lag within chance, or that of an AR(1) process if longer.
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


def normalised(logs: Array) -> tuple[Array, float]:
    """Return weights in proportion to exp(logs) that add up to 1, and the log of their sum."""
    most = logs.max()
    weights = np.exp(logs - most)
    total = weights.sum()
    return weights / total, float(most + np.log(total))


def mixture_quantile(probability: float, middles: Array, sds: Array, weights: Array) -> float:
    """Return a quantile of a Gaussian mixture (Brent's method)."""
    from scipy.optimize import brentq
    from scipy.special import ndtr

    heavy = weights > 1e-12  # lighter components move no quantile
    middles, sds, weights = middles[heavy], sds[heavy], weights[heavy] / weights[heavy].sum()
    low, high = float((middles - 9 * sds).min()), float((middles + 9 * sds).max())
    end: Any = brentq(
        lambda value: float(weights @ ndtr((value - middles) / sds)) - probability,
        low,
        high,
        xtol=1e-9,
    )
    return float(end)
