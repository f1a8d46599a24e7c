"""Statistics shared by all fits: noise, autocorrelation, and quantiles of mixtures."""

from __future__ import annotations

import math
from functools import cache
from itertools import takewhile

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
    values = (float(residuals[lag:] @ residuals[:-lag]) / power for lag in range(1, count // 4))
    chance = 2 / np.sqrt(count)
    lasting = list(takewhile(lambda value: value >= chance, values))
    if not lasting:
        return 1.0
    first = min(lasting[0] + unknowns * (1 + lasting[0]) / count, 0.98)
    return max(1 + 2 * sum(lasting), (1 + first) / (1 - first) if len(lasting) > 2 else 1.0)


def noise_of(heights: Array, seconds: Array | None = None) -> float:
    """Estimate the noise's standard deviation of heights, shape (T,), by third differences.

    A parabola has none, and 0.6745 is the median absolute value of a normal distribution. Times
    [s], shape (T,), matter where they are uneven.
    """
    return float(np.median(np.abs(_third_differences(heights, seconds)))) / 0.6745


def _third_differences(heights: Array, seconds: Array | None) -> Array:
    """Return divided differences of a sample and the three after it, as large as its noise."""
    if seconds is None:
        return np.diff(heights, 3) / np.sqrt(20.0)  # by which they multiply white noise
    four = np.lib.stride_tricks.sliding_window_view
    clock, values = four(seconds, 4), four(heights, 4)
    apart = (clock[:, :, None] - clock[:, None, :] + np.eye(4)).prod(axis=2)
    distinct = np.all(apart != 0, axis=1)
    shares = 1 / apart[distinct]
    return (shares * values[distinct]).sum(axis=1) / np.linalg.norm(shares, axis=1)


def surer_noise_of(heights: Array, seconds: Array | None = None) -> float:
    """Estimate the same by the trimmed mean square of third differences, impacts left out.

    It takes six tenths of the samples for the same certainty.
    """
    bends = _third_differences(heights, seconds)
    usual = noise_of(heights, seconds)
    noise = bends[np.abs(bends) <= _TYPICAL_SDS * usual]
    if not len(noise):
        return usual
    return float(np.sqrt(np.mean(noise**2))) * _TRIMMED


def robust_regression(columns: Array, values: Array) -> tuple[Array, Array, float, Array]:
    """Regress values (N,) on columns (N, U) by reweighting of what is far off (Cauchy).

    Returns coefficients (U,), residuals (N,), their spread, and the weights of rows (N,).
    """
    weights: Array = np.ones(len(values))
    found: Array = np.zeros(columns.shape[1])
    residuals, spread = values, 1.0
    for _ in range(5):
        rows = columns * weights[:, None]
        found = np.asarray(np.linalg.lstsq(rows, values * weights)[0], dtype=np.float64)
        residuals = values - columns @ found
        spread = 1.4826 * float(np.median(np.abs(residuals))) + 1e-6
        weights = 1 / np.sqrt(1 + (residuals / spread / 2) ** 2)
    return found, residuals, spread, weights


def normalised(logs: Array) -> tuple[Array, float]:
    """Return weights in proportion to exp(logs) that add up to 1, and the log of their sum."""
    most = logs.max()
    weights = np.exp(logs - most)
    total = weights.sum()
    return weights / total, float(most + np.log(total))


_CDF_REACH, _CDF_CELLS = 9.0, 1024  # beyond so many standard deviations nothing is left


@cache
def _cdf_cells() -> Array:
    """Return cubics of the normal distribution over its cells, highest power first, (4, cells)."""
    nodes = np.linspace(-_CDF_REACH, _CDF_REACH, _CDF_CELLS + 1)
    below = np.array([0.5 * math.erfc(-node / math.sqrt(2.0)) for node in nodes.tolist()])
    density = np.exp(-0.5 * nodes**2) / math.sqrt(2.0 * math.pi)
    rises, slopes = np.diff(below), density * (2 * _CDF_REACH / _CDF_CELLS)
    before, after = slopes[:-1], slopes[1:]  # Hermite's form, of values and slopes at both ends
    return np.stack(
        [before + after - 2 * rises, 3 * rises - 2 * before - after, before, below[:-1]]
    )


def normal_cdf(values: Array) -> Array:
    """Compute the standard normal distribution function to 1e-10, of the shape of `values`.

    Without `scipy.special`, which takes as long to import as a small log to be tuned.
    """
    place = (np.clip(values, -_CDF_REACH, _CDF_REACH) + _CDF_REACH) * (
        _CDF_CELLS / (2 * _CDF_REACH)
    )
    cell = np.minimum(place.astype(np.intp), _CDF_CELLS - 1)
    since, (cube, square, slope, below) = place - cell, _cdf_cells()[:, cell]
    return ((cube * since + square) * since + slope) * since + below


def mixture_quantile(probability: float, middles: Array, sds: Array, weights: Array) -> float:
    """Return a quantile of a Gaussian mixture, by Newton's method in a bracket."""
    heavy = weights > 1e-12  # lighter components move no quantile
    middles, sds, weights = middles[heavy], sds[heavy], weights[heavy] / weights[heavy].sum()
    low, high = float((middles - 9 * sds).min()), float((middles + 9 * sds).max())
    mean = float(weights @ middles)
    sd = float(np.sqrt(weights @ (sds**2 + (middles - mean) ** 2)))
    nodes, below = np.linspace(-_CDF_REACH, _CDF_REACH, _CDF_CELLS, endpoint=False), _cdf_cells()[3]
    value = mean + sd * float(np.interp(probability, below, nodes))  # of one normal distribution
    for _ in range(100):  # bisection alone needs half as many
        if not high - low > 1e-9:
            break
        off = (value - middles) / sds
        beyond = float(weights @ normal_cdf(off)) - probability
        low, high = (low, value) if beyond > 0 else (value, high)
        density = float(weights @ (np.exp(-0.5 * off**2) / sds)) / np.sqrt(2 * np.pi)
        step = beyond / max(density, 1e-9)
        if abs(step) < 1e-10:
            break
        value = value - step if low < value - step < high else (low + high) / 2
    return value
