"""Simulate the hidden world of the bounce-shot experiment, unknown to the planner.

It shares no code with the planner's simulator (`recorders/simulators/shot`) nor with what tunes.
A ball is stepped at 960 Hz (midpoint rule), one at a time, through quadratic drag; a step that
would end inside of something ends where the ball touches it. At impacts: a restitution that falls
with speed, sliding friction with spin, and for a ball that is not round a normal that is off by
some degrees.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tunenet_logs.arrays import Array

Vector = tuple[float, float, float]

RATE_HZ = 960.0  # of steps: a ball at 5 m/s goes 5 mm in one, a sixth of its radius
GRAVITY_M_S2 = 9.81
RADIUS_M = 0.03
MASS_KG = 0.040
# Of every ball: about a racquetball's size and mass; Coulomb's coefficient at all that it hits.
FRICTION = 0.25

_AIR_KG_M3 = 1.2
_DRAG_COEFFICIENT = 0.47
DRAG_1_M = 0.5 * _AIR_KG_M3 * _DRAG_COEFFICIENT * math.pi * RADIUS_M**2 / MASS_KG
_SPEED_M_S = 3.0  # impact speed to which `HiddenBall.restitution` belongs
_LIVELIEST = 0.95  # restitution of the slowest impacts: the power law alone would pass 1
_AT_REST_M_S = 0.03  # slower impacts give no rebound: a ball comes to rest
# Along the normal after an impact, so that the next step does not start inside.
_MIN_OUT_M_S = 0.003

_HALVINGS = 40  # Bisections of a step that find a contact: 1 / 960 s over 2^40 is 1e-15 s
_MAX_IMPACTS = 8  # in one step; then the ball stays where it is until the next


@dataclass(frozen=True)
class HiddenBall:
    """Ball as it is.

    Attributes:
        name: as on a label.
        restitution: at 3 m/s.
        slope: p, by which it falls with an impact's speed.
        off_round_deg: standard deviation of the angle by which an impact's normal is off, in any
            direction.
    """

    name: str
    restitution: float
    slope: float
    off_round_deg: float = 0.0

    @property
    def is_round(self) -> bool:
        """Whether its impacts are as they should be."""
        return self.off_round_deg == 0

    def restitution_at(self, speed_m_s: float) -> float:
        """Return the restitution at an impact of this speed along the normal."""
        ratio = max(speed_m_s, _AT_REST_M_S) / _SPEED_M_S
        return min(self.restitution * ratio**-self.slope, _LIVELIEST)


@dataclass(frozen=True)
class Obstacle:
    """Obstacle for a ball.

    Attributes:
        gap: from a ball's skin to it, by the ball's centre.
        normal: unit vector out of it there.
        restitution: of any ball on it; None where it is the ball's own.
    """

    gap: Callable[[Vector], float]
    normal: Callable[[Vector], Vector]
    restitution: float | None = None


@dataclass(frozen=True, eq=False)
class BallPath:
    """Path of a ball.

    Attributes:
        positions_m: of its centre at 960 Hz, shape (T, 3).
        hits: which obstacle at which sample, in order.
    """

    positions_m: Array
    hits: tuple[tuple[int, int], ...]

    def at(self, seconds: Array) -> Array:
        """Interpolate positions at `seconds` after the release, shape (N, 3) [m]."""
        clock = np.arange(len(self.positions_m)) / RATE_HZ
        return np.column_stack([np.interp(seconds, clock, axis) for axis in self.positions_m.T])


def run_ball(
    ball: HiddenBall,
    start_m: Vector,
    obstacles: Sequence[Obstacle],
    seconds: float,
    rng: np.random.Generator,
    velocity_m_s: Vector = (0.0, 0.0, 0.0),
    is_over: Callable[[Vector], bool] | None = None,
) -> BallPath:
    """Release a ball and step it for `seconds`, or until `is_over`."""
    position, velocity, spin = start_m, velocity_m_s, (0.0, 0.0, 0.0)
    positions, hits = [position], []
    for sample in range(1, int(seconds * RATE_HZ) + 1):
        remaining_s = 1 / RATE_HZ
        for _ in range(_MAX_IMPACTS):
            end, end_velocity = _flown(position, velocity, remaining_s)
            hit, used_s = _first_hit(position, velocity, remaining_s, end, obstacles)
            if hit < 0:
                position, velocity = end, end_velocity
                break
            position, velocity = _flown(position, velocity, used_s)
            velocity, spin = _impact(ball, obstacles[hit], position, velocity, spin, rng)
            hits.append((hit, sample))
            remaining_s -= used_s
        positions.append(position)
        if is_over is not None and is_over(position):
            break
    return BallPath(np.array(positions), tuple(hits))


def ground(height_m: float) -> Obstacle:
    """Make a level floor without end."""
    return Obstacle(lambda center: center[2] - height_m - RADIUS_M, lambda _: (0.0, 0.0, 1.0))


def table(edge_m: float, heading_rad: float) -> Obstacle:
    """Make a level table at height 0 that ends in a sharp edge in that direction."""
    ahead, aside = math.cos(heading_rad), math.sin(heading_rad)

    def from_table(center: Vector) -> tuple[float, float]:
        return max(center[0] * ahead + center[1] * aside - edge_m, 0.0), center[2]

    def gap(center: Vector) -> float:
        beyond, up = from_table(center)
        return math.inf if beyond == 0 and up < -RADIUS_M else math.hypot(beyond, up) - RADIUS_M

    def normal(center: Vector) -> Vector:
        beyond, up = from_table(center)
        away = math.hypot(beyond, up) or 1e-12
        return ahead * beyond / away, aside * beyond / away, up / away

    return Obstacle(gap, normal)


def incline(tilt_rad: float, reach_m: float) -> Obstacle:
    """Make a plane through the origin, down along x, that ends `reach_m` down its slope."""
    normal = (math.sin(tilt_rad), 0.0, math.cos(tilt_rad))
    down = (math.cos(tilt_rad), 0.0, -math.sin(tilt_rad))

    def gap(center: Vector) -> float:
        away = _dot(center, normal)
        if _dot(center, down) > reach_m or away < -RADIUS_M:
            return math.inf
        return away - RADIUS_M

    return Obstacle(gap, lambda _: normal)


def ring(center_m: Vector, ring_m: float, rod_m: float, restitution: float) -> Obstacle:
    """Make a horizontal ring of a round rod: radius to the rod's middle, and of the rod."""

    def from_rod(center: Vector) -> tuple[float, float, float, float]:
        x, y = center[0] - center_m[0], center[1] - center_m[1]
        across = math.hypot(x, y) or 1e-12
        outward = 1 - ring_m / across
        return x * outward, y * outward, center[2] - center_m[2], across

    def gap(center: Vector) -> float:
        x, y, z, _ = from_rod(center)
        return math.sqrt(x * x + y * y + z * z) - rod_m - RADIUS_M

    def normal(center: Vector) -> Vector:
        x, y, z, _ = from_rod(center)
        away = math.sqrt(x * x + y * y + z * z) or 1e-12
        return x / away, y / away, z / away

    return Obstacle(gap, normal, restitution)


