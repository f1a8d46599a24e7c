"""Paths of balls that spoil a drop, each in place of the good one's.

A path is a function of a scene and a random generator, and gives points [m], shape (T, 3), at the
times of the scene's pictures: of one that lasts for six fall times at least.
"""

from __future__ import annotations

import numpy as np

from analysis.evaluation.video.bouncing_ball import GRAVITY_M_S2, DroppedBall, drop_ball
from analysis.evaluation.video.tracks import TrackScene, upright
from tunenet_logs.arrays import Array

# Fraction of the first impact's speed at which a ball that will roll off moves sideways.
_SIDEWAYS = (0.05, 0.25)

_BELOW = (0.3, 1.5)  # from the table down to the next thing that it hits [drop heights]
_TILT_DEG = (10.0, 45.0)  # of an edge's normal where the ball hits it, from the vertical
# Fraction of the way to the camera that a drifting ball goes in a fall time.
_TOWARDS = (0.05, 0.15)

_CATCH_FALLS = (0.05, 0.15)  # how long hands give way [fall times]


def rolls_off(scene: TrackScene, rng: np.random.Generator) -> Array:
    """Roll or fly over the edge after the first or second bounce, and fall."""
    fall = scene.fall()
    bounces = int(rng.integers(1, 3))
    landed_s, speed = fall.impacts_s[bounces], fall.impact_speeds_m_s[bounces]
    off_s = landed_s
    if rng.random() < 0.5:
        off_s, speed = landed_s + scene.ball.fall_s * rng.uniform(0.0, 1.0), 0.0
    below = _from_above(scene, off_s, scene.ball.drop_m * rng.uniform(*_BELOW), -speed)
    heights = np.where(scene.seconds < landed_s, fall.heights_m, below)
    sideways_m_s = rng.uniform(*_SIDEWAYS) * fall.impact_speeds_m_s[0]
    return _moving(scene, heights, fall.impacts_s[0], sideways_m_s, rng)


def edge_first(scene: TrackScene, rng: np.random.Generator) -> Array:
    """Hit an edge at the first impact."""
    return _edge(scene, 0, rng)


def edge_second(scene: TrackScene, rng: np.random.Generator) -> Array:
    """Hit an edge at the second impact."""
    return _edge(scene, 1, rng)


def thrown(scene: TrackScene, rng: np.random.Generator) -> Array:
    """Throw up and catch, once or twice, without an impact."""
    heights = np.zeros(len(scene.seconds))
    start_s, top_m = 0.0, scene.ball.drop_m * rng.uniform(0.6, 1.0)
    for _ in range(int(rng.integers(1, 3))):
        speed = np.sqrt(2 * GRAVITY_M_S2 * top_m)
        lasts_s = 2 * speed / GRAVITY_M_S2 * rng.uniform(0.9, 1.0)
        since = np.maximum(scene.seconds - start_s, 0.0)
        flight = np.minimum(since, lasts_s)
        heights += speed * flight - GRAVITY_M_S2 / 2 * flight**2
        caught_m_s = speed - GRAVITY_M_S2 * lasts_s
        heights += _given_way(scene, since - lasts_s, caught_m_s, rng)
        start_s += lasts_s + scene.ball.fall_s * rng.uniform(0.5, 1.2)
        top_m *= rng.uniform(0.3, 0.9)
    return upright(heights)


def held(scene: TrackScene, rng: np.random.Generator) -> Array:
    """Hold in a hand that is not still."""
    drop_m, fall_s = scene.ball.drop_m, scene.ball.fall_s
    reach_m = drop_m * rng.uniform(0.02, 0.15)
    slow_s = fall_s * rng.uniform(0.3, 1.0)
    hand = [smooth_noise(scene.seconds, slow_s, rng) for _ in range(3)]
    middle = np.array([0.0, 0.0, drop_m * rng.uniform(0.4, 0.9)])
    return middle + reach_m * np.column_stack(hand)


