"""How fast an even clock ticks: from samples on ticks, and what cameras are built for."""

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
_USUAL_PERIODS = np.concatenate([_NOMINAL_PERIODS, 1.001 * _NOMINAL_PERIODS])
"""What cameras are built for, and the same as television has it [ms]."""

_USUAL_SLACK = 15.0
"""Log likelihood that may be lost by taking a rate as exactly a usual one."""

_MOST_LOST = 0.35
"""Of all ticks, at a usual rate."""

_NOMINAL_GAIN = 4.0
"""Log likelihood that a rate is worth beside the same as television has it: in the few seconds of a
drop, delays hardly tell them apart."""

_CHOSEN_GAIN = 4.0
"""Log likelihood that the usual rate is worth by which the samples were put on ticks."""

APART = 0.3
"""Of a period: by so much neighbouring rates differ at the last sample."""

_KERNEL = 25.0
"""Width of a law's scale over that of the kernel which its density is seen through, and ..."""

_NARROWEST_MS = 0.15
"""... the least."""


def usual_periods(least: float, most: float) -> Array:
    """Periods that cameras are built for and that so many samples may come from [ms].

    Args:
        least: the shortest mean step of the samples; some may be missing.
        most: the longest.
    """
    return _USUAL_PERIODS[((1 - _MOST_LOST) * least <= _USUAL_PERIODS) & (most >= _USUAL_PERIODS)]


def period_of(ticks: Ticks, arrivals: Array, clock: Clocks) -> tuple[float, float, float]:
    """Period, time of tick 0, and the period's standard deviation.

    The rate at which delays are least scattered: their law has edges or peaks, on whatever side.
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
    usual = _USUAL_PERIODS[np.abs(_USUAL_PERIODS - period) < APART / span * period]
    if len(usual):
        costs = costs_of(usual) - _CHOSEN_GAIN * (usual == clock.periods[0])
        costs -= _NOMINAL_GAIN * np.isin(usual, _NOMINAL_PERIODS)
        if costs.min() < least + _USUAL_SLACK:
            period = float(usual[costs.argmin()])
    return period, float((arrivals - period * ticks).min()), error


def period_below(ticks: Ticks, arrivals: Array) -> float:
    """Period of the line below all arrivals that is nearest to them in sum."""
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
    """Whether a point lies on or above the line through those on its sides."""
    rise = (point[1] - one[1]) * (other[0] - point[0])
    return rise >= (other[1] - point[1]) * (point[0] - one[0])


def _mean_delay(late: Array) -> Array:
    """As `_scatter` where delays are exponential: what decides is those that are hardly late."""
    mean = (late - late.min(axis=1, keepdims=True)).mean(axis=1)
    return late.shape[1] * np.log(np.maximum(mean, _NARROWEST_MS))


def _scatter(late: Array, kernel: float) -> Array:
    """How scattered delays are: the sum of their densities' negative logs, shape (C,).

    Each delay's density is that of the others through a Gaussian kernel.

    Args:
        late: shape (C, T).
        kernel: standard deviation.
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
