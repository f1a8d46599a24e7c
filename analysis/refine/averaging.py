"""Several models' opinions of one value, as one value and interval; and what samples are worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TWO_SIDED = 1.96
_TAILS = (0.025, 0.975)


@dataclass(frozen=True)
class Opinion:
    """One model's.

    Attributes:
        middle: the value.
        sds: standard deviations to below and above.
        weight: of the model; those of all models add up to 1.
    """

    middle: float
    sds: tuple[float, float]
    weight: float


def average(opinions: Sequence[Opinion]) -> tuple[float, tuple[float, float]]:
    """Mean and 95 % interval of a share that is told by normal distributions, within 0 and 1."""
    mean = sum(one.weight * one.middle for one in opinions)
    mean = float(np.clip(mean, 0.0, 1.0))
    low, high = (_quantile(opinions, side) for side in (0, 1))
    return mean, (max(0.0, min(low, mean)), min(1.0, max(high, mean)))


def _quantile(opinions: Sequence[Opinion], side: int) -> float:
    from scipy.optimize import brentq
    from scipy.stats import norm

    def excess(value: float) -> float:
        shares = (one.weight * norm.cdf((value - one.middle) / one.sds[side]) for one in opinions)
        return float(sum(shares)) - _TAILS[side]

    ends = [one.middle + sign * 9 * one.sds[side] for one in opinions for sign in (-1, 1)]
    found: Any = brentq(excess, min(ends), max(ends), xtol=1e-9)
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
