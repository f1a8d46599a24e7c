"""Hunt and Crossley's contact, F = k x (1 + d x'), and the restitution that it makes.

A body that meets it at speed v and leaves at e v obeys, with u = d v and gravity left out,

    u - ln(1 + u) = -e u - ln(1 - e u),

whatever its mass and the stiffness k: the restitution falls with speed (Hunt and Crossley,
"Coefficient of restitution interpreted as damping in vibroimpact", 1975).
"""

from __future__ import annotations

import math

LEAST = 0.01
"""Restitution: a smaller one takes a dissipation without bound."""

_BEND = 1e-4
"""Of u, below which both sides are the same but for rounding, and e = 1 - 2 u / 3."""


def dissipation(restitution: float, speed_m_s: float) -> float:
    """The dissipation d [s/m] with which an impact of this speed has this restitution.

    Args:
        restitution: from 0 to 1; one under `LEAST` counts as that.
        speed_m_s: of the impact, over 0.
    """
    wanted = max(restitution, LEAST)
    low, high = 0.0, 1 / wanted
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (middle, high) if _restitution(middle) > wanted else (low, middle)
    return low / speed_m_s


def restitution(dissipation_s_m: float, speed_m_s: float) -> float:
    """The restitution of an impact of this speed."""
    return _restitution(dissipation_s_m * speed_m_s)


def _restitution(u: float) -> float:
    if u < _BEND:
        return 1 - 2 * u / 3
    low, high = 0.0, min(1.0, 1 / u)
    taken = u - math.log1p(u)
    for _ in range(100):
        middle = (low + high) / 2
        given = -middle * u - math.log1p(-middle * u) if middle * u < 1 else math.inf
        low, high = (middle, high) if given < taken else (low, middle)
    return (low + high) / 2