def _flown(position: Vector, velocity: Vector, seconds: float) -> tuple[Vector, Vector]:
    """Return position and velocity after one step of the midpoint rule (Runge-Kutta 2)."""
    x, y, z = velocity
    slow = DRAG_1_M * math.sqrt(x * x + y * y + z * z)
    half = seconds / 2
    mx, my, mz = x - half * slow * x, y - half * slow * y, z - half * (GRAVITY_M_S2 + slow * z)
    slow = DRAG_1_M * math.sqrt(mx * mx + my * my + mz * mz)
    after = (
        x - seconds * slow * mx,
        y - seconds * slow * my,
        z - seconds * (GRAVITY_M_S2 + slow * mz),
    )
    x, y, z = position
    return (x + seconds * mx, y + seconds * my, z + seconds * mz), after


def _first_hit(
    position: Vector,
    velocity: Vector,
    seconds: float,
    end: Vector,
    obstacles: Sequence[Obstacle],
) -> tuple[int, float]:
    """Find by bisection which obstacle a step ends in, and when it touches; -1 for none."""
    found, soonest = -1, math.inf
    for index, obstacle in enumerate(obstacles):
        if obstacle.gap(end) >= 0:
            continue
        low, high = 0.0, seconds
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            if obstacle.gap(_flown(position, velocity, middle)[0]) >= 0:
                low = middle
            else:
                high = middle
        if low < soonest:
            found, soonest = index, low
    return found, soonest


