"""Impact where a fall and the flight after it meet, and the samples of each.

Throughout, `clock` are times [s] and `heights` heights [m], shape (T,), `noise` is the standard
deviation of a height [m], and `index` a sample within one or two of the impact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.drop.remedies import GOOD_DROP
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError

Indices = NDArray[np.intp]  # of samples, increasing


@dataclass(frozen=True, eq=False)
class Impact:
    """First impact of a drop.

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
    """Fitted impact, on a clock of the caller's.

    Attributes:
        contact_sd_m: standard error of the contact's height [m].
        fall: parabola of the fall, highest power first, shape (3,).
    """

    contact_sd_m: float
    fall: Array


def meet(clock: Array, heights: Array, fall: Indices, flight: Indices, noise: float) -> ImpactFit:
    """Locate an impact by intersecting the parabolas before and after it.

    One least-squares fit gives both, with one curvature. Standard errors are its covariance carried
    through the crossing by central differences (the delta method). Needs 2 samples of the flight.
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
    """Intersect a fall's parabola (highest power first) with a level [m]; the rebound is NaN."""
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


def gravity_of(clock: Array, heights: Array, indices: Indices, noise: float) -> float:
    """Estimate the acceleration of free flight [m/s²]; NaN where the samples do not fix it."""
    if len(indices) < _MIN_COUNT:
        return float("nan")
    times = clock[indices] - clock[indices].mean()
    design = np.column_stack([np.ones_like(times), times, times**2])
    solution, *_ = np.linalg.lstsq(design, heights[indices], rcond=None)
    sd = 2 * noise * np.sqrt(max(np.linalg.pinv(design.T @ design)[2, 2], 0.0))
    return float(-2 * solution[2]) if sd < _SURE_GRAVITY else float("nan")


def _crossing(coefficients: NDArray[Any]) -> Array:
    """Return time, height, speed before and ratio of the speeds where two parabolas cross."""
    offset, slope, offset_up, slope_up, curve = coefficients
    impact = (offset_up - offset) / (slope - slope_up)
    speed = -(slope + 2 * curve * impact)
    after = slope_up + 2 * curve * impact
    height = offset + slope * impact + curve * impact**2
    return np.array([impact, height, speed, after / speed])


# Samples that fix an acceleration, and its standard error [m/s²] beyond which it is not fixed.
_MIN_COUNT, _SURE_GRAVITY = 4, 0.5

# Samples of a flight from which on its own curvature is known, and how much more than the fall's
# that may be.
_PARABOLA, _FASTER = 6, 1.8

MIN_DROP_M = 0.02  # a lower fall lasts 64 ms: a camera of 60 Hz sees it in four pictures
# Lower parts of a descent that are tried as its free fall, the largest first.
_FALL_FRACTIONS = (0.95, 0.8, 0.6, 0.4, 0.25)

_MIN_FALL = 4  # samples of a fall: one more than its parabola has coefficients
_REST_WINDOW_S = 0.25  # longer than the top of a bounce stays within the tolerance of a rest
# Samples that are looked through at first: a ball rests soon, whatever the recording's length.
_FIRST_BLOCK = 256


def fall_samples(
    clock: Array, heights: Array, start: int, index: int, noise: float
) -> tuple[Indices, Array]:
    """Select the samples of the free fall before an impact, and fit their parabola.

    It is the largest lower part of the way down that is a parabola, from `start` on: the ball may
    have been held, carried or lowered by hand before.

    Returns:
        Their indices, at least 4, and the least-squares parabola, highest power first, shape (3,).

    Raises:
        NotFoundError: nothing before the impact is a free fall.
    """
    low = float(heights[index])
    top, first = low, index
    while first > start and heights[first - 1] > top - 6 * noise - 0.05 * (top - low):
        first -= 1
        top = max(top, float(heights[first]))
    depth = top - low
    if depth < max(MIN_DROP_M, 15 * noise):
        raise NotFoundError(f"the ball falls by only {1000 * depth:.0f} mm", GOOD_DROP)
    for fraction in _FALL_FRACTIONS:
        high = np.flatnonzero(heights[first : index - 1] > low + fraction * depth)
        begin = first + (int(high[-1]) + 1 if len(high) else 0)
        fall = np.arange(begin, index - 1)
        if len(fall) < _MIN_FALL:
            continue
        parabola = np.polyfit(clock[fall], heights[fall], 2)
        residuals = heights[fall] - np.polyval(parabola, clock[fall])
        if parabola[0] < 0 and np.sqrt(np.mean(residuals**2)) < 2 * noise + 0.002 * depth:
            return fall, parabola
    what = "no free fall is seen before an impact (carried, or too few samples)"
    raise NotFoundError(what, GOOD_DROP)


