"""What a driver reports as torques, as a function of terms with priors.

It is the model's torque with errors of the links, times a gain, late by a lag, plus friction and an
offset. Each is a term: how it changes the torques, and how large it usually is. A run with an empty
gripper has the same terms, without the payload.

The model is Pinocchio's regressor: the torques of a rigid arm are linear in the masses, first
moments and inertias of its links, and of what it holds (Atkeson, An and Hollerbach 1986).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.payload.arm_motion import ArmMotion
from recorders.simulators.arm.description import PAYLOAD_RADIUS_M, Arm
from recorders.simulators.arm.dynamics import UPRIGHT_GRAVITY_M_S2
from recorders.simulators.arm.rigid_bodies import rotation_from_rpy
from tunenet_logs.arrays import Array

PAYLOAD_SD_KG = 5.0
CENTRE_SD_M = 0.05
"""Wide: what an arm lifts, and where in a hand its centre may be."""

OFFSET_SD_NM = 0.3
FRICTION_SD_NM = 0.5
GAIN_SD = 0.03
LINK_MASS_SD = 0.05
LINK_CENTRE_SD_M = 0.003
LAG_SD_S = 0.03
"""Usual errors of joint torque sensors and arm models; a gain and a link's mass as fractions,
friction dry and per rad/s. The scale of each group is fitted beside (`torque_fit.LEVELS`)."""

DRIFT_SD_NM = 0.05
"""Of a sensor's zero, between the empty run and the other."""

_SIGN_RAD_S = 0.015
"""Speed below which dry friction fades: a motion's zero crossing is not known better."""

MASS = 0
CENTRE = slice(1, 4)
"""Indices of the payload's terms: its mass [kg] and its first moments [kg·m]."""

_BODY_PARAMETERS = 10
"""Of one body in Pinocchio: mass, first moments (3), and the inertia about the joint's frame as
xx, xy, yy, xz, yz, zz, which is its lower triangle by rows."""


@dataclass(frozen=True)
class Convention:
    """What a driver means by torque.

    Attributes:
        sign: +1 where it is the joint's, -1 where it is the load's.
        has_gravity: whether the arm's own weight is in it.
    """

    sign: int
    has_gravity: bool


CONVENTIONS = tuple(Convention(sign, full) for full in (True, False) for sign in (1, -1))


@dataclass(frozen=True, eq=False)
class ArmTorques:
    """Of an arm along a motion.

    Attributes:
        empty_nm: with nothing in the gripper [N·m], shape (T, J).
        payload: what a payload adds: per kg in the tool frame's origin, then per kg·m of its
            centre's offset along the frame's x, y, z, shape (T, J, 4).
        link_masses: per fraction that a link with all its inertia is heavier, shape (T, J, L).
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
        self._model.gravity.linear = np.array(UPRIGHT_GRAVITY_M_S2)
        self._data: Any = self._model.createData()
        links = self._model.inertias[1:]
        self._links = np.stack([link.toDynamicParameters() for link in links])
        self._payload = _payload_parameters(arm)

    def torques(self, position: Array, velocity: Array, acceleration: Array) -> ArmTorques:
        """Along a motion [rad, rad/s, rad/s^2], each of shape (T, J)."""
        compute = self._library.computeJointTorqueRegressor
        rows = zip(position, velocity, acceleration, strict=True)
        stacked = np.stack([compute(self._model, self._data, *row).copy() for row in rows])
        regressor = stacked.reshape(*position.shape, -1)  # of one joint, rows are flat
        by_link = regressor.reshape(*position.shape, -1, _BODY_PARAMETERS)
        masses = self._links[:, :1]
        return ArmTorques(
            empty_nm=regressor @ self._links.ravel(),
            payload=by_link[:, :, -1] @ self._payload,
            link_masses=np.einsum("tjlp,lp->tjl", by_link, self._links),
            link_centres=(by_link[..., 1:4] * masses).reshape(*position.shape, -1),
        )

    def gravity_nm(self, position: Array) -> Array:
        """Torques of gravity alone on the empty arm [N·m], shape (T, J)."""
        compute = self._library.computeGeneralizedGravity
        return np.stack([compute(self._model, self._data, row).copy() for row in position])


def _payload_parameters(arm: Arm) -> Array:
    """Parameters of the last joint's body, per kg and per kg·m of a payload, shape (10, 4).

    Its own inertia is a solid ball's. The square of its centre's offset is left out: the torques
    of an arm do not show it.
    """
    rotation = rotation_from_rpy(arm.tool_from_last_rpy)
    tool = np.array(arm.tool_from_last_m)
    parameters = np.zeros((_BODY_PARAMETERS, 4))
    parameters[0, 0] = 1.0
    parameters[1:4, 0] = tool
    parameters[1:4, 1:] = rotation
    ball = 0.4 * PAYLOAD_RADIUS_M**2 * np.eye(3)
    inertias = [ball + tool @ tool * np.eye(3) - np.outer(tool, tool)]
    for axis in rotation.T:
        crossed = np.outer(tool, axis)
        inertias.append(2 * tool @ axis * np.eye(3) - crossed - crossed.T)
    for column, inertia in enumerate(inertias):
        parameters[4:, column] = inertia[np.tril_indices(3)]
    return parameters


@dataclass(frozen=True, eq=False)
class Terms:
    """The unknowns, the payload's first.

    Attributes:
        names: in words, of each.
        groups: that are scaled together, of each.
        sds: of the priors about 0, shape (N,), in the units of the terms.
    """

    names: tuple[str, ...]
    groups: tuple[str, ...]
    sds: Array

    def indices(self, group: str) -> NDArray[np.int64]:
        """Of a group's terms."""
        return np.flatnonzero(np.array([name == group for name in self.groups]))


