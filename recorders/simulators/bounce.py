"""A bounce without drag in closed form: one curve that depends on the restitution alone.

Time s in fall times after the first impact, height u above contact in drop heights. The ball falls
from u = 1 at s = -1; every impact keeps `restitution` of the speed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def bounce_heights(places: Array, restitution: float) -> Array:
    """Heights u [drop heights] at `places` s [fall times], shape (T,).

    With e the restitution, flight n = 0, 1, ... starts at s_n = 2 e (1 - e^n) / (1 - e), and in it
    u = x (2 e^(n+1) - x), x = s - s_n. Before the fall u is 1; after the last flight it is 0.
    """
    fall = 1.0 - np.clip(places + 1.0, 0.0, None) ** 2
    flight = _flight_of(places, restitution)
    after = places - _start(flight, restitution)
    rise = 2.0 * restitution ** (flight + 1.0)
    return np.where(places < 0.0, fall, np.clip(after * (rise - after), 0.0, None))


def impact_places(restitution: float, count: int) -> Array:
    """The first `count` impacts s_n [fall times], the first at 0, shape (count,)."""
    return _start(np.arange(float(count)), restitution)


def _start(flight: Array, restitution: float) -> Array:
    if restitution == 1.0:
        return 2.0 * flight
    return 2.0 * restitution * (1.0 - restitution**flight) / (1.0 - restitution)


def _flight_of(places: Array, restitution: float) -> Array:
    """In which flight each place is; a place after the end of all is in the last of many."""
    places = np.clip(places, 0.0, None)
    if restitution == 1.0:
        return np.floor(places / 2.0)
    if restitution == 0.0:
        return np.zeros_like(places)
    left = 1.0 - places * (1.0 - restitution) / (2.0 * restitution)  # e^n at the n-th impact
    most = 1e-12
    flight = np.floor(np.log(np.clip(left, most, None)) / np.log(restitution))
    return np.clip(flight, 0.0, None)
