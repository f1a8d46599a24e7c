"""What `mujoco.sysid` is given of a log, and what it makes of it."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.studies.sysid import measured, toolbox_answer
from tunenet_logs.analysis.evaluation.worlds.machines import (
    BLOCK_FRICTION,
    DELAY,
    PAYLOAD,
    HeldCommands,
    arm_log,
    block_log,
    pendulum_log,
)
from tunenet_logs.recorders.simulators.mujoco import mujoco

HELD = HeldCommands(np.array([0.0, 0.1, 0.3]), np.array([[1.0], [2.0], [-1.0]]))


def test_a_step_sees_the_mean_of_what_is_held_in_it():
    steps = HELD.over_steps(0.04, 10, 0.0)[:, 0]
    assert steps[:2] == pytest.approx([1.0, 1.0])
    assert steps[2] == pytest.approx(1.5)  # half of it is the second command
    assert steps[3:7] == pytest.approx([2.0, 2.0, 2.0, 2.0])
    assert steps[7] == pytest.approx(0.5)
    assert steps[8:] == pytest.approx([-1.0, -1.0])


def test_a_delay_moves_all_of_it_and_holds_the_first_before():
    late = HELD.over_steps(0.04, 10, 0.12)[:, 0]
    assert late[:3] == pytest.approx([1.0, 1.0, 1.0])
    assert late[3:] == pytest.approx(HELD.over_steps(0.04, 7, 0.0)[:, 0])


def test_a_delay_changes_it_smoothly():
    means = [HELD.over_steps(0.01, 50, delay) for delay in (0.02, 0.02 + 1e-7)]
    slope = (means[1] - means[0]).sum() / 1e-7
    assert slope == pytest.approx((1.0 - -1.0) / 0.01, rel=1e-4)


def test_the_first_state_is_told_by_the_first_samples():
    for log, places in ((pendulum_log(1), 1), (arm_log(1), 2)):
        spec = mujoco().MjSpec.from_string(log.model)
        seen = measured(log.episode, spec, with_efforts=True)
        truth = [log.clean[f"/joint_states.{one}"][0] for one in ("position", "velocity")]
        noise = [log.noise[f"/joint_states.{one}"] for one in ("position", "velocity")]
        assert len(seen.start) == 2 * places
        assert np.all(np.abs(seen.start - np.concatenate(truth)) < 3 * np.concatenate(noise))
        assert np.all(np.abs(seen.start - np.concatenate(truth)) < seen.start_reach)
        assert seen.values.shape[1] == spec.compile().nsensordata


@pytest.mark.slow
def test_the_toolbox_finds_a_payload_and_a_delay():
    log = arm_log(0)
    answer = toolbox_answer(log)
    assert answer.values[PAYLOAD] == pytest.approx(log.truth[PAYLOAD], rel=0.05)
    assert answer.values[DELAY] == pytest.approx(log.truth[DELAY], abs=1e-3)
    assert answer.rollouts > 10
    assert answer.seconds > 0


@pytest.mark.slow
def test_the_toolbox_finds_a_friction_where_it_tunes_the_start():
    log = block_log(1)
    answer = toolbox_answer(log, tunes_start=True)
    low, high = answer.intervals[BLOCK_FRICTION]
    assert low < answer.values[BLOCK_FRICTION] < high
    assert answer.values[BLOCK_FRICTION] == pytest.approx(log.truth[BLOCK_FRICTION], rel=0.02)
