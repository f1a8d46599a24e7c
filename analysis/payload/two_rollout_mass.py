"""A second opinion of a payload's mass: a line through two torques of another engine's model.

Torques are linear in the mass, so the arm without a payload and with 1 kg, driven along the logged
motion, tell it in closed form. Only the sensors' offsets are taken out: by the motion itself, or by
an empty run.
"""

from __future__ import annotations

import numpy as np

from analysis.payload.arm_motion import ArmMotion
from analysis.payload.terms import Convention
from recorders.simulators.arm.description import Arm, Payload
from recorders.simulators.arm.dynamics import held_efforts_nm, joint_efforts_nm
from recorders.simulators.arm.path import JointPath
from tunenet_logs.arrays import Array

_OFFSET_SD_NM = 0.3


def secant(
    arm: Arm,
    motion: ArmMotion,
    convention: Convention,
    lag_s: float,
    tare: ArmMotion | None = None,
) -> float:
    """The mass [kg] by least squares along a measured motion; it may be below 0.

    Args:
        arm: as it is without a payload.
        motion: while it held it.
        convention: what its driver means by torque.
        lag_s: of the torques behind the positions.
        tare: while it held nothing: its mean residuals are the offsets.
    """
    arm = arm.without_limits()
    path = _path(motion, lag_s)
    empty_nm = _empty_nm(arm, path, convention)
    for_kg = joint_efforts_nm(arm, path, Payload(1.0)) - joint_efforts_nm(arm, path)
    left = convention.sign * motion.effort - empty_nm
    used = motion.used
    if tare is None:
        noise = np.var(left - np.mean(left, axis=0), axis=0)
        free = _OFFSET_SD_NM**2 / (_OFFSET_SD_NM**2 + noise / len(left))
        left = left - free * np.mean(left, axis=0)
        slopes = for_kg - free * np.mean(for_kg, axis=0)
    else:
        tare_nm = _empty_nm(arm, _path(tare, lag_s), convention)
        left = left - np.mean(convention.sign * tare.effort - tare_nm, axis=0)
        slopes = for_kg
        used = used & tare.used
    slopes, left = slopes[:, used], left[:, used]
    return float(np.sum(slopes * left) / np.sum(slopes**2))


def _path(motion: ArmMotion, lag_s: float) -> JointPath:
    return JointPath(motion.seconds, *motion.at(motion.seconds - lag_s))


def _empty_nm(arm: Arm, path: JointPath, convention: Convention) -> Array:
    """What a driver of that convention tells of the empty arm."""
    empty_nm = joint_efforts_nm(arm, path)
    return empty_nm if convention.has_gravity else empty_nm - held_efforts_nm(arm, path)
