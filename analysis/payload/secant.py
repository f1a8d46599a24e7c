"""Cross-check the mass by a secant through two rollouts in another engine's inverse dynamics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.payload.arm_motion import ArmMotion
from analysis.payload.torque_model import Convention
from recorders.simulators.arm.description import Arm, Payload
from recorders.simulators.arm.dynamics import held_efforts_nm, joint_efforts_nm
from recorders.simulators.arm.path import JointPath
from tunenet_logs.arrays import Array

_OFFSET_SHARE = 0.01  # usual offset of a sensor, by what its joint is built for


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
    """Estimate the mass by a secant through rollouts of 0 and 1 kg [kg]; it may be below 0.

    Torques are linear in the mass, so the arm without a payload and with 1 kg, driven along the
    logged motion, give it by least squares in closed form. Only sensor offsets are removed.

    Args:
        arm: Without a payload.
        motion: While it held it.
        convention: The driver's torque convention.
        lag_s: Of the torques behind the positions [s].
        com_m: The payload's centre of mass in the tool frame.
        scales_nm: Rated torque of each joint [N·m], shape (J,).
        tares: While it held nothing: the mass that this gives for them is subtracted.
    """
    arm = arm.without_limits()
    masses_kg = []
    for run in (motion, *tares):
        path = JointPath(run.seconds, *run.at(run.seconds - lag_s))
        empty_nm = joint_efforts_nm(arm, path)
        slopes = joint_efforts_nm(arm, path, Payload(1.0, com_m)) - empty_nm
        if not convention.has_gravity:
            empty_nm -= held_efforts_nm(arm, path)
        residual = convention.sign * run.effort - empty_nm
        # An offset of normal prior is projected out of both, less so where the noise is large.
        noise = np.var(residual - np.mean(residual, axis=0), axis=0)
        offsets = (_OFFSET_SHARE * scales_nm) ** 2
        free = offsets / (offsets + noise / len(residual))
        residual -= free * np.mean(residual, axis=0)
        slopes -= free * np.mean(slopes, axis=0)
        slopes, residual = slopes[:, run.used], residual[:, run.used]
        masses_kg.append(float(np.sum(slopes * residual) / np.sum(slopes**2)))
    return masses_kg[0] - float(np.mean(masses_kg[1:] or [0.0]))
