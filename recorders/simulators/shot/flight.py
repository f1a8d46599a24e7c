"""Simulate many shots at once, event-driven: each step ends at the first impact in it.

Between impacts a ball flies on a parabola, exactly, or with the air's drag by the classical
Runge-Kutta method (RK4), whose error at these steps is below 1e-10 m. The time of a contact is
found by regula falsi, every third iteration a bisection.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recorders.simulators.shot.contact import BallStates, Board, Collide, Rim, Surface, collide
from recorders.simulators.shot.rig import ShotRig
from recorders.simulators.speed_law import SpeedLaw
from tunenet_logs.arrays import Array

Mask = NDArray[np.bool_]

STEP_S = 0.002  # between positions that are kept
# Step where no position is kept: it moves where a ball passes by less than 0.02 mm.
COARSE_S = 0.004

_MAX_FALLS = 8
# A flight ends after 8 times its fall, but not before 4 s: a ball may roll for ever.
_MIN_LONGEST_S = 4.0

_ROUNDS = 14  # iterations for the time of a contact
_OFF_M = 1e-9  # gap that a ball is left with after an impact: rounding must not leave it inside
_BELOW_RADII = 3.0  # ball radii below the hoop from where none comes back


@dataclass(frozen=True, eq=False)
class Flights:
    """Results of N shots.

    Attributes:
        offset_m: of the centre from the hoop's, forward and left, where it last came down through
            the hoop's plane after an impact; NaN where it never did; shape (N, 2).
        gap_m: smallest gap from ball to rim on the way, inside or outside of the hoop; negative
            where ball and rim overlap; shape (N,).
        is_through: whether that was inside of the rim, shape (N,).
        has_touched: whether it hit the rim, shape (N,).
        impact_m_s: speed along the plane's normal at the first impact, shape (N,).
        positions_m: of the centres every step, shape (T, N, 3); T is 0 where they are not kept.
    """

    offset_m: Array
    gap_m: Array
    is_through: Mask
    has_touched: Mask
    impact_m_s: Array
    positions_m: Array


def fly(
    rig: ShotRig,
    law: SpeedLaw,
    released: BallStates,
    shifts: Array,
    *,
    has_rim: bool,
    drags_1_m: Array | None = None,
    step_s: float = STEP_S,
    keep: bool = False,
    impacts: Collide = collide,
) -> Flights:
    """Release balls and simulate each until it is below the hoop.

    Args:
        rig: plane, hoop and ball.
        law: restitution of the balls on the plane, by speed.
        released: N balls at time 0; changed in place.
        shifts: added to each ball's restitution, shape (N,).
        has_rim: whether the rim is an obstacle.
        drags_1_m: of each ball, shape (N,); the rig's ball's if None.
        step_s: between positions.
        keep: whether to return the positions.
        impacts: how they are solved.
    """
    if drags_1_m is None:
        drags_1_m = np.full(len(shifts), rig.ball.air_drag_1_m)
    run = _Run(rig, law, released, shifts, drags_1_m, has_rim, impacts)
    kept = [released.position_m.copy()] if keep else []
    for _ in range(int(np.ceil(_longest_s(rig, released, drags_1_m) / step_s))):
        run.step(step_s)
        if keep:
            kept.append(released.position_m.copy())
        if run.is_over.all():
            break
    return Flights(
        offset_m=run.offset_m,
        gap_m=run.gap_m,
        is_through=run.is_through,
        has_touched=run.has_touched,
        impact_m_s=run.impact_m_s,
        positions_m=np.array(kept).reshape(-1, len(shifts), 3),
    )


def _longest_s(rig: ShotRig, released: BallStates, drags_1_m: Array) -> float:
    """Bound a flight's duration by the fall, with drag, from the highest start."""
    low_m = min(_floor_m(rig), float(rig.touch_m[2]))
    fall_m = float(released.position_m[:, 2].max(initial=low_m)) - low_m
    drag = float(drags_1_m.max(initial=0.0))
    fall_s = np.sqrt(2 * fall_m / rig.gravity_m_s2)
    if drag:
        lost = drag * fall_m
        still_s = 1 / np.sqrt(drag * rig.gravity_m_s2)
        fall_s = still_s * (lost + np.log1p(np.sqrt(-np.expm1(-2 * lost))))
    return max(_MIN_LONGEST_S, _MAX_FALLS * float(fall_s))


