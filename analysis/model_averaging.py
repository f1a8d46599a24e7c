"""Several models' opinions of one value, as one value and interval; and what samples are worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tunenet_logs.arrays import Array

TWO_SIDED = 1.96
_TAILS = (0.025, 0.975)


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
    opinions: Sequence[ModelEstimate], least: float = 0.0, most: float = 1.0
) -> tuple[float, tuple[float, float]]:
    """Mean and 95 % interval of what normal distributions tell, within `least` and `most`."""
    total = sum(one.weight for one in opinions)
    mean = sum(one.weight * one.middle for one in opinions) / total
    mean = float(np.clip(mean, least, most))
    low, high = (_quantile(opinions, side) for side in (0, 1))
    return mean, (min(max(low, least), mean), max(min(high, most), mean))


def _quantile(opinions: Sequence[ModelEstimate], side: int) -> float:
    from scipy.optimize import brentq
    from scipy.special import ndtr

    weights = np.array([one.weight for one in opinions])
    weights /= weights.sum()
    middles = np.array([one.middle for one in opinions])
    sds = np.array([one.sds[side] for one in opinions])

    def excess(value: float) -> float:
        return float(weights @ ndtr((value - middles) / sds)) - _TAILS[side]

    low, high = float(np.min(middles - 9 * sds)), float(np.max(middles + 9 * sds))
    found: Any = brentq(excess, low, high, xtol=1e-9)
    return float(found)


def correlation_time(left: Array, unknowns: int) -> float:
    """How many samples are worth one: 1 for white noise, more where neighbours lean one way.

    Args:
        left: what a fit leaves of them, in order, shape (T,).
        unknowns: how many were fitted: that takes some of the leaning away.
    """
    count, power = len(left), float(left @ left)
    if not power:
        return 1.0
    lags = [float(left[lag:] @ left[:-lag]) / power for lag in range(1, count // 4)]
    chance = 2 / np.sqrt(count)
    if not lags or lags[0] < chance:
        return 1.0
    lasting = next((at for at, one in enumerate(lags) if one < chance), len(lags))
    first = min(lags[0] + unknowns * (1 + lags[0]) / count, 0.98)
    return max(1 + 2 * sum(lags[:lasting]), (1 + first) / (1 - first) if lasting > 2 else 1.0)
