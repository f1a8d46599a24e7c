"""Paths: the paper's circle, random ones, a user's file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]  (where no type checker looks)
import pytest

from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.recorders.simulators.arm.description import Arm, jaco
from tunenet_logs.recorders.simulators.arm.path import (
    CIRCLE_CSV,
    CIRCLE_RAD_S,
    JointPath,
    circle,
    circle_at,
    eased,
    link_poses,
    path_from_file,
    random_path,
    read_path_file,
    write_path_file,
)

ARM = jaco()


def check_derivatives(path: JointPath, tolerance: float) -> None:
    """Velocities and accelerations are those of the positions."""
    step = path.seconds[1] - path.seconds[0]
    for values, derivative in (
        (path.position_rad, path.velocity_rad_s),
        (path.velocity_rad_s, path.acceleration_rad_s2),
    ):
        slopes = (values[2:] - values[:-2]) / (2 * step)
        assert np.abs(slopes - derivative[1:-1]).max() < tolerance


def share_of_speed(path: JointPath, arm: Arm) -> float:
    limits = np.array([joint.max_velocity_rad_s for joint in arm.joints])
    return float((np.abs(path.velocity_rad_s) / limits).max())


def test_the_tool_goes_round_the_papers_circle():
    path = circle(240, 6)
    angle = CIRCLE_RAD_S * path.seconds
    wanted = np.column_stack(
        [np.full(len(angle), -0.4), 0.2 * np.cos(angle), 0.3 + 0.2 * np.sin(angle)]
    )
    assert np.abs(link_poses(ARM, path.position_rad).position_m[:, -1] - wanted).max() < 1e-9
    assert share_of_speed(path, ARM) < 0.71
    check_derivatives(path, 1e-4)
    turn_later = circle_at(path.seconds + 2 * np.pi / CIRCLE_RAD_S)
    assert np.abs(turn_later.position_rad - path.position_rad).max() < 1e-9


def test_frames_are_where_another_library_has_them():
    model = pinocchio.buildModelFromXML(ARM.urdf())
    data = model.createData()
    path = random_path(ARM, 0, rate_hz=5)
    poses = link_poses(ARM, path.position_rad)
    for row, angles in enumerate(path.position_rad):
        pinocchio.forwardKinematics(model, data, angles)
        for index in range(1, 8):
            assert np.abs(data.oMi[index].translation - poses.position_m[row, index]).max() < 1e-9
            assert np.abs(data.oMi[index].rotation - poses.rotation[row, index]).max() < 1e-9


@pytest.mark.parametrize("seed", range(8))
def test_random_motions_are_smooth_and_allowed(seed: int):
    path = random_path(ARM, seed, rate_hz=240).checked(ARM)
    assert 0.3 < share_of_speed(path, ARM) <= 0.7
    check_derivatives(path, 1e-3)
    again = random_path(ARM, seed, rate_hz=240)
    assert np.array_equal(path.position_rad, again.position_rad)
    assert link_poses(ARM, path.position_rad).position_m[:, -1, 2].min() > 0


@pytest.mark.parametrize("lasts_s", [5.0, 0.8])
def test_an_eased_path_goes_the_same_way_from_rest_to_rest(lasts_s: float):
    path = circle(240, lasts_s)
    easy = eased(path, 1.0, rate_hz=1000)
    check_derivatives(easy, 0.01)
    assert np.abs(easy.velocity_rad_s[[0, -1]]).max() == 0
    assert np.abs(easy.acceleration_rad_s2[[0, -1]]).max() < 1e-9
    assert np.abs(easy.position_rad[[0, -1]] - path.position_rad[[0, -1]]).max() < 1e-9
    assert share_of_speed(easy, ARM) <= share_of_speed(path, ARM) + 1e-6
    tool_m = link_poses(ARM, easy.position_rad).position_m[:, -1] - [-0.4, 0.0, 0.3]
    assert np.abs(np.hypot(tool_m[:, 1], tool_m[:, 2]) - 0.2).max() < 1e-6


def test_a_path_comes_back_from_its_file(tmp_path: Path):
    file = tmp_path / "path.csv"
    path = random_path(ARM, 1, rate_hz=100)
    names = ARM.joint_names[::-1]
    write_path_file(file, names, path.seconds + 7, path.position_rad[:, ::-1], overwrite=False)
    back = path_from_file(ARM, file, rate_hz=100)
    assert np.abs(back.position_rad - path.position_rad[: len(back.seconds)]).max() < 1e-6
    assert np.abs(back.acceleration_rad_s2 - path.acceleration_rad_s2[:-1])[5:-5].max() < 1e-3
    with pytest.raises(LogError, match="--overwrite"):
        write_path_file(file, names, path.seconds, path.position_rad, overwrite=False)


def test_the_shipped_circle_is_one_turn_that_can_be_commanded():
    names, seconds, position_rad = read_path_file(CIRCLE_CSV)
    assert names == ARM.joint_names
    assert seconds[-1] == pytest.approx(2 * np.pi / CIRCLE_RAD_S, abs=1e-6)
    assert np.array_equal(position_rad[0], position_rad[-1])


HEADER = "time_s," + ",".join(ARM.joint_names)
ROW = ",0.3,3.4,0.7,1.4,2.3,1.9,0.7"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["0 rows"]),
        ("a,b\n1,2\n", ["time_s"]),
        (f"{HEADER}\n0{ROW}\n0{ROW}\n", ["line 3", "increase"]),
        (f"{HEADER}\n0{ROW}\n1{ROW},4\n", ["line 3", "9 values", "8 columns"]),
        (f"{HEADER}\n0{ROW}\nx{ROW}\n", ["line 3", "time_s", "'x'"]),
        (f"{HEADER}\n0{ROW}\n1{ROW.replace('3.4', 'nan')}\n", ["line 3", "joint_2", "nan"]),
        (f"{HEADER}\n0{ROW}\n1{ROW}\n", ["2 rows", "at least 6"]),
        (f"{HEADER.replace('joint_3', 'joint_2')}\n0{ROW}\n", ["one name"]),
        (f"{HEADER.replace('joint_3', 'joint_9')}\n0{ROW}\n1{ROW}\n", ["joint_3", "joint_9"]),
        (
            f"{HEADER}\n" + "".join(f"{t}{ROW.replace('3.4', '0.1')}\n" for t in range(9)),
            ["joint_2", "limits"],
        ),
        ('a"\n\x00', ["time_s"]),
    ],
)
def test_a_bad_table_is_one_line_with_the_place(tmp_path: Path, text: str, words: list[str]):
    file = tmp_path / "path.csv"
    file.write_text(text)
    with pytest.raises(UsageError) as caught:
        path_from_file(ARM, file)
    for word in (str(file), *words):
        assert word in str(caught.value)


def test_a_path_of_other_joints_or_with_holes_is_none():
    path = circle(10)
    with pytest.raises(UsageError, match="6"):
        JointPath(path.seconds, *(np.zeros((50, 6)),) * 3).checked(ARM)
    with pytest.raises(UsageError, match="finite"):
        JointPath(path.seconds, np.full((50, 7), np.nan), *(np.zeros((50, 7)),) * 2)
    with pytest.raises(UsageError, match="increase"):
        JointPath(path.seconds[::-1], *(np.zeros((50, 7)),) * 3)
