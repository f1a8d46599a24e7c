"""Torques: a rollout and inverse dynamics agree; payloads do what they weigh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.arm.description import Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import circle, circle_at, random_path
from tunenet_logs.recorders.simulators.arm.payload import (
    CALIBRATED,
    PAYLOAD_MASS,
    TOPIC,
    PayloadRollout,
    PayloadSimulator,
    joint_efforts_nm,
    roll_out,
)
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

ARM = jaco()
HELD = Payload(0.7, (0.01, 0.02, -0.01))

pytestmark = pytest.mark.usefixtures("each_engine")


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_a_rollout_applies_the_torques_of_inverse_dynamics():
    times = CALIBRATED.times()
    rollout = roll_out(ARM, circle_at(times), HELD)
    along_the_circle = joint_efforts_nm(ARM, circle_at(times[150:-1]), HELD)
    assert rms(rollout.effort_nm - along_the_circle) < 0.001
    where_it_went = joint_efforts_nm(ARM, rollout.path, HELD)
    assert rms(rollout.effort_nm - where_it_went) < 1e-9


def test_rollouts_are_bit_identical_whatever_ran_before():
    short = replace(CALIBRATED, samples=50)
    path = circle_at(short.times())
    first = roll_out(ARM, path, HELD, short).effort_nm
    roll_out(ARM, circle_at(CALIBRATED.times()), Payload(2.0))
    joint_efforts_nm(ARM, circle(), Payload(3.0))
    assert np.array_equal(roll_out(ARM, path, HELD, short).effort_nm, first)


def test_torques_are_linear_in_the_mass_and_nothing_is_kept_from_before():
    path = random_path(ARM, 2)
    empty = joint_efforts_nm(ARM, path)
    unit = joint_efforts_nm(ARM, path, Payload(1.0)) - empty
    for mass in (0.0, 0.4, 1.7, 5.0):
        efforts = joint_efforts_nm(ARM, path, Payload(mass))
        assert np.abs(efforts - (empty + mass * unit)).max() < 1e-9


def test_what_a_kilogram_does_to_each_joint_on_the_circle():
    """Measured in a prototype of the same arm: joint 7 sees nothing."""
    path = circle()
    unit = joint_efforts_nm(ARM, path, Payload(1.0)) - joint_efforts_nm(ARM, path)
    per_joint = np.sqrt(np.mean(unit**2, axis=0))
    assert per_joint == pytest.approx([0.08, 4.06, 0.25, 2.54, 1.77, 0.93, 0.0], abs=0.005)


def test_at_rest_upright_torques_are_lever_times_weight():
    """Joint 2 of a still arm holds what hangs off its axis."""
    path = circle(60, 0.1)
    none = np.zeros_like(path.velocity_rad_s)
    still = replace(path, velocity_rad_s=none, acceleration_rad_s2=none)
    doubled = joint_efforts_nm(ARM, still, None, (0.0, 0.0, -2 * GRAVITY_M_S2))
    assert np.abs(doubled - 2 * joint_efforts_nm(ARM, still)).max() < 1e-9
    assert np.abs(joint_efforts_nm(ARM, still, None, (0.0, 0.0, 0.0))).max() < 1e-9


def test_the_simulators_give_episodes():
    simulator = PayloadSimulator(ARM, circle(), HELD.com_m)
    episode = simulator.rollout({"payload_mass": 0.7})
    efforts = episode.signals[f"{TOPIC}.effort"]
    assert efforts.columns == ARM.joint_names
    assert efforts.unit == "N·m"
    assert np.abs(efforts.values - joint_efforts_nm(ARM, circle(), HELD)).max() < 1e-9
    assert episode.info.kind == "payload"
    assert episode.info.truth["payload_mass"] == 0.7
    assert episode.info.truth["payload_com_y"] == 0.02
    again = simulator.rollout({"payload_mass": 0.7}).signals[f"{TOPIC}.effort"].values
    assert np.array_equal(again, efforts.values)


def test_the_rollout_simulator_samples_what_was_before_a_step():
    settings = replace(CALIBRATED, samples=240)
    simulator = PayloadRollout(ARM, circle_at(settings.times()), HELD.com_m, settings)
    episode = simulator.rollout({"payload_mass": 0.7})
    efforts = episode.signals[f"{TOPIC}.effort"]
    assert efforts.rate_hz == pytest.approx(60)
    ideal = joint_efforts_nm(ARM, circle_at(settings.times()[150:-1:4]), HELD)
    assert rms(efforts.values - ideal) < 0.001
    reached = episode.signals[f"{TOPIC}.position"].values
    wanted = circle_at(settings.times()[150:-1:4]).position_rad
    assert np.abs(reached - wanted).max() < 2e-4


@pytest.mark.parametrize("mass", [-0.1, 20.1, float("nan"), float("inf")])
def test_the_engine_never_sees_a_bad_mass(mass: float):
    simulator = PayloadSimulator(ARM, circle(10, 1))
    with pytest.raises(UsageError, match="payload_mass"):
        simulator.rollout({PAYLOAD_MASS.name: mass})
    with pytest.raises(UsageError, match="friction"):
        simulator.rollout({"friction": 0.1})


@pytest.mark.parametrize(
    "field", [{"step_hz": 0}, {"burn_in": 0}, {"force_nm": float("nan")}, {"position_gain": 2}]
)
def test_the_engine_never_sees_bad_settings(field: dict[str, float]):
    with pytest.raises(UsageError, match=next(iter(field))):
        replace(CALIBRATED, **field)  # type: ignore[arg-type]
