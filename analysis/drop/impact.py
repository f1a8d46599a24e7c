"""Where a fall and the flight after it meet: the impact's time, level and speeds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array

Samples = NDArray[np.intp]
Parabola = tuple[float, float, float]
"""Highest power first."""


@dataclass(frozen=True)
class ImpactFit:
    """An impact, on a clock of the caller's.

    Attributes:
        impact_s: its time.
        contact_m: the height there.
        contact_sd_m: standard error of that height.
        fall_speed: just before, positive [m/s].
        restitution: ratio of the speeds after and before, by the two parabolas alone; NaN where
            the flight is not seen.
        restitution_sd: its standard error; NaN likewise.
        fall: parabola of the fall.
    """

    impact_s: float
    contact_m: float
    contact_sd_m: float
    fall_speed: float
    restitution: float
    restitution_sd: float
    fall: Parabola

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


def meet(clock: Array, heights: Array, fall: Samples, flight: Samples, noise: float) -> ImpactFit:
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
    covariance = max(noise, 1e-9) ** 2 * np.linalg.pinv(design.T @ design)
    steps = np.sqrt(np.diag(covariance))
    nudges: Array = np.diag(steps)
    either_way = [(_crossing(solution + step), _crossing(solution - step)) for step in nudges]
    slopes = np.array([(up - down) / 2 for up, down in either_way])  # shape (5, 4)
    correlation = covariance / np.outer(steps, steps)
    errors = np.sqrt(np.maximum(np.diag(slopes.T @ correlation @ slopes), 0.0))
    impact, contact, speed, restitution = (float(value) for value in _crossing(solution))
    offset, slope, _, _, curve = (float(value) for value in solution)
    return ImpactFit(
        impact_s=impact,
        contact_m=contact,
        contact_sd_m=float(errors[1]),
        fall_speed=speed,
        restitution=restitution,
        restitution_sd=float(errors[3]),
        fall=(curve, slope, offset),
    )


def falling_to(level: float, fall: Parabola, level_sd: float = 0.0) -> ImpactFit:
    """Where a fall's parabola comes down to a known level."""
    curve, slope, offset = fall
    speed = float(np.sqrt(max(slope**2 - 4 * curve * (offset - level), 0.0)))
    impact = (-slope - speed) / (2 * curve)
    unknown = float("nan")
    return ImpactFit(impact, level, level_sd, speed, unknown, unknown, fall)


def meet_at(level: float, meeting: ImpactFit) -> ImpactFit:
    """The same meeting where its level is known better, from the ball at rest.

    The restitution stays that of the two parabolas: a second opinion must not lean on the first.
    """
    return replace(
        falling_to(level, meeting.fall),
        restitution=meeting.restitution,
        restitution_sd=meeting.restitution_sd,
    )


def gravity_of(clock: Array, heights: Array, samples: Samples, noise: float) -> tuple[float, float]:
    """Acceleration of some samples of free flight and its standard error [m/s²]; NaN below 4."""
    if len(samples) < 4:
        return float("nan"), float("nan")
    times = clock[samples] - clock[samples].mean()
    design = np.column_stack([np.ones_like(times), times, times**2])
    solution, *_ = np.linalg.lstsq(design, heights[samples], rcond=None)
    variance = noise**2 * np.linalg.pinv(design.T @ design)[2, 2]
    return float(-2 * solution[2]), float(2 * np.sqrt(max(variance, 0.0)))


def _crossing(coefficients: NDArray[Any]) -> Array:
    """Time, height, speed before and ratio of the speeds where the two parabolas cross."""
    offset, slope, offset_up, slope_up, curve = coefficients
    impact = (offset_up - offset) / (slope - slope_up)
    speed = -(slope + 2 * curve * impact)
    after = slope_up + 2 * curve * impact
    height = offset + slope * impact + curve * impact**2
    return np.array([impact, height, speed, after / speed])
