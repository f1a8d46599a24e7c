"""Integrate a ball that bounces in air: the truth, which shares nothing with the fit.

Between impacts dv/dt = -g - k v |v|, stepped by the classical Runge-Kutta method (Kutta 1901). A
flight is cut at its apex, where v |v| is not smooth: the time to it is the integral of
dv / (g + k v²), by Gauss and Legendre. The step that ends on the table is found by Newton's method.
Several balls are stepped at once: those of a fit's derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tunenet_logs.arrays import Array

GRAVITY_M_S2 = 9.81

MIN_SPEED_M_S = 0.05  # speed of an impact below which the restitution no longer changes
_STILL_M_S = 1e-3  # a ball that rebounds slower lies still: it would rise by 50 nm
STEPS = 32  # of half a flight at the first impact's speed; of slower ones fewer, in proportion
_MIN_STEPS = 2

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


@dataclass(frozen=True)
class RealBall:
    """Ball and its drop height.

    Attributes:
        restitution: e, at the first impact's speed.
        slope: p of e(v) = e (v / v_first)^-p, kept from 0 to 1.
        drag_1_m: k of dv/dt = -g - k v |v|.
        drop_m: from its contact with the table up to where it is let go, at rest.
    """

    restitution: float
    slope: float
    drag_1_m: float
    drop_m: float

    @property
    def values(self) -> Array:
        """Parameters in the order of the fields, shape (4,)."""
        return np.array([self.restitution, self.slope, self.drag_1_m, self.drop_m])


@dataclass(frozen=True, eq=False)
class Paths:
    """Motion of B balls: states from each of which one step reaches the next.

    Attributes:
        drops_m: see `RealBall`, shape (B,).
        drags_1_m: likewise, shape (B,).
        times_s: of M states, after the release, shape (B, M), never falling.
        heights_m: over the contact, shape (B, M).
        speeds_m_s: upward, after an impact, shape (B, M).
        impacts_s: of N impacts, shape (B, N); those after the end asked for are not all there.
        impact_speeds_m_s: downward, shape (B, N); 0 once it lies.
        rests_s: from when on a ball lies still, shape (B,); inf where it does not.
    """

    drops_m: Array
    drags_1_m: Array
    times_s: Array
    heights_m: Array
    speeds_m_s: Array
    impacts_s: Array
    impact_speeds_m_s: Array
    rests_s: Array

    def at(self, seconds: Array) -> Array:
        """Return heights over the contact [m], shape (B, T), at times after the release, (B, T)."""
        rows = np.arange(len(seconds))[:, None]
        since = np.maximum(seconds, 0.0)
        found = [
            np.searchsorted(own, asked, side="right") - 1
            for own, asked in zip(self.times_s, since, strict=True)
        ]
        states = np.array(found)
        heights, _ = _stepped(
            self.heights_m[rows, states],
            self.speeds_m_s[rows, states],
            since - self.times_s[rows, states],
            self.drags_1_m[:, None],
        )
        heights = np.where(since >= self.rests_s[:, None], 0.0, heights)
        return np.where(seconds <= 0, self.drops_m[:, None], heights)


def fallen(balls: Array, until_s: float, steps: int = STEPS) -> Paths:
    """Integrate balls (restitution, slope, drag [1/m], drop [m]), shape (B, 4), until they lie."""
    restitutions, slopes, drags, drops = np.asarray(balls, dtype=np.float64).T
    tape = _Tape(drags, np.zeros(len(drops)), drops, np.zeros(len(drops)))
    first = tape.fall(steps)
    impacts, speeds = [tape.time], [first]
    rests = np.full(len(drops), np.inf)
    hit = first
    while True:
        ratio = np.maximum(hit, MIN_SPEED_M_S) / first
        up = np.clip(restitutions * ratio**-slopes, 0.0, 1.0) * hit
        still = up < _STILL_M_S
        rests = np.where(still & np.isinf(rests), tape.time, rests)
        if np.all(still | (tape.time > until_s)):
            break
        count = max(_MIN_STEPS, int(np.ceil(steps * np.max(up / first))))
        tape.rise(np.where(still, 0.0, up), count)
        hit = np.where(still, 0.0, tape.fall(count))
        impacts.append(tape.time)
        speeds.append(hit)
    return Paths(
        drops,
        drags,
        *(np.array(column).T for column in zip(*tape.states, strict=True)),
        impacts_s=np.array(impacts).T,
        impact_speeds_m_s=np.array(speeds).T,
        rests_s=rests,
    )


class _Tape:
    """States of B balls as they are stepped, each a time, a height and a speed of shape (B,)."""

    def __init__(self, drags: Array, time: Array, height: Array, speed: Array) -> None:
        self._drags = drags
        self.time, self._height, self._speed = time, height, speed
        self.states: list[tuple[Array, Array, Array]] = []

    def _go(self, step: Array) -> None:
        self.states.append((self.time, self._height, self._speed))
        self._height, self._speed = _stepped(self._height, self._speed, step, self._drags)
        self.time = self.time + step

    def rise(self, speed: Array, count: int) -> None:
        """Step from the table to the apex, in `count` steps."""
        self._height, self._speed = np.zeros_like(speed), speed
        inner = speed[:, None] / 2 * (_NODES + 1)
        pace = 1 / (GRAVITY_M_S2 + self._drags[:, None] * inner**2)
        step = speed / 2 * (pace @ _WEIGHTS) / count
        for _ in range(count):
            self._go(step)

    def fall(self, count: int) -> Array:
        """Step from the apex to the table; return the speed there, downward, shape (B,).

        As long as it would take without air in `count` steps, nearly all of the rest in a few.
        """
        self._height = np.maximum(self._height, 0.0)
        without_air = np.sqrt(2 * self._height / GRAVITY_M_S2)
        for _ in range(count):
            self._go(without_air / count)
        few = max(1, count // 4)
        slowed = 0.98 * self._rest()
        for _ in range(few):
            self._go(slowed / few)
        self._go(self._rest())
        return -self._speed

    def _rest(self) -> Array:
        """Find by Newton's method how long one step to the table takes, shape (B,)."""
        pull = GRAVITY_M_S2 - self._drags * self._speed**2
        height, speed = np.maximum(self._height, 0.0), np.minimum(self._speed, 0.0)
        rest = (speed + np.sqrt(speed**2 + 2 * pull * height)) / pull
        for _ in range(5):
            after, faster = _stepped(height, speed, rest, self._drags)
            rest = np.maximum(rest - after / np.minimum(faster, -1e-9), 0.0)
        return rest


def _stepped(height: Array, speed: Array, step: Array, drag: Array) -> tuple[Array, Array]:
    """Return heights and speeds one Runge-Kutta step later."""

    def pull(speed: Array) -> Array:
        return -GRAVITY_M_S2 - drag * speed * np.abs(speed)

    half = step / 2
    first = pull(speed)
    second = pull(speed + half * first)
    third = pull(speed + half * second)
    fourth = pull(speed + step * third)
    went = step * (speed + step / 6 * (first + second + third))
    return height + went, speed + step / 6 * (first + 2 * (second + third) + fourth)
