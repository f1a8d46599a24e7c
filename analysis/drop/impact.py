"""Where a fall and the flight after it meet: the impact's time, level and speeds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array

Indices = NDArray[np.intp]
"""Of samples, increasing."""


@dataclass(frozen=True, eq=False)
class Impact:
    """The first impact of a drop.

    Attributes:
        impact_s: its time [s].
        contact_m: height at contact [m].
        impact_speed_m_s: just before, positive.
        flight_restitution: ratio of the speeds after and before, by the parabolas of fall and
            flight alone; NaN where too little of the first flight is seen.
        flight_restitution_sd: its standard error; NaN likewise.
        gravity_m_s2: fitted acceleration of fall and flight together.
    """

    impact_s: float
    contact_m: float
    impact_speed_m_s: float
    flight_restitution: float
    flight_restitution_sd: float
    gravity_m_s2: float

    @property
    def fall_time_s(self) -> float:
        """Time of a fall from rest to the impact's speed [s]."""
        return self.impact_speed_m_s / self.gravity_m_s2

    @property
    def drop_height_m(self) -> float:
        """Height of a fall from rest to the impact's speed [m]."""
        return self.impact_speed_m_s**2 / (2 * self.gravity_m_s2)


@dataclass(frozen=True, eq=False)
class ImpactFit(Impact):
    """An impact as it is fitted, on a clock of the caller's.

    Attributes:
        contact_sd_m: standard error of the contact's height [m].
        fall: parabola of the fall, highest power first, shape (3,).
    """

    contact_sd_m: float
    fall: Array


def meet(clock: Array, heights: Array, fall: Indices, flight: Indices, noise: float) -> ImpactFit:
    """Fit fall and flight with one curvature by least squares, and find where they cross.

    Standard errors are the fit's covariance carried through the crossing by central differences
    (the delta method).

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
    impact_s, contact_m, speed_m_s, restitution = _crossing(solution).tolist()
    offset, slope, _, _, curve = solution.tolist()
    return ImpactFit(
        impact_s=impact_s,
        contact_m=contact_m,
        impact_speed_m_s=speed_m_s,
        flight_restitution=restitution,
        flight_restitution_sd=float(errors[3]),
        gravity_m_s2=-2 * curve,
        contact_sd_m=float(errors[1]),
        fall=np.array([curve, slope, offset]),
    )


def falling_to(level_m: float, fall: Array, level_sd_m: float = 0.0) -> ImpactFit:
    """Where a fall's parabola comes down to a known level; what comes after it is NaN.

    Args:
        level_m: height [m].
        fall: parabola, highest power first, shape (3,).
        level_sd_m: standard error of the level [m].
    """
    curve, slope, offset = fall.tolist()
    speed = float(np.sqrt(max(slope**2 - 4 * curve * (offset - level_m), 0.0)))
    return ImpactFit(
        impact_s=(-slope - speed) / (2 * curve),
        contact_m=level_m,
        impact_speed_m_s=speed,
        flight_restitution=float("nan"),
        flight_restitution_sd=float("nan"),
        gravity_m_s2=-2 * curve,
        contact_sd_m=level_sd_m,
        fall=fall,
    )


def gravity_of(clock: Array, heights: Array, indices: Indices, noise: float) -> tuple[float, float]:
    """Acceleration of some samples of free flight and its standard error [m/s²]; NaN below 4.

    Args:
        clock: times [s], shape (T,).
        heights: heights [m], shape (T,).
        indices: of the samples to fit.
        noise: standard deviation of a height [m].
    """
    if len(indices) < 4:
        return float("nan"), float("nan")
    times = clock[indices] - clock[indices].mean()
    design = np.column_stack([np.ones_like(times), times, times**2])
    solution, *_ = np.linalg.lstsq(design, heights[indices], rcond=None)
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
