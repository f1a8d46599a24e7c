"""Machines that no engine simulated move as the owners' models with the true values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

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
    HeldCommands,
    ModelLog,
    Pendulum,
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
from tunenet_logs.episode import Array
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


class Simulated(NamedTuple):
    """Motion of a model, from the log's start on."""

    seconds: Array  # of positions, shape (T,)
    late_s: float  # by which velocities are half a step behind the others
    places: Array  # joints' or a free body's positions, shape (T, Q)
    speeds: Array  # shape (T, V)


def true_model(log: ModelLog) -> Any:
    """The owner's model with the true values."""
    model = mujoco().MjModel.from_xml_string(log.model)
    for address, value in log.truth.items():
        kind, _, rest = address.partition("/")
        name, _, field = rest.partition(".")
        if kind == "joint":
            getattr(model, f"dof_{field}")[model.joint(name).dofadr[0]] = value
        elif kind == "body":
            body = model.body(name).id
            model.body_inertia[body] *= value / model.body_mass[body]
            model.body_mass[body] = value
        elif kind == "geom":
            model.geom(name).friction[0] = value
    mujoco().mj_setConst(model, mujoco().MjData(model))
    return model


def simulated(log: ModelLog, places: Array, speeds: Array) -> Simulated:
    """The model's motion; first positions may be fewer than the model has."""
    model = true_model(log)
    data, step_s = mujoco().MjData(model), model.opt.timestep
    data.qpos[: len(places)], data.qvel[: len(speeds)] = places, speeds
    last_s = max(one.seconds[-1] for one in log.episode.signals.values())
    count = int(last_s / step_s) + 2
    control = np.zeros((count, model.nu))
    if (told := log.episode.signals.get("/joint_commands.position")) is not None:
        held = HeldCommands(told.seconds, told.values)
        control = held.over_steps(step_s, count, log.truth["delay/commands"])
    rows = []
    for row in control:
        data.ctrl[:] = row
        where, fast = data.qpos.copy(), data.qvel.copy()
        mujoco().mj_step(model, data)
        rows.append((where, fast))
    kinds = [np.array([row[kind] for row in rows]) for kind in range(2)]
    exact = model.opt.integrator == mujoco().mjtIntegrator.mjINT_RK4
    return Simulated(np.arange(count) * step_s, 0.0 if exact else step_s / 2, *kinds)


def read(seconds: Array, values: Array, at: Array) -> Array:
    """Simulated values of shape (S, C) at a sensor's times of shape (T,), shape (T, C)."""
    return np.column_stack([np.interp(at, seconds, column) for column in values.T])


def off(values: Array, log: ModelLog, name: str) -> float:
    """Largest rms difference of a column from what a sensor without noise reads, over its noise."""
    apart = (values - log.clean[name]) / log.noise[name]
    return float(np.max(np.sqrt(np.mean(apart**2, axis=0))))


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
        if name == "/joint_states.velocity" and make is pendulum_log:
            assert log.noise[name] == pytest.approx(NOISE * np.std(log.clean[name], axis=0))
        assert np.array_equal(2 * log.noise[name], loud.noise[name])
    if "/joint_commands.position" in log.episode.signals:
        assert not log.noise["/joint_commands.position"].any()
        assert log.episode.signals["/joint_commands.position"].rate_hz == pytest.approx(50, rel=0.1)


def test_what_a_log_cannot_tell_is_named():
    log = pendulum_of_unknown_mass(1)
    assert set(log.unidentifiable) == set(log.truth) == {PENDULUM_DAMPING, FRICTION, ARMATURE, MASS}
    log = arm_with_a_brake(1)
    assert (set(log.truth), log.unidentifiable) == (
        {PAYLOAD, DELAY, ELBOW_DAMPING},
        (ELBOW_DAMPING,),
    )
    assert block_of_unknown_mass(1).unidentifiable == ("body/block.mass",)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 1.4])
def test_a_swing_tells_ratios_alone(factor: float):
    """Mass, moments and frictions by one factor are the same motion, in MuJoCo too."""
    log = pendulum_of_unknown_mass(3)
    name = "/joint_states.position"
    start = log.clean[name][0]
    scaled = replace(log, truth={name: factor * value for name, value in log.truth.items()})
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