def make_terms(joints: Sequence[str], logs: int) -> Terms:
    """For the joints of an arm, and a log (1) or a log with its tare (2)."""
    numbers = range(1, len(joints) + 1)
    axes = ("x", "y", "z")
    table: list[tuple[str, str, float]] = [("payload", "payload", PAYLOAD_SD_KG)]
    table += [(f"centre {axis}", "centre", CENTRE_SD_M) for axis in axes]
    table += [(f"offset of joint {n}", "offset", OFFSET_SD_NM) for n in numbers]
    table += [(f"viscous friction of joint {n}", "friction", FRICTION_SD_NM) for n in numbers]
    table += [(f"dry friction of joint {n}", "friction", FRICTION_SD_NM) for n in numbers]
    table += [(f"gain of joint {n}", "gain", GAIN_SD) for n in numbers]
    table += [(f"mass of link {n}", "links", LINK_MASS_SD) for n in numbers]
    table += [
        (f"centre {axis} of link {n}", "links", LINK_CENTRE_SD_M) for n in numbers for axis in axes
    ]
    table += [(name, "lag", LAG_SD_S) for name in ("lag", "lag of the tare")[:logs]]
    if logs > 1:
        table += [(f"drift of joint {n}", "drift", DRIFT_SD_NM) for n in numbers]
    names, groups, sds = zip(*table, strict=True)
    return Terms(names, groups, np.array(sds))


def smooth_sign(velocity: Array) -> Array:
    """Which way joints turn, of velocities [rad/s]: -1 to 1, smooth about standing still."""
    return np.tanh(velocity / _SIGN_RAD_S)


@dataclass(frozen=True, eq=False)
class Linearization:
    """The torques about some values of the terms: `predicted_nm + slopes @ (values - these)`.

    Attributes:
        predicted_nm: at these values [N·m], shape (T, J).
        slopes: derivatives by the terms, shape (T, J, N).
    """

    predicted_nm: Array
    slopes: Array


@dataclass(frozen=True, eq=False)
class LoggedArm:
    """One log's torques as a function of the terms.

    Attributes:
        model: the arm's.
        terms: of all logs that are fitted together.
        motion: this one's.
        convention: what its driver means by torque.
        which: 0 for the log itself, 1 for its tare.
    """

    model: ArmModel
    terms: Terms
    motion: ArmMotion
    convention: Convention
    which: int

    @property
    def torques_nm(self) -> Array:
        """As measured, with the joint's sign [N·m], shape (T, J)."""
        return self.convention.sign * self.motion.effort

    def linearized(self, values: Array) -> Linearization:
        """The torques and their derivatives about values of the terms, shape (N,)."""
        indices = {group: self.terms.indices(group) for group in dict.fromkeys(self.terms.groups)}
        lag = int(indices["lag"][self.which])
        lag_s = float(values[lag])
        position, velocity, acceleration = self.motion.at(self.motion.seconds - lag_s)
        torques = self.model.torques(position, velocity, acceleration)
        own = np.eye(position.shape[1])
        gains = 1 + values[indices["gain"]]
        slopes = np.zeros((*position.shape, len(values)))
        if self.which == 0:
            slopes[..., :4] = torques.payload
            if "drift" in indices:
                slopes[..., indices["drift"]] = own
        slopes[..., indices["links"]] = np.concatenate(
            [torques.link_masses, torques.link_centres], axis=-1
        )
        masses = [MASS, 1, 2, 3, *indices["links"]]
        full_nm = torques.empty_nm + slopes[..., masses] @ values[masses]
        slopes[..., masses] *= gains[None, :, None]
        slopes[..., indices["offset"]] = own
        viscous, dry = np.split(indices["friction"], 2)
        slopes[..., viscous] = velocity[..., None] * own
        slopes[..., dry] = smooth_sign(velocity)[..., None] * own
        gravity_nm = 0.0 if self.convention.has_gravity else self.model.gravity_nm(position)
        felt_nm = full_nm + slopes[..., indices["friction"]] @ values[indices["friction"]]
        slopes[..., indices["gain"]] = felt_nm[..., None] * own
        slopes[..., indices["friction"]] *= gains[None, :, None]
        added = [*indices["offset"], *indices.get("drift", [])]
        predicted = gains * felt_nm - gravity_nm + slopes[..., added] @ values[added]
        rates = np.gradient(gains * felt_nm - gravity_nm, self.motion.seconds, axis=0)
        slopes[..., lag] = -rates
        return Linearization(predicted, slopes)
