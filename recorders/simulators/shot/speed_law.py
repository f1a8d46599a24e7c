"""How a ball's restitution falls with the speed of an impact."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tunenet_logs.arrays import Array
from tunenet_logs.errors import UsageError

_SLOWEST_M_S = 0.05
"""Below it a ball is not known better, and the law must not go beyond all bounds."""


@dataclass(frozen=True)
class SpeedLaw:
    """e(v) = restitution (v / at)^-slope.

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
        """Restitution at impacts of these speeds, from 0 to 1, any shape."""
        share = np.maximum(speeds_m_s, _SLOWEST_M_S) / self.at_m_s
        return np.clip(self.restitution * share**-self.slope, 0.0, 1.0)
