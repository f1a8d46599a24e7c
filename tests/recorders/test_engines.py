"""The border to the physics engines: what each must keep, and how one is chosen."""

from __future__ import annotations

import math
import os
from dataclasses import replace

import numpy as np
import pytest

from tests.engines import HAS_PYBULLET, needs_pybullet
from tests.recorders.test_arm_description import by_pinocchio
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.arm.description import Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import circle, circle_at, random_path
from tunenet_logs.recorders.simulators.arm.payload import PAPER as PAPER_ROLLOUT
from tunenet_logs.recorders.simulators.arm.payload import (
    PayloadSimulator,
    joint_efforts_nm,
    roll_out,
)
from tunenet_logs.recorders.simulators.ball import TOPIC, DropRig, DropSimulator, SpeedLaw
from tunenet_logs.recorders.simulators.base import CALIBRATED, PAPER, Engine
from tunenet_logs.recorders.simulators.known import ENGINE_VARIABLE, ENGINES, engine, simulated_by
from tunenet_logs.recorders.simulators.shot import (
    STEP_S,
    BounceShot,
    ShotRig,
    shoot,
    shoot_in_engine,
)

RIG = DropRig(gap_m=1.0, rate_hz=240.0, samples=300)
RADIUS_M = 0.05

# ---- Laws of every engine, beside those of the drop and the arm: impacts, shots, and torques


@pytest.mark.usefixtures("each_engine")
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


@pytest.mark.usefixtures("each_engine")
def test_an_impact_leaves_nothing_for_the_next():
    world = engine().ball_world(RADIUS_M, CALIBRATED)
    one = (np.array([1.0, 0.5, -2.0]), np.array([10.0, -20.0, 5.0]), 0.7, 0.3, 0.4)
    first = world.impact(*one)
    world.impact(np.array([3.0, 0.0, -5.0]), np.zeros(3), 0.2, 0.9, 2 / 3)
    world.place(1.0, 0.4)
    world.steps(0.01, 100)
    assert np.array_equal(first, world.impact(*one))


@pytest.mark.usefixtures("each_engine")
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


@pytest.mark.usefixtures("each_engine")
@pytest.mark.parametrize("held", [None, Payload(0.8, (0.03, -0.02, 0.05))])
def test_torques_are_pinocchios(held: Payload | None):
    arm = jaco()
    for path in (circle(), random_path(arm, 5)):
        wanted = by_pinocchio(arm.urdf(held), path)
        assert np.abs(joint_efforts_nm(arm, path, held) - wanted).max() < 1e-6


def test_simulators_say_their_engine_and_their_steps(each_engine: str):
    drop = DropSimulator(RIG)
    assert (drop.engine, drop.step_hz) == (engine().name, 240.0)
    shot = BounceShot(ShotRig(), height_m=0.5, rate_hz=240.0)
    assert shot.step_hz == 720.0
    assert shot.rollout({"restitution": 0.7}).info.source == f"{shot.engine}, bounce shot"
    arm = PayloadSimulator(jaco(), circle(60.0))
    assert arm.step_hz == pytest.approx(60.0)
    assert arm.rollout({"payload_mass": 0.5}).info.source == f"{arm.engine}, inverse dynamics"
    assert {drop.engine, shot.engine, arm.engine} == {engine(each_engine).name}
    assert drop.engine.startswith(f"{each_engine} ")


# ---- Another engine is a module and one line; one is chosen by name


@pytest.mark.parametrize("restitution", [0.3, 0.6, 0.9, 1.0])
def test_a_drop_runs_in_another_engine(monkeypatch: pytest.MonkeyPatch, restitution: float):
    monkeypatch.setitem(ENGINES, "toy", "tunenet_logs.analysis.evaluation.studies.engines")
    simulator = DropSimulator(RIG, CALIBRATED, engine("toy").ball_world(RIG.radius_m, CALIBRATED))
    episode = simulator.rollout({"restitution": restitution})
    heights_m = episode.signals[TOPIC].values[:, 2] - RIG.radius_m
    fall_s = math.sqrt(2 * RIG.gap_m / CALIBRATED.gravity_m_s2)
    seconds = np.arange(RIG.samples) / RIG.rate_hz - fall_s
    inside = (seconds > 0.2 * restitution * fall_s) & (seconds < 1.8 * restitution * fall_s)
    # A flight between two impacts is z = v t - g t^2 / 2: each sample gives its v.
    t = seconds[inside]
    speeds = heights_m[inside] / t + CALIBRATED.gravity_m_s2 * t / 2
    found = speeds / (CALIBRATED.gravity_m_s2 * fall_s)
    assert found == pytest.approx(np.full(len(t), restitution), abs=1e-3)
    assert simulator.engine == episode.info.source == "exact 1.0"


@needs_pybullet
def test_every_engine_offers_what_the_protocol_names():
    from tunenet_logs.recorders.simulators import mujoco
    from tunenet_logs.recorders.simulators import pybullet as bullet

    offered: tuple[Engine, Engine] = (bullet, mujoco)  # pyright compares the signatures
    assert [one.name.split()[0] for one in offered] == list(ENGINES)


