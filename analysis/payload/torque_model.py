"""Torques that a driver reports, as a function of the terms of `torque_terms.py`.

They are those of a rigid arm (link parameters near the model's, a base not quite level, encoders
off zero) and of its rotors and gears, times a gain, delayed by a lag, plus what sensors and hoses
add. A run with an empty gripper has the same terms, without the payload.

The rigid part is Pinocchio's joint-torque regressor: torques are linear in the masses, first
moments and inertias of links and payload (Atkeson, An and Hollerbach 1986).
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.payload.arm_motion import ArmMotion
from analysis.payload.torque_terms import (
    CENTRE,
    MASS,
    OWN_TERMS,
    PAYLOAD_TERMS,
    WAVES,
    Terms,
)
from recorders.simulators.arm.description import PAYLOAD_RADIUS_M, Arm
from recorders.simulators.arm.rigid_bodies import rotation_from_rpy
from recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.arrays import Array

# Speed below which dry friction fades: a motion's zero crossing is not known better.
_SIGN_RAD_S = 0.015

# Speeds over which friction falls from its peak: Stribeck's are between them.
_SHAPE_RAD_S = (0.03, 0.1, 0.3)

# Of one body in Pinocchio: mass, first moments (3), and the inertia about the joint's frame as xx,
# xy, yy, xz, yz, zz, which is its lower triangle by rows.
_BODY_PARAMETERS = 10

_MIN_KG = 1e-6  # of a link, whatever a fit makes of it on its way
_OFFSET, _LOAD_WAY, _LOAD, _GAIN = 0, 2, 7, 9
_GEAR = slice(1, 9)
# Of a joint's own terms: what is a gear's, between the arm and the sensor; and what is not.
_BESIDE = [_OFFSET, *range(10, OWN_TERMS)]


@dataclass(frozen=True)
class Convention:
    """Torque convention of a driver.

    Attributes:
        sign: +1 if it is the joint's torque, -1 if it is the load's.
        has_gravity: Whether the arm's own weight is included.
    """

    sign: int
    has_gravity: bool


CONVENTIONS = tuple(Convention(sign, full) for full in (True, False) for sign in (1, -1))


@dataclass(frozen=True, eq=False)
class RigidTorques:
    """Torques of a rigid arm along a motion, with its links and payload as fitted.

    Attributes:
        total_nm: Shape (T, J).
        slopes: By the payload's terms, the links', the tilt and the encoder zeros: (T, J, C).
    """

    total_nm: Array
    slopes: Array


class ArmModel:
    """Rigid-body model of the arm in Pinocchio.

    Args:
        arm: Checked numbers; it stands upright, but for a tilt.
    """

    def __init__(self, arm: Arm) -> None:
        self._library: Any = import_module("pinocchio")
        self._model: Any = self._library.buildModelFromXML(arm.urdf())
        self._data: Any = self._model.createData()
        self._links = np.stack([one.toDynamicParameters() for one in self._model.inertias[1:]])
        self._payload = _payload_parameters(arm)

    def empty_nm(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Compute torques of the arm as described (Newton-Euler), along a motion of (T, J)."""
        self._become(self._links, np.zeros(2))
        rows = zip(position, velocity, acceleration, strict=True)
        model, data, rnea = self._model, self._data, self._library.rnea
        return np.stack([rnea(model, data, *row).copy() for row in rows])

    def gravity_nm(self, position: Array) -> Array:
        """Compute gravity torques of the arm as described [N·m], shape (T, J)."""
        self._become(self._links, np.zeros(2))
        return self._held_nm(position)

    def torques(
        self, position: Array, velocity: Array, acceleration: Array, values: Array, *, held: bool
    ) -> RigidTorques:
        """Compute torques along a motion, with their derivatives by the terms (regressor).

        Args:
            position: Of each joint [rad], shape (T, J).
            velocity: [rad/s], shape (T, J).
            acceleration: [rad/s^2], shape (T, J).
            values: Of the terms, shape (N,): the payload's, the links', tilt and zeros are used.
            held: Whether the payload is there.
        """
        count = position.shape[1]
        first = PAYLOAD_TERMS
        masses, centres_m, inertias, tilt = np.split(
            values[first : first + 5 * count + 2], [count, 4 * count, 5 * count]
        )
        bodies = self._links * (1 + masses[:, None])
        bodies[:, 1:4] += self._links[:, :1] * centres_m.reshape(count, 3)
        bodies[:, 4:] += self._links[:, 4:] * inertias[:, None]
        if held:
            bodies[-1] += self._payload @ values[:first]
        self._become(bodies, tilt)
        model, data, library = self._model, self._data, self._library
        regressors, by_angle = [], []
        for row in zip(position, velocity, acceleration, strict=True):
            regressors.append(library.computeJointTorqueRegressor(model, data, *row).copy())
            by_angle.append(library.computeRNEADerivatives(model, data, *row)[0].copy())
        regressor = np.stack(regressors).reshape(*position.shape, count, _BODY_PARAMETERS)
        slopes = np.zeros((*position.shape, first + 6 * count + 2))
        if held:
            slopes[..., :first] = regressor[:, :, -1] @ self._payload
        at = first
        slopes[..., at : at + count] = np.einsum("tjlp,lp->tjl", regressor, self._links)
        at += count
        by_centre = regressor[..., 1:4] * self._links[:, :1]
        slopes[..., at : at + 3 * count] = by_centre.reshape(*position.shape, -1)
        at += 3 * count
        slopes[..., at : at + count] = np.einsum(
            "tjlp,lp->tjl", regressor[..., 4:], self._links[:, 4:]
        )
        at += count
        for axis in range(2):
            model.gravity.linear = GRAVITY_M_S2 * np.eye(3)[axis]
            slopes[..., at + axis] = self._held_nm(position)
        slopes[..., at + 2 :] = np.stack(by_angle)
        return RigidTorques(np.einsum("tjlp,lp->tj", regressor, bodies), slopes)

    def _held_nm(self, position: Array) -> Array:
        compute = self._library.computeGeneralizedGravity
        return np.stack([compute(self._model, self._data, row).copy() for row in position])

    def _become(self, bodies: Array, tilt: Array) -> None:
        """Set the links' parameters, shape (J, 10), and the tilt of gravity, shape (2,)."""
        down = -np.sqrt(max(1.0 - float(tilt @ tilt), 0.0))
        self._model.gravity.linear = GRAVITY_M_S2 * np.array([*tilt, down])
        for index, body in enumerate(bodies, 1):
            own = body.copy()
            own[0] = max(own[0], _MIN_KG)
            self._model.inertias[index] = self._library.Inertia.FromDynamicParameters(own)


