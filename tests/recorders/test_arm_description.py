"""A URDF, or a name, becomes an arm that two libraries understand alike, whatever hangs on it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]  (where no type checker looks)
import pytest

from tests.conftest import real
from tests.engines import needs_pybullet
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.arm.description import (
    JACO_TOOL_LINK,
    JACO_URDF,
    Arm,
    Payload,
    jaco,
    read_arm,
)
from tunenet_logs.recorders.simulators.arm.known import (
    ARMS,
    DEFAULT,
    FOLDER,
    arms_called,
    known_arm,
)
from tunenet_logs.recorders.simulators.arm.path import JointPath, circle, random_path
from tunenet_logs.recorders.simulators.arm.payload import joint_efforts_nm
from tunenet_logs.recorders.simulators.base import UPRIGHT_GRAVITY_M_S2


def by_pinocchio(urdf: str | Path, path: JointPath) -> np.ndarray:
    """Torques of the path's joints by another library, its other joints at 0; shape (T, J)."""
    if isinstance(urdf, Path):
        model = pinocchio.buildModelFromUrdf(str(urdf))
    else:
        model = pinocchio.buildModelFromXML(urdf)
    model.gravity.linear = np.array(UPRIGHT_GRAVITY_M_S2)
    data, joints = model.createData(), path.position_rad.shape[1]
    rows = []
    for row in range(len(path.seconds)):
        position: list[float] = []  # a continuous joint has two coordinates there
        for index in range(model.nv):
            angle = path.position_rad[row, index] if index < joints else 0.0
            is_free = model.joints[index + 1].nq == 2
            position += [np.cos(angle), np.sin(angle)] if is_free else [angle]
        rates = [
            np.concatenate([part[row], np.zeros(model.nv - joints)])
            for part in (path.velocity_rad_s, path.acceleration_rad_s2)
        ]
        rows.append(pinocchio.rnea(model, data, np.array(position), *rates)[:joints].copy())
    return np.array(rows)


def off_nm(arm: Arm, path: JointPath, held: Payload | None = None) -> float:
    """How far two libraries are apart on an arm, at most."""
    wanted = by_pinocchio(arm.urdf(held), path)
    return float(np.abs(joint_efforts_nm(arm, path, held) - wanted).max())


def link(name: str, mass: float | None = 1.0, xyz: str = "0 0 0.1", moments: str = "") -> str:
    if mass is None:
        return f'<link name="{name}"/>'
    moments = moments or 'ixx="0.02" ixy="0.003" ixz="-0.002" iyy="0.03" iyz="0.004" izz="0.015"'
    return (
        f'<link name="{name}"><inertial><origin xyz="{xyz}" rpy="0.3 -0.2 0.5"/>'
        f'<mass value="{mass}"/><inertia {moments}/></inertial></link>'
    )


def joint(name: str, parent: str, child: str, kind: str = "revolute", more: str = "") -> str:
    limit = '<limit lower="-2" upper="2" effort="50" velocity="1"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 0.05 0.3" rpy="0.4 0.7 -0.2"/><axis xyz="0 1 2"/>{limit}{more}</joint>'
    )


GRASPING = (
    link("base", None) + link("upper", 3.0) + link("cover", 0.4, "0.05 0 0") + link("slide", 2.0)
    + link("hand", 1.5, "0.01 0.02 0.03") + link("finger", 0.2) + link("tip", 0.1)
    + link("tool", None) + joint("turn", "base", "upper") + joint("glue", "upper", "cover", "fixed")
    + joint("reach", "upper", "slide", "prismatic") + joint("roll", "slide", "hand", "continuous")
    + joint("pinch", "hand", "finger")
    + joint("bend", "finger", "tip", more='<mimic joint="pinch"/>')
    + joint("hold", "hand", "tool", "fixed")
)  # fmt: skip
STILL = JointPath(np.arange(3.0), np.full((3, 3), 0.4), *np.zeros((2, 3, 3)))


