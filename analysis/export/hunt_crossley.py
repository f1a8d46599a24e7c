"""Hunt-Crossley contact, F = k x (1 + d x'), and its coefficient of restitution.

A body that meets it at speed v and leaves at e v obeys, with u = d v and without gravity,

    u - ln(1 + u) = -e u - ln(1 - e u),

independent of its mass and the stiffness k: the restitution falls with speed (Hunt and Crossley,
"Coefficient of restitution interpreted as damping in vibroimpact", 1975).
"""

from __future__ import annotations

import math

MIN = 0.01  # restitution: a smaller one takes a dissipation without bound
_BEND = 1e-4  # of u, below which both sides are the same but for rounding, and e = 1 - 2 u / 3


def dissipation(restitution: float, speed_m_s: float) -> float:
    """Solve for the dissipation d [s/m] of a restitution, at least `MIN`, at this speed."""
    wanted = max(restitution, MIN)
    low, high = 0.0, 1 / wanted
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (middle, high) if _restitution(middle) > wanted else (low, middle)
    return low / speed_m_s


def restitution(dissipation_s_m: float, speed_m_s: float) -> float:
    """Solve for the coefficient of restitution at this impact speed."""
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
