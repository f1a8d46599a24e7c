"""Compute bounces in closed form: speed-dependent restitution and quadratic air drag.

Time s in sqrt(2 H / g) after the first impact, height u above contact in drop heights H, so that
u'' = -2 - drag u' |u'|. Without drag the ball falls from u = 1 at s = -1, and n impacts later
u = x (w - x), with x the time since that impact and w the speed that it left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tunenet_logs.arrays import Array

# More than any log has impacts: it ends the flights of a restitution of almost 1.
_MAX_FLIGHTS = 400

# Speed [drop heights, sqrt(2 H / g)] below which the ball is at rest: it would rise 2.5e-11 H.
_MIN_SPEED = 1e-5

_STEEPEST = 1.5  # angle of a rise beyond which the ball would have come from infinitely fast
# Drag below which the ball flies on a parabola: logarithms over it lose half their digits.
_NO_DRAG = 1e-7


@dataclass(frozen=True)
class Bounce:
    """A ball's bounces, in dimensionless numbers.

    Attributes:
        restitution: at the first impact, e_1.
        slope: p of e_n = e_1 (v_n / v_1)^-p: how the restitution falls with the impact's speed.
        drag: quadratic drag, deceleration over speed squared, times the drop height.
        each: restitutions at the first impacts, where they follow no law.
        constant_below: fraction of the first impact's speed below which the restitution no longer
            changes with speed: a power law has no bound.
        flies_in: whether the ball flies before the top of the fall, too: it was thrown, or bounced
            before. Else it is held there.
        contact: duration of each impact's contact [sqrt(2 H / g)].
    """

    restitution: float
    slope: float = 0.0
    drag: float = 0.0
    each: tuple[float, ...] = ()
    constant_below: float = 0.0
    flies_in: bool = False
    contact: float = 0.0

    def heights(self, places: Array) -> Array:
        """Compute heights u over contact.

        Args:
            places: times s [sqrt(2 H / g)] after the first impact, shape (T,).

        Returns:
            Shape (T,) [drop heights]; 1 before the fall of a ball that is held, 0 once it is at
            rest.
        """
        starts, speeds = self.flights(float(places.max(initial=0.0)))
        falls = places < 0.0
        flies = ~falls
        flown = places[flies]
        flight = np.maximum(np.searchsorted(starts, flown, side="right") - 1, 0)
        after = flown - starts[flight]
        heights = np.empty_like(places)
        if self.drag < _NO_DRAG:
            since = places[falls] + 1.0
            heights[falls] = 1.0 - (since if self.flies_in else np.maximum(since, 0.0)) ** 2
            heights[flies] = np.maximum(after * (speeds[flight] - after), 0.0)
            return heights
        rate, lasts = np.sqrt(2.0 * self.drag), self.fall_time
        since = places[falls] + lasts
        fall = 1.0 - np.log(np.cosh(rate * np.clip(since, 0.0, lasts))) / self.drag
        if self.flies_in:
            to_top = np.clip(-rate * since, 0.0, _STEEPEST)
            fall = fall + np.log(np.cos(to_top)) / self.drag
        heights[falls] = fall
        angles = np.arctan(speeds * np.sqrt(self.drag / 2.0))
        tops = np.log(1.0 / np.cos(angles)) / self.drag
        to_apex = angles[flight] - rate * after
        rises = to_apex > 0.0
        sinks = ~rises
        up = np.log(np.cos(to_apex[rises]) / np.cos(angles)[flight[rises]]) / self.drag
        down = np.log(np.cosh(np.minimum(-to_apex[sinks], 20.0))) / self.drag
        over = np.empty_like(flown)
        over[rises], over[sinks] = up, tops[flight[sinks]] - down
        heights[flies] = np.maximum(over, 0.0)
        return heights

    def flights(self, last: float) -> tuple[Array, Array]:
        """Compute start times and speeds of the flights up to a time.

        Args:
            last: time s [sqrt(2 H / g)].

        Returns:
            Times of their starts, the first 0 (or when the first contact ends), and speeds there
            [drop heights, sqrt(2 H / g)], each of shape (N,).
        """
        first, each, given = self.impact_speed, self.each, len(self.each)
        usual, power, has_drag = self.restitution, -self.slope, self.drag >= _NO_DRAG
        per_speed, twice_rate = math.sqrt(self.drag / 2.0), math.sqrt(2.0 * self.drag)
        slowest = self.constant_below
        start, speed = self.contact, (each[0] if each else min(usual, 1.0)) * first
        starts, speeds, count = [start], [speed], 1
        while start <= last and count < _MAX_FLIGHTS and speed > _MIN_SPEED:
            lasted = impact = speed
            if has_drag:  # as in `flight`
                reach = speed * per_speed
                lasted = (math.atan(reach) + math.asinh(reach)) / twice_rate
                impact = speed / math.hypot(1.0, reach)
            if count < given:
                kept = each[count]
            else:
                ratio = impact / first
                kept = usual * (ratio if ratio > slowest else slowest) ** power
                kept = kept if kept < 1.0 else 1.0
            start += lasted + self.contact
            speed = kept * impact
            starts.append(start)
            speeds.append(speed)
            count += 1
        if speed <= _MIN_SPEED:
            speeds[-1] = 0.0
        return np.array(starts), np.array(speeds)

    def arrivals(self, speeds: Array) -> Array:
        """Compute the speeds of the impacts before flights of these speeds, shape (N,)."""
        return np.array([self.impact_speed, *(self.flight(one)[1] for one in speeds[:-1].tolist())])

    @property
    def impact_speed(self) -> float:
        """Speed of the first impact [drop heights, sqrt(2 H / g)]."""
        if self.drag < _NO_DRAG:
            return 2.0
        return math.sqrt(-2.0 * math.expm1(-2.0 * self.drag) / self.drag)

    @property
    def fall_time(self) -> float:
        """Duration of the fall: arccosh(e^drag) / sqrt(2 drag), exact for small drag, too."""
        if self.drag < _NO_DRAG:
            return 1.0
        return math.asinh(math.sqrt(math.expm1(2.0 * self.drag))) / math.sqrt(2.0 * self.drag)

    def flight(self, speed: float) -> tuple[float, float]:
        """Compute duration and final speed of a flight that begins with `speed`.

        Up: v' = -2 - drag v^2 gives an arctan; down: the same with +, an asinh.
        """
        if self.drag < _NO_DRAG:
            return speed, speed
        reach = speed * math.sqrt(self.drag / 2.0)
        lasted = (math.atan(reach) + math.asinh(reach)) / math.sqrt(2.0 * self.drag)
        return lasted, speed / math.hypot(1.0, reach)