def caught(scene: TrackScene, rng: np.random.Generator) -> Array:
    """Catch in the flight after the first bounce, and carry on."""
    fall, ball = scene.fall(), scene.ball
    up_m_s = ball.restitution * fall.impact_speeds_m_s[0]
    flown_s = 2 * up_m_s / GRAVITY_M_S2 * rng.uniform(0.3, 0.95)
    at_m = up_m_s * flown_s - GRAVITY_M_S2 / 2 * flown_s**2
    since = scene.seconds - fall.impacts_s[0] - flown_s
    hand = _given_way(scene, since, up_m_s - GRAVITY_M_S2 * flown_s, rng)
    way = np.clip(since / (ball.fall_s * rng.uniform(1.0, 3.0)), 0.0, 1.0)
    carried_m = rng.uniform(0.0, 0.8) * ball.drop_m * (3 * way**2 - 2 * way**3)
    return upright(np.where(since < 0, fall.heights_m, at_m + hand + carried_m))


def drifts(scene: TrackScene, rng: np.random.Generator) -> Array:
    """Drift towards the camera or away from the release on."""
    towards = np.array([*scene.view.position_m[:2], 0.0])
    rate = rng.choice([-1.0, 1.0]) * rng.uniform(*_TOWARDS)
    gone = np.maximum(scene.seconds, 0.0) / scene.ball.fall_s * rate
    return upright(scene.fall().heights_m) + gone[:, None] * towards


def smooth_noise(seconds: Array, slow_s: float, rng: np.random.Generator) -> Array:
    """Draw a random function of mean 0 and deviation 1 that changes over `slow_s`, (T,)."""
    waves = 40
    rates = rng.normal(0.0, 1.0, waves) / slow_s
    phases = rng.uniform(0.0, 2 * np.pi, waves)
    return np.sqrt(2 / waves) * np.cos(seconds[:, None] * rates + phases).sum(axis=1)


def _edge(scene: TrackScene, hit: int, rng: np.random.Generator) -> Array:
    """Rebound about a tilted normal: over the edge of a table or tile, and on beside it."""
    fall = scene.fall()
    at_s, speed = fall.impacts_s[hit], fall.impact_speeds_m_s[hit]
    tilt = np.radians(rng.uniform(*_TILT_DEG))
    kept = (1 + scene.ball.restitution) * speed * np.cos(tilt)
    up_m_s, sideways_m_s = kept * np.cos(tilt) - speed, kept * np.sin(tilt)
    is_table = rng.random() < 0.5
    below_m = scene.ball.drop_m * rng.uniform(*_BELOW) if is_table else 0.0
    after = _from_above(scene, at_s, below_m, up_m_s if is_table else max(up_m_s, 0.0))
    heights = np.where(scene.seconds < at_s, fall.heights_m, after)
    return _moving(scene, heights, at_s, sideways_m_s, rng)


def _from_above(scene: TrackScene, start_s: float, below_m: float, up_m_s: float) -> Array:
    """Return heights from `start_s` on, where what is hit next lies that far below."""
    ball = DroppedBall(below_m, scene.ball.restitution, speed_m_s=up_m_s)
    return drop_ball(ball, scene.seconds - start_s).heights_m - below_m


def _moving(
    scene: TrackScene, heights: Array, start_s: float, speed_m_s: float, rng: np.random.Generator
) -> Array:
    """Move sideways in any direction, from `start_s` on."""
    way = rng.uniform(0.0, 2 * np.pi)
    gone = speed_m_s * np.maximum(scene.seconds - start_s, 0.0)
    return np.column_stack([gone * np.cos(way), gone * np.sin(way), heights])


def _given_way(scene: TrackScene, since: Array, speed: float, rng: np.random.Generator) -> Array:
    """Return how far a hand that catches at that upward speed goes with it."""
    slow_s = scene.ball.fall_s * rng.uniform(*_CATCH_FALLS)
    after = np.maximum(since, 0.0)
    return speed * after * np.exp(-after / slow_s)
