"""Estimate the period of a uniform clock from samples on ticks, and from usual frame rates."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.lateness import RARER, Clocks

Array = NDArray[np.float64]
Ticks = NDArray[np.int64]

_HZ = (5, 6, 10, 12, 12.5, 15, 20, 24, 25, 30, 40, 48, 50, 60, 72, 75, 80, 90, 100, 120)
_HZ += (144, 150, 180, 200, 240, 250, 300, 360, 400, 480, 500, 1000)
_NOMINAL_PERIODS = 1e3 / np.array(_HZ)
# What cameras are built for, and the same as television has it [ms].
_TYPICAL_PERIODS = np.concatenate([_NOMINAL_PERIODS, 1.001 * _NOMINAL_PERIODS])

_TYPICAL_SLACK = 15.0  # log likelihood that may be lost by taking a rate as exactly a usual one
_MAX_LOST = 0.35  # of all ticks, at a usual rate
# Log likelihood that a rate is worth beside the same as television has it: in the few seconds of a
# drop, delays hardly tell them apart.
_NOMINAL_GAIN = 4.0

# Log likelihood that the usual rate is worth by which the samples were put on ticks.
_CHOSEN_GAIN = 4.0

APART = 0.3  # of a period: by so much neighbouring rates differ at the last sample
# Width of a law's scale over that of the kernel which its density is seen through, and ...
_KERNEL = 25.0

_NARROWEST_MS = 0.15  # ... the least.


def usual_periods(least: float, most: float) -> Array:
    """Return usual camera periods [ms] for a mean step of `least` to `most`, some ticks lost."""
    return _TYPICAL_PERIODS[
        ((1 - _MAX_LOST) * least <= _TYPICAL_PERIODS) & (most >= _TYPICAL_PERIODS)
    ]


def period_of(ticks: Ticks, arrivals: Array, clock: Clocks) -> tuple[float, float, float]:
    """Estimate period, time of tick 0, and the period's standard deviation.

    Minimises the entropy of the delays, whose law has edges or peaks on either side.
    """
    kernel = max(_NARROWEST_MS, float(clock.scales[0]) / _KERNEL)
    span, middle = float(np.ptp(ticks)), ticks - ticks.mean()

    def costs_of(periods: Array) -> Array:
        late = arrivals - periods[:, None] * middle
        return _mean_delay(late) if clock.laws[0] == RARER else _scatter(late, kernel)

    period, error, least = float(clock.periods[0]), 0.0, np.inf
    for width in (1.0, 0.25):
        tried = period * (1 + np.linspace(-APART, APART, 41) * width / span)
        costs = costs_of(tried)
        least = min(least, float(costs.min()))
        weights = np.exp(costs.min() - costs)
        weights /= weights.sum()
        period = float(weights @ tried)
        error = float(np.sqrt(weights @ (tried - period) ** 2))
    usual = _TYPICAL_PERIODS[np.abs(_TYPICAL_PERIODS - period) < APART / span * period]
    if len(usual):
        costs = costs_of(usual) - _CHOSEN_GAIN * (usual == clock.periods[0])
        costs -= _NOMINAL_GAIN * np.isin(usual, _NOMINAL_PERIODS)
        if costs.min() < least + _TYPICAL_SLACK:
            period = float(usual[costs.argmin()])
    return period, float((arrivals - period * ticks).min()), error


def period_below(ticks: Ticks, arrivals: Array) -> float:
    """Fit the line below all arrivals with the least sum of distances, by the lower convex hull."""
    hull: list[tuple[int, float]] = []
    for tick, arrival in zip(ticks.tolist(), arrivals.tolist(), strict=True):
        while len(hull) > 1 and _is_above(hull[-2], hull[-1], (tick, arrival)):
            hull.pop()
        hull.append((tick, arrival))
    middle = float(ticks.mean())
    for (first, low), (last, high) in pairwise(hull):
        if last >= middle:
            return (high - low) / (last - first)
    return 0.0


def _is_above(one: tuple[int, float], point: tuple[int, float], other: tuple[int, float]) -> bool:
    """Check whether a point lies on or above the line through those on its sides."""
    rise = (point[1] - one[1]) * (other[0] - point[0])
    return rise >= (other[1] - point[1]) * (point[0] - one[0])


def _mean_delay(late: Array) -> Array:
    """Return the cost of `_scatter` for exponential delays, decided by those hardly late."""
    mean = (late - late.min(axis=1, keepdims=True)).mean(axis=1)
    return late.shape[1] * np.log(np.maximum(mean, _NARROWEST_MS))


def _scatter(late: Array, kernel: float) -> Array:
    """Return the negative log likelihood of delays under their leave-one-out density, shape (C,).

    Args:
        late: shape (C, T).
        kernel: standard deviation of the Gaussian kernel of the density.
    """
    fine = 3.0 / kernel
    bins = ((late - late.min(axis=1, keepdims=True)) * fine).astype(np.int64)
    width = 9
    shape = np.exp(-0.5 * (np.arange(-width, width + 1) / 3.0) ** 2)
    costs = np.empty(len(late))
    for row, own in enumerate(bins):
        counts = np.bincount(own)
        density = np.convolve(counts, shape)[own + width] - shape[width]
        costs[row] = -np.log(np.maximum(density, 0.05)).sum()
    return costs
