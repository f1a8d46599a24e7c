"""Simulate the bounce shot of the paper's third experiment: off an incline, through a hoop.

Many shots are simulated at once, event-driven: each step ends at the first impact in it. Between
impacts a ball flies on a parabola, exactly, or with the air's drag by the classical Runge-Kutta
method (RK4), whose error at these steps is below 1e-10 m. The time of a contact is found by regula
falsi, every third iteration a bisection. An impact is solved in closed form or by an engine.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.files import read_small_file
from tunenet_logs.recorders.simulators.ball import RESTITUTION, TOPIC, SpeedLaw
from tunenet_logs.recorders.simulators.base import (
    CALIBRATED,
    GRAVITY_M_S2,
    Parameter,
    check_limits,
    limits_of,
)
from tunenet_logs.recorders.simulators.known import Ball, engine
from tunenet_logs.terminal import one_line, short_name

# ---- Rig: ball, inclined plane, hoop, and the robot's reach
#
# The origin is where the ball touches the plane. x points horizontally towards the hoop, down the
# plane, y to the left, z up.

# Of each quantity: smallest and largest value, and what a rig's file says of it.

_NULLABLE = ("ball.mass_kg", "ball.drag_1_m")  # what need not be known


@dataclass(frozen=True)
class ShotBall:
    """The ball."""

    radius_m: Annotated[float, 0.002, 0.5] = 0.03
    mass_kg: Annotated[float | None, 1e-4, 50.0, "for the air's drag; null leaves the air out"] = (
        0.04
    )
    drag_coefficient: Annotated[float, 0.01, 3.0, "0.47: a smooth sphere's at these speeds"] = 0.47
    inertia_share: Annotated[float, 0.2, 0.7, "over m r^2: 0.4 solid, 0.667 a thin shell"] = 0.4
    drag_1_m: Annotated[
        float | None, 0.0, 10.0, "measured [1/m]; null: by size, mass and drag_coefficient"
    ] = None

    @property
    def air_drag_1_m(self) -> float:
        """Quadratic drag [1/m], measured or computed; 0 without a mass."""
        return self.body.drag_1_m or 0.0 if self.drag_1_m is None else self.drag_1_m

    @property
    def body(self) -> Ball:
        """The ball's size, mass and drag coefficient."""
        return Ball(2 * self.radius_m, self.mass_kg, self.drag_coefficient)


@dataclass(frozen=True)
class Plane:
    """The inclined plane."""

    incline_deg: Annotated[float, 0.0, 80.0, "from the horizontal, down towards the hoop"] = 25.0
    downhill_m: Annotated[
        float, 0.001, 10.0, "from the impact point to its lower edge, along its slope"
    ] = 0.15
    friction: Annotated[float, 0.0, 5.0, "Coulomb's coefficient between ball and plane"] = 0.25

    @property
    def normal(self) -> Array:
        """Unit vector out of the plane, shape (3,)."""
        tilt = math.radians(self.incline_deg)
        return np.array([math.sin(tilt), 0.0, math.cos(tilt)])

    @property
    def downhill(self) -> Array:
        """Unit vector down the plane, shape (3,)."""
        tilt = math.radians(self.incline_deg)
        return np.array([math.cos(tilt), 0.0, -math.sin(tilt)])


@dataclass(frozen=True)
class Hoop:
    """A horizontal hoop, its rim a torus."""

    forward_m: Annotated[float, 0.01, 10.0, "its centre, horizontally"] = 0.45
    up_m: Annotated[float, -10.0, 10.0, "negative: below the impact point"] = -0.10
    free_radius_m: Annotated[float, 0.002, 5.0, "of the opening"] = 0.066
    rim_m: Annotated[float, 0.0005, 0.5, "how thick the rim is"] = 0.005
    restitution: Annotated[float, 0.0, 1.0, "of the ball on the rim"] = 0.6
    friction: Annotated[float, 0.0, 5.0, "likewise"] = 0.25

    @property
    def center_m(self) -> Array:
        """Centre of the hoop, shape (3,)."""
        return np.array([self.forward_m, 0.0, self.up_m])

    @property
    def ring_radius_m(self) -> float:
        """Radius to the rim's centre line."""
        return self.free_radius_m + self.rim_m / 2


