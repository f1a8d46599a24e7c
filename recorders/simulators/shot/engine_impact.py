"""Solve the impacts of a shot by a physics engine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recorders.simulators.base import BallWorld
from recorders.simulators.shot.contact import MIN_REBOUND_M_S, BallStates, Collide
from tunenet_logs.arrays import Array


def solved_by(world: BallWorld) -> Collide:
    """Make a `collide` that solves impacts in the engine of `world`, one after another."""

    def collide(
        balls: BallStates,
        which: NDArray[np.int64],
        normals: Array,
        restitution: Array,
        friction: float,
        radius_m: float,  # noqa: ARG001 (the world's)
        inertia_share: float,
    ) -> None:
        for ball, normal, wanted in zip(which.tolist(), normals, restitution, strict=True):
            axes = _upright(normal)
            velocity, spin = axes @ balls.velocity_m_s[ball], axes @ balls.spin_rad_s[ball]
            least = MIN_REBOUND_M_S / max(-float(velocity[2]), 1e-9)
            rebound = max(float(wanted), least)
            velocity, spin = world.impact(velocity, spin, rebound, friction, inertia_share)
            balls.velocity_m_s[ball], balls.spin_rad_s[ball] = axes.T @ velocity, axes.T @ spin

    return collide


def _upright(normal: Array) -> Array:
    """Return the axes of a frame whose z is the normal, as rows, shape (3, 3)."""
    aside = np.eye(3)[int(np.argmin(np.abs(normal)))]
    x = np.cross(aside, normal)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(normal, x), normal])
