"""The regressor against another library: PyBullet's inverse dynamics along the same motion."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.payload.torque_model import ArmModel
from recorders.simulators.arm.description import Payload
from recorders.simulators.arm.dynamics import joint_efforts_nm
from recorders.simulators.arm.path import random_path
from tests.analysis.payload.arm_logs import ARM

PATH = random_path(ARM, 7, 60.0, 1.0)
MOTION = (PATH.position_rad, PATH.velocity_rad_s, PATH.acceleration_rad_s2)
MODEL = ArmModel(ARM)


def test_the_empty_arm():
    torques = MODEL.torques(*MOTION)
    np.testing.assert_allclose(torques.empty_nm, joint_efforts_nm(ARM, PATH), atol=1e-6)


@pytest.mark.parametrize("com_m", [(0.0, 0.0, 0.0), (0.03, -0.02, 0.01)])
def test_a_payload(com_m):
    payload = Payload(0.8, com_m)
    torques = MODEL.torques(*MOTION)
    numbers = 0.8 * np.array([1.0, *com_m])
    added = joint_efforts_nm(ARM, PATH, payload) - joint_efforts_nm(ARM, PATH)
    np.testing.assert_allclose(torques.payload @ numbers, added, atol=2e-3 if any(com_m) else 1e-6)


def test_a_heavier_link_and_its_centre():
    torques = MODEL.torques(*MOTION)
    for at in range(len(ARM.joints)):
        joints = list(ARM.joints)
        link = joints[at].link
        x, y, z, *more = (1.1 * one for one in link.inertia_kg_m2)
        heavier = replace(link, mass_kg=1.1 * link.mass_kg, inertia_kg_m2=(x, y, z, *more))
        joints[at] = replace(joints[at], link=heavier)
        moved = joint_efforts_nm(replace(ARM, joints=tuple(joints)), PATH) - torques.empty_nm
        np.testing.assert_allclose(0.1 * torques.link_masses[:, :, at], moved, atol=1e-6)
        off = (link.com_m[0], link.com_m[1] + 0.003, link.com_m[2])
        joints[at] = replace(ARM.joints[at], link=replace(link, com_m=off))
        moved = joint_efforts_nm(replace(ARM, joints=tuple(joints)), PATH) - torques.empty_nm
        along_y = torques.link_centres[:, :, 3 * at + 1]
        np.testing.assert_allclose(0.003 * along_y, moved, atol=1e-3)


def test_gravity_alone():
    still = np.zeros_like(PATH.position_rad)
    held = MODEL.torques(PATH.position_rad, still, still).empty_nm
    np.testing.assert_allclose(MODEL.gravity_nm(PATH.position_rad), held, atol=1e-9)
