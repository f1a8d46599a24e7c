"""Contact of balls with plane and rim: Newton restitution and Coulomb friction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recorders.simulators.shot.rig import ShotRig
from tunenet_logs.arrays import Array

# A ball that would stay is thrown up by this (5 um high), so that it goes on rolling from impact to
# impact.
MIN_REBOUND_M_S = 0.01

_MIN_M = 1e-9  # below any length here: it only keeps a direction from being divided by 0


@dataclass
class BallStates:
    """The states of N balls at a moment; they do not touch each other.

    Attributes:
        position_m: of the centres, shape (N, 3).
        velocity_m_s: shape (N, 3).
        spin_rad_s: shape (N, 3).
    """

    position_m: Array
    velocity_m_s: Array
    spin_rad_s: Array


def collide(
    balls: BallStates,
    which: NDArray[np.int64],
    normals: Array,
    restitution: Array,
    friction: float,
    radius_m: float,
    inertia_share: float,
) -> None:
    """Apply the impulse of an impact to balls, in place.

    Along the normal the speed is reversed times the restitution (Newton's law of impact); across it
    friction takes the slip of the touching point, at most all of it, and at most the friction
    coefficient times the normal impulse (Coulomb's law): sticking takes slip / (1 + 1 / k), with
    k = I / (m r^2); 2/7 of it for a solid sphere.

    Args:
        balls: all of them.
        which: those that touch, shape (M,).
        normals: unit vectors from what is touched to their centres, shape (M, 3).
        restitution: shape (M,).
        friction: Coulomb's coefficient.
        radius_m: of the balls.
        inertia_share: k.
    """
    velocity, spin = balls.velocity_m_s[which], balls.spin_rad_s[which]
    slip = velocity + np.cross(spin, -radius_m * normals)
    inward = -np.sum(slip * normals, axis=1)
    slip += inward[:, None] * normals
    outward = np.maximum(restitution * inward, MIN_REBOUND_M_S)
    pushed = inward + outward
    slipping = np.linalg.norm(slip, axis=1)
    held = np.minimum(slipping / (1 + 1 / inertia_share), friction * pushed)
    along = slip * (held / np.maximum(slipping, 1e-12))[:, None]
    balls.velocity_m_s[which] = velocity + pushed[:, None] * normals - along
    torque = np.cross(-normals, -along)
    balls.spin_rad_s[which] = spin + torque / (inertia_share * radius_m)


# What `collide` does.
Collide = Callable[[BallStates, NDArray[np.int64], Array, Array, float, float, float], None]


class Surface(Protocol):
    """A fixed surface."""

    def gaps_m(self, positions_m: Array) -> Array:
        """Compute signed gaps from the ball to the surface, (N, 3) -> (N,) [m]."""
        ...

    def normals(self, positions_m: Array) -> Array:
        """Compute unit normals from the surface to the ball's centre, (N, 3) -> (N, 3)."""
        ...


class Board:
    """The inclined plane, taken as infinite; `holds` says where it ends."""

    def __init__(self, rig: ShotRig) -> None:
        self._normal, self._downhill = rig.plane.normal, rig.plane.downhill
        self._radius_m, self._end_m = rig.ball.radius_m, rig.plane.downhill_m

    def gaps_m(self, positions_m: Array) -> Array:
        """See `Surface`."""
        return positions_m @ self._normal - self._radius_m

    def normals(self, positions_m: Array) -> Array:
        """See `Surface`."""
        return np.broadcast_to(self._normal, positions_m.shape)

    def holds(self, positions_m: Array) -> NDArray[np.bool_]:
        """Return whether the board reaches as far down as the balls are, shape (N,)."""
        return positions_m @ self._downhill <= self._end_m


class Rim:
    """The hoop's rim: a torus about the vertical through its centre."""

    def __init__(self, rig: ShotRig) -> None:
        self._center_m, self._ring_m = rig.hoop.center_m, rig.hoop.ring_radius_m
        self._reach_m = rig.ball.radius_m + rig.hoop.rim_m / 2

    def gaps_m(self, positions_m: Array) -> Array:
        """See `Surface`."""
        out, up = self._from_ring(positions_m)
        return np.hypot(out, up) - self._reach_m

    def normals(self, positions_m: Array) -> Array:
        """See `Surface`."""
        offset = positions_m - self._center_m
        out, up = self._from_ring(positions_m)
        across = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), _MIN_M)
        away = np.maximum(np.hypot(out, up), _MIN_M)
        flat = offset[:, :2] * (out / across / away)[:, None]
        return np.column_stack([flat, up / away])

    def is_within(self, positions_m: Array) -> NDArray[np.bool_]:
        """Return whether centres are nearer to the hoop's axis than the rim, shape (N,)."""
        return self._from_ring(positions_m)[0] < 0

    def _from_ring(self, positions_m: Array) -> tuple[Array, Array]:
        """Return offsets from the rim's centre line, outwards and up, each of shape (N,)."""
        offset = positions_m - self._center_m
        return np.hypot(offset[:, 0], offset[:, 1]) - self._ring_m, offset[:, 2]
