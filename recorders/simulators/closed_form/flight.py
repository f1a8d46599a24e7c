"""Compute vertical flight in air in closed form: position, speed, and time of landing.

dv/dt = -g - k v |v| with the drag k [1/m]. Upward that is a tangent of time, downward a hyperbolic
one; without drag it is a parabola.
"""

from __future__ import annotations

import math

import numpy as np

from tunenet_logs.arrays import Array

# Drag [1/m] below which a flight is a parabola: over 100 m the air changes it by 1e-7.
_NO_DRAG = 1e-9


def flown(
    height_m: float, speed_m_s: float, seconds: float, gravity_m_s2: float, drag_1_m: float
) -> tuple[float, float]:
    """Compute height [m] and upward speed [m/s] after a time of free flight."""
    if drag_1_m < _NO_DRAG:
        after = speed_m_s - gravity_m_s2 * seconds
        return height_m + (speed_m_s + after) / 2 * seconds, after
    rate, terminal = _scales(gravity_m_s2, drag_1_m)
    if speed_m_s > 0:
        angle = math.atan(speed_m_s / terminal)
        rises_s = angle / rate
        if seconds < rises_s:
            left = angle - rate * seconds
            rise = math.log(math.cos(left) / math.cos(angle)) / drag_1_m
            return height_m + rise, terminal * math.tan(left)
        height_m += math.log(math.hypot(1.0, speed_m_s / terminal)) / drag_1_m
        seconds, speed_m_s = seconds - rises_s, 0.0
    return _fallen(height_m, speed_m_s, seconds, rate, terminal, drag_1_m)


def flown_heights_m(
    height_m: float, speed_m_s: float, seconds: Array, gravity_m_s2: float, drag_1_m: float
) -> Array:
    """Compute heights [m] after times of free flight; see `flown`.

    Args:
        height_m: at the start [m].
        speed_m_s: upward speed at the start.
        seconds: since the start, increasing, shape (T,).
        gravity_m_s2: downward acceleration.
        drag_1_m: of the air.

    Returns:
        Shape (T,).
    """
    if drag_1_m < _NO_DRAG:
        return height_m + (speed_m_s - gravity_m_s2 / 2 * seconds) * seconds
    rate, terminal = _scales(gravity_m_s2, drag_1_m)
    heights_m = np.empty(len(seconds))
    rising, rises_s, top_m = 0, 0.0, height_m
    if speed_m_s > 0:
        angle = math.atan(speed_m_s / terminal)
        rises_s, speed = angle / rate, 0.0
        rising = int(np.searchsorted(seconds, rises_s))
        left = np.cos(angle - rate * seconds[:rising])
        heights_m[:rising] = height_m + np.log(left / math.cos(angle)) / drag_1_m
        top_m += math.log(math.hypot(1.0, speed_m_s / terminal)) / drag_1_m
    else:
        speed = -speed_m_s
    since = math.atanh(min(speed / terminal, _MAX_SPEED))
    until = since + rate * (seconds[rising:] - rises_s)
    log_cosh = np.where(
        until < 1,
        np.log1p(2 * np.sinh(np.minimum(until, 1.0) / 2) ** 2),
        until + np.log1p(np.exp(-2 * until)) - math.log(2),
    )
    heights_m[rising:] = top_m - (log_cosh - _log_cosh(since)) / drag_1_m
    return heights_m


def lands_after_s(height_m: float, speed_m_s: float, gravity_m_s2: float, drag_1_m: float) -> float:
    """Compute the time to reach height 0 from this height [m] and upward speed [m/s]."""
    if drag_1_m < _NO_DRAG:
        reach = math.sqrt(speed_m_s**2 + 2 * gravity_m_s2 * height_m)
        return (speed_m_s + reach) / gravity_m_s2
    rate, terminal = _scales(gravity_m_s2, drag_1_m)
    before_s = 0.0
    if speed_m_s > 0:
        before_s = math.atan(speed_m_s / terminal) / rate
        height_m += math.log(math.hypot(1.0, speed_m_s / terminal)) / drag_1_m
        speed_m_s = 0.0
    fallen_s = math.atanh(min(-speed_m_s / terminal, _MAX_SPEED)) / rate
    fallen_m = _log_cosh(rate * fallen_s) / drag_1_m
    return before_s + _arccosh_exp(drag_1_m * (height_m + fallen_m)) / rate - fallen_s


# Of the terminal speed: a fall from rest comes no nearer in double precision.
_MAX_SPEED = 1 - 1e-12


def _scales(gravity_m_s2: float, drag_1_m: float) -> tuple[float, float]:
    """Return rate [1/s] and terminal speed [m/s] of a fall."""
    return math.sqrt(gravity_m_s2 * drag_1_m), math.sqrt(gravity_m_s2 / drag_1_m)


def _fallen(
    height_m: float,
    speed_m_s: float,
    seconds: float,
    rate: float,
    terminal: float,
    drag_1_m: float,
) -> tuple[float, float]:
    """Compute the downward part of a flight: a later part of a fall from rest."""
    since = math.atanh(min(-speed_m_s / terminal, _MAX_SPEED))
    until = since + rate * seconds
    fall_m = (_log_cosh(until) - _log_cosh(since)) / drag_1_m
    return height_m - fall_m, -terminal * math.tanh(until)


def _log_cosh(value: float) -> float:
    """Compute log(cosh(value)), also where cosh is too large, or too near to 1."""
    if value < 1:
        return math.log1p(2 * math.sinh(value / 2) ** 2)
    return value + math.log1p(math.exp(-2 * value)) - math.log(2)


def _arccosh_exp(value: float) -> float:
    """Compute arccosh(e^value), exact for small values, too."""
    if value > 20:
        return value + math.log(2)
    return math.asinh(math.sqrt(math.expm1(2 * value)))
