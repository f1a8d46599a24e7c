"""The paper's simulator: PyBullet as it comes, stepped at 60 Hz, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.arm.description import Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import circle_at
from tunenet_logs.recorders.simulators.arm.payload import PAPER as PAPER_ROLLOUT
from tunenet_logs.recorders.simulators.arm.payload import joint_efforts_nm, roll_out
from tunenet_logs.recorders.simulators.ball import TOPIC, DropRig, DropSimulator
from tunenet_logs.recorders.simulators.base import PAPER
from tunenet_logs.recorders.simulators.known import engine, simulated_by

ARM = jaco()
HELD = Payload(0.7, (0.01, 0.02, -0.01))


def heights(rig: DropRig, restitution: float) -> np.ndarray:
    """Height under the ball [m], shape (T,)."""
    episode = DropSimulator(rig, PAPER).rollout({"restitution": restitution})
    return episode.signals[TOPIC].values[:, 2] - rig.radius_m


@needs_pybullet
def test_repeated_rollouts_are_bit_identical():
    rig = DropRig(gap_m=2.0)
    simulator = DropSimulator(rig, PAPER)
    first = simulator.rollout({"restitution": 0.6}).signals[TOPIC].values
    simulator.rollout({"restitution": 0.2})
    again = simulator.with_rig(rig).rollout({"restitution": 0.6}).signals[TOPIC].values
    assert np.array_equal(first, again)
    assert np.array_equal(first[:, 2] - rig.radius_m, heights(rig, 0.6))


@needs_pybullet
def test_many_fixed_steps_are_single_steps_one_after_another():
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
def test_the_papers_settings_give_the_papers_restitution():
    """At 60 Hz with PyBullet's defaults .5 gives about .534 (measured over 4 to 5 m)."""
    rig = DropRig(gap_m=4.0, radius_m=0.5)
    curve = heights(rig, 0.5)
    low = int(np.argmin(curve[:90]))
    ratio = np.sqrt(curve[low:].max() / curve[0])
    assert 0.4 < ratio < 0.6
    assert len(curve) == 400
    assert curve[0] < 4.0  # sampled after the first step


@needs_pybullet
def test_the_papers_simulator_has_no_air():
    with pytest.raises(UsageError, match="takes the values restitution, not"):
        DropSimulator(DropRig(), PAPER).rollout({"restitution": 0.5, "drag": 0.1})


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@needs_pybullet
def test_the_papers_rollout_differs_by_its_damping_alone():
    rollout = roll_out(ARM, circle_at(PAPER_ROLLOUT.times()), HELD, PAPER_ROLLOUT)
    efforts = joint_efforts_nm(ARM, rollout.path, HELD, PAPER_ROLLOUT.gravity_m_s2)
    assert rms(rollout.effort_nm - efforts) < 0.02
    undamped = replace(PAPER_ROLLOUT, is_damped=False)
    rollout = roll_out(ARM, circle_at(PAPER_ROLLOUT.times()), HELD, undamped)
    efforts = joint_efforts_nm(ARM, rollout.path, HELD, PAPER_ROLLOUT.gravity_m_s2)
    assert rms(rollout.effort_nm - efforts) < 1e-9
    assert rollout.effort_nm.shape == (1200, 7)


def test_without_pybullet_there_is_none():
    with simulated_by("mujoco"):
        with pytest.raises(UsageError, match="the preset paper is PyBullet's own behaviour"):
            DropSimulator(DropRig(), PAPER)
        with pytest.raises(UsageError, match="the preset paper is PyBullet's own behaviour"):
            roll_out(ARM, circle_at(PAPER_ROLLOUT.times()), HELD, PAPER_ROLLOUT)
