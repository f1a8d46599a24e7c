"""Simulate the track of a drop before a camera, without rendering it.

A pinhole stands anywhere from which a person films a drop. Places have noise and are not rounded.
"""

from __future__ import annotations

import numpy as np

from analysis.evaluation.real_balls.drops import RecordedDrop
from analysis.evaluation.real_balls.physics import GRAVITY_M_S2
from analysis.tracking.track import Track
from tunenet_logs.arrays import Array

NOISE_PX = 0.3  # standard deviation of a coordinate
SIZE_PX = (320, 240)  # width and height of a picture
_AWAY = (1.5, 5.0)
_ELEVATION_DEG = (-10.0, 35.0)
_ROLL_DEG = 3.0
_IN_PICTURE = (0.5, 0.85)
# Of the camera: distance in drop heights, elevation seen from the middle of the drop, standard
# deviation of its roll, the drop over the picture's height, and how far the ball is from the middle
# column at most.
_ASIDE_PX = 40.0

_PLUMB_DEG = 1.0
# Standard deviations of what a tracker says: of the vertical's direction and of a radius.
_RADIUS_NOISE = 0.03


def filmed(drop: RecordedDrop, radius_m: float, rng: np.random.Generator) -> Track:
    """Simulate the track of the ball; `drop` says when a picture is taken."""
    pixels, depth_m, focal_px = _seen(drop, rng)
    noise = rng.normal(0.0, 1.0, (len(pixels), 3))
    places = pixels[2:] + NOISE_PX * noise[2:, :2]
    radii = focal_px * radius_m / depth_m[2:] * (1 + _RADIUS_NOISE * noise[2:, 2])
    inside = np.all((places > 0) & (places < np.array(SIZE_PX) - 1), axis=1)
    places[~inside], radii[~inside] = np.nan, np.nan
    plumb = (pixels[1] - pixels[0]) * GRAVITY_M_S2 / drop.ball.drop_m
    return Track(
        stamps_ns=drop.stamps_ns,
        places_px=places,
        radius_px=radii,
        confidence=inside.astype(np.float64),
        size_px=SIZE_PX,
        gravity_px=_turn(np.radians(rng.normal(0.0, _PLUMB_DEG))) @ plumb,
        colour=(200, 120, 60),
    )


def _seen(drop: RecordedDrop, rng: np.random.Generator) -> tuple[Array, Array, float]:
    """Return pixels, shape (2 + T, 2), depths, shape (2 + T,) [m], and focal length [px].

    Of the release and the contact, then of the ball in each picture.
    """
    fall_m = drop.ball.drop_m
    heights = np.concatenate([[fall_m, 0.0], drop.truth_m(drop.seconds)])
    away = fall_m * rng.uniform(*_AWAY)
    elevation = np.radians(rng.uniform(*_ELEVATION_DEG))
    elevation = max(elevation, -np.arctan2(0.4 * fall_m, away))  # not from under the table
    up = heights - fall_m / 2
    depth = away - up * np.sin(elevation)
    rows = -up * np.cos(elevation) / depth
    focal = rng.uniform(*_IN_PICTURE) * SIZE_PX[1] / float(rows[1] - rows[0])
    down = focal * (rows - (rows[0] + rows[1]) / 2)
    across = np.full_like(down, rng.uniform(-_ASIDE_PX, _ASIDE_PX)) * away / depth
    turned = np.column_stack([across, down]) @ _turn(np.radians(rng.normal(0.0, _ROLL_DEG))).T
    return turned + (np.array(SIZE_PX) - 1) / 2, depth, focal


def _turn(angle: float) -> Array:
    """Return the rotation by an angle [rad], shape (2, 2)."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])
