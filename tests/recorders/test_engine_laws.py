"""What every engine must keep, beside the drop and the arm: impacts, shots, and torques."""

from __future__ import annotations

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]  (where no type checker looks)
import pytest

from tunenet_logs.recorders.simulators.arm.description import Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import circle, random_path
from tunenet_logs.recorders.simulators.arm.payload import joint_efforts_nm
from tunenet_logs.recorders.simulators.ball import SpeedLaw
from tunenet_logs.recorders.simulators.base import CALIBRATED, UPRIGHT_GRAVITY_M_S2
from tunenet_logs.recorders.simulators.known import engine
from tunenet_logs.recorders.simulators.shot import STEP_S, ShotRig, shoot, shoot_in_engine

pytestmark = pytest.mark.usefixtures("each_engine")

RADIUS_M = 0.05


@pytest.mark.parametrize("share", [0.4, 2 / 3])
def test_an_impact_is_a_rigid_balls(share: float):
    """Newton's law along the normal; across it friction stops the slip, or takes its share."""
    world = engine().ball_world(RADIUS_M, CALIBRATED)
    rng = np.random.default_rng(3)
    for _ in range(50):
        restitution, friction = rng.uniform(0, 1, 2)
        velocity = np.array([*rng.uniform(-4, 4, 2), -rng.uniform(0.05, 8)])
        spin = rng.uniform(-60, 60, 3)
        after, turning = world.impact(velocity, spin, restitution, friction, share)
        slip = velocity + np.cross(spin, [0, 0, -RADIUS_M])
        slip[2] = 0
        slipping = float(np.linalg.norm(slip))
        stop = slipping / (1 + 1 / share)
        taken = min(stop, friction * (1 + restitution) * -velocity[2]) * slip / slipping
        wanted = velocity - taken
        wanted[2] = -restitution * velocity[2]
        assert after == pytest.approx(wanted, abs=1e-3)
        turned = spin + np.cross([0, 0, -1], -taken) / (share * RADIUS_M)
        assert RADIUS_M * turning == pytest.approx(RADIUS_M * turned, abs=1e-3)


def test_an_impact_leaves_nothing_for_the_next():
    world = engine().ball_world(RADIUS_M, CALIBRATED)
    one = (np.array([1.0, 0.5, -2.0]), np.array([10.0, -20.0, 5.0]), 0.7, 0.3, 0.4)
    first = world.impact(*one)
    world.impact(np.array([3.0, 0.0, -5.0]), np.zeros(3), 0.2, 0.9, 2 / 3)
    world.place(1.0, 0.4)
    world.steps(0.01, 100)
    again = world.impact(*one)
    assert np.array_equal(first, again)


@pytest.mark.parametrize("height_m", [0.2, 0.3, 0.45])
def test_a_shot_flies_as_the_closed_form_has_it(height_m: float):
    """Off the plane and off the rim, with spin and air: within a tenth of a millimetre."""
    rig, law = ShotRig(), SpeedLaw(0.74, 0.08)
    wanted = shoot(rig, law, np.array([height_m]))
    found = shoot_in_engine(rig, law, height_m, STEP_S)
    assert found.has_touched == wanted.has_touched
    assert found.is_through == wanted.is_through
    first = slice(None, None) if not wanted.has_touched[0] else slice(0, 200)
    assert found.positions_m[first] == pytest.approx(wanted.positions_m[first], abs=1e-4)


@pytest.mark.parametrize("held", [None, Payload(0.8, (0.03, -0.02, 0.05))])
def test_torques_are_pinocchios(held: Payload | None):
    arm = jaco()
    model = pinocchio.buildModelFromXML(arm.urdf(held))
    model.gravity.linear = np.array(UPRIGHT_GRAVITY_M_S2)
    data = model.createData()
    for path in (circle(), random_path(arm, 5)):
        wanted = [
            pinocchio.rnea(model, data, *state)
            for state in zip(
                path.position_rad, path.velocity_rad_s, path.acceleration_rad_s2, strict=True
            )
        ]
        assert np.abs(joint_efforts_nm(arm, path, held) - wanted).max() < 1e-6
