"""Tracks of bouncing balls as uncalibrated cameras show them, for testing what is made of films.

The ball is integrated from impact to impact here, by nothing that the fit uses; what a tracker adds
is noise, whole pixels, gaps, and pictures in which the ball is held, out of view or not found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.observe.tracking.track import Track

Array = NDArray[np.float64]

_G_M_S2 = 9.81
_SIZE_PX = (320, 240)
_MARGIN_PX = 4.0


@dataclass(frozen=True)
class Ball:
    """What falls.

    Attributes:
        drop_m: height of the fall.
        restitution: at the first impact.
        slope: p of e_n = e (v_n / v_1)^-p.
        drag_1_m: quadratic drag, deceleration over speed squared.
    """

    drop_m: float
    restitution: float
    slope: float = 0.0
    drag_1_m: float = 0.0


def heights_m(ball: Ball, seconds: Array) -> Array:
    """Height over the table [m] at times after the release at 0; before, the ball is held.

    Integrated in steps of a millisecond or less, each impact met within its step.
    """
    end = float(seconds[-1])
    clock, height, speed, first = 0.0, ball.drop_m, 0.0, 0.0
    times, places = [0.0], [ball.drop_m]
    step = 1e-3 if not ball.drag_1_m else 2e-4
    while clock < end:
        acceleration = -_G_M_S2 - ball.drag_1_m * speed * abs(speed)
        after = height + speed * step + acceleration * step**2 / 2
        if after > 0:
            clock, height, speed = clock + step, after, speed + acceleration * step
        else:
            part = (speed + np.sqrt(speed**2 - 2 * acceleration * height)) / -acceleration
            clock, height, speed = clock + part, 0.0, speed + acceleration * part
            first = first or -speed
            speed = ball.restitution * (-speed / first) ** -ball.slope * -speed
            if speed < 1e-3 * first:
                break
        times.append(clock)
        places.append(height)
    times.append(max(end, clock) + 1.0)
    places.append(places[-1] if clock >= end else 0.0)
    curve = np.interp(seconds, times, places)
    return np.where(seconds < 0, ball.drop_m, curve)


@dataclass(frozen=True)
class TrackSet:
    """A kind of rig.

    Attributes:
        drop_m: range of the fall.
        rates_hz: range of the frame rate; None for 6 to 150 frames a fall.
        distance: range of the camera's distance [falls].
        elevation_deg: range of its elevation above the middle of the fall.
        free: whether releases may be unseen, and pictures without the ball.
    """

    name: str
    drop_m: tuple[float, float]
    rate_hz: float | None
    distance: tuple[float, float]
    elevation_deg: tuple[float, float]
    free: bool


PAPERS = TrackSet("A", (3.5, 4.5), 60.0, (1.2, 2.4), (24.0, 50.0), free=False)
ANY_POSE = TrackSet("B", (0.2, 5.0), 60.0, (1.2, 4.0), (-10.0, 50.0), free=False)
ANYTHING = TrackSet("C", (0.2, 5.0), None, (1.2, 4.0), (-10.0, 50.0), free=True)


def draw_track(
    which: TrackSet, ball: tuple[float, float], noise_px: float, seed: int
) -> tuple[Ball, Track]:
    """A ball of restitution within `ball`, and its track."""
    rng = np.random.default_rng([seed, *which.name.encode()])
    dropped = Ball(float(rng.uniform(*which.drop_m)), float(rng.uniform(*ball)))
    return dropped, film_track(which, dropped, noise_px, rng)


def film_track(which: TrackSet, ball: Ball, noise_px: float, rng: np.random.Generator) -> Track:
    """The track of a given ball through a random camera of the set."""
    fall_s = float(np.sqrt(2 * ball.drop_m / _G_M_S2))
    rate_hz = which.rate_hz or float(np.exp(rng.uniform(*np.log([6, 150])))) / fall_s
    held_s = rng.uniform(0.0, 0.6) if not which.free else rng.uniform(-0.6, 0.6) * fall_s
    seconds = np.arange(-held_s, rng.uniform(4.0, 6.0) * fall_s, 1 / rate_hz)
    up = heights_m(ball, seconds)
    places, radius = _through_camera(which, ball, up, rng)
    places = np.round(places + rng.normal(0.0, noise_px, places.shape))
    lost = np.zeros(len(seconds), dtype=bool)
    if which.free:
        lost = rng.random(len(seconds)) < rng.uniform(0.0, 0.1)
        if rng.random() < 0.3:
            gap = rng.uniform(0.05, 0.3) * fall_s
            start = rng.uniform(-0.5, 3.0) * fall_s
            lost |= (seconds > start) & (seconds < start + gap)
    places[lost] = np.nan
    return Track(
        stamps_ns=np.round((seconds - seconds[0]) * 1e9).astype(np.int64),
        places_px=places,
        radius_px=np.where(lost, np.nan, radius),
        confidence=(~lost).astype(np.float64),
        size_px=_SIZE_PX,
        gravity_px=np.array([0.0, 1.0]),
        colour=(128, 128, 128),
    )


def _through_camera(
    which: TrackSet, ball: Ball, up_m: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Pixels, shape (T, 2), and radii, of a ball above the origin; all of the fall is in view."""
    while True:
        distance = ball.drop_m * rng.uniform(*which.distance)
        elevation = np.radians(rng.uniform(*which.elevation_deg))
        roll = np.radians(rng.normal(0.0, 4.0))
        focal = _SIZE_PX[1] / 2 / np.tan(np.radians(rng.uniform(40.0, 60.0)) / 2)
        aim = ball.drop_m * np.array([rng.normal(0.0, 0.1), rng.uniform(0.35, 0.6)])
        position = np.array([-distance * np.cos(elevation), aim[1] + distance * np.sin(elevation)])
        forward = np.array([-position[0], aim[1] - position[1]])
        forward /= np.linalg.norm(forward)
        upward = np.array([-forward[1], forward[0]])
        offset = np.column_stack([np.full_like(up_m, -position[0]), up_m - position[1]])
        depth = offset @ forward
        across = np.column_stack([np.full_like(up_m, -aim[0]), -(offset @ upward)])
        turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
        pixels = (np.array(_SIZE_PX) - 1) / 2 + focal * (across @ turn.T) / depth[:, None]
        inside = (pixels > _MARGIN_PX) & (pixels < np.array(_SIZE_PX) - 1 - _MARGIN_PX)
        if depth.min() > 0 and inside.all() and np.ptp(pixels[:, 1]) > 0.4 * _SIZE_PX[1]:
            return pixels, focal * 0.03 * ball.drop_m / depth