def _impact(
    ball: HiddenBall,
    obstacle: Obstacle,
    position: Vector,
    velocity: Vector,
    spin: Vector,
    rng: np.random.Generator,
) -> tuple[Vector, Vector]:
    """Return velocity and spin of a solid sphere after an impact with Coulomb friction."""
    true_normal = obstacle.normal(position)
    normal = true_normal if ball.is_round else _tilted(true_normal, ball.off_round_deg, rng)
    arm = (-RADIUS_M * normal[0], -RADIUS_M * normal[1], -RADIUS_M * normal[2])
    turning = _cross(spin, arm)
    touching = (velocity[0] + turning[0], velocity[1] + turning[1], velocity[2] + turning[2])
    inward = -_dot(touching, normal)
    if inward <= 0:
        return _kept_out(velocity, true_normal), spin
    kept = ball.restitution_at(inward) if obstacle.restitution is None else obstacle.restitution
    if inward < _AT_REST_M_S:
        kept = 0.0
    push = (1 + kept) * inward
    slip = tuple(touching[i] + inward * normal[i] for i in range(3))
    slipping = math.sqrt(slip[0] ** 2 + slip[1] ** 2 + slip[2] ** 2)
    grip = min(FRICTION * push, slipping / 3.5) / slipping if slipping > 1e-9 else 0.0
    kick = tuple(push * normal[i] - grip * slip[i] for i in range(3))
    twist = _cross(arm, (kick[0], kick[1], kick[2]))
    per_inertia = 1 / (0.4 * RADIUS_M**2)  # of a unit mass
    after = (velocity[0] + kick[0], velocity[1] + kick[1], velocity[2] + kick[2])
    turned = (
        spin[0] + per_inertia * twist[0],
        spin[1] + per_inertia * twist[1],
        spin[2] + per_inertia * twist[2],
    )
    return _kept_out(after, true_normal), turned


def _kept_out(velocity: Vector, normal: Vector) -> Vector:
    """Keep a ball from leaving into what it hit."""
    x, y, z = velocity
    more = _MIN_OUT_M_S - _dot(velocity, normal)
    if more <= 0:
        return velocity
    return x + more * normal[0], y + more * normal[1], z + more * normal[2]


def _tilted(normal: Vector, sd_deg: float, rng: np.random.Generator) -> Vector:
    off, turn = math.radians(rng.normal(0.0, sd_deg)), rng.uniform(0.0, 2 * math.pi)
    one = np.cross(normal, (0.0, 1.0, 0.0) if abs(normal[1]) < 0.9 else (1.0, 0.0, 0.0))
    one /= np.linalg.norm(one)
    other = np.cross(normal, one)
    aside = math.cos(turn) * one + math.sin(turn) * other
    turned = np.array(normal) + math.tan(off) * aside
    turned /= np.linalg.norm(turned)
    return float(turned[0]), float(turned[1]), float(turned[2])


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _cross(one: Vector, other: Vector) -> Vector:
    return (
        one[1] * other[2] - one[2] * other[1],
        one[2] * other[0] - one[0] * other[2],
        one[0] * other[1] - one[1] * other[0],
    )
