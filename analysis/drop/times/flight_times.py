"""Impact times of many bouncing balls at once: flights with drag, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recorders.simulators.base import GRAVITY_M_S2
from recorders.simulators.speed_law import MIN_SPEED_M_S
from tunenet_logs.arrays import Array

# Below it the closed form would lose its digits: over 100 m it changes a flight by 1e-7.
_MIN_DRAG_1_M = 1e-9

_MAX_SPEED_M_S, _MIN_SPEED_LEAVING_M_S = 1e3, 1e-6  # speeds that a fit may try on its way


@dataclass(frozen=True, eq=False)
class FlightTimes:
    """Flights of M balls, N + 1 impacts each.

    Attributes:
        impacts_s: after the first impact, which is 0, shape (N + 1, M) [s].
        leaving_m_s: speeds after these impacts, shape (N + 1, M).
        arriving_m_s: speeds before them, the first of them unknown (NaN), shape (N + 1, M).
    """

    impacts_s: Array
    leaving_m_s: Array
    arriving_m_s: Array


def flights(
    count: int, leaving_m_s: Array, restitution: Array, slope: Array, drag_1_m: Array
) -> FlightTimes:
    """Compute the flights of M balls from an impact on.

    Args:
        count: N, of the flights.
        leaving_m_s: speed after the first impact, shape (M,).
        restitution: at the second impact, shape (M,); more than 1 is not cut, so that a fit can
            show it.
        slope: p of e_n = e_2 (v_n / v_2)^-p, constant below `MIN_SPEED_M_S`, shape (M,).
        drag_1_m: deceleration by the air over speed squared, shape (M,).
    """
    drag_1_m = np.maximum(drag_1_m, _MIN_DRAG_1_M)
    rate, per_speed = np.sqrt(GRAVITY_M_S2 * drag_1_m), np.sqrt(drag_1_m / GRAVITY_M_S2)
    shape = (count + 1, *np.shape(leaving_m_s + restitution))
    impacts_s, leaving, arriving = np.zeros(shape), np.zeros(shape), np.full(shape, np.nan)
    leaving[0] = leaving_m_s
    first = np.ones(shape[1:])
    for number in range(1, count + 1):
        reach = leaving[number - 1] * per_speed
        impacts_s[number] = impacts_s[number - 1] + (np.arctan(reach) + np.arcsinh(reach)) / rate
        speed = leaving[number - 1] / np.hypot(1.0, reach)
        arriving[number] = speed
        held = np.maximum(speed, MIN_SPEED_M_S)
        if number == 1:
            first = held
        kept = restitution * (held / first) ** -slope
        leaving[number] = np.clip(kept * speed, _MIN_SPEED_LEAVING_M_S, _MAX_SPEED_M_S)
    return FlightTimes(impacts_s, leaving, arriving)


def leaving_speeds(lasting_s: Array, drag_1_m: float) -> Array:
    """Solve for the speeds at the start of flights of these durations, by Newton, (N,) [m/s]."""
    drag_1_m = max(drag_1_m, _MIN_DRAG_1_M)
    rate, per_speed = np.sqrt(GRAVITY_M_S2 * drag_1_m), np.sqrt(drag_1_m / GRAVITY_M_S2)
    speeds = GRAVITY_M_S2 * lasting_s / 2
    for _ in range(6):
        reach = speeds * per_speed
        lasted = (np.arctan(reach) + np.arcsinh(reach)) / rate
        grows = (1 / (1 + reach**2) + 1 / np.hypot(1.0, reach)) / GRAVITY_M_S2
        speeds = np.maximum(speeds - (lasted - lasting_s) / grows, speeds / 2)
    return speeds


def apex_m(leaving_m_s: float, drag_1_m: float) -> float:
    """Return how high a ball rises that leaves with this speed [m]."""
    drag_1_m = max(drag_1_m, _MIN_DRAG_1_M)
    return float(np.log1p(drag_1_m * leaving_m_s**2 / GRAVITY_M_S2) / (2 * drag_1_m))


def fallen_m_s(height_m: Array | float, drag_1_m: Array | float) -> Array:
    """Return the speed at the end of a fall from rest, of the shape of both [m/s]."""
    drag_1_m = np.maximum(drag_1_m, _MIN_DRAG_1_M)
    return np.sqrt(-GRAVITY_M_S2 / drag_1_m * np.expm1(-2 * drag_1_m * height_m))
