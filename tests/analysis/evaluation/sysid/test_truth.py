"""Machines that no engine simulated move as the owners' models with the true values."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.analysis.evaluation.sysid.simulated import off, read, simulated
from tunenet_logs.analysis.evaluation.worlds.machines import (
    ARMATURE,
    DELAY,
    ELBOW_DAMPING,
    FRICTION,
    KP,
    KV,
    MASS,
    NOISE,
    PAYLOAD,
    PENDULUM_DAMPING,
    POSE,
    START_NS,
    ModelLog,
    Pendulum,
    PlanarArm,
    arm_log,
    arm_with_a_brake,
    block_log,
    block_of_unknown_mass,
    pendulum_log,
    pendulum_of_unknown_mass,
    wrong_arms,
    wrong_blocks,
    wrong_pendulums,
)
from tunenet_logs.recorders.simulators.mujoco import mujoco

MAKERS = (
    pendulum_log,
    pendulum_of_unknown_mass,
    arm_log,
    arm_with_a_brake,
    block_log,
    block_of_unknown_mass,
)
Maker = Callable[..., ModelLog]


def _joints_off(log: ModelLog) -> dict[str, float]:
    """The largest rms difference of each joint signal, over its noise."""
    names = [f"/joint_states.{one}" for one in ("position", "velocity", "effort")]
    motion = simulated(log, *(log.clean[name][0] for name in names[:2]))
    at = log.episode.signals[names[0]].seconds
    places = read(motion.seconds, motion.places, at)
    speeds = read(motion.seconds - motion.late_s, motion.speeds, at)
    found = {"position": off(places, log, names[0]), "velocity": off(speeds, log, names[1])}
    if names[2] in log.clean:
        told = log.episode.signals["/joint_commands.position"]
        obeyed = np.searchsorted(told.seconds + log.truth[DELAY], at, "right") - 1
        wanted = told.values[np.maximum(obeyed, 0)]
        found["effort"] = off(KP * (wanted - places) - KV * speeds, log, names[2])
    return found


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_pendulum_moves_as_its_model(seed: int):
    assert max(_joints_off(pendulum_log(seed)).values()) < 0.06


@pytest.mark.parametrize("make", [arm_log, arm_with_a_brake])
def test_an_arm_moves_as_its_model(make: Maker):
    found = _joints_off(make(1))
    assert max(found["position"], found["velocity"]) < 0.1
    assert found["effort"] < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_block_slides_as_its_model(seed: int):
    log = block_log(seed)
    clean, seconds = log.clean[POSE], log.episode.signals[POSE].seconds
    moved = np.polynomial.polynomial.polyfit(seconds[:5], clean[:5, :2], 2)
    half_step_s = 0.00025  # by which a velocity that is set is before the positions
    motion = simulated(log, clean[0], moved[1] - 2 * moved[2] * half_step_s)
    assert off(read(motion.seconds, motion.places[:, :3], seconds), log, POSE) < 0.25


def test_dry_friction_holds_a_pendulum_for_good():
    pendulum = Pendulum(0.05, 0.1, 0.02, 1.5)
    motion = pendulum.at(np.arange(0.0, 30.0, 0.01))
    assert np.all(motion[-100:] == motion[-1])
    assert motion[-1, 1] == 0
    assert abs(pendulum.pull(motion[-1, 0])) <= pendulum.friction


def test_what_a_pendulum_loses_is_what_friction_takes():
    pendulum = Pendulum(0.06, 0.08, 0.03, -2.0)
    seconds = np.arange(0.0, 4.0, 1e-4)
    angle, speed = pendulum.at(seconds).T
    power = pendulum.damping * speed**2 + pendulum.friction * np.abs(speed)
    energy = pendulum.inertia * speed**2 / 2 - 9.81 * 0.4 * np.cos(angle)
    taken = np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2 * np.diff(seconds))])
    assert energy[0] - energy == pytest.approx(taken, abs=1e-5)


def test_an_arm_that_is_told_nothing_new_rests():
    told = np.array([[0.7, -0.4], [0.7, -0.4]])
    angles, speeds, torques = PlanarArm(1.3, 0.03).moved(
        np.arange(0.0, 2.0, 0.1), np.array([0.0, 1.0]), told
    )
    assert angles == pytest.approx(np.broadcast_to(angles[0], angles.shape), abs=1e-6)
    assert speeds == pytest.approx(np.zeros_like(speeds), abs=1e-6)
    assert torques[0] == pytest.approx(PlanarArm(1.3, 0.03).weight(*angles[0]), rel=1e-6)


def test_a_command_is_obeyed_after_its_delay():
    told_s, seconds = np.array([0.0, 0.5]), np.arange(0.0, 0.6, 0.005)
    told = np.array([[0.7, -0.4], [0.9, -0.4]])
    _, speeds, torques = PlanarArm(1.0, 0.042).moved(seconds, told_s, told)
    jump = np.flatnonzero(np.abs(np.diff(torques[:, 0])) > 1.0)[0] + 1
    assert 0.542 <= seconds[jump] < 0.5475
    assert np.abs(speeds[:jump]).max() < 1e-6


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
        assert signal.stamps_ns[0] == START_NS
        steps_ns = np.diff(signal.stamps_ns)
        assert np.std(steps_ns) == pytest.approx(0.2e6 * np.sqrt(2), rel=0.3)
        apart = signal.values - log.clean[name]
        assert np.all(np.std(apart, axis=0) <= 1.3 * log.noise[name])
        assert np.array_equal(2 * log.noise[name], loud.noise[name])
    if "/joint_commands.position" in log.episode.signals:
        assert not log.noise["/joint_commands.position"].any()
        assert log.episode.signals["/joint_commands.position"].rate_hz == pytest.approx(50, rel=0.1)


def test_noise_is_in_proportion_to_a_signal():
    log = pendulum_log(2)
    name = "/joint_states.velocity"
    apart = np.std(log.episode.signals[name].values - log.clean[name])
    assert apart == pytest.approx(NOISE * np.std(log.clean[name]), rel=0.1)


def test_what_a_log_cannot_tell_is_named():
    assert set(pendulum_of_unknown_mass(1).unidentifiable) == {
        PENDULUM_DAMPING,
        FRICTION,
        ARMATURE,
        MASS,
    }
    assert arm_with_a_brake(1).unidentifiable == (ELBOW_DAMPING,)
    assert set(arm_with_a_brake(1).truth) == {PAYLOAD, DELAY, ELBOW_DAMPING}
    assert block_of_unknown_mass(1).unidentifiable == ("body/block.mass",)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 1.4])
def test_a_swing_tells_ratios_alone(factor: float):
    """Mass, moments and frictions by one factor are the same motion, in MuJoCo too."""
    log = pendulum_of_unknown_mass(3)
    name = "/joint_states.position"
    start = log.clean[name][0]
    scaled = ModelLog(
        log.episode,
        {address: factor * value for address, value in log.truth.items()},
        log.model,
        log.tune,
    )
    motions = [simulated(one, start, np.zeros(1)).places for one in (log, scaled)]
    assert motions[0] == pytest.approx(motions[1], abs=1e-5)


def test_wrong_models_are_models():
    arm, block = arm_log(0), block_log(0)
    models = {**wrong_pendulums(arm), **wrong_arms(arm)}
    assert len(wrong_arms(arm)) == 6
    for text in (*models.values(), *wrong_blocks(block).values()):
        mujoco().MjModel.from_xml_string(text)
    welded = mujoco().MjModel.from_xml_string(wrong_arms(arm)["no elbow"])
    assert (welded.njnt, welded.nu) == (1, 1)


@pytest.mark.parametrize("seed", range(12))
def test_a_block_with_less_gravity_is_wrong_only_where_friction_cannot_make_up_for_it(seed: int):
    log = block_log(seed)
    wrong = wrong_blocks(log)
    friction = log.truth["geom/block.friction[0]"]
    assert "gravity turned by 90 degrees" in wrong
    assert ("gravity of 3.7 m/s²" in wrong) == (friction * 9.81 / 3.7 >= 1.32)