def _payload_parameters(arm: Arm) -> Array:
    """Return the last body's inertial parameters by the payload's terms, shape (10, 10).

    A payload's mass has the inertia of a solid ball. The square of its centre's offset is left out:
    an arm's torques do not show it.
    """
    rotation = rotation_from_rpy(arm.tool_from_last_rpy)
    tool = np.array(arm.tool_from_last_m)
    parameters = np.zeros((_BODY_PARAMETERS, PAYLOAD_TERMS))
    parameters[0, MASS] = 1.0
    parameters[1:4, MASS] = tool
    parameters[1:4, CENTRE] = rotation
    ball = 0.4 * PAYLOAD_RADIUS_M**2 * np.eye(3)
    inertias = [ball + tool @ tool * np.eye(3) - np.outer(tool, tool)]
    for axis in rotation.T:
        crossed = np.outer(tool, axis)
        inertias.append(2 * tool @ axis * np.eye(3) - crossed - crossed.T)
    inertias += [rotation @ moment @ rotation.T for moment in moments()]
    for column, inertia in enumerate(inertias):
        parameters[4:, column] = inertia[np.tril_indices(3)]
    return parameters


def moments() -> list[Array]:
    """Return the unit tensors of the six moments of inertia, in order, each (3, 3)."""
    tensors = []
    for row, column in zip(*np.tril_indices(3), strict=True):
        tensor = np.zeros((3, 3))
        tensor[row, column] = tensor[column, row] = 1.0
        tensors.append(tensor)
    return tensors


def smooth_sign(velocity: Array) -> Array:
    """Return the sign of velocities [rad/s], smoothed about 0 by a tanh."""
    return np.tanh(velocity / _SIGN_RAD_S)


@dataclass(frozen=True, eq=False)
class Linearization:
    """Torques linearised about some values of the terms.

    Attributes:
        predicted_nm: At these values [N·m], shape (T, J).
        columns: Terms that each joint's slopes are by, shape (J, C).
        slopes: Derivatives, shape (T, J, C).
    """

    predicted_nm: Array
    columns: NDArray[np.int64]
    slopes: Array

    def moved_nm(self, change: Array) -> Array:
        """Return the change of torques, (T, J), for a change of the terms, shape (N,)."""
        return np.einsum("tjc,jc->tj", self.slopes, change[self.columns])


