"""A bounce in closed form: a restitution, how it falls with speed, and the air's drag.

Time s in sqrt(2 H / g) after the first impact, height u above contact in drop heights H, so that
u'' = -2 - drag u' |u'|. Without drag the ball falls from u = 1 at s = -1, and n impacts later
u = x (w - x), with x the time since that impact and w the speed that it left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MOST_FLIGHTS = 400
_SLOWEST = 1e-5
_NO_DRAG = 1e-7


@dataclass(frozen=True)
class Bounce:
    """A ball.

    Attributes:
        restitution: at the first impact, e_1.
        slope: p of e_n = e_1 (v_n / v_1)^-p: how the restitution falls with the impact's speed.
        drag: quadratic drag, deceleration over speed squared, times the drop height.
        each: restitutions at the first impacts, where they follow no law.
    """

    restitution: float
    slope: float = 0.0
    drag: float = 0.0
    each: tuple[float, ...] = ()

    def heights(self, places: Array) -> Array:
        """Heights u [drop heights] at `places` s, shape (T,); 1 before the fall, 0 after all."""
        starts, speeds = self.flights(float(places.max(initial=0.0)))
        flight = np.clip(np.searchsorted(starts, places, side="right") - 1, 0, None)
        after = np.clip(places - starts[flight], 0.0, None)
        return np.where(places < 0.0, self._fall(places), self._flight(after, speeds[flight]))

    def flights(self, last: float) -> tuple[Array, Array]:
        """When each flight up to `last` starts, and with what speed; the first starts at 0."""
        first = self.fall_speed(1.0)
        starts, speeds = [0.0], [self._kept(0, 1.0) * first]
        while starts[-1] <= last and len(starts) < _MOST_FLIGHTS and speeds[-1] > _SLOWEST:
            if self.drag < _NO_DRAG:
                lasted = impact = speeds[-1]
            else:
                apex, lasted = self.apex(speeds[-1])
                impact = self.fall_speed(apex)
            kept = self._kept(len(starts), impact / first)
            starts.append(starts[-1] + lasted)
            speeds.append(kept * impact)
        if speeds[-1] <= _SLOWEST:
            speeds[-1] = 0.0
        return np.array(starts), np.array(speeds)

    def _kept(self, number: int, share: float) -> float:
        """Restitution at an impact, whose speed is this share of the first one's."""
        if number < len(self.each):
            return self.each[number]
        return min(self.restitution * share**-self.slope, 1.0)

    def fall_speed(self, height: float) -> float:
        """At the end of a fall from rest [drop heights, sqrt(2 H / g)]."""
        if self.drag < _NO_DRAG:
            return 2.0 * math.sqrt(height)
        return math.sqrt(-2.0 * math.expm1(-2.0 * self.drag * height) / self.drag)

    def apex(self, speed: float) -> tuple[float, float]:
        """Height of a flight, and how long it lasts."""
        if self.drag < _NO_DRAG:
            return speed**2 / 4.0, speed
        height = math.log1p(speed**2 * self.drag / 2.0) / (2.0 * self.drag)
        rise = math.atan(speed * math.sqrt(self.drag / 2.0)) / math.sqrt(2.0 * self.drag)
        return height, rise + self._fall_time(height)

    def _fall_time(self, height: float) -> float:
        """Of a fall from rest, with drag: arccosh(e^x) / sqrt(2 drag), x = drag height."""
        x = self.drag * height
        return math.log(math.exp(x) + math.sqrt(math.expm1(2.0 * x))) / math.sqrt(2.0 * self.drag)

    def _angle(self, speed: Array) -> Array:
        return np.arctan(speed * np.sqrt(self.drag / 2.0))

    def _fall(self, places: Array) -> Array:
        if self.drag < _NO_DRAG:
            return 1.0 - np.clip(places + 1.0, 0.0, None) ** 2
        rate = np.sqrt(2.0 * self.drag)
        lasts = self._fall_time(1.0)
        since = np.clip(places + lasts, 0.0, lasts)
        return 1.0 - np.log(np.cosh(rate * since)) / self.drag

    def _flight(self, after: Array, speed: Array) -> Array:
        if self.drag < _NO_DRAG:
            return np.clip(after * (speed - after), 0.0, None)
        rate, angle = np.sqrt(2.0 * self.drag), self._angle(speed)
        left = angle - rate * after
        up = np.log(np.cos(np.clip(left, 0.0, None)) / np.cos(angle)) / self.drag
        down = np.log(np.cosh(np.clip(-left, 0.0, 20.0))) / self.drag
        return np.clip(up - down, 0.0, None)
