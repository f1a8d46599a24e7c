"""What a log says of an arm: degrees, turns, stale and stuck samples, topics apart."""

from dataclasses import replace

import numpy as np
import pytest

from tests.analysis.payload.arm_logs import (
    ARM,
    CLEAN,
    FULL_HZ,
    changed,
    circle_log,
    driver,
    on_topic,
    renamed,
    with_fingers,
    with_values,
)
from tunenet_logs.analysis.payload.arm_log import even_clock, read_arm_log
from tunenet_logs.analysis.payload.torque_model import arm_motion
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.arm.description import Payload
from tunenet_logs.recorders.simulators.arm.path import circle, circle_at
from tunenet_logs.recorders.simulators.arm.payload import FieldClock, driver_episode

NUMBERED = tuple(f"joint{number}" for number in range(1, 8))


@pytest.fixture(scope="module")
def episode():
    return circle_log(Payload(0.5))


def test_degrees_and_turns_become_the_same_angles(episode):
    plain = read_arm_log(episode, ARM)
    cut = changed(episode, position=with_values(lambda q: np.degrees(q) % 360))
    found = read_arm_log(cut, ARM)
    assert "degrees" in found.warnings[0]
    assert np.all(np.abs(np.diff(found.position.values, axis=0)) < 0.1)
    turns = (found.position.values - plain.position.values) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)


def test_radians_are_left_as_they_are(episode):
    found = read_arm_log(episode, ARM)
    assert found.warnings == ()
    np.testing.assert_array_equal(
        found.position.values, episode.signals["/joint_states.position"].values
    )


def test_speeds_that_no_arm_has_are_no_sign_of_degrees(episode):
    """Stamps that are a hundred times too close, or a second publisher that always says zero."""
    fast = changed(
        episode,
        **dict.fromkeys(
            ("position", "velocity", "effort"),
            lambda one: replace(
                one, stamps_ns=one.stamps_ns[0] + (one.stamps_ns - one.stamps_ns[0]) // 100
            ),
        ),
    )
    mixed = changed(
        episode, position=with_values(lambda q: np.where(np.arange(len(q))[:, None] % 2, q, 0.0))
    )
    for odd in (fast, mixed):
        found = read_arm_log(odd, ARM)
        assert not any("converted" in warning for warning in found.warnings)
        assert any("bad stamps, two publishers" in warning for warning in found.warnings)


def test_a_wrist_whose_turns_are_counted_is_no_sign_of_degrees(episode):
    turned = changed(episode, position=with_values(lambda q: q + 6 * np.pi * (np.arange(7) == 6)))
    plain, found = read_arm_log(episode, ARM), read_arm_log(turned, ARM)
    turns = (found.position.values - plain.position.values) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    assert any("taken as rad" in warning for warning in found.warnings)


def test_of_a_long_log_the_part_that_moves_is_used_and_that_is_said(episode):
    seconds = np.arange(0, 2400, 0.5)
    moves = ((seconds >= 1300) * np.sin(seconds))[:, None] * np.linspace(0.3, 0.9, 7)
    long = changed(
        episode,
        **dict.fromkeys(
            ("position", "velocity", "effort"),
            lambda one: replace(
                one,
                stamps_ns=(1e9 * seconds).astype(np.int64),
                values=moves + 1e-6 * seconds[:, None],
            ),
        ),
    )
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
    mixed = changed(episode, position=with_fingers, velocity=with_fingers, effort=with_fingers)
    plain, found = read_arm_log(episode, ARM), read_arm_log(mixed, ARM)
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


def test_samples_without_an_even_clock_are_said_to_be_late():
    rng = np.random.default_rng(5)
    seconds = np.cumsum(rng.uniform(0.02, 0.06, 100))
    assert even_clock(seconds - 0.01, seconds) is None


def test_a_part_of_the_log(episode):
    log = read_arm_log(episode, ARM, start_s=1.0, end_s=3.0)
    assert log.effort.seconds[0] >= 1.0
    assert log.effort.seconds[-1] <= 3.0
    with pytest.raises(NotFoundError, match="--start 99 is past the end"):
        read_arm_log(episode, ARM, start_s=99)


def test_incomplete_rows_are_left_out(episode):
    def holes(values):
        values[10:20, 3] = np.nan
        return values

    log = read_arm_log(changed(episode, effort=with_values(holes)), ARM)
    whole = read_arm_log(episode, ARM)
    assert len(log.effort.seconds) == len(whole.effort.seconds) - 10


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"effort": with_values(np.zeros_like)}, "every torque is 0"),
        ({"effort": with_values(lambda one: 0 * one + 1.5)}, "no torque ever changes"),
        ({"effort": with_values(lambda one: one + np.nan)}, "no torque is a number"),
        ({"effort": lambda one: renamed(one, tuple("abcdefg"))}, "there: a, b, c"),
        ({"position": lambda one: renamed(one, tuple("abcdefg"))}, "there: a, b, c"),
    ],
)
def test_what_cannot_be_used_is_refused_with_its_reason(episode, change, reason):
    with pytest.raises(NotFoundError, match=reason):
        read_arm_log(changed(episode, **change), ARM)


