"""What balls do that touch something fixed: a rebound, and Coulomb's friction on their slip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array

LEAST_REBOUND_M_S = 0.01
"""A ball that would stay is thrown up so little (5 um), so that it goes on rolling from impact to
impact."""


@dataclass
class Balls:
    """Many balls at a moment, each on its own.

    Attributes:
        position_m: of the centres, shape (N, 3).
        velocity_m_s: shape (N, 3).
        spin_rad_s: shape (N, 3).
    """

    position_m: Array
    velocity_m_s: Array
    spin_rad_s: Array


def collide(
    balls: Balls,
    which: NDArray[np.int64],
    normals: Array,
    restitution: Array,
    friction: float,
    radius_m: float,
    inertia_share: float,
) -> None:
    """Give balls the impulse of an impact, in place.

    Along the normal the speed is reversed times the restitution; across it friction takes the slip
    of the touching point, at most all of it and at most Coulomb's share of the normal impulse:
    sticking takes slip / (1 + 1 / k), with k = I / (m r^2); 2/7 of it for a solid sphere.

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
    outward = np.maximum(restitution * inward, LEAST_REBOUND_M_S)
    pushed = inward + outward
    slipping = np.linalg.norm(slip, axis=1)
    held = np.minimum(slipping / (1 + 1 / inertia_share), friction * pushed)
    along = slip * (held / np.maximum(slipping, 1e-12))[:, None]
    balls.velocity_m_s[which] = velocity + pushed[:, None] * normals - along
    torque = np.cross(-normals, -along)
    balls.spin_rad_s[which] = spin + torque / (inertia_share * radius_m)