def _floor_m(rig: ShotRig) -> float:
    return rig.hoop.up_m - _BELOW_RADII * rig.ball.radius_m


class _Run:
    """State of the shots under way."""

    def __init__(
        self,
        rig: ShotRig,
        law: SpeedLaw,
        balls: BallStates,
        shifts: Array,
        drags_1_m: Array,
        has_rim: bool,
        impacts: Collide,
    ) -> None:
        self._collide = impacts
        self._rig, self._law, self._balls, self._shifts = rig, law, balls, shifts
        self._drags_1_m, self._has_air = drags_1_m, bool(drags_1_m.any())
        self._board, self._rim, self._has_rim = Board(rig), Rim(rig), has_rim
        count = len(shifts)
        self._is_past_board = np.zeros(count, dtype=bool)
        self.is_over = np.zeros(count, dtype=bool)
        self.has_touched = np.zeros(count, dtype=bool)
        self.is_through = np.zeros(count, dtype=bool)
        self.offset_m = np.full((count, 2), np.nan)
        self.gap_m = np.full(count, np.inf)
        self.impact_m_s = np.full(count, np.nan)

    def step(self, step_s: float) -> None:
        """Advance all unfinished balls by one step, through all impacts in it."""
        going = np.flatnonzero(~self.is_over)
        left = np.full(len(going), step_s)
        while len(going):
            left = self._advance(going, left)
            going, left = going[left > 0], left[left > 0]
        self._end()

    def _advance(self, going: NDArray[np.int64], left: Array) -> Array:
        """Advance to the end of the step or its first impact; return the time left."""
        balls, rig = self._balls, self._rig
        start, speed = balls.position_m[going], balls.velocity_m_s[going]
        end, faster = self.flown(going, start, speed, left)
        used, hit = left.copy(), np.zeros(len(going), dtype=int)
        surfaces: list[Surface] = [self._board, self._rim] if self._has_rim else [self._board]
        for number, surface in enumerate(surfaces, start=1):
            inside = surface.gaps_m(end) < 0
            if number == 1:
                inside &= ~self._is_past_board[going]
            rows = np.flatnonzero(inside)
            if not len(rows):
                continue
            touched = self._touch_s(surface, going[rows], start[rows], speed[rows], left[rows])
            first = touched < used[rows]
            used[rows[first]], hit[rows[first]] = touched[first], number
        changed = np.flatnonzero(hit)
        if len(changed):
            end[changed], faster[changed] = self.flown(
                going[changed], start[changed], speed[changed], used[changed]
            )
        self._note(going, start, end, speed, faster, used)
        balls.position_m[going], balls.velocity_m_s[going] = end, faster
        if len(changed):
            self._bounce(going[hit == 1], self._board, rig.plane.friction)
            self._bounce(going[hit == 2], self._rim, rig.hoop.friction)
        return left - used

    def flown(
        self, which: NDArray[np.int64], position: Array, velocity: Array, seconds: Array
    ) -> tuple[Array, Array]:
        """Integrate free flight exactly, or with drag by RK4; positions and velocities, (N, 3)."""
        drag, after = self._drags_1_m[which, None], seconds[:, None]
        gravity = np.array([0.0, 0.0, -self._rig.gravity_m_s2])
        if not self._has_air:
            return position + after * (velocity + after / 2 * gravity), velocity + after * gravity

        def accelerated(speed: Array) -> Array:
            return gravity - drag * np.sqrt((speed**2).sum(axis=1, keepdims=True)) * speed

        half = after / 2
        one = accelerated(velocity)
        two = accelerated(velocity + half * one)
        three = accelerated(velocity + half * two)
        four = accelerated(velocity + after * three)
        moved = after * velocity + after**2 / 6 * (one + two + three)
        return position + moved, velocity + after / 6 * (one + 2 * two + 2 * three + four)

    def _touch_s(
        self,
        surface: Surface,
        which: NDArray[np.int64],
        start: Array,
        speed: Array,
        most: Array,
    ) -> Array:
        """Find contact times in (0, `most`] by regula falsi, every third iteration a bisection."""
        low, high = np.zeros(len(most)), most.copy()
        above = np.maximum(surface.gaps_m(start), _OFF_M / 2)
        below = surface.gaps_m(self.flown(which, start, speed, most)[0])
        for turn in range(_ROUNDS):
            middle = (low + high) / 2
            if turn % 3:
                middle = low + (high - low) * above / (above - below)
            gap = surface.gaps_m(self.flown(which, start, speed, middle)[0])
            is_out = gap > 0
            low, above = np.where(is_out, middle, low), np.where(is_out, gap, above)
            high, below = np.where(is_out, high, middle), np.where(is_out, below, gap)
        return high

    def _bounce(self, which: NDArray[np.int64], surface: Board | Rim, friction: float) -> None:
        balls, ball = self._balls, self._rig.ball
        if isinstance(surface, Board) and len(which):
            holds = surface.holds(balls.position_m[which])
            self._is_past_board[which[~holds]] = True
            which = which[holds]
        if not len(which):
            return
        normals = surface.normals(balls.position_m[which])
        inward = -np.sum(balls.velocity_m_s[which] * normals, axis=1)
        if isinstance(surface, Board):
            first = np.isnan(self.impact_m_s[which])
            self.impact_m_s[which[first]] = inward[first]
            restitution = np.clip(self._law.at(inward) + self._shifts[which], 0.0, 1.0)
        else:
            self.has_touched[which] = True
            restitution = np.full(len(which), self._rig.hoop.restitution)
        self._collide(
            balls, which, normals, restitution, friction, ball.radius_m, ball.inertia_share
        )
        off = _OFF_M - surface.gaps_m(balls.position_m[which])
        balls.position_m[which] += np.maximum(off, 0.0)[:, None] * normals

    def _note(
        self,
        going: NDArray[np.int64],
        start: Array,
        end: Array,
        speed: Array,
        faster: Array,
        used: Array,
    ) -> None:
        """Record the gap to the rim, and the crossing of the hoop's plane."""
        gaps = self._rim.gaps_m(start), self._rim.gaps_m(end)
        nearest = np.minimum(*gaps)
        closing = [
            np.sum(self._rim.normals(place) * rate, axis=1)
            for place, rate in ((start, speed), (end, faster))
        ]
        rows = np.flatnonzero((closing[0] < 0) & (closing[1] > 0))
        if len(rows):
            share = closing[0][rows] / (closing[0][rows] - closing[1][rows])
            between = self.flown(going[rows], start[rows], speed[rows], used[rows] * share)[0]
            nearest[rows] = np.minimum(nearest[rows], self._rim.gaps_m(between))
        self.gap_m[going] = np.minimum(self.gap_m[going], nearest)
        level = self._rig.hoop.up_m
        has_bounced = ~np.isnan(self.impact_m_s[going])
        rows = np.flatnonzero(has_bounced & (start[:, 2] >= level) & (end[:, 2] < level))
        if len(rows):
            share = (start[rows, 2] - level) / (start[rows, 2] - end[rows, 2])
            at = start[rows] + share[:, None] * (end[rows] - start[rows])
            self.offset_m[going[rows]] = (at - self._rig.hoop.center_m)[:, :2]
            self.is_through[going[rows]] = self._rim.is_within(at)

    def _end(self) -> None:
        """Finish the balls that fall below the hoop after their impact."""
        falls = self._balls.velocity_m_s[:, 2] < 0
        is_low = self._balls.position_m[:, 2] < _floor_m(self._rig)
        has_bounced = self._is_past_board | ~np.isnan(self.impact_m_s)
        self.is_over |= falls & is_low & has_bounced