def test_one_is_chosen_for_a_block_and_the_processes_in_it():
    before = engine()
    assert before is engine("pybullet" if HAS_PYBULLET else "mujoco")  # the first there is
    with simulated_by("mujoco"):
        assert engine().name.startswith("mujoco ")
        with simulated_by(None):
            assert os.environ[ENGINE_VARIABLE] == "mujoco"
    assert engine() is before
    assert ENGINE_VARIABLE not in os.environ


@pytest.mark.parametrize("name", ["gazebo", "no", "MuJoCo"])
def test_an_engine_that_is_none_is_named(monkeypatch: pytest.MonkeyPatch, name: str):
    monkeypatch.setenv(ENGINE_VARIABLE, name)
    with pytest.raises(UsageError, match=r"no engine is named '.*'; there is: pybullet, mujoco"):
        engine()
    monkeypatch.setitem(ENGINES, "absent", "tests.recorders.absent_engine")
    with pytest.raises(UsageError, match="absent is not installed; pip install absent"):
        engine("absent")


# ---- The paper's simulator: PyBullet as it comes, stepped at 60 Hz, and nothing else

HELD = Payload(0.7, (0.01, 0.02, -0.01))


def heights(rig: DropRig, restitution: float) -> np.ndarray:
    """Height under the ball [m], shape (T,)."""
    episode = DropSimulator(rig, PAPER).rollout({"restitution": restitution})
    return episode.signals[TOPIC].values[:, 2] - rig.radius_m


@needs_pybullet
def test_the_papers_rollouts_are_bit_identical_and_many_steps_are_single_ones():
    rig = DropRig(gap_m=2.0)
    simulator = DropSimulator(rig, PAPER)
    first = simulator.rollout({"restitution": 0.6}).signals[TOPIC].values
    simulator.rollout({"restitution": 0.2})
    again = simulator.with_rig(rig).rollout({"restitution": 0.6}).signals[TOPIC].values
    assert np.array_equal(first, again)
    assert np.array_equal(first[:, 2] - rig.radius_m, heights(rig, 0.6))
    world = engine().ball_world(0.5, PAPER)
    world.place(4.2, 0.6)
    singly = [world.step(1 / 60)[0] for _ in range(300)]
    world.place(4.2, 0.6)
    assert world.steps(1 / 60, 300) == singly
    assert min(singly) < 0.6 < max(singly[100:])  # it bounced on the way


@needs_pybullet
@pytest.mark.parametrize("hold_s", [0.5, 5.0, 50.0])
def test_a_held_ball_starts_late_with_the_papers_settings(hold_s: float):
    rig = DropRig(gap_m=4.0, radius_m=0.5, samples=100)
    held = round(hold_s * rig.rate_hz)
    curve = heights(replace(rig, hold_s=hold_s), 0.5)
    assert np.array_equal(curve[:held], np.full(min(held, 100), 4.0))
    assert np.array_equal(curve[held:], heights(rig, 0.5)[: max(100 - held, 0)])


@needs_pybullet
def test_the_papers_settings_give_the_papers_restitution_and_no_air():
    """At 60 Hz with PyBullet's defaults .5 gives about .534 (measured over 4 to 5 m)."""
    curve = heights(DropRig(gap_m=4.0, radius_m=0.5), 0.5)
    low = int(np.argmin(curve[:90]))
    assert 0.4 < np.sqrt(curve[low:].max() / curve[0]) < 0.6
    assert len(curve) == 400
    assert curve[0] < 4.0  # sampled after the first step
    with pytest.raises(UsageError, match="takes the values restitution, not"):
        DropSimulator(DropRig(), PAPER).rollout({"restitution": 0.5, "drag": 0.1})


@needs_pybullet
@pytest.mark.parametrize(("is_damped", "most_nm"), [(True, 0.02), (False, 1e-9)])
def test_the_papers_rollout_differs_by_its_damping_alone(is_damped: bool, most_nm: float):
    settings = replace(PAPER_ROLLOUT, is_damped=is_damped)
    rollout = roll_out(jaco(), circle_at(settings.times()), HELD, settings)
    efforts = joint_efforts_nm(jaco(), rollout.path, HELD, settings.gravity_m_s2)
    assert np.sqrt(np.mean((rollout.effort_nm - efforts) ** 2)) < most_nm
    assert rollout.effort_nm.shape == (1200, 7)


def test_without_pybullet_there_is_none():
    words = "the preset paper is PyBullet's own behaviour"
    with simulated_by("mujoco"):
        with pytest.raises(UsageError, match=words):
            DropSimulator(DropRig(), PAPER)
        with pytest.raises(UsageError, match=words):
            roll_out(jaco(), circle_at(PAPER_ROLLOUT.times()), HELD, PAPER_ROLLOUT)
