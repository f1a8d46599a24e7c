"""The mass by a line through two rollouts of the other engine: a second way to it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.payload.arm_motion import ArmMotion
from analysis.payload.torque_model import Convention
from recorders.simulators.arm.description import Arm, Payload
from recorders.simulators.arm.dynamics import held_efforts_nm, joint_efforts_nm
from recorders.simulators.arm.path import JointPath
from tunenet_logs.arrays import Array

_OFFSET_SHARE = 0.01
"""Usual offset of a sensor, by what its joint is built for."""


def secant(
    arm: Arm,
    motion: ArmMotion,
    convention: Convention,
    lag_s: float,
    *,
    com_m: tuple[float, float, float],
    scales_nm: Array,
    tares: Sequence[ArmMotion] = (),
) -> float:
    """The mass [kg]; it may be below 0.

    Torques are linear in the mass, so the arm without a payload and with 1 kg, driven along the
    logged motion, give it by least squares in closed form. Only the sensors' offsets are taken out.

    Args:
        arm: as it is without a payload.
        motion: while it held it.
        convention: what its driver means by torque.
        lag_s: of the torques behind the positions [s].
        com_m: the payload's centre in the tool frame.
        scales_nm: what each joint is built for [N·m], shape (J,).
        tares: while it held nothing: their mean residuals are the offsets.
    """
    arm = arm.without_limits()
    path = JointPath(motion.seconds, *motion.at(motion.seconds - lag_s))
    empty_nm = _empty_nm(arm, path, convention)
    one = Payload(1.0, com_m)
    for_kg = joint_efforts_nm(arm, path, one) - joint_efforts_nm(arm, path)
    residual = convention.sign * motion.effort - empty_nm
    used = motion.used
    if not tares:
        # An offset of normal prior is projected out of both, less so where the noise is large.
        noise = np.var(residual - np.mean(residual, axis=0), axis=0)
        offsets = (_OFFSET_SHARE * scales_nm) ** 2
        free = offsets / (offsets + noise / len(residual))
        residual = residual - free * np.mean(residual, axis=0)
        slopes = for_kg - free * np.mean(for_kg, axis=0)
    else:
        zeros_nm = []
        for tare in tares:
            tare_path = JointPath(tare.seconds, *tare.at(tare.seconds - lag_s))
            tare_nm = _empty_nm(arm, tare_path, convention)
            zeros_nm.append(np.mean(convention.sign * tare.effort - tare_nm, axis=0))
            used = used & tare.used
        residual = residual - np.mean(zeros_nm, axis=0)
        slopes = for_kg
    slopes, residual = slopes[:, used], residual[:, used]
    return float(np.sum(slopes * residual) / np.sum(slopes**2))


def _empty_nm(arm: Arm, path: JointPath, convention: Convention) -> Array:
    """Torques of the empty arm as a driver of that convention gives them [N·m], shape (T, J)."""
    empty_nm = joint_efforts_nm(arm, path)
    return empty_nm if convention.has_gravity else empty_nm - held_efforts_nm(arm, path)
