"""What torques an arm needs along a motion, and what each of its masses does to them.

Pinocchio's regressor: the torques of a rigid arm are linear in the masses, first moments and
inertias of its links, and of what it holds (Atkeson, An and Hollerbach 1986).
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from recorders.simulators.arm.description import PAYLOAD_RADIUS_M, Arm
from recorders.simulators.arm.dynamics import GRAVITY_M_S2
from recorders.simulators.arm.frames import rotation_from_rpy
from tunenet_logs.arrays import Array

_NUMBERS = 10
"""Of one body: mass, first moments (3), inertia (6) about the joint's frame."""
_XX, _XY, _YY, _XZ, _YZ, _ZZ = range(4, 10)
_AXES = ((_XX, _XY, _XZ), (_XY, _YY, _YZ), (_XZ, _YZ, _ZZ))


@dataclass(frozen=True, eq=False)
class Torques:
    """Of an arm along a motion.

    Attributes:
        empty_nm: with nothing in the gripper [N·m], shape (T, J).
        payload: what a payload adds: per kg in the tool frame's origin, then per kg·m of its
            centre's offset along the frame's x, y, z, shape (T, J, 4).
        link_masses: per share that a link with all its inertia is heavier, shape (T, J, L).
        link_centres: per m that its centre is off along x, y, z, shape (T, J, 3 L).
    """

    empty_nm: Array
    payload: Array
    link_masses: Array
    link_centres: Array


class ArmModel:
    """The arm in Pinocchio.

    Args:
        arm: checked numbers; it stands upright.
    """

    def __init__(self, arm: Arm) -> None:
        self._library: Any = import_module("pinocchio")
        self._model: Any = self._library.buildModelFromXML(arm.urdf())
        self._model.gravity.linear = np.array(GRAVITY_M_S2)
        self._data: Any = self._model.createData()
        self._links = np.stack([one.toDynamicParameters() for one in self._model.inertias[1:]])
        self._payload = _payload_numbers(arm)

    def torques(self, position: Array, velocity: Array, acceleration: Array) -> Torques:
        """Along a motion [rad, rad/s, rad/s^2], each of shape (T, J)."""
        at = self._regressor(position, velocity, acceleration)
        by_link = at.reshape(*position.shape, -1, _NUMBERS)
        masses = self._links[:, :1]
        return Torques(
            empty_nm=at @ self._links.ravel(),
            payload=by_link[:, :, -1] @ self._payload,
            link_masses=np.einsum("tjlp,lp->tjl", by_link, self._links),
            link_centres=(by_link[..., 1:4] * masses).reshape(*position.shape, -1),
        )

    def held_nm(self, position: Array) -> Array:
        """What gravity alone asks of the empty arm [N·m], shape (T, J)."""
        compute = self._library.computeGeneralizedGravity
        return np.stack([compute(self._model, self._data, row).copy() for row in position])

    def _regressor(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Shape (T, J, 10 L)."""
        compute = self._library.computeJointTorqueRegressor
        rows = zip(position, velocity, acceleration, strict=True)
        found = [compute(self._model, self._data, *row).copy() for row in rows]
        return np.stack(found).reshape(*position.shape, -1)  # of one joint it is a flat array


def _payload_numbers(arm: Arm) -> Array:
    """The ten numbers of the last joint's body, per kg and per kg·m of a payload, shape (10, 4).

    Its own inertia is a solid ball's. The square of its centre's offset is left out: the torques
    of an arm do not show it.
    """
    rotation = rotation_from_rpy(arm.tool_from_last_rpy)
    place = np.array(arm.tool_from_last_m)
    numbers = np.zeros((_NUMBERS, 4))
    numbers[0, 0] = 1.0
    numbers[1:4, 0] = place
    numbers[1:4, 1:] = rotation
    ball = 0.4 * PAYLOAD_RADIUS_M**2 * np.eye(3)
    _set_inertia(numbers[:, 0], ball + place @ place * np.eye(3) - np.outer(place, place))
    for axis, way in enumerate(rotation.T):
        crossed = np.outer(place, way)
        inertia = 2 * place @ way * np.eye(3) - crossed - crossed.T
        _set_inertia(numbers[:, 1 + axis], inertia)
    return numbers


def _set_inertia(numbers: Array, tensor: Array) -> None:
    for row, places in zip(tensor, _AXES, strict=True):
        numbers[list(places)] = row
