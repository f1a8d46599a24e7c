"""Simulate dropped balls for `tests.bench.lab_files` and `lab_units`: a truth no fit shares.

The motion is stepped (classical Runge-Kutta, fourth order) with the air's drag on the whole
velocity; each impact is met within its step by halving it. Nothing of the analysis or of the
recorders is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Array

GRAVITY_M_S2 = 9.80665

_STEP_S = 0.004  # longest step: far below what any fit could see
_REST_M_S = 0.03  # an impact slower than this is the last one
_AFTER_S, _MAX_S = 0.6, 7.0  # how long a ball is seen at rest, and how long a recording is at most
VERDICTS = ("ok", "suspect", "rejected")  # in the order of the tables


@dataclass(frozen=True, eq=False)
class LabDrop:
    """Drop as a laboratory sees it."""

    restitution: float  # at the first impact
    impact_speed_m_s: float  # of the first impact, downward
    rate_hz: float  # of the samples
    seconds: Array  # of the samples, from 0, shape (T,)
    xyz_m: Array  # seen places, z up, with noise, NaN where the ball was not seen, shape (T, 3)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Mask of the samples that were seen, bool, shape (T,)."""
        return np.isfinite(self.xyz_m[:, 2])


def random_drop(
    rng: np.random.Generator, *, most_unseen: float = 0.3, with_gaps: bool = False
) -> LabDrop:
    """Draw a ball held, let go, bouncing, and at rest if there is time.

    Up to `most_unseen` of the samples are missing; with gaps, half of them in gaps of 20 to 150 ms.
    """
    restitution, slope = float(rng.uniform(0.4, 0.93)), float(rng.uniform(0.0, 0.12))
    drag_1_m, drop_m = float(rng.uniform(0.0, 0.15)), float(rng.uniform(0.4, 2.0))
    heading, drift = rng.uniform(0, 2 * np.pi), rng.uniform(0.0, 0.3)
    held_s = float(rng.uniform(0.3, 1.2))
    rate_hz = float(rng.choice([60, 100, 120, 150, 200, 240, 250, 300, 360]))
    seconds = np.arange(round((held_s + _MAX_S) * rate_hz)) / rate_hz
    velocity = np.array([drift * np.cos(heading), drift * np.sin(heading), 0.0])
    places, speed, rest_s = _motion(
        seconds - held_s, velocity, drop_m, restitution, slope, drag_1_m
    )
    keep = seconds <= held_s + rest_s + _AFTER_S
    seconds, places = seconds[keep], places[keep]
    places = places + rng.uniform([-1, -1, -0.5], [1, 1, 1.0])
    places += rng.normal(0.0, rng.uniform(0.0002, 0.002), places.shape)
    share = float(rng.uniform(0.0, most_unseen))
    missing = rng.random(len(seconds)) < (share / 2 if with_gaps else share)
    while with_gaps and missing.mean() < share:
        begin = int(rng.integers(1, len(seconds) - 1))
        missing[begin : begin + max(1, round(rng.uniform(0.02, 0.15) * rate_hz))] = True
    missing[[0, -1]] = False
    places[missing] = np.nan
    return LabDrop(restitution, speed, rate_hz, seconds, places)


def hand_waved(rng: np.random.Generator, seconds: Array) -> Array:
    """Draw the motion of a hand: smooth, never falling freely [m], shape (T, 3)."""
    places = np.tile(rng.uniform(-1, 1, 3), (len(seconds), 1))
    for hertz in rng.uniform(0.15, 1.1, 4):
        swing, phase = rng.uniform(0.01, 0.12, 3), rng.uniform(0, 2 * np.pi, 3)
        places += swing * np.sin(2 * np.pi * hertz * seconds[:, None] + phase)
    return places + rng.normal(0.0, 0.0005, places.shape)


def still(rng: np.random.Generator, seconds: Array) -> Array:
    """Draw a thing that stands there [m], shape (T, 3)."""
    return rng.uniform(-1, 1, 3) + rng.normal(0.0, 0.0005, (len(seconds), 3))


def _motion(
    seconds: Array,
    velocity: Array,
    drop_m: float,
    restitution: float,
    slope: float,
    drag_1_m: float,
) -> tuple[Array, float, float]:
    """Integrate places over the contact, (T, 3), the first impact's speed, and when it rests.

    Restitution is e_n = e_1 (v_n / v_1)^-slope, at most 1. Before 0 s the ball is held.
    """
    state = np.array([0.0, 0.0, drop_m, *velocity])
    places = np.tile(state[:3], (len(seconds), 1))
    clock, first, rest_s = 0.0, 0.0, np.inf
    for index in np.flatnonzero(seconds > 0):
        while rest_s == np.inf and clock < seconds[index]:
            step = min(float(seconds[index]) - clock, _STEP_S)
            after = _stepped(state, step, drag_1_m)
            if after[2] < 0:
                step, after = _met(state, step, drag_1_m)
                hit = -float(after[5])
                first = first or hit
                after[2] = 0.0
                after[5] = hit * min(1.0, restitution * (hit / first) ** -slope)
                rest_s = clock + step if hit < _REST_M_S else np.inf
            state, clock = after, clock + step
        places[index] = state[:3]
    return places, first, min(rest_s, float(seconds[-1]))


def _met(state: Array, step: float, drag_1_m: float) -> tuple[float, Array]:
    """Bisect for the part of a step after which the ball touches, and its state there."""
    low, high = 0.0, step
    for _ in range(50):
        middle = (low + high) / 2
        if _stepped(state, middle, drag_1_m)[2] < 0:
            high = middle
        else:
            low = middle
    return high, _stepped(state, high, drag_1_m)


def _stepped(state: Array, step: float, drag_1_m: float) -> Array:
    """Take one step of the Runge-Kutta method; the state is x, y, z and their speeds."""
    one = _slope_of(state, drag_1_m)
    two = _slope_of(state + step / 2 * one, drag_1_m)
    three = _slope_of(state + step / 2 * two, drag_1_m)
    four = _slope_of(state + step * three, drag_1_m)
    return state + step / 6 * (one + 2 * two + 2 * three + four)


def _slope_of(state: Array, drag_1_m: float) -> Array:
    speed = state[3:]
    pull = -drag_1_m * float(np.sqrt(speed @ speed)) * speed
    pull[2] -= GRAVITY_M_S2
    return np.concatenate([speed, pull])