def arm_of(folder: Path, body: str, tool: str = "tool") -> Arm:
    file = folder / "arm.urdf"
    file.write_text(f'<robot name="grasper">{body}</robot>')
    return read_arm(file, tool)


# ---- The Jaco, and arms that others described


def test_the_jaco_is_the_published_one():
    arm = jaco()
    assert arm.joint_names == tuple(f"j2s7s300_joint_{number}" for number in range(1, 8))
    masses = [one.link.mass_kg for one in arm.joints]
    assert masses[:6] == [0.7477, 0.8447, 0.8447, 0.6763, 0.463, 0.463]
    assert masses[6] == pytest.approx(0.463 + 0.827563)
    assert arm.joints[1].limits_rad == pytest.approx(np.radians([47, 313]))
    assert arm.joints[0].limits_rad == (-np.inf, np.inf)
    assert arm.joints[0].max_velocity_rad_s == pytest.approx(np.radians(36))
    # lumping what is fixed changes nothing: another library reads the shipped file itself
    path = circle(30)
    assert np.abs(by_pinocchio(JACO_URDF, path) - joint_efforts_nm(arm, path)).max() < 1e-9


@needs_pybullet
@pytest.mark.parametrize(
    ("name", "tool", "tolerance"),
    [
        ("kuka_iiwa/model.urdf", "lbr_iiwa_link_7", 1e-9),
        ("franka_panda/panda.urdf", "panda_hand", 1e-9),
        ("franka_panda/panda.urdf", "panda_grasptarget", 1e-9),
        ("xarm/xarm6_robot.urdf", "link6", 1e-3),  # two of its inertias are no body's
        ("xarm/xarm6_with_gripper.urdf", "xarm_gripper_base_link", 1e-3),
    ],
)
def test_arms_that_others_described(name: str, tool: str, tolerance: float):
    """Another library reads the same file, with its fingers still at 0."""
    import pybullet_data  # pyright: ignore[reportMissingImports]  (it comes with PyBullet)

    file = Path(pybullet_data.getDataPath()) / name
    arm = read_arm(file, tool)
    path = random_path(arm, 3, rate_hz=10)
    names = list(pinocchio.buildModelFromUrdf(str(file)).names)
    assert names[1 : len(arm.joints) + 1] == list(arm.joint_names)
    assert np.abs(by_pinocchio(file, path) - joint_efforts_nm(arm, path)).max() < tolerance


def test_an_arm_whose_base_is_no_body_is_read():
    """A published one; a link that it moves has a moment below 0, too."""
    arm = read_arm(real("ros1/jaco2_6dof_bsd3.urdf"), "jaco_link_hand")
    assert len(arm.joints) == 6
    (remark,) = arm.remarks
    assert "jaco_link_2" in remark
    assert off_nm(arm, random_path(arm, 1, rate_hz=10, seconds=2)) < 1e-9


# ---- Any serial arm with fingers, covers and a slide


def test_any_serial_arm_with_fingers_covers_and_a_slide(tmp_path: Path):
    arm = arm_of(tmp_path, GRASPING)
    assert arm.joint_names == ("turn", "reach", "roll")
    assert [one.is_prismatic for one in arm.joints] == [False, True, False]
    assert [one.link.mass_kg for one in arm.joints] == pytest.approx([3.4, 2.0, 1.8])
    path = JointPath(np.arange(40.0), *np.random.default_rng(0).uniform(-1.5, 1.5, (3, 40, 3)))
    wanted = by_pinocchio(tmp_path / "arm.urdf", path)
    assert np.abs(joint_efforts_nm(arm, path) - wanted).max() < 1e-9
    assert off_nm(arm, path, Payload(0.7, (0.02, 0.0, 0.05))) < 1e-9
    # the tool link says where the arm ends
    assert arm_of(tmp_path, GRASPING, "slide").joint_names == ("turn", "reach")
    assert arm_of(tmp_path, GRASPING, "finger").joint_names == ("turn", "reach", "roll", "pinch")