@dataclass(frozen=True)
class Release:
    """Heights of release: how far the ball falls until it touches the plane."""

    lowest_m: Annotated[float, 0.005, 50.0, "how far the ball falls until it touches the plane"] = (
        0.25
    )
    highest_m: Annotated[float, 0.005, 50.0] = 0.85
    height_sd_m: Annotated[float, 0.0, 0.5, "how well the robot keeps a height"] = 0.002


@dataclass(frozen=True)
class ShotRig:
    """The complete rig."""

    ball: ShotBall = field(default_factory=ShotBall)
    plane: Plane = field(default_factory=Plane)
    hoop: Hoop = field(default_factory=Hoop)
    release: Release = field(default_factory=Release)
    gravity_m_s2: Annotated[float, 0.1, 100.0] = GRAVITY_M_S2

    def __post_init__(self) -> None:
        check_limits(self)
        for part, kind in _PARTS.items():
            for item, (low, high, _) in limits_of(kind).items():
                name, value = f"{part}.{item}", getattr(getattr(self, part), item)
                if value is None and name in _NULLABLE:
                    continue
                if value is None or not low <= value <= high:
                    told = "missing" if value is None else f"{value:g}"
                    raise UsageError(f"{name} {told} is not a number from {low:g} to {high:.6g}")
        hoop, ball, release = self.hoop, self.ball, self.release
        if release.lowest_m >= release.highest_m:
            raise UsageError(
                f"release.lowest_m {release.lowest_m:g} is not below release.highest_m "
                f"{release.highest_m:g}"
            )
        if hoop.free_radius_m <= ball.radius_m:
            raise UsageError(
                f"hoop.free_radius_m {hoop.free_radius_m:g} lets no ball of ball.radius_m "
                f"{ball.radius_m:g} through; make the hoop wider"
            )
        # Check that the hoop is clear of the ball's fall, from the highest release.
        across = abs(hoop.forward_m - float(self.touch_m[0]))
        highest_m = float(self.touch_m[2]) + release.highest_m
        near_m = math.hypot(max(across - hoop.ring_radius_m, 0.0), max(hoop.up_m - highest_m, 0.0))
        if near_m <= ball.radius_m + hoop.rim_m:
            raise UsageError(
                f"hoop.forward_m {hoop.forward_m:g}: the hoop hangs in the ball's way to the "
                "plane; move it away"
            )
        try:
            _ = ball.body
        except UsageError as error:
            raise UsageError(f"ball.mass_kg: {error}") from error

    def with_drag(self, drag_1_m: float) -> ShotRig:
        """Copy the rig with another air drag on its ball [1/m]."""
        return replace(self, ball=replace(self.ball, drag_1_m=drag_1_m))

    @property
    def touch_m(self) -> Array:
        """The ball's centre where it first touches the plane, shape (3,)."""
        return self.ball.radius_m * self.plane.normal


_PARTS: Mapping[str, type] = {"ball": ShotBall, "plane": Plane, "hoop": Hoop, "release": Release}


# ---- Contact with plane and rim: Newton restitution and Coulomb friction

Which = NDArray[np.int64]  # numbers of balls

_MIN_REBOUND_M_S = 0.01  # of a ball that would stay (5 um high): it rolls on in small hops
_MIN_M = 1e-9  # below any length here: it only keeps a direction from being divided by 0


@dataclass
class BallStates:
    """The states of N balls at a moment; they do not touch each other."""

    position_m: Array  # of the centres, shape (N, 3)
    velocity_m_s: Array  # shape (N, 3)
    spin_rad_s: Array  # shape (N, 3)


def collide(
    balls: BallStates,
    which: Which,
    normals: Array,
    restitution: Array,
    friction: float,
    ball: ShotBall,
) -> None:
    """Solve impacts of balls `which` (M,) along unit normals (M, 3) away from what they touch.

    Along the normal the speed is reversed times the restitution (Newton's law of impact); across it
    friction takes the slip of the touching point, at most all of it, and at most the friction
    coefficient times the normal impulse (Coulomb's law): sticking takes slip / (1 + 1 / k), with
    k = I / (m r^2); 2/7 of it for a solid sphere.
    """
    velocity, spin = balls.velocity_m_s[which], balls.spin_rad_s[which]
    slip = velocity + np.cross(spin, -ball.radius_m * normals)
    inward = -np.sum(slip * normals, axis=1)
    slip += inward[:, None] * normals
    outward = np.maximum(restitution * inward, _MIN_REBOUND_M_S)
    pushed = inward + outward
    slipping = np.linalg.norm(slip, axis=1)
    held = np.minimum(slipping / (1 + 1 / ball.inertia_share), friction * pushed)
    along = slip * (held / np.maximum(slipping, 1e-12))[:, None]
    balls.velocity_m_s[which] = velocity + pushed[:, None] * normals - along
    torque = np.cross(-normals, -along)
    balls.spin_rad_s[which] = spin + torque / (ball.inertia_share * ball.radius_m)


