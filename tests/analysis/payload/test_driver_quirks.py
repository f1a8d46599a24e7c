"""Joints are found by name, by ending and by number, and what is missing is named."""

import pytest

from tunenet_logs.analysis.payload.arm_log import match_joints
from tunenet_logs.errors import NotFoundError

JACO = tuple(f"j2s7s300_joint_{number}" for number in range(1, 8))
UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")


@pytest.mark.parametrize(
    "columns",
    [
        JACO,
        tuple(f"joint{number}" for number in range(1, 8)),
        tuple(f"left/j2s7s300_joint_{number}" for number in range(1, 8)),
        tuple(f"panda_joint{number}" for number in range(1, 8)),
        tuple(f"A{number}" for number in range(1, 8)),
    ],
)
def test_in_any_order_among_others(columns):
    fingers = ("j2s7s300_joint_finger_1", "j2s7s300_joint_finger_2", "gripper_joint_7")
    shuffled = (fingers[0], *columns[::-1], *fingers[1:])
    assert match_joints(JACO, shuffled) == tuple(7 - at for at in range(7))


def test_names_without_numbers_are_matched_by_their_ending():
    columns = ("left_elbow_joint", "left_shoulder_pan_joint", "left_shoulder_lift_joint")
    assert match_joints(UR, columns) == (1, 2, 0)


@pytest.mark.parametrize("first", [0, 1])
def test_columns_that_are_only_numbered_are_the_joints_from_base_to_tool(first):
    columns = ("gripper", *(f"joint{first + at}" for at in (1, 0, 2)))
    assert match_joints(UR, columns) == (2, 1, 3)
    with pytest.raises(NotFoundError, match="--arm NAME"):
        match_joints(UR, (*columns, f"joint{first + 3}"))


def test_a_missing_joint_is_named_with_what_is_there():
    with pytest.raises(NotFoundError, match=r"j2s7s300_joint_7 \(there: j2s7s300_joint_1, "):
        match_joints(JACO, JACO[:-1])


def test_two_arms_are_not_guessed_at():
    columns = tuple(
        f"{side}_joint_{number}" for side in ("left", "right") for number in range(1, 8)
    )
    with pytest.raises(NotFoundError, match="left_joint_1 and right_joint_1"):
        match_joints(JACO, columns)
