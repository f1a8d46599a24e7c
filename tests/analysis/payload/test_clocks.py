"""Arms whose clock jumps, or that rest so long that no spline goes over it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.analysis.payload.arm_logs import ARM, changed, circle_log
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.payload.arm_log import most_knots, read_arm_log
from tunenet_logs.analysis.payload.torque_model import arm_motion, smoothing_spline
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Episode
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.arm.description import Payload

DAY_NS = 86_400 * 10**9


@pytest.fixture(scope="module")
def episode() -> Episode:
    return circle_log(Payload(0.5))


def with_stamps(episode: Episode, change) -> Episode:
    def moved(signal):
        stamps = change(signal.stamps_ns.copy())
        order = np.argsort(stamps)
        return replace(signal, stamps_ns=stamps[order], values=signal.values[order])

    return changed(episode, position=moved, velocity=moved, effort=moved)


def stamp_off(at: int, by_ns: int):
    def change(stamps):
        stamps[at] += by_ns
        return stamps

    return change


@pytest.mark.parametrize("days", [1, 100, 18_000, -1])
@pytest.mark.parametrize("at", [0, 150, -1])
def test_a_stamp_days_off_costs_nothing(episode: Episode, at: int, days: int):
    """Before, 1.8 GB a day: knots all over the time from the arm to the stamp."""
    tuning = tune_episode(with_stamps(episode, stamp_off(at, days * DAY_NS)), TuneOptions())
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.parameters is not None
    assert any("the clock jumps by" in words for words in tuning.warnings)
    assert len(tuning.detection.motion.spline.t) < 200
    assert tuning.trace is not None
    assert abs(float(tuning.trace.estimate[0]) - 0.5) < 0.02


def test_a_tare_with_a_stamp_days_off_serves(episode: Episode):
    tare = with_stamps(circle_log(None), stamp_off(100, DAY_NS))
    tuning = tune_episode(episode, TuneOptions(tares=(tare,)))
    assert tuning.verdict == "ok", tuning.reason
    assert len(tuning.detection.tares[0].motion.spline.t) < 200
    assert any(words.startswith("tare: ") and "jumps" in words for words in tuning.warnings)


def test_hours_between_two_motions_are_no_grid(episode: Episode):
    def change(stamps):
        stamps[100:] += 8 * 3600 * 10**9
        return stamps

    log = read_arm_log(with_stamps(episode, change), ARM)
    assert "a pause of 28800.0 s after sample 100" in log.warnings[0]
    assert len(arm_motion(log).spline.t) < 200


def test_a_minute_of_rest_is_bridged_as_before(episode: Episode):
    def change(stamps):
        stamps[100:] += 60 * 10**9
        return stamps

    log = read_arm_log(with_stamps(episode, change), ARM)
    assert not log.warnings
    motion = arm_motion(log)
    assert motion.seconds[-1] > 60
    assert len(motion.spline.t) > 1500


def test_too_little_beside_a_long_pause_says_the_pause(episode: Episode):
    def change(stamps):
        return stamps + np.arange(len(stamps)) // 15 * 3600 * 10**9

    with pytest.raises(NotFoundError, match="a pause of 3600"):
        read_arm_log(with_stamps(episode, change), ARM)


def test_a_spline_has_a_bounded_number_of_knots():
    seconds = np.append(np.arange(100) * 0.01, 1e7)
    spline = smoothing_spline(seconds, np.sin(seconds)[:, None])
    assert len(spline.t) <= most_knots(len(seconds)) + 20