# Functions that do what `collide` does.
Collide = Callable[[BallStates, Which, Array, Array, float, ShotBall], None]


class Board:
    """The inclined plane, taken as infinite."""

    def __init__(self, rig: ShotRig) -> None:
        self._normal, self._radius_m = rig.plane.normal, rig.ball.radius_m

    def gaps_m(self, positions_m: Array) -> Array:
        """Compute signed gaps from the ball to the plane, (N, 3) -> (N,) [m]."""
        return positions_m @ self._normal - self._radius_m

    def normals(self, positions_m: Array) -> Array:
        """Return the unit normals towards the balls, shape (N, 3)."""
        return np.broadcast_to(self._normal, positions_m.shape)


class Rim:
    """The hoop's rim: a torus about the vertical through its centre."""

    def __init__(self, rig: ShotRig) -> None:
        self._center_m, self._ring_m = rig.hoop.center_m, rig.hoop.ring_radius_m
        self._reach_m = rig.ball.radius_m + rig.hoop.rim_m / 2

    def gaps_m(self, positions_m: Array) -> Array:
        """Compute signed gaps from the ball to the rim, (N, 3) -> (N,) [m]."""
        out, up = self.from_ring(positions_m)
        return np.hypot(out, up) - self._reach_m

    def normals(self, positions_m: Array) -> Array:
        """Compute unit normals from the rim to the balls' centres, (N, 3) -> (N, 3)."""
        offset = positions_m - self._center_m
        out, up = self.from_ring(positions_m)
        across = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), _MIN_M)
        away = np.maximum(np.hypot(out, up), _MIN_M)
        flat = offset[:, :2] * (out / across / away)[:, None]
        return np.column_stack([flat, up / away])

    def from_ring(self, positions_m: Array) -> tuple[Array, Array]:
        """Return offsets from the rim's centre line, outwards and up, each of shape (N,)."""
        offset = positions_m - self._center_m
        return np.hypot(offset[:, 0], offset[:, 1]) - self._ring_m, offset[:, 2]


# ---- Flights: many shots at once, from release to below the hoop

Mask = NDArray[np.bool_]
STEP_S = 0.002  # between positions that are kept
COARSE_S = 0.004  # step where none is kept: it moves where a ball passes by less than 0.02 mm

_OFF_M = 1e-9  # gap that a ball is left with after an impact: rounding must not leave it inside


