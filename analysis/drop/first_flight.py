"""How long a ball flies after its first impact, to a fraction of a sample."""

from __future__ import annotations

import numpy as np

from analysis.drop.free_fall import noise_of
from tunenet_logs.arrays import Array

_MIN_SAMPLES = 4
_LOW_SHARE = 0.3
"""A flight is over below this share of its height: it is fitted up to there."""


def first_flight_s(seconds: Array, heights: Array) -> float:
    """Duration of the flight between the first two impacts.

    The first impact is where the parabolas of fall and flight meet, the second one where the
    flight's is as low again. So the second impact itself, which falls anywhere in the step of an
    engine, plays no part: the duration changes evenly with the restitution. Drag biases it, alike
    in two curves that are compared.

    Args:
        seconds: times of the samples, shape (T,), increasing, from before the first impact.
        heights: heights there, shape (T,), finite, in any unit.

    Returns:
        In the unit of `seconds`; 0 where the ball is not seen to leave the table and come back.
    """
    impact = _impact(heights)
    if impact is None or len(heights) - impact < _MIN_SAMPLES:
        return 0.0
    rest = float(np.quantile(heights[impact:], 0.05))  # the table, where most samples rest on it
    least = 6 * noise_of(heights) + 1e-3 * float(np.ptp(heights))
    top = np.maximum.accumulate(heights[impact:])
    over = (top > rest + least) & (heights[impact:] < rest + _LOW_SHARE * (top - rest))
    if not over.any():
        return 0.0
    flight = slice(impact + 1, impact + int(np.argmax(over)))
    if flight.stop - flight.start < _MIN_SAMPLES:
        return 0.0
    clock = seconds - seconds[impact]
    falling = heights[:impact] < rest + 0.98 * (heights[0] - rest)
    down = np.polyfit(clock[:impact][falling], heights[:impact][falling], 2)
    up = np.polyfit(clock[flight], heights[flight], 2)
    if not 0.5 * down[0] > up[0] > 2 * down[0]:  # noise about a ball at rest is no free flight
        return 0.0
    apex = -up[1] / (2 * up[0])
    meetings = np.roots(down - up)
    near = meetings[np.argmin(np.abs(meetings))]
    return float(max(0.0, 2 * (apex - near.real)))


def _impact(heights: Array) -> int | None:
    """The lowest sample of the first fall."""
    low = heights < (heights.max() + heights.min()) / 2
    stops = np.flatnonzero(low[:-1] & (np.diff(heights) >= 0))
    return int(stops[0]) if len(stops) and stops[0] >= _MIN_SAMPLES else None
