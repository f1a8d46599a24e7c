"""Simulate a shot in the hidden world, on the rig as it stands there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from analysis.evaluation.shots.ground_truth_sim import (
    RADIUS_M,
    HiddenBall,
    Vector,
    incline,
    ring,
    run_ball,
)
from recorders.simulators.shot.rig import ShotRig

ACROSS_SD_M = 0.0015
# Standard deviations of a robot's release, along each horizontal axis and in height.
HEIGHT_SD_M = 0.002

_RIM_RESTITUTION = 0.55  # of any ball on the hoop's rim: less lively than on the plane
_MAX_S = 4.0  # after which a shot is over: the ball is below the hoop long before


@dataclass(frozen=True)
class HiddenShot:
    """Result of a shot.

    Attributes:
        is_through: the ball fell through the hoop.
        has_touched: it hit the rim.
        miss_m: from the hoop's centre where its centre first came down through the hoop's plane
            after the bounce, negative where that was short of it; None where it never did.
    """

    is_through: bool
    has_touched: bool
    miss_m: float | None


def take_shot(
    ball: HiddenBall, rig: ShotRig, height_m: float, rng: np.random.Generator, *, errs: bool = True
) -> HiddenShot:
    """Drop a ball above the plane with a robot's release error, or none if not `errs`."""
    tilt = math.radians(rig.plane.incline_deg)
    off = rng.normal(0.0, 1.0, 3) * (ACROSS_SD_M, ACROSS_SD_M, HEIGHT_SD_M) * errs
    start: Vector = (
        RADIUS_M * math.sin(tilt) + float(off[0]),
        float(off[1]),
        RADIUS_M * math.cos(tilt) + max(height_m + float(off[2]), 0.001),
    )
    hoop = rig.hoop
    middle = (hoop.forward_m, 0.0, hoop.up_m)
    rod_m = hoop.rim_m / 2
    obstacles = (
        incline(tilt, rig.plane.downhill_m),
        ring(middle, hoop.free_radius_m + rod_m, rod_m, _RIM_RESTITUTION),
    )
    low_m = hoop.up_m - 3 * RADIUS_M
    run = run_ball(ball, start, obstacles, _MAX_S, rng, is_over=lambda at: at[2] < low_m)
    crossings = _down_through(run.positions_m, hoop.up_m)
    misses = [math.hypot(x - hoop.forward_m, y) for x, y in crossings]
    return HiddenShot(
        is_through=bool(misses) and misses[-1] < hoop.free_radius_m,
        has_touched=any(which == 1 for which, _ in run.hits),
        miss_m=math.copysign(misses[0], crossings[0][0] - hoop.forward_m) if misses else None,
    )


def _down_through(positions_m: np.ndarray, level_m: float) -> list[tuple[float, float]]:
    """Return points (x, y) [m] where a path, shape (T, 3), comes down through a level."""
    heights = positions_m[:, 2]
    found = []
    for row in np.flatnonzero((heights[:-1] >= level_m) & (heights[1:] < level_m)).tolist():
        fraction = (heights[row] - level_m) / (heights[row] - heights[row + 1])
        x, y, _ = positions_m[row] + fraction * (positions_m[row + 1] - positions_m[row])
        found.append((float(x), float(y)))
    return found
