"""Compute joint torques along a path by an engine's inverse dynamics."""

from __future__ import annotations

import numpy as np

from recorders.simulators.arm.description import Arm, Payload
from recorders.simulators.arm.path import JointPath
from recorders.simulators.base import GRAVITY_M_S2
from recorders.simulators.engines import engine
from tunenet_logs.arrays import Array

# Gravity in the base's frame of an arm that stands upright.
UPRIGHT_GRAVITY_M_S2 = (0.0, 0.0, -GRAVITY_M_S2)


def joint_efforts_nm(
    arm: Arm,
    path: JointPath,
    payload: Payload | None = None,
    gravity_m_s2: tuple[float, float, float] = UPRIGHT_GRAVITY_M_S2,
) -> Array:
    """Compute the torques along a path by inverse dynamics: rigid links, no friction.

    Returns:
        Shape (T, J) [N·m], or [N] for a prismatic joint.

    Raises:
        UsageError: the path does not fit the arm.
    """
    return engine().inverse_dynamics(arm, path.checked(arm), payload, gravity_m_s2)


def held_efforts_nm(arm: Arm, path: JointPath) -> Array:
    """Compute the gravity torques of the empty arm at each position of a path.

    Returns:
        Shape (T, J) [N·m].

    Raises:
        UsageError: the path does not fit the arm.
    """
    still = np.zeros_like(path.position_rad)
    return joint_efforts_nm(arm, JointPath(path.seconds, path.position_rad, still, still))
