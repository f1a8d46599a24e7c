"""Where a fall and the flight after it meet: the impact's time, level and speeds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Samples = NDArray[np.intp]


@dataclass(frozen=True)
class Meeting:
    """An impact, on a clock of the caller's.

    Attributes:
        impact_s: its time.
        contact_m: the height there.
        contact_sd_m: standard error of that height.
        fall_speed: just before, positive [m/s].
        rebound_speed: just after, positive [m/s]; NaN where unknown.
        fall: parabola of the fall, highest power first.
    """

    impact_s: float
    contact_m: float
    contact_sd_m: float
    fall_speed: float
    rebound_speed: float
    fall: tuple[float, float, float]

    @property
    def gravity(self) -> float:
        """Acceleration of the fall [m/s²]."""
        return -2 * self.fall[0]

    @property
    def drop_height_m(self) -> float:
        """Fall from rest that gives the fall's speed [m]."""
        return self.fall_speed**2 / (2 * self.gravity)

    @property
    def fall_time_s(self) -> float:
        """Duration of that fall [s]."""
        return self.fall_speed / self.gravity


def meet(clock: Array, heights: Array, fall: Samples, flight: Samples, noise: float) -> Meeting:
    """Fit fall and flight with one curvature, and find where they cross.

    Args:
        clock: times [s], shape (T,).
        heights: heights [m], shape (T,).
        fall: samples of the fall.
        flight: samples of the first flight, at least 2.
        noise: standard deviation of a height [m].
    """
    times = np.concatenate([clock[fall], clock[flight]])
    in_fall = np.arange(len(times)) < len(fall)
    design = np.column_stack([in_fall, in_fall * times, ~in_fall, ~in_fall * times, times**2])
    values = np.concatenate([heights[fall], heights[flight]])
    solution, *_ = np.linalg.lstsq(design, values, rcond=None)
    offset, slope, offset_up, slope_up, curve = (float(value) for value in solution)
    impact = (offset_up - offset) / (slope - slope_up)
    # How the contact's height changes with each coefficient, for its standard error.
    by_time = (slope + 2 * curve * impact) / (slope - slope_up)
    gradient = np.array([1 - by_time, (1 - by_time) * impact, by_time, by_time * impact, impact**2])
    covariance = max(noise, 1e-9) ** 2 * np.linalg.pinv(design.T @ design)
    return Meeting(
        impact_s=impact,
        contact_m=offset + slope * impact + curve * impact**2,
        contact_sd_m=float(np.sqrt(max(gradient @ covariance @ gradient, 0.0))),
        fall_speed=-(slope + 2 * curve * impact),
        rebound_speed=slope_up + 2 * curve * impact,
        fall=(curve, slope, offset),
    )


def falling_to(level: float, fall: tuple[float, float, float], level_sd: float = 0.0) -> Meeting:
    """Where a fall's parabola (highest power first) comes down to a known level."""
    curve, slope, offset = fall
    speed = float(np.sqrt(max(slope**2 - 4 * curve * (offset - level), 0.0)))
    impact = (-slope - speed) / (2 * curve)
    return Meeting(impact, level, level_sd, speed, float("nan"), fall)


def meet_at(
    level: float, clock: Array, heights: Array, flight: Samples, meeting: Meeting
) -> Meeting:
    """The same meeting where its level is known better, from the ball at rest."""
    known = falling_to(level, meeting.fall)
    if not len(flight):
        return known
    since = clock[flight] - known.impact_s
    straight = heights[flight] - level + meeting.gravity / 2 * since**2
    return replace(known, rebound_speed=float(since @ straight / (since @ since)))
