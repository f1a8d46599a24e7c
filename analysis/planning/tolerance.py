"""Tolerances of a shot: ranges of height, restitution and drag in which the ball passes.

Heights and restitutions are simulated on a grid around a shot, which is widened until the ball does
not pass, and drags on one from zero up; between grid points, the end is where the linearly
interpolated gap is zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.planning.known_ball import KnownBall
from recorders.simulators.bounce_shot import passes
from recorders.simulators.shot.flight import Flights
from recorders.simulators.shot.rig import ShotRig
from tunenet_logs.arrays import Array

Range = tuple[float, float]  # lower and upper end
# Beyond the reach: 30 mm, or more standard deviations of a height than a shot is ever off.
_ROOM_M, _ROOM_SDS = 0.03, 5

# Beyond the reach: a shot that passes even from there is reported as passing that far.
_MAX_ROOM_M = 1.0

# Heights that are tried at a time beyond either end of the reach: as dense as those within it, but
# enough to find an end, and not too many for the time a user waits.
_MIN_COUNT, _MAX = 12, 100

# Of the restitution, to either side, at first: the default hoop forgives about 0.04.
_FIRST_SHIFT = 0.15

_SHIFTS = 15  # that are tried at a time to either side: a hundredth apart at first
_MIN_HEIGHT_M = 0.005  # the lowest height that is tried: from 0 m a ball has no impact
# Drags that are tried at a time to either side: down to none, and up by so much, closer by.
_DRAGS, _MAX_DRAG_1_M = 12, 0.5

# [m] Added to the negative gap of a ball that passes outside, to tell it from one that touches.
_OUTSIDE = -1.0


def signed_gap_m(flights: Flights) -> Array:
    """Return the gap of ball and rim, shape (N,) [m]; negative unless it passes freely inside."""
    return np.where(flights.is_through, flights.gap_m, -np.abs(flights.gap_m) + _OUTSIDE)


def height_ends(
    rig: ShotRig, ball: KnownBall, heights_m: Array, gaps_m: Array, which: NDArray[np.int64]
) -> list[Range]:
    """Find, around each given height, the least and greatest [m] from which the ball passes.

    The search goes beyond the reach too: by five standard deviations of a height or 30 mm, and
    on until the ball does not pass, or for 1 m.

    Args:
        rig: Plane, hoop and reach.
        ball: With its uncertainty.
        heights_m: Ascending, shape (N,).
        gaps_m: Signed, at these, shape (N,).
        which: Indices of heights from which it passes, shape (M,).

    Returns:
        M ranges.
    """
    wide, gaps, before = heights_m, gaps_m, 0
    pitch_m = (heights_m[-1] - heights_m[0]) / (len(heights_m) - 1)
    room_m = max(_ROOM_M, _ROOM_SDS * rig.release.height_sd_m)
    most_m = max(_MAX_ROOM_M, room_m)
    while True:
        count = int(np.clip(np.ceil(room_m / pitch_m), _MIN_COUNT, _MAX))
        lowest, highest = max(wide[0] - room_m, _MIN_HEIGHT_M), wide[-1] + room_m
        below = np.linspace(lowest, wide[0], count, endpoint=False)
        above = np.linspace(wide[-1], highest, count + 1)[1:]
        beyond = np.concatenate([below, above])
        more = signed_gap_m(passes(rig, ball.law, beyond, np.zeros(2 * count)))
        wide = np.concatenate([below, wide, above])
        gaps = np.concatenate([more[:count], gaps, more[count:]])
        before += count
        found = [_ends(wide, gaps, before + index) for index in which.tolist()]
        is_open = any(low == wide[0] > _MIN_HEIGHT_M or high == wide[-1] for low, high in found)
        if not is_open or highest >= heights_m[-1] + most_m:
            return found
        room_m *= 2


def restitution_ends(rig: ShotRig, ball: KnownBall, heights_m: Array, values: Array) -> list[Range]:
    """Find how far each shot's restitution may be off, down and up, while the ball still passes.

    Args:
        rig: Plane, hoop and reach.
        ball: With its uncertainty.
        heights_m: From which it passes, shape (N,).
        values: Its restitutions there, shape (N,); ends beyond 0 and 1 are not searched.

    Returns:
        N ranges of differences from `values`.
    """
    shifts = np.linspace(-_FIRST_SHIFT, _FIRST_SHIFT, 2 * _SHIFTS + 1)
    gaps = _shifted_gaps_m(rig, ball, heights_m, shifts)
    while True:
        most = float(shifts[-1])
        found = [_ends(shifts, one, len(shifts) // 2) for one in gaps]
        low, high = np.array(found).T
        is_open = (low == -most) & (values > most) | (high == most) & (values + most < 1)
        if most >= 1 or not is_open.any():
            return found
        outer = np.linspace(most, min(2 * most, 1.0), _SHIFTS + 1)[1:]
        beyond = np.concatenate([-outer[::-1], outer])
        more = np.full((len(heights_m), len(beyond)), _OUTSIDE)
        more[is_open] = _shifted_gaps_m(rig, ball, heights_m[is_open], beyond)
        shifts = np.concatenate([beyond[:_SHIFTS], shifts, beyond[_SHIFTS:]])
        gaps = np.hstack([more[:, :_SHIFTS], gaps, more[:, _SHIFTS:]])


def drag_ends(rig: ShotRig, ball: KnownBall, heights_m: Array) -> list[Range]:
    """Find, around the ball's drag, the least and greatest [1/m] with which it passes.

    The search goes from zero to 0.5 /m more.

    Args:
        rig: Plane, hoop and reach; its ball's drag is the middle.
        ball: With its uncertainty.
        heights_m: From which it passes, shape (N,).

    Returns:
        N ranges.
    """
    middle_1_m = rig.ball.air_drag_1_m
    away = np.linspace(0.0, 1.0, _DRAGS + 1)[1:] ** 2
    below = middle_1_m * (1 - away[::-1]) if middle_1_m else np.zeros(0)
    drags = np.concatenate([below, [middle_1_m], middle_1_m + _MAX_DRAG_1_M * away])
    heights, tried = np.repeat(heights_m, len(drags)), np.tile(drags, len(heights_m))
    flights = passes(rig, ball.law, heights, np.zeros(len(heights)), tried)
    gaps = signed_gap_m(flights).reshape(len(heights_m), len(drags))
    return [_ends(drags, one, len(below)) for one in gaps]


def _shifted_gaps_m(rig: ShotRig, ball: KnownBall, heights_m: Array, shifts: Array) -> Array:
    """Compute signed gaps at N heights and S restitution shifts, shape (N, S) [m]."""
    grid = np.repeat(heights_m, len(shifts)), np.tile(shifts, len(heights_m))
    return signed_gap_m(passes(rig, ball.law, *grid)).reshape(len(heights_m), len(shifts))


def _ends(values: Array, gaps: Array, index: int) -> Range:
    """Interpolate the range of ascending `values` around `index` where `gaps` [m] are positive."""
    found = []
    for way in (-1, 1):
        at = index
        while 0 <= at + way < len(values) and gaps[at + way] > 0:
            at += way
        end = float(values[at])
        if 0 <= at + way < len(values):
            inside, outside = gaps[at], gaps[at + way]
            # Only a ball inside the hoop has a gap that goes through zero where it touches.
            fraction = inside / (inside - outside) if outside > _OUTSIDE else 0.5
            end += float(fraction * (values[at + way] - values[at]))
        found.append(end)
    return found[0], found[1]
