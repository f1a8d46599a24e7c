"""Coefficient of restitution as a function of impact speed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tunenet_logs.arrays import Array
from tunenet_logs.errors import UsageError

# The law is constant below this speed: no ball is measured there, and a power law has no bound.
MIN_SPEED_M_S = 0.05


@dataclass(frozen=True)
class SpeedLaw:
    """Power law of the restitution, e(v) = restitution (v / at_m_s)^-slope.

    Attributes:
        restitution: at an impact of `at_m_s`.
        slope: p; 0 for one restitution at all speeds.
        at_m_s: speed along the surface's normal.

    Raises:
        UsageError: a value that no ball has.
    """

    restitution: float
    slope: float = 0.0
    at_m_s: float = 3.0

    def __post_init__(self) -> None:
        if not 0 <= self.restitution <= 1:
            raise UsageError(f"restitution {self.restitution:g} is not a number from 0 to 1")
        if not abs(self.slope) <= 1:
            raise UsageError(f"slope {self.slope:g} is not a number from -1 to 1")
        if not (math.isfinite(self.at_m_s) and self.at_m_s > 0):
            raise UsageError(f"impact speed {self.at_m_s:g} m/s is not over 0")

    def at(self, speeds_m_s: Array) -> Array:
        """Compute the restitution, 0 to 1, at impacts of these speeds [m/s], of their shape."""
        ratio = np.maximum(speeds_m_s, MIN_SPEED_M_S) / self.at_m_s
        return np.clip(self.restitution * ratio**-self.slope, 0.0, 1.0)
