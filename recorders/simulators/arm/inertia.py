"""Masses of links: moved to other frames, put together, along their principal axes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from recorders.simulators.arm.frames import Frame
from tunenet_logs.arrays import Array


@dataclass(frozen=True)
class Inertial:
    """What a link weighs.

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
        """The inertia as a matrix, shape (3, 3)."""
        xx, xy, xz, yy, yz, zz = self.inertia_kg_m2
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def seen_from(self, frame: Frame) -> Inertial:
        """The same in the frame in which `frame`, the link's, is given."""
        com_m = frame.origin_m + frame.rotation @ np.array(self.com_m)
        return inertial(self.mass_kg, com_m, frame.rotation @ self.tensor() @ frame.rotation.T)

    def principal(self) -> tuple[Array, Array]:
        """Principal moments, shape (3,), and their axes as columns of a rotation, (3, 3).

        A tensor that is no body's, with one moment over the sum of the others (files round theirs),
        has that one lowered to the sum: PyBullet would take all of it for 0.
        """
        tensor = self.tensor()
        if np.any(tensor - np.diag(np.diag(tensor))):
            moments, axes = np.linalg.eigh(tensor)
            axes[:, 2] *= np.sign(np.linalg.det(axes))
        else:
            moments, axes = np.diag(tensor), np.eye(3)
        most = (moments.sum() - moments) * (1 - 1e-9)
        return np.minimum(moments, most), axes


NOTHING = Inertial(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
"""A link without mass."""


def inertial(mass_kg: float, com_m: Array, tensor: Array) -> Inertial:
    """From arrays: the centre of mass [m], shape (3,), and the inertia [kg m²], shape (3, 3)."""
    x, y, z = (float(one) for one in com_m)
    xx, xy, xz, yy, yz, zz = (float(one) for one in tensor[np.triu_indices(3)])
    return Inertial(mass_kg, (x, y, z), (xx, xy, xz, yy, yz, zz))


def combined(parts: Iterable[Inertial]) -> Inertial:
    """Bodies in one frame, fixed to each other, as one; `NOTHING` if they weigh nothing."""
    heavy = [one for one in parts if one != NOTHING]
    mass_kg = sum(one.mass_kg for one in heavy)
    if mass_kg <= 0:
        return NOTHING
    if len(heavy) == 1:
        return heavy[0]
    com_m = sum((one.mass_kg * np.array(one.com_m) for one in heavy), np.zeros(3)) / mass_kg
    tensor = np.zeros((3, 3))
    for one in heavy:
        away = np.array(one.com_m) - com_m
        tensor += one.tensor() + one.mass_kg * (away @ away * np.eye(3) - np.outer(away, away))
    return inertial(mass_kg, com_m, tensor)


def solid_sphere(mass_kg: float, radius_m: float) -> Inertial:
    """A ball about its own centre."""
    moment = 0.4 * mass_kg * radius_m**2
    return Inertial(mass_kg, (0.0, 0.0, 0.0), (moment, 0.0, 0.0, moment, 0.0, moment))