def release(
    clock: Array, heights: Array, start: int, last: int, impact: ImpactFit
) -> tuple[float, float]:
    """Estimate when [s] and at what height [m] a fall began: the apex of its upper quarter.

    Drag bends a long fall, so the parabola of its end would put the release elsewhere.
    """
    contact = impact.contact_m
    begin, top = last, float(heights[max(start, last - 5) : last + 1].max())
    while begin > start and heights[begin - 1] >= heights[begin] - 0.01 * (top - contact):
        begin -= 1
        top = max(top, float(heights[begin]))
    fraction = (heights[begin : last + 1] - contact) / (top - contact)
    upper = begin + np.flatnonzero((fraction > 0.75) & (fraction < 0.985))
    parabolas = [impact.fall]
    if len(upper) >= 5:
        parabola = np.polyfit(clock[upper], heights[upper], 2)
        parabolas += [parabola] if parabola[0] < 0 else []
    (apex_s, apex_m), *others = [
        (-slope / (2 * curve), offset - slope**2 / (4 * curve))
        for curve, slope, offset in (parabola.tolist() for parabola in parabolas)
    ]
    if others and abs(others[0][0] - apex_s) < 0.25 * (impact.impact_s - apex_s):
        return others[0]
    return apex_s, apex_m


def flight_samples(clock: Array, heights: Array, index: int, fall: Array, noise: float) -> Indices:
    """Select the first flight's samples: those on one parabola, of about the fall's curvature.

    Their number, at least 3 or none, is found by doubling, then by bisection. `fall` is the fall's
    parabola, highest power first, shape (3,).
    """
    tolerance = 4 * noise + 5e-4 * np.ptp(heights)
    landing = falling_to(float(heights[max(index - 3, 0) : index + 4].min()), fall)
    speed_m_s = max(landing.impact_speed_m_s, 1e-3)
    doubt_s = (clock[index] - clock[index - 1]) / 2 + 3 * noise / speed_m_s
    begin = int(np.searchsorted(clock, landing.impact_s + doubt_s))

    def is_flight(stop: int) -> bool:
        if stop > len(clock):
            return False
        times = clock[begin:stop]
        curve = fall[0]
        if stop - begin > _PARABOLA:  # the air slows a fall more than a flight
            free = float(np.polyfit(times - times.mean(), heights[begin:stop], 2)[0])
            curve = float(np.clip(free, _FASTER * fall[0], fall[0]))
        straight = heights[begin:stop] - curve * times**2
        off = straight - np.polyval(np.polyfit(times, straight, 1), times)
        return bool(np.abs(off).max() < tolerance)

    if not is_flight(begin + 3):
        return np.arange(0)
    reach = 3
    while is_flight(begin + 2 * reach):
        reach *= 2
    good, bad = begin + reach, begin + 2 * reach
    while bad - good > 1:
        middle = (good + bad) // 2
        good, bad = (middle, bad) if is_flight(middle) else (good, middle)
    samples = np.arange(begin, good - 1)  # the last one may have touched the table
    return samples if len(samples) >= 3 else samples[:0]


def rest_and_end(
    clock: Array, heights: Array, index: int, impact: Impact, noise: float
) -> tuple[Indices, int]:
    """Find the samples at rest after the bounces (perhaps none), and where the ball is moved."""
    contact, depth = impact.contact_m, impact.drop_height_m
    after = heights[index + 1 :]
    above = np.flatnonzero(after > contact + 1.1 * depth + 6 * noise)
    end = index + 1 + (int(above[0]) if len(above) else len(after))
    width = int(np.ceil(_REST_WINDOW_S / float(np.median(np.diff(clock))))) + 1
    third = width // 3
    sag = impact.gravity_m_s2 * (_REST_WINDOW_S / 3) ** 2
    begin, size = index + 1, _FIRST_BLOCK
    while third and end - begin >= width:
        block = heights[begin : min(begin + size + width - 1, end)]
        windows = np.lib.stride_tricks.sliding_window_view(block, width)
        highest, lowest = windows.max(axis=1), windows.min(axis=1)
        # Near the top of a bounce a ball hardly moves either, but it curves.
        edges = windows[:, :third].mean(axis=1) + windows[:, -third:].mean(axis=1)
        bend = edges - 2 * windows[:, third : width - third].mean(axis=1)
        still = (highest - lowest < 0.002 * depth + 8 * noise) & (np.abs(bend) < sag / 2)
        low = highest < contact + 0.05 * depth + 8 * noise
        settled = np.flatnonzero(still & low)
        if len(settled):
            begin += int(settled[0])
            break
        begin, size = begin + size, 2 * size
    else:
        return np.arange(0), end
    level = np.median(heights[begin : begin + width])
    moved = np.flatnonzero(np.abs(heights[begin:end] - level) > 0.02 * depth + 8 * noise)
    end = begin + int(moved[0]) if len(moved) else end
    return np.arange(begin, end), end