@dataclass(frozen=True, eq=False)
class LoggedArm:
    """Torque model of one run.

    Attributes:
        model: The arm's.
        terms: Of all runs that are fitted together.
        motion: This one's.
        run: 0 for the log itself, from 1 for its tares.
        covered: For a tare along the log's path, which of the log's times it covers; None for any
            other run.
    """

    model: ArmModel
    terms: Terms
    motion: ArmMotion
    run: int
    covered: NDArray[np.bool_] | None = None

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Measured samples, shape (T,): a tare along the log's path may not cover it."""
        return np.ones(len(self.motion.seconds), bool) if self.covered is None else self.covered

    def torques_nm(self, convention: Convention) -> Array:
        """Return measured torques with the joint's sign [N·m], shape (T, J)."""
        return convention.sign * self.motion.effort

    @property
    def columns(self) -> NDArray[np.int64]:
        """Indices of the terms that each joint's torques depend on, shape (J, C).

        First what all joints share, the lag last of it; then the joint's own; then its drifts.
        """
        joints = self.terms.joints
        common = np.arange(PAYLOAD_TERMS + 6 * joints + 2)
        own = len(common) + np.arange(joints)[:, None] * OWN_TERMS + np.arange(OWN_TERMS)
        lag = len(common) + joints * OWN_TERMS + self.run * (1 + 2 * joints)
        drifts = lag + 1 + np.arange(joints)[:, None] + joints * np.arange(2)
        return np.hstack([np.tile(np.append(common, lag), (joints, 1)), own, drifts])

    def linearized(self, values: Array, convention: Convention) -> Linearization:
        """Linearise the torques about values of the terms, shape (N,)."""
        columns, joints, seconds = self.columns, self.terms.joints, self.motion.seconds
        first = columns.shape[1] - OWN_TERMS - 2
        of_joint = values[columns[:, first : first + OWN_TERMS]]
        zeros = values[first - 1 - joints : first - 1]
        said, velocity, acceleration = self.motion.at(seconds - values[columns[0, first - 1]])
        rigid = self.model.torques(said + zeros, velocity, acceleration, values, held=self.run == 0)
        own = _own_features(rigid.total_nm, said, velocity, acceleration)
        gains = 1 + of_joint[:, _GAIN]
        carried = 1 + of_joint[:, _LOAD] * np.sign(rigid.total_nm) * own[..., _LOAD_WAY]
        felt_nm = rigid.total_nm + np.einsum("tjc,jc->tj", own[..., _GEAR], of_joint[:, _GEAR])
        own[..., _GEAR] *= gains[:, None]
        own[..., _GAIN] = felt_nm
        drifts = np.stack([np.ones_like(said), np.zeros_like(said)], axis=-1)
        drifts[..., 1] = np.linspace(-1.0, 1.0, len(seconds))[:, None]
        beside = np.einsum("tjc,jc->tj", own[..., _BESIDE], of_joint[:, _BESIDE])
        beside += np.einsum("tjc,jc->tj", drifts, values[columns[:, -2:]])
        moving_nm = gains * felt_nm + beside
        if not convention.has_gravity:
            moving_nm = moving_nm - self.model.gravity_nm(said)
        lags = -np.gradient(moving_nm, seconds, axis=0)[..., None]
        shared = rigid.slopes * (gains * carried)[..., None]
        return Linearization(moving_nm, columns, np.concatenate([shared, lags, own, drifts], -1))


def _own_features(rigid_nm: Array, position: Array, velocity: Array, acceleration: Array) -> Array:
    """Return the regressors of the joints' own terms, (T, J, OWN_TERMS); gains are 0."""
    way = smooth_sign(velocity)
    slow = [way * np.exp(-((velocity / width) ** 2)) for width in _SHAPE_RAD_S]
    angles = [wave * position for wave in range(1, WAVES + 1)]
    waves = [turn(angle) for angle in angles for turn in (np.cos, np.sin)]
    ones, load = np.ones_like(way), np.abs(rigid_nm) * way
    gear = [velocity, way, *slow, way**2, load, acceleration]
    return np.stack([ones, *gear, np.zeros_like(way), *waves], axis=-1)
