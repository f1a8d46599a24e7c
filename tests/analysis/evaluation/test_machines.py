"""Machines that no engine simulated move as the models of their owners; a toolbox of others."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.studies.sysid import measured, toolbox_answer
from tunenet_logs.analysis.evaluation.worlds import machines
from tunenet_logs.recorders.simulators.mujoco import mujoco

MAKERS = (
    machines.pendulum_log,
    machines.pendulum_of_unknown_mass,
    machines.arm_log,
    machines.arm_with_a_brake,
    machines.block_log,
    machines.block_of_unknown_mass,
)
Maker = Callable[..., machines.ModelLog]


def test_what_a_pendulum_loses_is_what_friction_takes():
    pendulum = machines.Pendulum(0.06, 0.08, 0.03, -2.0)
    seconds = np.arange(0.0, 4.0, 1e-4)
    angle, speed = pendulum.at(seconds).T
    power = pendulum.damping * speed**2 + pendulum.friction * np.abs(speed)
    energy = pendulum.inertia * speed**2 / 2 - 9.81 * 0.4 * np.cos(angle)
    taken = np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2 * np.diff(seconds))])
    assert energy[0] - energy == pytest.approx(taken, abs=1e-5)


@pytest.mark.parametrize("make", MAKERS)
def test_logs_are_as_ros_has_them(make: Maker):
    log, again, loud = make(5), make(5), make(5, 2.0)
    assert set(log.unidentifiable) <= set(log.truth)
    assert [text.partition("=")[0] for text in log.tune] == list(log.truth)
    for address, ends in (text.split("=") for text in log.tune):
        low, high = map(float, ends.split(":"))
        assert low < log.truth[address] < high
    mujoco().MjModel.from_xml_string(log.model)
    for name, signal in log.episode.signals.items():
        assert np.array_equal(signal.values, again.episode.signals[name].values)
        assert signal.stamps_ns[0] == machines.START_NS
        steps_ns = np.diff(signal.stamps_ns)
        assert np.std(steps_ns) == pytest.approx(0.2e6 * np.sqrt(2), rel=0.3)
        apart = signal.values - log.clean[name]
        assert np.all(np.std(apart, axis=0) <= 1.3 * log.noise[name])
        assert np.array_equal(2 * log.noise[name], loud.noise[name])
    if "/joint_commands.position" in log.episode.signals:
        assert not log.noise["/joint_commands.position"].any()
        assert log.episode.signals["/joint_commands.position"].rate_hz == pytest.approx(50, rel=0.1)


# ---- What `mujoco.sysid` is given of a log, and what it makes of it.


def test_a_step_sees_the_mean_of_what_is_held_in_it():
    held = machines.HeldCommands(np.array([0.0, 0.1, 0.3]), np.array([[1.0], [2.0], [-1.0]]))
    steps = held.over_steps(0.04, 10, 0.0)[:, 0]
    expected = [1.0, 1.0, 1.5, 2.0, 2.0, 2.0, 2.0, 0.5, -1.0, -1.0]  # 1.5: half is the second
    assert steps == pytest.approx(expected)
    late = held.over_steps(0.04, 10, 0.12)[:, 0]  # holds the first before
    assert late == pytest.approx([1.0, 1.0, 1.0, *expected[:7]])
    means = [held.over_steps(0.01, 50, delay) for delay in (0.02, 0.02 + 1e-7)]
    assert (means[1] - means[0]).sum() / 1e-7 == pytest.approx((1.0 - -1.0) / 0.01, rel=1e-4)


def test_the_first_state_is_told_by_the_first_samples():
    for log, places in ((machines.pendulum_log(1), 1), (machines.arm_log(1), 2)):
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
    for name in ("absl", "colorama", "tabulate", "yaml"):
        pytest.importorskip(name, reason="needs mujoco.sysid's own libraries")
    log = machines.arm_log(0)
    answer = toolbox_answer(log)
    assert answer.values[machines.PAYLOAD] == pytest.approx(log.truth[machines.PAYLOAD], rel=0.05)
    assert answer.values[machines.DELAY] == pytest.approx(log.truth[machines.DELAY], abs=1e-3)
