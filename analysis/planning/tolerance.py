"""How far off a shot may be and the ball still passes: looked for until it does not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.planning.known_ball import KnownBall
from recorders.simulators.bounce_shot import passes
from recorders.simulators.shot.flight import Flights
from recorders.simulators.shot.rig import ShotRig
from tunenet_logs.arrays import Array

Range = tuple[float, float]

_ROOM_M = 0.03
_ROOM_SDS = 5
_MOST_ROOM_M = 1.0
"""Beyond the reach; what passes even there is told as passing so far."""

_FEWEST, _MOST = 12, 100
"""Heights that are tried at a time beyond either end of the reach."""

_FIRST_SHIFT = 0.15
_SHIFTS = 15
"""That are tried at a time to either side."""

_LEAST_HEIGHT_M = 0.005
_OUTSIDE = -1.0


def signed_gap_m(flights: Flights) -> Array:
    """Between ball and rim where it passes inside; negative where it touches or passes outside."""
    return np.where(flights.is_through, flights.gap_m, -np.abs(flights.gap_m) + _OUTSIDE)


def height_ends(
    rig: ShotRig, ball: KnownBall, heights_m: Array, gaps_m: Array, which: NDArray[np.int64]
) -> list[Range]:
    """The heights around each of those asked for between which the ball passes.

    They are looked for beyond the reach too: as far as five standard deviations of a height and
    30 mm, and on until the ball does not pass, or for 1 m.

    Args:
        rig: where.
        ball: which.
        heights_m: ascending, shape (N,).
        gaps_m: signed, at these, shape (N,).
        which: indices of heights from which it passes.
    """
    wide, gaps, before = heights_m, gaps_m, 0
    pitch_m = (heights_m[-1] - heights_m[0]) / (len(heights_m) - 1)
    room_m = max(_ROOM_M, _ROOM_SDS * rig.release.height_sd_m)
    most_m = max(_MOST_ROOM_M, room_m)
    while True:
        count = int(np.clip(np.ceil(room_m / pitch_m), _FEWEST, _MOST))
        lowest, highest = max(wide[0] - room_m, _LEAST_HEIGHT_M), wide[-1] + room_m
        below = np.linspace(lowest, wide[0], count, endpoint=False)
        above = np.linspace(wide[-1], highest, count + 1)[1:]
        beyond = np.concatenate([below, above])
        more = signed_gap_m(passes(rig, ball.law, beyond, np.zeros(2 * count)))
        wide = np.concatenate([below, wide, above])
        gaps = np.concatenate([more[:count], gaps, more[count:]])
        before += count
        found = [_ends(wide, gaps, before + index) for index in which.tolist()]
        is_open = any(low == wide[0] > _LEAST_HEIGHT_M or high == wide[-1] for low, high in found)
        if not is_open or highest >= heights_m[-1] + most_m:
            return found
        room_m *= 2


def restitution_ends(rig: ShotRig, ball: KnownBall, heights_m: Array, values: Array) -> list[Range]:
    """How far off each shot's restitution may be, down and up, and the ball still passes.

    Args:
        rig: where.
        ball: which.
        heights_m: from which it passes, shape (N,).
        values: its restitutions there; of ends beyond 0 and 1 there is nothing to find, (N,).
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


def _shifted_gaps_m(rig: ShotRig, ball: KnownBall, heights_m: Array, shifts: Array) -> Array:
    """Signed gaps at each height (row) and shift of the restitution (column)."""
    grid = np.repeat(heights_m, len(shifts)), np.tile(shifts, len(heights_m))
    return signed_gap_m(passes(rig, ball.law, *grid)).reshape(len(heights_m), len(shifts))


def _ends(places: Array, gaps: Array, index: int) -> Range:
    """The places around `index` between which all gaps are positive."""
    found = []
    for way in (-1, 1):
        at = index
        while 0 <= at + way < len(places) and gaps[at + way] > 0:
            at += way
        end = float(places[at])
        if 0 <= at + way < len(places):
            inside, outside = gaps[at], gaps[at + way]
            share = inside / (inside - outside) if outside > _OUTSIDE else 0.5
            end += float(share * (places[at + way] - places[at]))
        found.append(end)
    return found[0], found[1]