@dataclass(frozen=True, eq=False)
class Flights:
    """Results of N shots."""

    # Of the centre from the hoop's, forward and left, where it last came down through the hoop's
    # plane after an impact; NaN where it never did; shape (N, 2).
    offset_m: Array
    gap_m: Array  # smallest gap from ball to rim on the way, below 0 where they overlap, shape (N,)
    is_through: Mask  # whether that was inside of the rim, shape (N,)
    has_touched: Mask  # whether it hit the rim, shape (N,)
    impact_m_s: Array  # speed along the plane's normal at the first impact, shape (N,)
    positions_m: Array  # of the centres every step, shape (T, N, 3); T is 0 where they are not kept


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
    """Release balls and simulate each until it is below the hoop."""
    if drags_1_m is None:
        drags_1_m = np.full(len(shifts), rig.ball.air_drag_1_m)
    run = _Run(rig, law, released, shifts, drags_1_m, has_rim, impacts)
    kept = [released.position_m.copy()] if keep else []
    # Bound a flight's duration by the fall, with drag, from the highest start.
    low_m = min(run.floor_m, float(rig.touch_m[2]))
    fall_m = float(released.position_m[:, 2].max(initial=low_m)) - low_m
    drag = float(drags_1_m.max(initial=0.0))
    fall_s = np.sqrt(2 * fall_m / rig.gravity_m_s2)
    if drag:
        lost = drag * fall_m
        still_s = 1 / np.sqrt(drag * rig.gravity_m_s2)
        fall_s = still_s * (lost + np.log1p(np.sqrt(-np.expm1(-2 * lost))))
    # A flight ends after 8 times its fall, but not before 4 s: a ball may roll for ever.
    for _ in range(math.ceil(max(4.0, 8 * float(fall_s)) / step_s)):
        run.step(step_s)
        if keep:
            kept.append(released.position_m.copy())
        if run.is_over.all():
            break
    return replace(run.found, positions_m=np.array(kept).reshape(-1, len(shifts), 3))


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
        self.floor_m = rig.hoop.up_m - 3.0 * rig.ball.radius_m  # from so low no ball comes back
        count = len(shifts)
        self._is_past_board, self.is_over = np.zeros((2, count), dtype=bool)
        self.found = Flights(
            offset_m=np.full((count, 2), np.nan),
            gap_m=np.full(count, np.inf),
            is_through=np.zeros(count, dtype=bool),
            has_touched=np.zeros(count, dtype=bool),
            impact_m_s=np.full(count, np.nan),
            positions_m=np.empty((0, count, 3)),
        )

    def step(self, step_s: float) -> None:
        """Advance all unfinished balls by one step, through all impacts in it."""
        going = np.flatnonzero(~self.is_over)
        left = np.full(len(going), step_s)
        while len(going):
            left = self._advance(going, left)
            going, left = going[left > 0], left[left > 0]
        # Finish the balls that fall below the hoop after their impact.
        is_low = self._balls.position_m[:, 2] < self.floor_m
        falls = is_low & (self._balls.velocity_m_s[:, 2] < 0)
        self.is_over |= falls & (self._is_past_board | ~np.isnan(self.found.impact_m_s))

    def _advance(self, going: Which, left: Array) -> Array:
        """Advance to the end of the step or its first impact; return the time left."""
        balls, rig = self._balls, self._rig
        start, speed = balls.position_m[going], balls.velocity_m_s[going]
        end, faster = self.flown(going, start, speed, left)
        used, hit = left.copy(), np.zeros(len(going), dtype=int)
        surfaces = [self._board, self._rim] if self._has_rim else [self._board]
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
        self, which: Which, position: Array, velocity: Array, seconds: Array
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
        self, surface: Board | Rim, which: Which, start: Array, speed: Array, most: Array
    ) -> Array:
        """Find contact times in (0, `most`] by regula falsi, every third iteration a bisection."""
        low, high = np.zeros(len(most)), most.copy()
        above = np.maximum(surface.gaps_m(start), _OFF_M / 2)
        below = surface.gaps_m(self.flown(which, start, speed, most)[0])
        for turn in range(14):
            middle = (low + high) / 2
            if turn % 3:
                middle = low + (high - low) * above / (above - below)
            gap = surface.gaps_m(self.flown(which, start, speed, middle)[0])
            is_out = gap > 0
            low, above = np.where(is_out, middle, low), np.where(is_out, gap, above)
            high, below = np.where(is_out, high, middle), np.where(is_out, below, gap)
        return high

    def _bounce(self, which: Which, surface: Board | Rim, friction: float) -> None:
        balls, ball = self._balls, self._rig.ball
        if isinstance(surface, Board) and len(which):
            plane = self._rig.plane
            holds = balls.position_m[which] @ plane.downhill <= plane.downhill_m
            self._is_past_board[which[~holds]] = True
            which = which[holds]
        if not len(which):
            return
        normals = surface.normals(balls.position_m[which])
        inward = -np.sum(balls.velocity_m_s[which] * normals, axis=1)
        if isinstance(surface, Board):
            first = np.isnan(self.found.impact_m_s[which])
            self.found.impact_m_s[which[first]] = inward[first]
            restitution = np.clip(self._law.at(inward) + self._shifts[which], 0.0, 1.0)
        else:
            self.found.has_touched[which] = True
            restitution = np.full(len(which), self._rig.hoop.restitution)
        self._collide(balls, which, normals, restitution, friction, ball)
        off = _OFF_M - surface.gaps_m(balls.position_m[which])
        balls.position_m[which] += np.maximum(off, 0.0)[:, None] * normals

    def _note(
        self, going: Which, start: Array, end: Array, speed: Array, faster: Array, used: Array
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
        self.found.gap_m[going] = np.minimum(self.found.gap_m[going], nearest)
        level = self._rig.hoop.up_m
        has_bounced = ~np.isnan(self.found.impact_m_s[going])
        rows = np.flatnonzero(has_bounced & (start[:, 2] >= level) & (end[:, 2] < level))
        if len(rows):
            share = (start[rows, 2] - level) / (start[rows, 2] - end[rows, 2])
            at = start[rows] + share[:, None] * (end[rows] - start[rows])
            self.found.offset_m[going[rows]] = (at - self._rig.hoop.center_m)[:, :2]
            self.found.is_through[going[rows]] = self._rim.from_ring(at)[0] < 0


# ---- Shots: release, simulate, and record one as an episode


def shoot(rig: ShotRig, law: SpeedLaw, heights_m: Array) -> Flights:
    """Simulate shots from these heights, shape (N,), with their paths and the rim in their way."""
    start = released(rig, heights_m)
    return fly(rig, law, start, np.zeros(len(heights_m)), has_rim=True, keep=True)


def passes(
    rig: ShotRig, law: SpeedLaw, heights_m: Array, shifts: Array, drags_1_m: Array | None = None
) -> Flights:
    """Simulate shots as if the rim were not there: where they pass it, and how near."""
    start = released(rig, heights_m)
    return fly(rig, law, start, shifts, has_rim=False, drags_1_m=drags_1_m, step_s=COARSE_S)


def shoot_in_engine(rig: ShotRig, law: SpeedLaw, height_m: float, step_s: float) -> Flights:
    """Simulate one shot with the rim, each impact solved by the chosen engine."""
    world = engine().ball_world(rig.ball.radius_m, CALIBRATED)

    def solve(
        balls: BallStates,
        which: Which,
        normals: Array,
        restitution: Array,
        friction: float,
        ball: ShotBall,
    ) -> None:
        for index, normal, wanted in zip(which.tolist(), normals, restitution, strict=True):
            # The axes of a frame whose z is the normal, as rows, shape (3, 3).
            aside = np.eye(3)[int(np.argmin(np.abs(normal)))]
            x = np.cross(aside, normal)
            x /= np.linalg.norm(x)
            axes = np.array([x, np.cross(normal, x), normal])
            velocity, spin = axes @ balls.velocity_m_s[index], axes @ balls.spin_rad_s[index]
            least = _MIN_REBOUND_M_S / max(-float(velocity[2]), 1e-9)
            rebound = max(float(wanted), least)
            velocity, spin = world.impact(velocity, spin, rebound, friction, ball.inertia_share)
            balls.velocity_m_s[index], balls.spin_rad_s[index] = axes.T @ velocity, axes.T @ spin

    start, shift = released(rig, np.array([height_m])), np.zeros(1)
    return fly(rig, law, start, shift, has_rim=True, step_s=step_s, keep=True, impacts=solve)


def released(rig: ShotRig, heights_m: Array) -> BallStates:
    """Place balls at rest straight above the touch point."""
    up = np.column_stack([np.zeros((len(heights_m), 2)), heights_m])
    return BallStates(rig.touch_m + up, np.zeros_like(up), np.zeros_like(up))


@dataclass(frozen=True)
class BounceShot:
    """One shot; see `Simulator`."""

    rig: ShotRig
    height_m: Annotated[float, 0.005, 50.0, "m"]  # how far the ball falls
    slope: float = 0.0  # exponent of the restitution over speed; see `SpeedLaw`
    at_m_s: float = 3.0  # the impact's speed at which it has the restitution that is set
    rate_hz: Annotated[float, 1.0, 20_000.0, "Hz"] = 240.0
    parameters: tuple[Parameter, ...] = (RESTITUTION,)

    __post_init__ = check_limits

    @property
    def engine(self) -> str:
        """Engine that solves the impacts; the flights between are not the engine's."""
        return engine().name

    @property
    def step_hz(self) -> float:
        """Smallest multiple of `rate_hz` whose steps are `STEP_S` or shorter [Hz]."""
        return self.rate_hz * int(np.ceil(1 / (self.rate_hz * STEP_S)))

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """Simulate until the ball is below the hoop, with `values["restitution"]`."""
        if set(values) != {RESTITUTION.name}:
            raise UsageError(f"a shot takes the value restitution, not {sorted(values)}")
        law = SpeedLaw(RESTITUTION.checked(values[RESTITUTION.name]), self.slope, self.at_m_s)
        flights = shoot_in_engine(self.rig, law, self.height_m, 1 / self.step_hz)
        positions_m = flights.positions_m[:: round(self.step_hz / self.rate_hz), 0]
        stamps_ns = np.round(np.arange(len(positions_m)) * (1e9 / self.rate_hz)).astype(np.int64)
        info = EpisodeInfo(
            kind="bounce-shot",
            source=f"{self.engine}, bounce shot",
            rig={
                "ball_diameter_m": 2 * self.rig.ball.radius_m,
                "shot_height_m": self.height_m,
                "hoop_forward_m": self.rig.hoop.forward_m,
                "hoop_up_m": self.rig.hoop.up_m,
                "hoop_free_radius_m": self.rig.hoop.free_radius_m,
                "plane_incline_deg": self.rig.plane.incline_deg,
            },
            truth={
                RESTITUTION.name: law.restitution,
                "restitution_slope": law.slope,
                "drag": self.rig.ball.air_drag_1_m,
                "success": float(flights.is_through[0]),
                "miss_distance_m": float(np.nan_to_num(np.hypot(*flights.offset_m[0]), nan=-1.0)),
            },
        )
        return Episode(info, {TOPIC: Signal(TOPIC, stamps_ns, positions_m, ("x", "y", "z"), "m")})


# ---- Rig file: a small YAML that a person edits

# More than a rig's file has: of brackets, because YAML reads nested ones in quadratic time.
_MAX_FILE_BYTES, _MAX_BRACKETS = 20_000, 64

_GRAVITY = "gravity_m_s2"

_RIG_HEAD = """\
# The rig of a bounce shot. Lengths in m, from the impact point: where the ball touches the plane.
# What is left out is as here.
"""


def rig_text(rig: ShotRig) -> str:
    """Format the rig as a commented file."""
    lines: list[str] = []
    for part, kind in _PARTS.items():
        lines.append(f"{part}:")
        for name, (_, _, remark) in limits_of(kind).items():
            value = getattr(getattr(rig, part), name)
            line = f"  {name}: {'null' if value is None else value}"
            lines.append(f"{line:<27}# {remark}" if remark else line)
    return _RIG_HEAD + "\n".join((*lines, f"{_GRAVITY}: {rig.gravity_m_s2}", ""))


def read_rig(path: Path) -> ShotRig:
    """Read a rig from a file; the default rig's values replace missing ones."""
    try:
        data = read_small_file(path, _MAX_FILE_BYTES)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); give --rig a file") from error
    except ValueError as error:
        what = f"{error}, and no rig's file is; give --rig such a file"
        raise UsageError(f"{path}: {what}") from error
    try:
        told = _loaded(data)
        values = _mapping(told, "the file", [*_PARTS, _GRAVITY])
        given: dict[str, Any] = {}
        for name, kind in _PARTS.items():
            if name in values:
                part = _mapping(values[name], name, list(limits_of(kind)))
                given[name] = kind(
                    **{key: _number(f"{name}.{key}", one) for key, one in part.items()}
                )
        if _GRAVITY in values:
            given[_GRAVITY] = _number(_GRAVITY, values[_GRAVITY])
        return ShotRig(**given)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error


