"""Simulate a ball in each engine, and measure its motion alone."""

from __future__ import annotations

import math

import numpy as np

from analysis.evaluation.engines.exact_engine import EXACT
from analysis.evaluation.real_balls import physics
from analysis.evaluation.real_balls.drops import MIN_FALL
from analysis.evaluation.real_balls.physics import RealBall, fallen
from recorders.simulators.base import GRAVITY_M_S2
from recorders.simulators.contact import CALIBRATED
from recorders.simulators.drop import DRAG, RESTITUTION, SLOPE, TOPIC, DropRig, DropSimulator
from recorders.simulators.engines import engine
from tunenet_logs.arrays import Array

RADIUS_M = 0.05  # of the balls that engines drop
_FINE_HZ = 1920.0
# Samples by which a rebound's height is measured, and until when [fall times without air]: the top
# of the first rebound of a ball that keeps its speed is at 2, in air a little later.
_FINE_FALLS = 2.4

# By which the integrator's clock is slowed: its gravity is then the engines', while restitutions
# and drags, which no clock is in, stay as they are.
CLOCK = math.sqrt(physics.GRAVITY_M_S2 / GRAVITY_M_S2)


def integrated_m(ball: RealBall, seconds: Array) -> Array:
    """Integrate the heights of the underside without an engine [m], shape (T,)."""
    own_s = seconds / CLOCK
    return fallen(ball.values[None], float(own_s[-1])).at(own_s[None])[0]


def simulated_m(name: str, ball: RealBall, seconds: Array) -> Array:
    """Simulate the same heights in an engine of this name, one of `ENGINES`."""
    rig = DropRig(gap_m=ball.drop_m, radius_m=RADIUS_M, times_s=tuple(seconds.tolist()))
    world = engine(name).ball_world(RADIUS_M, CALIBRATED)
    values = {
        RESTITUTION.name: ball.restitution,
        SLOPE.name: ball.slope,
        DRAG.name: ball.drag_1_m,
    }
    episode = DropSimulator(rig, CALIBRATED, world).rollout(values)
    return episode.signals[TOPIC].values[:, 2] - RADIUS_M


def source_m(name: str, ball: RealBall, seconds: Array) -> Array:
    """Return the heights by a target's source: an engine, or the integrator for `EXACT`."""
    return integrated_m(ball, seconds) if name == EXACT else simulated_m(name, ball, seconds)


def fine_seconds(drop_m: float) -> Array:
    """Return times at which a drop's first rebound can be measured, shape (T,)."""
    span_s = _FINE_FALLS * math.sqrt(2 * drop_m / GRAVITY_M_S2)
    return np.arange(0.0, span_s, 1 / _FINE_HZ)


def rebound_restitution(heights_m: Array) -> float:
    """Return the root of the first rebound's height over the drop's; 0 without a rebound."""
    rises = np.diff(heights_m) > 0
    lowest = int(np.argmax(rises))
    falls = np.flatnonzero(~rises[lowest:])
    if not rises.any() or not len(falls):
        return 0.0
    before, top, after = heights_m[lowest + falls[0] - 1 : lowest + falls[0] + 2].tolist()
    bend = before - 2 * top + after  # of the parabola through the three highest
    if bend:
        top -= (after - before) ** 2 / (8 * bend)
    return math.sqrt(max(top, 0.0) / float(heights_m[0]))


def apart_percent(heights_m: Array, others_m: Array) -> float:
    """Return the RMS difference of two motions over the bounces in view [% of the drop]."""
    last = int(np.flatnonzero(heights_m > MIN_FALL * heights_m[0])[-1])
    off_m = (heights_m - others_m)[: last + 1]
    return 100 * float(np.sqrt(np.mean(off_m**2)) / heights_m[0])
