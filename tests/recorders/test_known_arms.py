"""Arms by name: masses are the published ones, three libraries agree, names are found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Command, real
from tests.recorders.test_arm_description import by_pinocchio
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.arm.description import (
    JACO_TOOL_LINK,
    JACO_URDF,
    Payload,
    read_arm,
)
from tunenet_logs.recorders.simulators.arm.known import (
    ARMS,
    DEFAULT,
    FOLDER,
    arms_called,
    known_arm,
)
from tunenet_logs.recorders.simulators.arm.path import random_path
from tunenet_logs.recorders.simulators.arm.payload import joint_efforts_nm

# Of the gripper by its maker's manual, and by the paper's first author.
_ROBOTIQ_KG, _PAPERS_ROBOTIQ_KG = 0.905, 0.827563

PUBLISHED_KG = {
    # kinova_inertial.xacro of kinova-ros: arm, half arms, forearm, wrists, hand, 6 finger parts
    "jaco7": 0.7477 + 2 * 0.8447 + 0.6763 + 2 * 0.463 + 0.99 + 6 * 0.01,
    "jaco7-robotiq85": 0.7477 + 2 * 0.8447 + 0.6763 + 3 * 0.463 + _PAPERS_ROBOTIQ_KG,
    "jaco6": 0.7477 + 0.99 + 0.6763 + 2 * 0.463 + 0.99 + 6 * 0.01,
    "jaco6-robotiq85": 0.7477 + 0.99 + 0.6763 + 3 * 0.463 + _PAPERS_ROBOTIQ_KG,
    "jaco6-bent": 0.7477 + 0.99 + 0.6763 + 2 * 0.426367 + 0.99 + 6 * 0.01,
    # Universal Robots' article on parameters for kinematics and dynamics
    "ur5e": 3.761 + 8.058 + 2.846 + 1.37 + 1.3 + 0.365,
    "ur10e": 7.369 + 13.051 + 3.989 + 2.1 + 1.98 + 0.615,
    # Gaz et al., 2019, table of the link masses; the hand and two fingers by Franka
    "panda-bare": 4.970684 + 0.646926 + 3.228604 + 3.587895 + 1.225946 + 1.666555 + 0.735522,
    "panda": 16.062132 + 0.73 + 2 * 0.015,
    "fr3": 16.062132 + 0.73 + 2 * 0.015,
    # kuka_lwr.urdf.xacro of kuka-lwr: five links, wrist, tip
    "lwr": 5 * 2.35 + 1.1 + 0.25,
    # gen3_macro.xacro of ros_kortex: shoulder, half arms, forearm, wrists, bracelet
    "gen3": 1.3773 + 2 * 1.1636 + 0.9302 + 2 * 0.6781 + 0.5,
    "gen3-robotiq85": 6.4909 + _ROBOTIQ_KG,
    # xarm7_type7_HT_BR2.yaml of xarm_ros; the gripper's nine parts of xarm_ros2
    "xarm7": 2.382 + 1.869 + 1.6383 + 1.7269 + 1.3203 + 1.325 + 0.17,
    "xarm7-gripper": 10.4315 + 0.54156 + 2 * (0.033618 + 0.048304) + 2 * 0.023013,
}


@pytest.mark.usefixtures("each_engine")
@pytest.mark.parametrize("name", ARMS)
def test_an_engine_and_another_library_agree(name: str):
    arm, held = known_arm(name).arm(), Payload(0.7, (0.02, -0.01, 0.05))
    path = random_path(arm, 4, rate_hz=10, seconds=3)
    efforts = joint_efforts_nm(arm, path, held)
    assert np.abs(efforts - by_pinocchio(arm.urdf(held), path)).max() < 1e-9
    assert np.sqrt(np.mean(efforts**2)) > 1


@pytest.mark.parametrize("name", ARMS)
def test_links_weigh_what_was_published(name: str):
    known = known_arm(name)
    arm = known.arm()
    assert sum(joint.link.mass_kg for joint in arm.joints) == pytest.approx(PUBLISHED_KG[name])
    assert arm.remarks == ()
    for joint in arm.joints:
        moments, _ = joint.link.principal()
        assert moments[0] > 0, joint.name
        assert joint.max_effort_nm < 400
        assert 0.5 < joint.max_velocity_rad_s < 4
    assert {len(names) for names in known.joint_names} == {len(arm.joints)}
    assert arm.joint_names in known.joint_names


def test_every_description_has_a_name_and_a_source():
    sources = "".join(path.read_text() for path in FOLDER.glob("*.md"))
    assert {path.stem for path in FOLDER.glob("*.urdf")} == set(ARMS)
    assert all(f"`{name}`" in sources for name in ARMS)
    default = known_arm(DEFAULT)
    assert (default.urdf, default.tool_link) == (JACO_URDF, JACO_TOOL_LINK)


def test_a_name_that_is_none_is_one_line_with_the_nearest():
    with pytest.raises(UsageError, match="--arm pandda: no such arm; did you mean panda or panda-"):
        known_arm("pandda")
    with pytest.raises(UsageError, match="did you mean ur5e or ur10e"):
        known_arm("ur5")
    with pytest.raises(UsageError, match=r"known are jaco7-robotiq85, jaco7, jaco6.*--urdf FILE"):
        known_arm("scara")
    assert known_arm("UR5e").name == "ur5e"


@pytest.mark.parametrize(
    ("columns", "names"),
    [
        (tuple(f"j2s7s300_joint_{k}" for k in range(1, 8)), ["jaco7-robotiq85", "jaco7"]),
        (tuple(f"left_j2n6s300_joint_{k}" for k in range(1, 7)), ["jaco6-bent"]),
        (tuple(f"arm/panda_joint{k}" for k in range(7, 0, -1)), ["panda", "panda-bare"]),
        (tuple(f"fr3_joint{k}" for k in range(1, 8)), ["fr3"]),
        (tuple(f"lwr_arm_{k}_joint" for k in range(7)), ["lwr"]),
        (tuple(f"joint{k}" for k in range(1, 8)), ["xarm7", "xarm7-gripper"]),
        (tuple(f"joint_{k}" for k in range(1, 8)), ["gen3", "gen3-robotiq85"]),
        (tuple(f"panda_joint{k}" for k in range(1, 7)), []),
        (tuple(f"spanda_joint{k}" for k in range(1, 8)), ["xarm7", "xarm7-gripper"]),
    ],
)
def test_joints_names_say_whose_they_are(columns: tuple[str, ...], names: list[str]):
    assert [known.name for known in arms_called((*columns, "finger_joint"))] == names


def test_joints_are_called_as_the_log_calls_them():
    lwr = known_arm("lwr")
    columns = tuple(f"lwr_{axis}_joint" for axis in ("a1", "a2", "e1", "a3", "a4", "a5", "a6"))
    assert lwr.arm(columns[::-1]).joint_names == columns
    assert lwr.arm().joint_names == tuple(f"lwr_arm_{number}_joint" for number in range(7))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--arm", "ur5e", "--path", "circle"], "--path circle is of a Jaco with 7 joints"),
        (["--arm", "ur7e"], "did you mean ur5e"),
        (["--arm", "ur5e", "--urdf", "a.urdf"], "--arm ur5e does not go with --urdf"),
    ],
)
def test_the_recorder_takes_names(command: Command, tmp_path: Path, words: list[str], message: str):
    result = command("tunenet-record", "--simulate", "payload", *words, "-o", tmp_path / "a.mcap")
    assert result.returncode == 2
    assert message in result.stderr


def test_an_arm_whose_base_is_no_body_is_read():
    """A published one; a link that it moves has a moment below 0, too."""
    arm = read_arm(real("ros1/jaco2_6dof_bsd3.urdf"), "jaco_link_hand")
    assert len(arm.joints) == 6
    (remark,) = arm.remarks
    assert "jaco_link_2" in remark
    path = random_path(arm, 1, rate_hz=10, seconds=2)
    assert np.abs(joint_efforts_nm(arm, path) - by_pinocchio(arm.urdf(), path)).max() < 1e-9
