"""The regressor against another library: PyBullet's inverse dynamics along the same motion."""

from dataclasses import replace

import numpy as np
import pytest

from tests.analysis.payload.arm_logs import ARM
from tunenet_logs.analysis.payload.torque_model import (
    CONVENTIONS,
    ArmModel,
    ArmMotion,
    LoggedArm,
    make_terms,
    smoothing_spline,
)
from tunenet_logs.recorders.simulators.arm.description import Payload
from tunenet_logs.recorders.simulators.arm.path import random_path
from tunenet_logs.recorders.simulators.arm.payload import joint_efforts_nm

PATH = random_path(ARM, 7, 60.0, 1.0)
MOTION = (PATH.position_rad, PATH.velocity_rad_s, PATH.acceleration_rad_s2)
MODEL = ArmModel(ARM)
JOINTS = len(ARM.joints)
TERMS = make_terms(ARM, np.full(JOINTS, 30.0), 1, drifts=False)
NOTHING = np.zeros(len(TERMS.sds))


def torques(values=NOTHING, *, held=True):
    return MODEL.torques(*MOTION, values, held=held)


def test_the_empty_arm():
    np.testing.assert_allclose(torques().total_nm, joint_efforts_nm(ARM, PATH), atol=1e-6)
    np.testing.assert_allclose(MODEL.empty_nm(*MOTION), torques().total_nm, atol=1e-9)


@pytest.mark.parametrize("com_m", [(0.0, 0.0, 0.0), (0.03, -0.02, 0.01)])
def test_a_payload(com_m):
    payload = Payload(0.8, com_m)
    numbers = 0.8 * np.array([1.0, *com_m])
    added = joint_efforts_nm(ARM, PATH, payload) - joint_efforts_nm(ARM, PATH)
    found = torques().slopes[..., :4] @ numbers
    np.testing.assert_allclose(found, added, atol=2e-3 if any(com_m) else 1e-6)
    values = NOTHING.copy()
    values[:4] = numbers
    np.testing.assert_allclose(torques(values).total_nm - torques().total_nm, found, atol=1e-9)
    assert not torques(values, held=False).slopes[..., :10].any()


def test_a_heavier_link_and_its_centre():
    empty, slopes = torques().total_nm, torques().slopes
    for at in range(JOINTS):
        joints = list(ARM.joints)
        link = joints[at].link
        x, y, z, *more = (1.1 * one for one in link.inertia_kg_m2)
        heavier = replace(link, mass_kg=1.1 * link.mass_kg, inertia_kg_m2=(x, y, z, *more))
        joints[at] = replace(joints[at], link=heavier)
        moved = joint_efforts_nm(replace(ARM, joints=tuple(joints)), PATH) - empty
        np.testing.assert_allclose(0.1 * slopes[..., 10 + at], moved, atol=1e-6)
        off = (link.com_m[0], link.com_m[1] + 0.003, link.com_m[2])
        joints[at] = replace(ARM.joints[at], link=replace(link, com_m=off))
        moved = joint_efforts_nm(replace(ARM, joints=tuple(joints)), PATH) - empty
        along_y = slopes[..., 10 + JOINTS + 3 * at + 1]
        np.testing.assert_allclose(0.003 * along_y, moved, atol=1e-3)


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_slopes_are_derivatives_of_the_torques(convention):
    """Of every term, by finite differences about values that are not 0."""
    rng = np.random.default_rng(4)
    seconds = np.arange(0.0, 3.0, 0.02)
    path = random_path(ARM, 7, 50.0, 3.0)
    spline = smoothing_spline(path.seconds, np.array(path.position_rad))
    effort = np.zeros((len(seconds), JOINTS))
    motion = ArmMotion(seconds, effort, np.ones(JOINTS, dtype=bool), spline)
    run = LoggedArm(MODEL, TERMS, motion, 0)
    values = 0.3 * TERMS.sds * rng.standard_normal(len(TERMS.sds))
    values[:4] = (0.9, 0.01, -0.01, 0.02)
    line = run.linearized(values, convention)
    inner = slice(5, -5)
    for term in range(len(TERMS.sds)):
        step = 1e-3 * max(TERMS.sds[term], 1e-4)
        more, less = values.copy(), values.copy()
        more[term] += step
        less[term] -= step
        ends = [run.linearized(one, convention).predicted_nm for one in (more, less)]
        expected = (ends[0] - ends[1]) / (2 * step)
        own = np.einsum("tjc,jc->tj", line.slopes, (line.columns == term).astype(float))
        most = float(np.abs(expected).max())
        within = 0.03 * most + 1e-6 / max(TERMS.sds[term], 1e-4)
        off = np.abs(own - expected)[inner]
        # Dry friction turns within a sample, where the lag's slope is a difference of two.
        worst = float(np.quantile(off, 0.9) if TERMS.names[term] == "lag" else off.max())
        assert worst < within, TERMS.names[term]


def test_gravity_alone():
    still = np.zeros_like(PATH.position_rad)
    held = MODEL.empty_nm(PATH.position_rad, still, still)
    np.testing.assert_allclose(MODEL.gravity_nm(PATH.position_rad), held, atol=1e-9)
