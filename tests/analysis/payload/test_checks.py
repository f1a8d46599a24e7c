"""Good logs pass every check; each kind of bad one fails the one that is meant for it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.analysis.payload.arm_logs import ARM, CLEAN, changed, circle_log, driver, with_values
from tests.conftest import real
from tunenet_logs.analysis.payload.arm_log import read_arm_log
from tunenet_logs.analysis.payload.checks import arm_checks, payload_checks
from tunenet_logs.analysis.payload.torque_fit import fit_payload
from tunenet_logs.analysis.payload.torque_model import arm_motion
from tunenet_logs.errors import NotFoundError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.arm.description import Payload
from tunenet_logs.recorders.simulators.arm.path import JointPath, circle
from tunenet_logs.recorders.simulators.arm.payload import driver_episode


def failed(episode, tare=None, **part) -> dict[str, bool]:
    """Names of the checks that fail, and whether that is fatal."""
    log = read_arm_log(episode, ARM, **part)
    motion = arm_motion(log)
    empty = [arm_motion(read_arm_log(tare, ARM))] if tare else []
    checks = arm_checks(log, motion, ARM)
    checks += payload_checks(fit_payload(ARM, motion, empty), ARM, log, is_stated=False)
    return {one.name: one.fatal for one in checks if not one.passed}


@pytest.mark.parametrize(
    "seed", [71, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (72, 73))]
)
def test_a_real_drivers_logs_pass_with_a_tare(seed):
    disturbances = driver(seed)
    tare = circle_log(None, disturbances.another_run())
    assert failed(circle_log(Payload(0.5), disturbances), tare) == {}


def test_a_clean_log_passes():
    assert failed(circle_log(Payload(0.5))) == {}


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))]
)
def test_noise_is_no_arm(seed):
    rng = np.random.default_rng(seed)
    noise = with_values(lambda one: rng.normal(0, 3, one.shape))
    assert failed(changed(circle_log(Payload(0.5)), effort=noise))["torques fit the arm"]


def test_torques_of_other_joints_are_no_arms():
    mixed = with_values(lambda one: one[:, [3, 0, 6, 5, 1, 2, 4]])
    assert failed(changed(circle_log(Payload(0.5), driver(5)), effort=mixed))["torques fit the arm"]


def test_constant_torques_are_no_arms():
    noise = np.random.default_rng(0).normal(0, 0.01, (400, 7))
    levels = np.array([1.5, -2.25, 3.0, 4.0, 5.0, 6.0, 1.0])
    flat = with_values(lambda one: levels + noise[: len(one)])
    assert failed(changed(circle_log(Payload(0.5)), effort=flat))["torques fit the arm"]


def test_an_arm_that_stands_still():
    path = circle(500.0, 5.2)
    place = path.position_rad[:1] + np.zeros_like(path.position_rad)
    still = JointPath(path.seconds, place, 0 * place, 0 * place)
    noisy = replace(CLEAN, position_noise_rad=2e-4, torque_noise_nm=0.2)
    assert "the arm moves" in failed(driver_episode(ARM, still, Payload(0.5), noisy))


def test_a_dead_torque_sensor():
    def dead(values):
        values[:, 3] = 7.0
        return values

    assert "every torque changes" in failed(
        changed(circle_log(Payload(0.5), driver(6)), effort=with_values(dead))
    )


def test_a_short_part():
    assert "long enough" in failed(circle_log(Payload(0.5), driver(6)), start_s=1.0, end_s=3.5)


def test_a_payload_off_centre_is_no_fault():
    off = circle_log(Payload(1.5, (0.0, 0.06, 0.06)), replace(driver(8), torque_noise_nm=0.05))
    assert failed(off) == {}


def test_a_log_of_a_real_jaco_without_torques():
    with pytest.raises(NotFoundError, match="no joint torques in this log"):
        read_arm_log(read_episode(real("ros1/jaco2_no_effort.bag")), ARM)


@pytest.mark.parametrize(
    ("name", "topic"),
    [
        pytest.param("jaco_names_recorded_by_rosbag", None, marks=pytest.mark.slow),
        ("jaco_names_recorded_by_rosbag", "/j2s7s300_driver/out/joint_torques"),
        pytest.param("jaco_names_recorded_by_rosbag_lz4", None, marks=pytest.mark.slow),
        ("jaco_names_recorded_by_rosbag_lz4", "/j2s7s300_driver/out/joint_state"),
    ],
)
def test_made_up_torques_in_a_bag(name, topic):
    """They are up to 40 times what the joints can do."""
    found = failed(read_episode(real(f"ros1/{name}.bag")), topic=topic)
    assert found["within what the arm lifts"]


@pytest.mark.parametrize("slow", ["position", "effort"])
def test_the_slower_of_positions_and_torques_counts(slow):
    def at_5_hz(signal):
        return replace(signal, stamps_ns=signal.stamps_ns[::12], values=signal.values[::12])

    log = read_arm_log(changed(circle_log(Payload(0.5)), **{slow: at_5_hz}), ARM)
    rate = next(one for one in arm_checks(log, arm_motion(log), ARM) if one.name == "rate")
    assert not rate.passed
    assert "5 Hz" in rate.detail
    assert "60 Hz" in rate.detail


@pytest.mark.parametrize("sds", [-9.0, 9.0])
def test_a_sensor_that_is_far_off_is_named_whichever_way(sds):
    log = read_arm_log(circle_log(Payload(0.5)), ARM)
    fit = fit_payload(ARM, arm_motion(log))
    terms = list(fit.nuisances)
    at = next(index for index, one in enumerate(terms) if one.group == "offset")
    terms[at] = replace(terms[at], value=sds * terms[at].prior_sd)
    checks = payload_checks(replace(fit, nuisances=tuple(terms)), ARM, log, is_stated=False)
    check = next(one for one in checks if one.name == "friction and sensors are usual")
    assert not check.passed
    assert terms[at].name in check.detail