def _loaded(data: bytes) -> Any:
    """Load the YAML; the safe loader makes plain values only."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    told = b"".join(line.partition(b"#")[0] for line in data.split(b"\n"))
    if sum(map(told.count, (b"[", b"{"))) > _MAX_BRACKETS:
        raise UsageError(f"over {_MAX_BRACKETS} brackets; see tunenet-plan --save-rig for a rig")
    if any(mark in told for mark in (b"&", b"*", b"!")):
        raise UsageError("holds &, * or !, which a rig's YAML does without; remove them")
    try:
        return YAML(typ="safe", pure=True).load(io.StringIO(data.decode("utf-8")))
    except (YAMLError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f" in line {mark.line + 1}"
        what = getattr(error, "problem", None) or type(error).__name__
        raise UsageError(
            f"no YAML{where} ({one_line(what)}); see tunenet-plan --save-rig"
        ) from error


def _mapping(told: Any, what: str, known: list[str]) -> dict[str, Any]:
    if told is None:
        return {}
    if not isinstance(told, dict):
        raise UsageError(f"{what} is not a list of names with values; there is: {', '.join(known)}")
    for key in told:
        if key not in known:
            raise UsageError(
                f"{short_name(key)} is nothing of {what}; there is: {', '.join(known)}"
            )
    return told


def _number(name: str, value: Any) -> float | None:
    if value is None and name in _NULLABLE:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UsageError(f"{name} {short_name(value)} is not a number")
    try:
        return float(value)
    except OverflowError as error:
        raise UsageError(f"{name} is not a number of this size") from error
