"""What a log says of an arm: units, joints, stale and stuck samples, rests, clocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline, CubicSpline

from tests.analysis.payload.arm_logs import (
    ARM,
    CLEAN,
    FULL_HZ,
    changed,
    circle_log,
    driver,
    of_all,
    on_topic,
    paused,
    renamed,
    stuck,
    with_fingers,
    with_values,
)
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.payload.arm_log import ArmLog, match_joints, read_arm_log
from tunenet_logs.analysis.payload.checks import arm_checks
from tunenet_logs.analysis.payload.torque_model import EvenSpline, arm_motion
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode, Signal
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.arm.description import Payload
from tunenet_logs.recorders.simulators.arm.path import circle, circle_at, random_path
from tunenet_logs.recorders.simulators.arm.payload import Disturbances, FieldClock, driver_episode

NUMBERED = tuple(f"joint{number}" for number in range(1, 8))
DAY_NS = 86_400 * 10**9


@pytest.fixture(scope="module")
def episode():
    return circle_log(Payload(0.5))


def read(episode: Episode, **changes: object) -> ArmLog:
    return read_arm_log(changed(episode, **changes) if changes else episode, ARM)


def turns(found: ArmLog, plain: ArmLog) -> Array:
    return (found.position.values - plain.position.values) / (2 * np.pi)


def test_degrees_and_turns_become_the_same_angles(episode):
    plain = read(episode)
    assert plain.warnings == ()
    shown = episode.signals["/joint_states.position"].values
    np.testing.assert_array_equal(plain.position.values, shown)
    found = read(episode, position=with_values(lambda q: np.degrees(q) % 360))
    assert "degrees" in found.warnings[0]
    assert np.all(np.abs(np.diff(found.position.values, axis=0)) < 0.1)
    np.testing.assert_allclose(turns(found, plain), np.round(turns(found, plain)), atol=1e-9)
    wrist = with_values(lambda q: q + 6 * np.pi * (np.arange(7) == 6))
    found = read(episode, position=wrist)  # whose turns are counted: no sign of degrees
    np.testing.assert_allclose(turns(found, plain), np.round(turns(found, plain)), atol=1e-9)
    assert any("taken as rad" in warning for warning in found.warnings)


def hurried(one: Signal) -> Signal:
    start_ns = one.stamps_ns[0]
    return replace(one, stamps_ns=start_ns + (one.stamps_ns - start_ns) // 100)


@pytest.mark.parametrize(
    "changes",
    [
        of_all(hurried),
        {"position": with_values(lambda q: np.where(np.arange(len(q))[:, None] % 2, q, 0.0))},
    ],
    ids=["stamps too close", "a second publisher of zeros"],
)
def test_speeds_that_no_arm_has_are_no_sign_of_degrees(episode, changes):
    found = read(episode, **changes)
    assert not any("converted" in warning for warning in found.warnings)
    assert any("bad stamps, two publishers" in warning for warning in found.warnings)


def test_of_a_long_log_the_part_that_moves_is_used_and_that_is_said(episode):
    seconds = np.arange(0, 2400, 0.5)
    moves = ((seconds >= 1300) * np.sin(seconds))[:, None] * np.linspace(0.3, 0.9, 7)
    stamps_ns, values = (1e9 * seconds).astype(np.int64), moves + 1e-6 * seconds[:, None]
    long = changed(episode, **of_all(lambda one: replace(one, stamps_ns=stamps_ns, values=values)))
    found = read_arm_log(long, ARM)
    first_s, last_s = found.position.seconds[[0, -1]]
    assert 1200 <= first_s <= 1320
    assert 590 <= last_s - first_s <= 600
    (words,) = [one for one in found.warnings if "--start" in one]
    assert words.startswith("2400 s are more than is fitted at once: the 600 s from 12")
    assert not any(
        "--start" in one for one in read_arm_log(long, ARM, start_s=0, end_s=500).warnings
    )


def test_columns_are_brought_into_the_arms_order(episode):
    plain = read(episode)
    found = read(episode, **of_all(with_fingers))
    assert found.joints == plain.joints
    np.testing.assert_array_equal(found.effort.values, plain.effort.values)


def test_positions_and_torques_of_two_topics_are_put_together(episode):
    effort = on_topic(episode.signals["/joint_states.effort"], "/out/joint_torques", NUMBERED)
    position = on_topic(episode.signals["/joint_states.position"], "/out/joint_state")
    apart = replace(episode, signals={one.name: one for one in (effort, position)})
    found = read_arm_log(apart, ARM)
    assert (found.effort.topic, found.position.topic) == ("/out/joint_torques", "/out/joint_state")
    assert found.velocity is None


def test_a_topic_that_is_still_gives_way_to_one_that_moves(episode):
    still = on_topic(episode.signals["/joint_states.effort"], "/a_command")
    still = replace(still, values=np.ones_like(still.values))
    found = read_arm_log(replace(episode, signals={still.name: still, **episode.signals}), ARM)
    assert found.effort.topic == "/joint_states"


def test_stale_samples_are_dropped_and_their_clock_found():
    log = read_arm_log(circle_log(Payload(0.5), driver(3)), ARM)
    assert log.position.rate_hz == pytest.approx(30, abs=0.1)
    assert 0.5 < log.position.repeated < 0.58
    assert np.any(np.diff(log.effort.values, axis=0), axis=1).all()


def test_a_part_of_the_log(episode):
    log = read_arm_log(episode, ARM, start_s=1.0, end_s=3.0)
    assert log.effort.seconds[0] >= 1.0
    assert log.effort.seconds[-1] <= 3.0
    with pytest.raises(NotFoundError, match="--start 99 is past the end"):
        read_arm_log(episode, ARM, start_s=99)


def test_what_is_no_number_is_left_out(episode):
    def without(rows: slice, joint: int):
        def change(values):
            values[rows, joint] = np.nan
            return values

        return with_values(change)

    whole = len(read(episode).effort.seconds)
    assert len(read(episode, effort=without(slice(10, 20), 3)).effort.seconds) == whole - 10
    log = read(episode, effort=without(slice(None), 6))
    assert list(log.constant) == [False] * 6 + [True]
    assert len(log.effort.seconds) == whole
    assert read(episode, velocity=with_values(lambda one: one + np.nan)).velocity is None


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"effort": with_values(np.zeros_like)}, "every torque is 0"),
        ({"effort": with_values(lambda one: 0 * one + 1.5)}, "no torque ever changes"),
        ({"effort": with_values(lambda one: one + np.nan)}, "no torque is a number"),
        ({"effort": lambda one: renamed(one, tuple("abcdefg"))}, "there: a, b, c"),
        ({"position": lambda one: renamed(one, tuple("abcdefg"))}, "there: a, b, c"),
        ({"effort": lambda one: replace(one, unit="")}, "no joint torques in this log"),
    ],
)
def test_what_cannot_be_used_is_refused_with_its_reason(episode, change, reason):
    with pytest.raises(NotFoundError, match=reason):
        read(episode, **change)


def test_a_topic_without_the_arms_joints_is_refused(episode):
    with pytest.raises(
        NotFoundError, match=r"no usable topic /nope \(there is: /joint_states\); name one"
    ):
        read_arm_log(episode, ARM, topic="/nope")
    base = on_topic(episode.signals["/joint_states.position"], "/base", tuple("abcdefg"))
    both = replace(episode, signals={**episode.signals, base.name: base})
    with pytest.raises(NotFoundError, match=r"/base: no joint of the log is .*there: a, b"):
        read_arm_log(both, ARM, topic="/base")
    assert read_arm_log(both, ARM, topic="/joint_states.effort").effort.topic == "/joint_states"


JACO = tuple(f"j2s7s300_joint_{number}" for number in range(1, 8))
UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")


@pytest.mark.parametrize(
    "columns",
    [
        JACO,
        NUMBERED,
        tuple(f"left/j2s7s300_joint_{number}" for number in range(1, 8)),
        tuple(f"panda_joint{number}" for number in range(1, 8)),
        tuple(f"A{number}" for number in range(1, 8)),
    ],
)
def test_in_any_order_among_others(columns):
    fingers = ("j2s7s300_joint_finger_1", "j2s7s300_joint_finger_2", "gripper_joint_7")
    shuffled = (fingers[0], *columns[::-1], *fingers[1:])
    assert match_joints(JACO, shuffled) == tuple(7 - at for at in range(7))


@pytest.mark.parametrize(
    ("columns", "places"),
    [
        (("left_elbow_joint", "left_shoulder_pan_joint", "left_shoulder_lift_joint"), (1, 2, 0)),
        *(
            (("gripper", *(f"joint{first + at}" for at in (1, 0, 2))), (2, 1, 3))
            for first in (0, 1)
        ),
    ],
)
def test_names_of_other_arms_are_matched_by_ending_or_number(columns, places):
    assert match_joints(UR, columns) == places


@pytest.mark.parametrize(
    ("joints", "columns", "says"),
    [
        (UR, ("gripper", *(f"joint{at}" for at in range(4))), "--arm NAME"),
        (JACO, JACO[:-1], r"j2s7s300_joint_7 \(there: j2s7s300_joint_1, "),
        (
            JACO,
            tuple(f"{side}_joint_{at}" for side in ("left", "right") for at in range(1, 8)),
            "left_joint_1 and right_joint_1",
        ),
    ],
    ids=["one too many", "one is missing", "two arms"],
)
def test_joints_that_are_not_found_are_named(joints, columns, says):
    with pytest.raises(NotFoundError, match=says):
        match_joints(joints, columns)


@pytest.mark.parametrize(("last", "off_rad"), [(151, 1e-4), (None, 1e-3), (None, 0.3)])
def test_positions_of_an_arm_at_rest_that_hardly_change_are_a_motion(episode, last, off_rad):
    def steps(values):
        values[:] = values[0]
        values[150:last, 2] += off_rad
        return values

    motion = arm_motion(read(episode, position=with_values(steps)))
    position, _, _ = motion.at(motion.seconds)
    start = episode.signals["/joint_states.position"].values[0]
    assert np.abs(position - start).max() < 0.4


def test_an_arm_that_rests_still_has_positions(episode):
    def rests(values):
        values[100:200] = values[100]
        values[200:] -= values[200] - values[100]
        return values

    log = read(episode, position=with_values(rests))
    assert float(np.diff(log.position.seconds).max()) < 0.2


@pytest.mark.parametrize("fields", [("position", "effort"), ("position",)])
def test_a_driver_that_was_stuck_leaves_a_hole(episode, fields):
    log = read(episode, **dict.fromkeys(fields, with_values(stuck(100, 160))))
    assert float(np.diff(log.position.seconds).max()) > 0.9
    motion = arm_motion(log)
    inside = (motion.seconds > 100 / 60 + 0.1) & (motion.seconds < 160 / 60 - 0.1)
    assert not inside.any()
    assert len(motion.seconds) > 200


@pytest.mark.parametrize(
    ("disturbances", "seconds", "most"),
    [
        ({}, 5.2, 1e-4),
        ({"position_noise_rad": 2e-4}, 5.2, 0.03),
        ({"rate_hz": 10.0}, 5.2, 0.003),
        ({"position_noise_rad": 2e-4}, 60.0, 0.03),
        ({"rate_hz": 65.0, "clock": FieldClock(30.0, 16.0, 58.0)}, 5.2, 0.05),
    ],
    ids=["clean", "noisy", "slow", "a minute", "stale"],
)
def test_derivatives_are_those_of_the_path(disturbances, seconds, most):
    noisy = replace(CLEAN, **disturbances)
    episode = driver_episode(ARM, circle(FULL_HZ, seconds), Payload(0.5), noisy)
    motion = arm_motion(read(episode))
    first_s = episode.signals["/joint_states.position"].stamps_ns[0] * 1e-9
    path = circle_at(motion.seconds + first_s)
    _, _, acceleration = motion.at(motion.seconds)
    assert np.abs(acceleration - path.acceleration_rad_s2).max() < most


def test_single_samples_elsewhere_are_left_out(episode):
    def glitches(values):
        values[50, 2] += 1.0
        values[120] -= 0.2
        return values

    plain = arm_motion(read_arm_log(episode, ARM))
    motion = arm_motion(read_arm_log(changed(episode, position=with_values(glitches)), ARM))
    for found, expected in zip(motion.at(motion.seconds), plain.at(plain.seconds), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-3)


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
    motion = arm_motion(read(episode))
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
    log = read(episode)
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
    log = read(episode)
    assert log.position.rate_hz == pytest.approx(clock.position_hz, rel=0.1)
    assert 0.4 < log.position.repeated < 0.56
    assert 0.15 < log.effort.repeated < 0.22
    lasts_s = PATHS[path].seconds[-1]
    assert len(log.position.seconds) == pytest.approx(lasts_s * clock.position_hz, rel=0.05)
    assert acceleration_error(path, episode) < 0.1


@pytest.mark.parametrize("path", PATHS)
def test_an_arm_that_rests_at_10_hz_has_no_gaps(path: str):
    log = read(log_of(path, Disturbances(rate_hz=10.0, torque_noise_nm=0.2)))
    assert [check.name for check in arm_checks(log, arm_motion(log), ARM) if not check.passed] == []


def test_torques_that_are_stuck_while_the_arm_moves_are_no_rest():
    whole = log_of("a pause", Disturbances(rate_hz=60.0))
    log = read(whole, effort=with_values(stuck(60, 120)))
    assert float(np.diff(log.effort.seconds).max()) == pytest.approx(1.0, abs=0.02)
    assert float(np.diff(log.position.seconds).max()) < 0.02


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


def with_stamps(episode: Episode, change) -> Episode:
    def moved(signal):
        stamps = change(signal.stamps_ns.copy())
        order = np.argsort(stamps)
        return replace(signal, stamps_ns=stamps[order], values=signal.values[order])

    return changed(episode, **of_all(moved))


def pushed(first: int, by_s: float, last: int | None = None):
    """Stamps from one place on, or up to another, that are so much later."""

    def change(stamps):
        stamps[first:last] += round(by_s * 1e9)
        return stamps

    return change


@pytest.mark.parametrize("days", [1, 18_000, -1])
@pytest.mark.parametrize("at", [0, 150, -1])
def test_a_stamp_days_off_costs_nothing(episode: Episode, at: int, days: int):
    off = with_stamps(episode, pushed(at, days * DAY_NS * 1e-9, (at + 1) or None))
    tuning = tune_episode(off, TuneOptions())
    assert tuning.verdict == "ok", tuning.reason
    assert any("the clock jumps by" in words for words in tuning.warnings)
    assert len(tuning.detection.motion.spline.coefficients) < 200
    assert tuning.estimate is not None
    assert abs(float(tuning.estimate[0]) - 0.5) < 0.02


def test_a_tare_with_a_stamp_days_off_serves(episode: Episode):
    tare = with_stamps(circle_log(None), pushed(100, DAY_NS * 1e-9, 101))
    tuning = tune_episode(episode, TuneOptions(tares=(tare,)))
    assert tuning.verdict == "ok", tuning.reason
    assert len(tuning.detection.tares[0].motion.spline.coefficients) < 200
    assert any(words.startswith("tare: ") and "jumps" in words for words in tuning.warnings)


def test_hours_between_two_motions_are_no_grid_and_a_minute_is_bridged(episode: Episode):
    log = read(with_stamps(episode, pushed(100, 8 * 3600)))
    assert "a pause of 28800.0 s after sample 100" in log.warnings[0]
    assert len(arm_motion(log).spline.coefficients) < 200
    log = read(with_stamps(episode, pushed(100, 60)))
    assert not log.warnings
    motion = arm_motion(log)
    assert motion.seconds[-1] > 60
    assert len(motion.spline.coefficients) > 1500
    hourly = with_stamps(episode, lambda ns: ns + np.arange(len(ns)) // 15 * 3600 * 10**9)
    with pytest.raises(NotFoundError, match="a pause of 3600"):
        read(hourly)


@pytest.mark.parametrize("order", range(4))
def test_a_spline_on_even_knots_is_scipys(order: int):
    rng = np.random.default_rng(3)
    spline = EvenSpline(2.0, 0.05, rng.normal(size=(45, 3)))
    knots = 2.0 + 0.05 * np.arange(-5, 46)
    seconds = np.linspace(1.95, 4.05, 333)  # a knot beyond either end, too
    wanted = BSpline(knots, spline.coefficients, 5, extrapolate=True)(seconds, order)
    assert np.allclose(spline(seconds, order), wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())