def test_an_inertia_that_is_no_bodys_is_taken_as_the_nearest(tmp_path: Path):
    """Else PyBullet would take it for none."""
    moments = 'ixx="0.1" iyy="0.1" izz="0.21"'
    body = link("base") + link("arm", 1.0, moments=moments) + joint("turn", "base", "arm")
    path = JointPath(np.arange(5.0), np.zeros((5, 1)), np.zeros((5, 1)), np.ones((5, 1)))
    assert off_nm(arm_of(tmp_path, body, "arm"), path) < 1e-9


def test_a_moment_below_0_is_raised_and_said(tmp_path: Path):
    """Identified parameters have such; gravity's torques are the same."""
    moments = 'ixx="-0.1" iyy="0.2" izz="0.15"'
    body = GRASPING.replace(link("upper", 3.0), link("upper", 3.0, moments=moments))
    arm, sound = arm_of(tmp_path, body), arm_of(tmp_path, GRASPING)
    (remark,) = arm.remarks
    assert "link upper" in remark
    assert "-0.1 kg m²" in remark
    assert joint_efforts_nm(arm, STILL) == pytest.approx(joint_efforts_nm(sound, STILL), abs=1e-9)
    assert off_nm(arm, STILL) < 1e-9


@pytest.mark.parametrize("inertial", ['<mass value="-1"/>', '<inertia ixx="-1"/>', ""])
def test_what_a_base_weighs_is_never_asked(tmp_path: Path, inertial: str):
    base = f'<link name="base"><inertial>{inertial}</inertial></link>'
    arm = arm_of(tmp_path, GRASPING.replace(link("base", None), base))
    assert arm == arm_of(tmp_path, GRASPING)


def test_a_hand_that_is_not_mounted_is_not_of_the_arm(tmp_path: Path):
    hand = link("palm", 5.0) + link("thumb") + joint("close", "palm", "thumb", "fixed")
    assert arm_of(tmp_path, GRASPING + hand) == arm_of(tmp_path, GRASPING)
    for tool in ("palm", "thumb"):
        with pytest.raises(UsageError, match=f"link palm, so {tool} is on no arm; add a fixed"):
            arm_of(tmp_path, GRASPING + hand, tool)


USES_IT = """
import sys, numpy as np
from pathlib import Path
from tunenet_logs.recorders.simulators.arm.description import Payload, read_arm
from tunenet_logs.recorders.simulators.arm.payload import joint_efforts_nm
from tunenet_logs.recorders.simulators.arm.path import JointPath
path = JointPath(np.arange(3.0), *np.zeros((3, 3, 3)))
for name in sys.argv[1:]:
    assert joint_efforts_nm(read_arm(Path(name), 'tool'), path, Payload(0.5)).shape == (3, 3)
"""


def test_names_stay_text_and_those_that_the_engine_has_already_do_not_end_it(tmp_path: Path):
    """In a process of its own: the engine ends it where two names are the same."""
    arm = arm_of(tmp_path, GRASPING.replace('name="turn"', 'name="a&quot;&lt;b&gt;"'))
    assert off_nm(arm, STILL) < 1e-9
    assert arm.joint_names[0] == 'a"<b>'
    files = []
    for name in ("payload_mount", "payload", "base", "link_2", "joint_2"):
        files.append(tmp_path / f"{name}.urdf")
        body = GRASPING.replace('name="turn"', f'name="{name}"')
        files[-1].write_text(f'<robot name="grasper">{body}</robot>')
    result = subprocess.run([sys.executable, "-c", USES_IT, *files], capture_output=True, text=True)
    assert result.returncode == 0, (result.returncode, result.stderr)


