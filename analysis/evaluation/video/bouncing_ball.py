"""Integrate a bouncing ball from impact to impact: a truth that no fit shares.

The fit has the bounce in closed form (`recorders/simulators/closed_form/bounce.py`). Here the
equation of motion is stepped (classical Runge-Kutta, fourth order), and each impact is met within
its step (Newton's method).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tunenet_logs.arrays import Array

GRAVITY_M_S2 = 9.81

_STEPS_A_FALL = 100  # in air. Without it one step is exact, however long.
_AT_REST = 1e-4  # fraction of the first impact's speed below which the ball lies still


@dataclass(frozen=True)
class DroppedBall:
    """Ball and its drop.

    Attributes:
        drop_m: height over its contact at the start.
        restitution: at the first impact.
        slope: p of e_n = e_1 (v_n / v_1)^-p; no impact gives more than it takes.
        drag_1_m: deceleration by the air over speed squared.
        speed_m_s: at the start, upward.
    """

    drop_m: float
    restitution: float
    slope: float = 0.0
    drag_1_m: float = 0.0
    speed_m_s: float = 0.0

    @property
    def fall_s(self) -> float:
        """Duration of a fall from rest without air."""
        return float(np.sqrt(2 * self.drop_m / GRAVITY_M_S2))


@dataclass(frozen=True, eq=False)
class Fall:
    """Motion of a dropped ball.

    Attributes:
        heights_m: over its contact, at the given times, shape (T,).
        impacts_s: up to the last of these times, or to the end of all bounces, shape (N,).
        impact_speeds_m_s: downward, shape (N,).
    """

    heights_m: Array
    impacts_s: Array
    impact_speeds_m_s: Array


def drop_ball(ball: DroppedBall, seconds: Array) -> Fall:
    """Integrate the ball at increasing times after its start, shape (T,); held before."""
    heights = np.full(len(seconds), ball.drop_m)
    longest = ball.fall_s / _STEPS_A_FALL if ball.drag_1_m else np.inf
    clock, height, speed = 0.0, ball.drop_m, ball.speed_m_s
    impacts: list[tuple[float, float]] = []
    resting = False
    for index in np.flatnonzero(seconds > 0):
        while not resting and clock < seconds[index]:
            step = min(float(seconds[index]) - clock, longest)
            after, faster = _step(height, speed, step, ball.drag_1_m)
            if after >= 0:
                clock, height, speed = clock + step, after, faster
                continue
            step, hit = _contact(height, speed, step, ball.drag_1_m)
            impacts.append((clock + step, hit))
            clock, height, speed = clock + step, 0.0, _rebound(ball, hit, impacts[0][1])
            resting = speed <= _AT_REST * impacts[0][1]
        heights[index] = 0.0 if resting else height
    times, speeds = np.array(impacts).reshape(-1, 2).T
    return Fall(heights, times, speeds)


def _rebound(ball: DroppedBall, hit: float, first: float) -> float:
    if hit <= 0:
        return 0.0
    return min(ball.restitution * (hit / first) ** -ball.slope, 1.0) * hit


def _step(height: float, speed: float, step: float, drag: float) -> tuple[float, float]:
    """Return height and upward speed one step later (Runge-Kutta-Nyström, fourth order)."""

    def accelerated(velocity: float) -> float:
        return -GRAVITY_M_S2 - drag * velocity * abs(velocity)

    half = step / 2
    first = accelerated(speed)
    second = accelerated(speed + half * first)
    third = accelerated(speed + half * second)
    fourth = accelerated(speed + step * third)
    gained = step / 6 * (first + 2 * second + 2 * third + fourth)
    went = step * speed + step**2 / 6 * (first + second + third)
    return height + went, speed + gained


def _contact(height: float, speed: float, most: float, drag: float) -> tuple[float, float]:
    """Find by Newton's method when a step touches, and how fast (downward)."""
    step = (speed + np.sqrt(speed**2 + 2 * GRAVITY_M_S2 * height)) / GRAVITY_M_S2
    step = min(float(step), most)
    for _ in range(6):  # Newton; exact at once without air
        after, faster = _step(height, speed, step, drag)
        if faster < 0:
            step = min(max(step - after / faster, 0.0), most)
    return step, max(-_step(height, speed, step, drag)[1], 0.0)
