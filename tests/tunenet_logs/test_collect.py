"""Of several publishers on one topic: what is apart stays apart, what is one becomes one."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.formats.base import BeyondLimitError
from tunenet_logs.formats.message_types import JointSample
from tunenet_logs.signals import JointRows, PositionRows

NS = 10_000_000


def test_joints_of_two_publishers_with_the_same_stamps_are_one_sample():
    rows = JointRows("/joint_states")
    for index in range(20):
        arm = JointSample(5 + index * NS, ("a", "b"), [index, -index], [], [1.0, 2.0])
        rows.add(index, arm)
        rows.add(index, JointSample(5 + index * NS, ("gripper",), [0.5 * index]))
    (position, effort), notes = rows.signals()
    assert position.columns == effort.columns == ("a", "b", "gripper")
    assert np.array_equal(position.values, [[one, -one, 0.5 * one] for one in range(20)])
    assert np.isnan(effort.values[:, 2]).all()
    assert not notes


def test_joints_of_two_publishers_at_other_times_are_samples_of_their_own():
    rows = JointRows("/joint_states")
    for index in range(20):
        rows.add(0, JointSample(5 + 2 * index * NS, ("a",), [index]))
        rows.add(0, JointSample(5 + (2 * index + 1) * NS, ("b",), [index]))
    (position,), _ = rows.signals()
    assert np.array_equal(
        np.isnan(position.values), np.tile([[False, True], [True, False]], (20, 1))
    )


def test_of_two_values_at_one_time_the_first_is_kept_and_that_is_said():
    rows = JointRows("/joint_states")
    for index in range(20):
        rows.add(0, JointSample(5 + index * NS, ("a",), [index]))
    rows.add(0, JointSample(5, ("a",), [99.0]))
    (position,), notes = rows.signals()
    assert position.values[0, 0] == 0
    assert any("already seen" in note for note in notes)


def test_a_body_in_two_frames_is_two_signals():
    rows = PositionRows("/tf")
    for index in range(20):
        rows.add(0, [(5 + index * NS, "ball", "world", 0, 0, index)])
        rows.add(0, [(5 + index * NS, "ball", "camera", 7, 7, index)])
    signals, notes = rows.signals()
    assert [one.name for one in signals] == ["/tf.ball", "/tf.ball@camera"]
    assert all(len(one.stamps_ns) == 20 for one in signals)
    assert any("several frames" in note for note in notes)


def test_more_names_than_any_robot_has_are_refused_and_are_no_damage():
    rows = PositionRows("/tf")
    with pytest.raises(BeyondLimitError):
        rows.add(0, [(1, f"frame{index}", "world", 0, 0, 0) for index in range(2000)])


@pytest.mark.parametrize(
    ("in_message", "given", "expected"),
    [
        ((), ("a", "b"), ("a", "b")),
        ((), ("a", "b", "c"), ("joint1", "joint2")),
        ((), ("a", "a"), ("joint1", "joint2")),
        ((), (), ("joint1", "joint2")),
        (("x", "y"), ("a", "b"), ("x", "y")),
    ],
)
def test_given_names_are_for_joints_without_names_and_as_many(
    in_message: tuple[str, ...], given: tuple[str, ...], expected: tuple[str, ...]
):
    rows = JointRows("/joint_states")
    rows.add(5, JointSample(5, in_message, effort=[1.0, 2.0]))
    (signal,), _ = rows.signals(given)
    assert signal.columns == expected


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_what_is_no_number_is_missing(value: float):
    """Infinite too: no ball is there, and no joint."""
    positions, joints = PositionRows("/ball"), JointRows("/joint_states")
    for index in range(20):
        height = value if index == 7 else 1.0
        positions.add(0, [(5 + index * NS, "", "world", 0, 0, height)])
        joints.add(0, JointSample(5 + index * NS, ("a", "b"), [height, 2.0]))
    for rows, column in ((positions, 2), (joints, 0)):
        (signal,), _ = rows.signals()
        gone = np.zeros(signal.values.shape, dtype=bool)
        gone[7, column] = True
        assert np.array_equal(np.isnan(signal.values), gone)
        assert np.isfinite(signal.values[~gone]).all()
