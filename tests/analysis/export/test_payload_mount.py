"""The exported payload weighs on a simulated arm what the tuning's payload does."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.export.tunings import payload_tuning
from tests.conftest import Command
from tests.engines import needs_pybullet
from tunenet_logs.recorders.simulators.arm.description import (
    JACO_TOOL_LINK,
    JACO_URDF,
    Payload,
    jaco,
)
from tunenet_logs.recorders.simulators.arm.path import JointPath

POSE_RAD = (0.3, 2.5, 0.2, 1.5, 0.4, 1.9, 0.1)
GRAVITY_M_S2 = (0.0, 0.0, -9.80665)


def held_nm(bullet, client: int, arm: int) -> np.ndarray:
    """Torques that hold the pose, shape (7,)."""
    joints = range(len(POSE_RAD))
    for _ in range(600):
        bullet.setJointMotorControlArray(
            arm,
            joints,
            bullet.POSITION_CONTROL,
            targetPositions=POSE_RAD,
            forces=[500.0] * len(joints),
            positionGains=[0.3] * len(joints),
            physicsClientId=client,
        )
        bullet.stepSimulation(physicsClientId=client)
    return np.array([state[3] for state in bullet.getJointStates(arm, joints, client)])


@needs_pybullet
def test_mounting_it_changes_the_torques_as_it_should(command: Command, tmp_path: Path):
    from tunenet_logs.recorders.simulators.pybullet import inverse_dynamics, pybullet

    mass_kg, com_m = 0.8, (0.01, -0.02, 0.03)
    tuning = payload_tuning(tmp_path / "a.json", mass_kg, com_m)
    assert command("tunenet-export", tuning, "--to", "pybullet").returncode == 0
    bullet = pybullet()
    client = bullet.connect(bullet.DIRECT)
    bullet.setGravity(*GRAVITY_M_S2, physicsClientId=client)
    flags = bullet.URDF_USE_INERTIA_FROM_FILE
    arm = bullet.loadURDF(str(JACO_URDF), useFixedBase=True, flags=flags, physicsClientId=client)
    links = {
        bullet.getJointInfo(arm, joint, physicsClientId=client)[12].decode(): joint
        for joint in range(bullet.getNumJoints(arm, physicsClientId=client))
    }
    for joint, angle_rad in enumerate(POSE_RAD):
        bullet.resetJointState(arm, joint, angle_rad, physicsClientId=client)
    empty_nm = held_nm(bullet, client, arm)
    mount = runpy.run_path(str(tmp_path / "a.pybullet.py"))["mount"]
    mount(arm, links[JACO_TOOL_LINK], client)
    more_nm = held_nm(bullet, client, arm) - empty_nm
    bullet.disconnect(client)
    still = np.zeros((1, len(POSE_RAD)))
    path = JointPath(np.zeros(1), np.array([POSE_RAD]), still, still)
    wanted_nm = np.diff(
        [
            inverse_dynamics(jaco(), path, payload, GRAVITY_M_S2)[0]
            for payload in (None, Payload(mass_kg, com_m))
        ],
        axis=0,
    )[0]
    assert np.abs(wanted_nm).max() > 1
    assert more_nm == pytest.approx(wanted_nm, abs=0.01)
