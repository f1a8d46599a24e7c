"""Rigid-body transforms and inertias: moved, combined, diagonalised."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import atan2, cos, hypot, sin

import numpy as np

from tunenet_logs.arrays import Array


def rotation_from_rpy(rpy: Sequence[float]) -> Array:
    """Compute R = Rz(yaw) Ry(pitch) Rx(roll) [rad], URDF's convention, shape (3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = zip(*((cos(angle), sin(angle)) for angle in rpy), strict=True)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_from_rotation(rotation: Array) -> tuple[float, float, float]:
    """Compute roll, pitch, yaw [rad] of a (3, 3) rotation; in gimbal lock, yaw is 0."""
    level = hypot(rotation[0, 0], rotation[1, 0])
    pitch = atan2(-rotation[2, 0], level)
    if level < 1e-9:  # pitch is 90 degrees: roll and yaw turn about the same axis
        return atan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0
    return (
        atan2(rotation[2, 1], rotation[2, 2]),
        pitch,
        atan2(rotation[1, 0], rotation[0, 0]),
    )


@dataclass(frozen=True, eq=False)
class Transform:
    """A rigid transform: the pose of a frame in its parent.

    Attributes:
        origin_m: the frame's origin in the parent, shape (3,).
        rotation: the frame's axes in the parent, as columns, shape (3, 3).
    """

    origin_m: Array
    rotation: Array

    @classmethod
    def at(cls, origin_m: Sequence[float], rpy: Sequence[float]) -> Transform:
        """Make a transform from an origin [m], and roll, pitch and yaw [rad]."""
        return cls(np.array(origin_m, np.float64), rotation_from_rpy(rpy))

    def __matmul__(self, inner: Transform) -> Transform:
        """Compose: map `inner`, given in this frame, to this frame's parent."""
        return Transform(
            self.origin_m + self.rotation @ inner.origin_m, self.rotation @ inner.rotation
        )


IDENTITY = Transform.at((0, 0, 0), (0, 0, 0))


@dataclass(frozen=True)
class Inertial:
    """Mass, centre of mass and inertia of a link, as in a URDF's `<inertial>`.

    Attributes:
        mass_kg: over 0 where a joint moves it.
        com_m: centre of mass in the link's frame.
        inertia_kg_m2: ixx, ixy, ixz, iyy, iyz, izz about the centre of mass, along the axes of the
            link's frame.
    """

    mass_kg: float
    com_m: tuple[float, float, float]
    inertia_kg_m2: tuple[float, float, float, float, float, float]

    def tensor(self) -> Array:
        """Return the inertia tensor, shape (3, 3) [kg m²]."""
        xx, xy, xz, yy, yz, zz = self.inertia_kg_m2
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def seen_from(self, frame: Transform) -> Inertial:
        """Transform to the parent of `frame`, the link's."""
        com_m = frame.origin_m + frame.rotation @ np.array(self.com_m)
        return inertial(self.mass_kg, com_m, frame.rotation @ self.tensor() @ frame.rotation.T)

    def principal(self) -> tuple[Array, Array]:
        """Diagonalise: principal moments [kg m²], shape (3,), and axes as columns, (3, 3).

        Where rounding in a file breaks the triangle inequality of the moments, the largest is
        lowered to the sum of the others: PyBullet would take all of them for 0.
        """
        tensor = self.tensor()
        if np.any(tensor - np.diag(np.diag(tensor))):
            moments, axes = np.linalg.eigh(tensor)
            axes[:, 2] *= np.sign(np.linalg.det(axes))
        else:
            moments, axes = np.diag(tensor), np.eye(3)
        most = (moments.sum() - moments) * (1 - 1e-9)
        return np.minimum(moments, most), axes


NOTHING = Inertial(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))  # a link without mass


def inertial(mass_kg: float, com_m: Array, tensor: Array) -> Inertial:
    """Make from arrays: centre of mass [m], shape (3,), and inertia [kg m²], shape (3, 3)."""
    x, y, z = (float(value) for value in com_m)
    xx, xy, xz, yy, yz, zz = (float(value) for value in tensor[np.triu_indices(3)])
    return Inertial(mass_kg, (x, y, z), (xx, xy, xz, yy, yz, zz))


def combined(parts: Iterable[Inertial]) -> Inertial:
    """Combine bodies fixed to each other (parallel axis theorem); `NOTHING` if massless.

    Returns:
        `NOTHING` if they weigh nothing.
    """
    heavy = [part for part in parts if part != NOTHING]
    mass_kg = sum(part.mass_kg for part in heavy)
    if mass_kg <= 0:
        return NOTHING
    if len(heavy) == 1:
        return heavy[0]
    com_m = sum((part.mass_kg * np.array(part.com_m) for part in heavy), np.zeros(3)) / mass_kg
    tensor = np.zeros((3, 3))
    for part in heavy:
        away = np.array(part.com_m) - com_m
        tensor += part.tensor() + part.mass_kg * (away @ away * np.eye(3) - np.outer(away, away))
    return inertial(mass_kg, com_m, tensor)


def solid_sphere(mass_kg: float, radius_m: float) -> Inertial:
    """Return the inertia of a solid sphere about its centre."""
    moment = 0.4 * mass_kg * radius_m**2
    return Inertial(mass_kg, (0.0, 0.0, 0.0), (moment, 0.0, 0.0, moment, 0.0, moment))
