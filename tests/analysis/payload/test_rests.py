"""An arm that rests: its equal samples are none of a driver that repeats what it has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from tests.analysis.payload.arm_logs import ARM, FULL_HZ, changed, with_values
from tests.analysis.payload.paused import paused
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.payload.arm_log import new_samples, read_arm_log
from tunenet_logs.analysis.payload.checks import arm_checks
from tunenet_logs.analysis.payload.torque_model import arm_motion
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Episode
from tunenet_logs.recorders.simulators.arm.description import Payload
from tunenet_logs.recorders.simulators.arm.path import circle, random_path
from tunenet_logs.recorders.simulators.arm.payload import Disturbances, FieldClock, driver_episode

TRUTH_KG = 1.803
TURN = circle(FULL_HZ, 6.0)
PATHS = {
    "a pause": paused(TURN, [3.0]),
    "rest at both ends": paused(TURN, [], before_s=2.0, after_s=2.0),
    "stop and go": paused(TURN, [1.5, 3.0, 4.5], 0.6, before_s=1.0, after_s=1.0),
    "any motion": paused(random_path(ARM, 4, FULL_HZ, 6.0), [3.0], before_s=0.5, after_s=0.5),
}


def stale_clock(rate_hz: float) -> FieldClock:
    """Of a driver that measures less often than it publishes."""
    return FieldClock(0.47 * rate_hz, 0.3 * rate_hz, 0.8 * rate_hz)


def log_of(path: str, disturbances: Disturbances) -> Episode:
    return driver_episode(ARM, PATHS[path], Payload(TRUTH_KG), disturbances)


def acceleration_error(path: str, episode: Episode) -> float:
    """Of the motion that is found, rms [rad/s^2]."""
    motion = arm_motion(read_arm_log(episode, ARM))
    first_s = float(episode.signals["/joint_states.position"].stamps_ns[0]) * 1e-9
    truth = CubicSpline(PATHS[path].seconds, PATHS[path].acceleration_rad_s2)
    _, _, found = motion.at(motion.seconds)
    return float(np.sqrt(np.mean((found - truth(motion.seconds + first_s)) ** 2)))


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize(
    ("rate_hz", "step_rad", "most"),
    [
        (10.0, 0.0, 0.02),
        (10.0, 1e-3, 0.03),
        (60.0, 0.0, 0.003),
        (60.0, 1e-4, 0.01),
        (60.0, 1e-3, 0.02),
        (100.0, 1e-3, 0.02),
        (500.0, 0.0, 0.003),
        (500.0, 1e-4, 0.01),
        (500.0, 1e-3, 0.08),
    ],
)
def test_a_rest_is_no_stale_sample(path: str, rate_hz: float, step_rad: float, most: float):
    episode = log_of(path, Disturbances(rate_hz=rate_hz, position_step_rad=step_rad))
    log = read_arm_log(episode, ARM)
    assert (log.position.repeated, log.position.late_s, log.effort.late_s) == (0.0, 0.0, 0.0)
    assert len(log.position.seconds) == len(episode.signals["/joint_states.position"].stamps_ns)
    assert acceleration_error(path, episode) < most


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("rate_hz", [60.0, 100.0, 500.0])
@pytest.mark.parametrize("step_rad", [0.0, 1e-4])
def test_a_driver_that_is_stale_rests_too(path: str, rate_hz: float, step_rad: float):
    clock = stale_clock(rate_hz)
    stale = Disturbances(rate_hz=rate_hz, clock=clock, position_step_rad=step_rad)
    episode = log_of(path, stale)
    log = read_arm_log(episode, ARM)
    assert log.position.rate_hz == pytest.approx(clock.position_hz, rel=0.1)
    assert 0.4 < log.position.repeated < 0.56
    assert 0.15 < log.effort.repeated < 0.22
    lasts_s = PATHS[path].seconds[-1]
    assert len(log.position.seconds) == pytest.approx(lasts_s * clock.position_hz, rel=0.05)
    assert acceleration_error(path, episode) < 0.1


@pytest.mark.parametrize("clock", [FieldClock(), stale_clock(60.0)])
@pytest.mark.parametrize(
    "path",
    [
        "a pause",
        "stop and go",
        pytest.param("rest at both ends", marks=pytest.mark.slow),
        pytest.param("any motion", marks=pytest.mark.slow),
    ],
)
def test_the_mass_of_an_arm_that_rests(path: str, clock: FieldClock):
    fine = Disturbances(rate_hz=60.0, clock=clock, torque_noise_nm=0.2, position_step_rad=1e-4)
    tuning = tune_episode(log_of(path, fine), TuneOptions(method="fit"))
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.estimate is not None
    assert float(tuning.estimate[0]) == pytest.approx(TRUTH_KG, abs=0.01)


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("noise_nm", [0.0, 0.2])
def test_an_arm_that_rests_at_10_hz_has_no_gaps(path: str, noise_nm: float):
    episode = log_of(path, Disturbances(rate_hz=10.0, torque_noise_nm=noise_nm))
    log = read_arm_log(episode, ARM)
    checks = arm_checks(log, arm_motion(log), ARM)
    assert [check.name for check in checks if not check.passed] == []


def test_messages_that_are_missing_are_a_gap_even_in_a_rest():
    def missing(signal):
        seconds = (signal.stamps_ns - signal.stamps_ns[0]) * 1e-9
        keep = (seconds < 4.4) | (seconds > 5.2)
        return replace(signal, stamps_ns=signal.stamps_ns[keep], values=signal.values[keep])

    whole = log_of("a pause", Disturbances(rate_hz=60.0))
    episode = changed(whole, position=missing, velocity=missing, effort=missing)
    log = read_arm_log(episode, ARM)
    checks = arm_checks(log, arm_motion(log), ARM)
    assert [check.name for check in checks if not check.passed] == ["no gaps"]


def test_torques_that_are_stuck_while_the_arm_moves_are_no_rest():
    def stuck(values):
        values[60:120] = values[60]
        return values

    whole = log_of("a pause", Disturbances(rate_hz=60.0))
    log = read_arm_log(changed(whole, effort=with_values(stuck)), ARM)
    assert float(np.diff(log.effort.seconds).max()) == pytest.approx(1.0, abs=0.02)
    assert float(np.diff(log.position.seconds).max()) < 0.02


@pytest.mark.parametrize("several", [2, 5, 16])
def test_what_moves_on_meanwhile_is_repeated(several: int):
    seconds = np.arange(600) / 100
    place = np.sin(seconds)[:, None] * [1.0, 0.5]
    first = np.arange(600) // several * several
    found = new_samples(seconds, place[first])
    assert found.repeated == pytest.approx(1 - 1 / several, abs=0.08)
    assert np.median(np.diff(found.seconds)) == pytest.approx(several / 100, rel=0.01)


def test_small_corrections_between_long_rests_are_no_motion():
    seconds = np.arange(900) / 100
    place = np.where(seconds < 3, np.sin(seconds), np.sin(3.0))[:, None] + np.zeros(2)
    place[500:] += 1e-3
    place[700:] += 3e-3
    found = new_samples(seconds, place)
    assert found.repeated == 0
    assert len(found.seconds) == len(seconds)


def test_angles_that_are_cut_to_a_turn_rest_too():
    seconds = np.arange(900) / 100
    place = np.where(seconds < 4, seconds, np.maximum(seconds - 2, 4.0))[:, None] * [1.0, -2.0]
    found = new_samples(seconds, np.mod(place, 2 * np.pi))
    assert found.repeated == 0
    assert len(found.seconds) == len(seconds)
