"""Everything between an arm's model and the torques of its driver, as terms with priors.

What a driver tells is the model's torque with errors of the links, times a gain, late by a lag,
plus friction and an offset. Each is a term: how it changes the torques, and how large it usually
is. An empty-gripper run has the same terms, without the payload.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.payload.arm_model import ArmModel
from analysis.payload.arm_motion import ArmMotion
from tunenet_logs.arrays import Array

PAYLOAD_SD_KG = 5.0
CENTRE_SD_M = 0.05
OFFSET_SD_NM = 0.3
FRICTION_SD_NM = 0.5
"""Also per rad/s."""
GAIN_SD = 0.03
LINK_MASS_SD = 0.05
LINK_CENTRE_SD_M = 0.003
LAG_SD_S = 0.03
DRIFT_SD_NM = 0.05
"""Of a sensor's zero, between the empty run and the other."""

_TURNS_RAD_S = 0.015
"""Speed below which dry friction fades: a motion's zero crossing is not known better."""

MASS = 0
CENTRE = slice(1, 4)


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
class Terms:
    """The unknowns, the payload's first.

    Attributes:
        names: in words, of each.
        groups: that are scaled together, of each.
        sds: of the priors about 0, shape (N,).
    """

    names: tuple[str, ...]
    groups: tuple[str, ...]
    sds: Array

    def places(self, group: str) -> NDArray[np.int64]:
        """Of a group's terms."""
        return np.flatnonzero(np.array([one == group for one in self.groups]))


def make_terms(joints: Sequence[str], logs: int) -> Terms:
    """For an arm, and a log or a log with its tare."""
    numbers = range(1, len(joints) + 1)
    axes = ("x", "y", "z")
    table: list[tuple[str, str, float]] = [("payload", "payload", PAYLOAD_SD_KG)]
    table += [(f"centre {axis}", "centre", CENTRE_SD_M) for axis in axes]
    table += [(f"offset of joint {one}", "offset", OFFSET_SD_NM) for one in numbers]
    table += [(f"viscous friction of joint {one}", "friction", FRICTION_SD_NM) for one in numbers]
    table += [(f"dry friction of joint {one}", "friction", FRICTION_SD_NM) for one in numbers]
    table += [(f"gain of joint {one}", "gain", GAIN_SD) for one in numbers]
    table += [(f"mass of link {one}", "links", LINK_MASS_SD) for one in numbers]
    table += [
        (f"centre {axis} of link {one}", "links", LINK_CENTRE_SD_M)
        for one in numbers
        for axis in axes
    ]
    table += [(name, "lag", LAG_SD_S) for name in ("lag", "lag of the tare")[:logs]]
    if logs > 1:
        table += [(f"drift of joint {one}", "drift", DRIFT_SD_NM) for one in numbers]
    names, groups, sds = zip(*table, strict=True)
    return Terms(names, groups, np.array(sds))


def turning(velocity: Array) -> Array:
    """Which way joints turn [rad/s]: -1 to 1, smooth about standing still."""
    return np.tanh(velocity / _TURNS_RAD_S)


@dataclass(frozen=True, eq=False)
class Linear:
    """The torques about some values of the terms: `predicted_nm + slopes @ (values - these)`.

    Attributes:
        predicted_nm: shape (T, J).
        slopes: shape (T, J, N).
    """

    predicted_nm: Array
    slopes: Array


class LoggedArm:
    """One log's torques as a function of the terms.

    Args:
        model: the arm's.
        terms: of all logs that are fitted together.
        motion: this one's.
        convention: what its driver means by torque.
        which: 0 for the log itself, 1 for its tare.
    """

    def __init__(
        self, model: ArmModel, terms: Terms, motion: ArmMotion, convention: Convention, which: int
    ) -> None:
        self._model = model
        self._terms = terms
        self._motion = motion
        self._convention = convention
        self._which = which
        self._lag = int(terms.places("lag")[which])

    @property
    def torques_nm(self) -> Array:
        """As measured, with the joint's sign, shape (T, J)."""
        return self._convention.sign * self._motion.effort

    def about(self, values: Array) -> Linear:
        """Linear about `values`, shape (N,)."""
        lag_s = float(values[self._lag])
        position, velocity, acceleration = self._motion.at(self._motion.seconds - lag_s)
        torques = self._model.torques(position, velocity, acceleration)
        joints = position.shape[1]
        own = np.eye(joints)
        places = self._places()
        gains = 1 + values[places["gain"]]
        slopes = np.zeros((*position.shape, len(values)))
        if self._which == 0:
            slopes[..., :4] = torques.payload
            if "drift" in places:
                slopes[..., places["drift"]] = own
        slopes[..., places["links"]] = np.concatenate(
            [torques.link_masses, torques.link_centres], axis=-1
        )
        masses = [MASS, 1, 2, 3, *places["links"]]
        full_nm = torques.empty_nm + slopes[..., masses] @ values[masses]
        slopes[..., masses] *= gains[None, :, None]
        slopes[..., places["offset"]] = own
        viscous, coulomb = np.split(places["friction"], 2)
        slopes[..., viscous] = velocity[..., None] * own
        slopes[..., coulomb] = turning(velocity)[..., None] * own
        held_nm = 0.0 if self._convention.has_gravity else self._model.held_nm(position)
        felt_nm = full_nm + slopes[..., places["friction"]] @ values[places["friction"]]
        slopes[..., places["gain"]] = felt_nm[..., None] * own
        slopes[..., places["friction"]] *= gains[None, :, None]
        added = [*places["offset"], *places.get("drift", [])]
        predicted = gains * felt_nm - held_nm + slopes[..., added] @ values[added]
        rates = np.gradient(gains * felt_nm - held_nm, self._motion.seconds, axis=0)
        slopes[..., self._lag] = -rates
        return Linear(predicted, slopes)

    def _places(self) -> dict[str, NDArray[np.int64]]:
        return {group: self._terms.places(group) for group in dict.fromkeys(self._terms.groups)}
