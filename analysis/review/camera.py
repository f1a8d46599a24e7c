"""Where a scene is looked at from, so that all of it is seen."""

from __future__ import annotations

import math

import numpy as np
import rerun.blueprint as rrb

from tunenet_logs.arrays import Array

_UP_RAD = 0.35
"""Of the camera, from the level: links hide each other less."""

_TAN_ACROSS, _TAN_UP = 0.36, 0.5
"""Tangents of half of what the camera sees."""


def eye_controls(points_m: Array, azimuth_rad: float, margin_m: float) -> rrb.EyeControls3D:
    """A camera that stands so far away that it sees all points.

    Args:
        points_m: shape (P, 3).
        azimuth_rad: the direction that it stands in, from x to y.
        margin_m: around each point.
    """
    middle = (points_m.min(axis=0) + points_m.max(axis=0)) / 2
    level = math.cos(_UP_RAD)
    towards = np.array(
        [level * math.cos(azimuth_rad), level * math.sin(azimuth_rad), math.sin(_UP_RAD)]
    )
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    off = points_m - middle
    distances_m = [
        (np.abs(off @ across) + margin_m) / half + off @ towards
        for across, half in ((right, _TAN_ACROSS), (np.cross(towards, right), _TAN_UP))
    ]
    eye = middle + float(np.max(distances_m)) * towards
    return rrb.EyeControls3D(
        position=eye.tolist(), look_target=middle.tolist(), eye_up=(0.0, 0.0, 1.0)
    )
