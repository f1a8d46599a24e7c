"""Place a 3D view's camera so that the whole scene is visible."""

from __future__ import annotations

import math

import numpy as np
import rerun.blueprint as rrb

from tunenet_logs.arrays import Array

_UP_RAD = 0.35  # of the camera, from the level: links hide each other less
_TAN_ACROSS, _TAN_UP = 0.36, 0.5  # Tangents of half of what the camera sees


def eye_controls(points_m: Array, azimuth_rad: float, margin_m: float) -> rrb.EyeControls3D:
    """Return a camera far enough away to see all points.

    Args:
        points_m: Shape (P, 3).
        azimuth_rad: Direction to the camera, from x to y.
        margin_m: Around each point.
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