def test_a_log_without_torques_is_refused(episode):
    signals = {name: one for name, one in episode.signals.items() if "effort" not in name}
    with pytest.raises(NotFoundError, match="no joint torques in this log"):
        read_arm_log(replace(episode, signals=signals), ARM)


def test_a_joint_whose_torque_is_never_a_number_is_left_out(episode):
    def deaf(values):
        values[:, 6] = np.nan
        return values

    log = read_arm_log(changed(episode, effort=with_values(deaf)), ARM)
    assert list(log.constant) == [False] * 6 + [True]
    assert len(log.effort.seconds) == len(read_arm_log(episode, ARM).effort.seconds)


def test_velocities_without_a_number_are_done_without(episode):
    log = read_arm_log(changed(episode, velocity=with_values(lambda one: one + np.nan)), ARM)
    assert log.velocity is None


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


def _flickers(values):
    values[:] = values[0]
    values[150, 2] += 1e-4
    return values


def _steps(off_rad):
    def step(values):
        values[:] = values[0]
        values[150:] += off_rad
        return values

    return step


@pytest.mark.parametrize("change", [_flickers, _steps(1e-3), _steps(0.3)])
def test_positions_of_an_arm_at_rest_that_hardly_change_are_a_motion(episode, change):
    motion = arm_motion(read_arm_log(changed(episode, position=with_values(change)), ARM))
    position, _, _ = motion.at(motion.seconds)
    start = episode.signals["/joint_states.position"].values[0]
    assert np.abs(position - start).max() < 0.4


def test_an_arm_that_rests_still_has_positions():
    def rests(values):
        values[100:200] = values[100]
        values[200:] -= values[200] - values[100]
        return values

    log = read_arm_log(changed(circle_log(Payload(0.5)), position=with_values(rests)), ARM)
    assert float(np.diff(log.position.seconds).max()) < 0.2


@pytest.mark.parametrize("fields", [("position", "effort"), ("position",)])
def test_a_driver_that_was_stuck_leaves_a_hole(fields):
    def stuck(values):
        values[100:160] = values[100]
        return values

    stuck_log = changed(circle_log(Payload(0.5)), **dict.fromkeys(fields, with_values(stuck)))
    log = read_arm_log(stuck_log, ARM)
    assert float(np.diff(log.position.seconds).max()) > 0.9
    motion = arm_motion(log)
    inside = (motion.seconds > 100 / 60 + 0.1) & (motion.seconds < 160 / 60 - 0.1)
    assert not inside.any()
    assert len(motion.seconds) > 200


@pytest.mark.parametrize(
    ("rate_hz", "noise_rad", "most"), [(60.0, 0.0, 1e-4), (60.0, 2e-4, 0.03), (10.0, 0.0, 0.003)]
)
def test_derivatives_are_those_of_the_path(rate_hz, noise_rad, most):
    noisy = replace(CLEAN, rate_hz=rate_hz, position_noise_rad=noise_rad)
    motion = arm_motion(read_arm_log(circle_log(Payload(0.5), noisy), ARM))
    path = circle_at(motion.seconds + _first_s(noisy))
    _, _, acceleration = motion.at(motion.seconds)
    assert np.abs(acceleration - path.acceleration_rad_s2).max() < most


def test_a_log_of_a_minute_is_as_smooth_as_a_short_one():
    noisy = replace(CLEAN, position_noise_rad=2e-4)
    episode = driver_episode(ARM, circle(FULL_HZ, 60.0), Payload(0.5), noisy)
    motion = arm_motion(read_arm_log(episode, ARM))
    path = circle_at(motion.seconds + _first_s(noisy))
    _, _, acceleration = motion.at(motion.seconds)
    assert np.abs(acceleration - path.acceleration_rad_s2).max() < 0.03


def _first_s(disturbances) -> float:
    return circle_log(None, disturbances).signals["/joint_states.position"].stamps_ns[0] * 1e-9


def test_single_samples_elsewhere_are_left_out(episode):
    def glitches(values):
        values[50, 2] += 1.0
        values[120] -= 0.2
        return values

    plain = arm_motion(read_arm_log(episode, ARM))
    motion = arm_motion(read_arm_log(changed(episode, position=with_values(glitches)), ARM))
    for found, expected in zip(motion.at(motion.seconds), plain.at(plain.seconds), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-3)


def test_stale_positions_do_not_shake_the_arm():
    stale = replace(CLEAN, rate_hz=65.0, clock=FieldClock(30.0, 16.0, 58.0))
    motion = arm_motion(read_arm_log(circle_log(Payload(0.5), stale), ARM))
    truth = circle_at(motion.seconds + _first_s(stale))
    _, _, acceleration = motion.at(motion.seconds)
    assert np.abs(acceleration - truth.acceleration_rad_s2).max() < 0.05