# ---- Bad files, and bad payloads


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<robot", "<!DOCTYPE robot><robot", ["document type"]),
        ("</robot>", "", ["not XML"]),
        ('value="3.0"', 'value="${mass}"', ["xacro arm.urdf > arm_expanded.urdf"]),
        ('value="3.0"', 'value="-3.0"', ["link upper", "-3 kg"]),
        ('value="3.0"', 'value="nan"', ["link upper", "mass value", "nan", "finite"]),
        ('value="3.0"', 'value="heavy"', ["link upper", "heavy"]),
        ('value="3.0"', 'value="3e9"', ["link upper", "3e9", "kg"]),
        ('<mass value="3.0"/>', "", ["link upper", "mass"]),
        ('xyz="0.1 0.05 0.3"', 'xyz="0.1 0.05"', ["joint turn", "3 finite numbers"]),
        ('xyz="0.1 0.05 0.3"', 'xyz="0.1 0.05 1e9"', ["joint turn", "1e9"]),
        ('xyz="0 1 2"', 'xyz="0 0 0"', ["joint turn", "axis"]),
        ('lower="-2"', 'lower="3"', ["joint turn", "limit"]),
        ('type="revolute"', 'type="ball"', ["joint turn", "ball", "revolute"]),
        ('type="revolute"', 'type="floating"', ["joint turn", "floating"]),
        ('child link="upper"', 'child link="nothing"', ["joint turn", "nothing"]),
        ('name="cover"', 'name="slide"', ["link slide", "twice"]),
        ('name="glue"', 'name="turn"', ["joint turn", "twice"]),
        ('name="glue"', 'name=""', ["<joint>", "name"]),
        ('child link="cover"', 'child link="slide"', ["joint reach", "glue", "slide"]),
        ('parent link="base"', 'parent link="tool"', ["loop"]),
        ('<mass value="2.0"/>', '<mass value="0"/>', ["joint reach", "no mass", "slide"]),
    ],
)
def test_a_bad_file_is_one_line_with_file_element_and_value(tmp_path: Path, old, new, words):
    file = tmp_path / "arm.urdf"
    text = f'<robot name="grasper">{GRASPING}</robot>'
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(UsageError) as caught:
        read_arm(file, "tool")
    message = str(caught.value)
    for word in (str(file), *words):
        assert word in message
    assert "\n" not in message


def test_what_is_no_text_is_no_description(tmp_path: Path):
    file = tmp_path / "arm.urdf"
    for data, says in (
        (None, "No such file"),
        (b"<sdf/>", r"<sdf>.*<robot>"),
        (b"\xff\xfe<\x00", "UTF-8"),
        (b" " * 4_000_001, "4 MB"),
    ):
        if data is not None:
            file.write_bytes(data)
        with pytest.raises(UsageError, match=says):
            read_arm(file, "tool")


@pytest.mark.parametrize(
    ("tool", "says"),
    [
        ("tip", r"joint bend.*<mimic>.*tip"),
        ("wrist", r"--tool-link.*upper.*hand"),
        ("base", "0 joints move link base"),
    ],
)
def test_a_link_where_no_arm_ends_is_refused(tmp_path: Path, tool: str, says: str):
    with pytest.raises(UsageError, match=says):
        arm_of(tmp_path, GRASPING, tool)


# ---- Arms by name

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
    arm = known_arm(name).arm()
    path = random_path(arm, 4, rate_hz=10, seconds=3)
    for held in (None, Payload(0.0), Payload(0.7, (0.02, -0.01, 0.05))):
        assert off_nm(arm, path, held) < 1e-9
        assert np.sqrt(np.mean(joint_efforts_nm(arm, path, held) ** 2)) > 1


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


def test_an_arm_is_called_as_a_log_or_a_user_calls_it():
    lwr = known_arm("lwr")
    columns = tuple(f"lwr_{axis}_joint" for axis in ("a1", "a2", "e1", "a3", "a4", "a5", "a6"))
    assert lwr.arm(columns[::-1]).joint_names == columns
    assert lwr.arm().joint_names == tuple(f"lwr_arm_{number}_joint" for number in range(7))
    assert known_arm("UR5e").name == "ur5e"
    with pytest.raises(UsageError, match=r"known are jaco7-robotiq85, jaco7, jaco6.*--urdf FILE"):
        known_arm("scara")
