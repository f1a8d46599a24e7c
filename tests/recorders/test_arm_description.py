"""A URDF becomes an arm that two libraries understand alike, whatever hangs on its links."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]  (where no type checker looks)
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.arm.description import (
    JACO_URDF,
    Arm,
    Payload,
    jaco,
    read_arm,
)
from tunenet_logs.recorders.simulators.arm.path import JointPath, circle, random_path
from tunenet_logs.recorders.simulators.arm.payload import joint_efforts_nm
from tunenet_logs.recorders.simulators.base import UPRIGHT_GRAVITY_M_S2

TURN = 1.5707963267948966


def by_pinocchio(urdf: str, path: JointPath) -> np.ndarray:
    """Torques by another library, shape (T, J)."""
    model = pinocchio.buildModelFromXML(urdf)
    model.gravity.linear = np.array(UPRIGHT_GRAVITY_M_S2)
    data = model.createData()
    rows = zip(path.position_rad, path.velocity_rad_s, path.acceleration_rad_s2, strict=True)
    return np.array([pinocchio.rnea(model, data, *row).copy() for row in rows])


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
    link("base", None)
    + link("upper", 3.0)
    + link("cover", 0.4, "0.05 0 0")
    + link("slide", 2.0)
    + link("hand", 1.5, "0.01 0.02 0.03")
    + link("finger", 0.2)
    + link("tip", 0.1)
    + link("tool", None)
    + joint("turn", "base", "upper")
    + joint("glue", "upper", "cover", "fixed")
    + joint("reach", "upper", "slide", "prismatic")
    + joint("roll", "slide", "hand", "continuous")
    + joint("pinch", "hand", "finger")
    + joint("bend", "finger", "tip", more='<mimic joint="pinch"/>')
    + joint("hold", "hand", "tool", "fixed")
)


def arm_of(folder: Path, body: str, tool: str = "tool") -> Arm:
    file = folder / "arm.urdf"
    file.write_text(f'<robot name="grasper">{body}</robot>')
    return read_arm(file, tool)


def test_the_jaco_is_the_published_one():
    arm = jaco()
    assert arm.joint_names == tuple(f"j2s7s300_joint_{number}" for number in range(1, 8))
    masses = [one.link.mass_kg for one in arm.joints]
    assert masses[:6] == [0.7477, 0.8447, 0.8447, 0.6763, 0.463, 0.463]
    assert masses[6] == pytest.approx(0.463 + 0.827563)
    assert arm.joints[1].limits_rad == pytest.approx(np.radians([47, 313]))
    assert arm.joints[0].limits_rad == (-np.inf, np.inf)
    assert arm.joints[0].max_velocity_rad_s == pytest.approx(np.radians(36))


@pytest.mark.parametrize("payload", [None, Payload(0.0), Payload(1.3, (0.03, -0.02, 0.01))])
def test_two_libraries_agree_on_the_jaco(payload: Payload | None):
    arm = jaco()
    for path in (circle(30), random_path(arm, 4, rate_hz=30)):
        efforts = joint_efforts_nm(arm, path, payload)
        assert np.abs(efforts - by_pinocchio(arm.urdf(payload), path)).max() < 1e-9
        assert np.sqrt(np.mean(efforts**2)) > 1


def test_the_shipped_file_is_the_arm_that_is_made_of_it():
    """Lumping what is fixed changes nothing: another library reads the file itself."""
    model = pinocchio.buildModelFromUrdf(str(JACO_URDF))
    model.gravity.linear = np.array(UPRIGHT_GRAVITY_M_S2)
    data = model.createData()
    path = circle(30)
    efforts = joint_efforts_nm(jaco(), path)
    for row in range(len(path.seconds)):
        parts: list[float] = []  # a continuous joint has two coordinates there
        for index, angle in enumerate(path.position_rad[row]):
            is_free = index % 2 == 0
            parts += [np.cos(angle), np.sin(angle)] if is_free else [angle]
        found = pinocchio.rnea(
            model, data, np.array(parts), path.velocity_rad_s[row], path.acceleration_rad_s2[row]
        )
        assert np.abs(found - efforts[row]).max() < 1e-9


def test_any_serial_arm_with_fingers_covers_and_a_slide(tmp_path: Path):
    arm = arm_of(tmp_path, GRASPING)
    assert arm.joint_names == ("turn", "reach", "roll")
    assert [one.is_prismatic for one in arm.joints] == [False, True, False]
    assert [one.link.mass_kg for one in arm.joints] == pytest.approx([3.4, 2.0, 1.8])
    rng = np.random.default_rng(0)
    path = JointPath(np.arange(40.0), *rng.uniform(-1.5, 1.5, (3, 40, 3)))
    efforts = joint_efforts_nm(arm, path, Payload(0.7, (0.02, 0.0, 0.05)))
    model = pinocchio.buildModelFromXML(
        f'<robot name="grasper">{GRASPING}</robot>'.replace('type="continuous"', 'type="revolute"')
    )
    model.gravity.linear = np.array(UPRIGHT_GRAVITY_M_S2)
    data = model.createData()
    empty = joint_efforts_nm(arm, path)
    for row in range(40):
        kinds = [
            np.concatenate([part[row], np.zeros(2)])
            for part in (path.position_rad, path.velocity_rad_s, path.acceleration_rad_s2)
        ]
        assert np.abs(pinocchio.rnea(model, data, *kinds)[:3] - empty[row]).max() < 1e-9
    assert (
        np.abs(efforts - by_pinocchio(arm.urdf(Payload(0.7, (0.02, 0, 0.05))), path)).max() < 1e-9
    )


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
    efforts = joint_efforts_nm(arm, path)
    model = pinocchio.buildModelFromUrdf(str(file))
    model.gravity.linear = np.array(UPRIGHT_GRAVITY_M_S2)
    data = model.createData()
    spare = np.zeros(model.nv - len(arm.joints))
    assert list(model.names)[1 : len(arm.joints) + 1] == list(arm.joint_names)
    for row in range(len(path.seconds)):
        state = [
            np.concatenate([part[row], spare])
            for part in (path.position_rad, path.velocity_rad_s, path.acceleration_rad_s2)
        ]
        found = pinocchio.rnea(model, data, *state)[: len(arm.joints)]
        assert np.abs(found - efforts[row]).max() < tolerance


def test_the_tool_link_says_where_the_arm_ends(tmp_path: Path):
    assert arm_of(tmp_path, GRASPING, "slide").joint_names == ("turn", "reach")
    assert arm_of(tmp_path, GRASPING, "finger").joint_names == ("turn", "reach", "roll", "pinch")


def test_an_inertia_that_is_no_bodys_is_taken_as_the_nearest(tmp_path: Path):
    """Else PyBullet would take it for none."""
    moments = 'ixx="0.1" iyy="0.1" izz="0.21"'
    body = link("base") + link("arm", 1.0, moments=moments) + joint("turn", "base", "arm")
    arm = arm_of(tmp_path, body, "arm")
    path = JointPath(np.arange(5.0), np.zeros((5, 1)), np.zeros((5, 1)), np.ones((5, 1)))
    assert np.abs(joint_efforts_nm(arm, path) - by_pinocchio(arm.urdf(), path)).max() < 1e-9


def test_a_moment_below_0_is_raised_and_said(tmp_path: Path):
    """Identified parameters have such; gravity's torques are the same."""
    moments = 'ixx="-0.1" iyy="0.2" izz="0.15"'
    body = GRASPING.replace(link("upper", 3.0), link("upper", 3.0, moments=moments))
    arm, sound = arm_of(tmp_path, body), arm_of(tmp_path, GRASPING)
    (remark,) = arm.remarks
    assert "link upper" in remark
    assert "-0.1 kg m²" in remark
    still = JointPath(np.arange(3.0), np.full((3, 3), 0.4), *np.zeros((2, 3, 3)))
    assert joint_efforts_nm(arm, still) == pytest.approx(joint_efforts_nm(sound, still), abs=1e-9)
    assert np.abs(joint_efforts_nm(arm, still) - by_pinocchio(arm.urdf(), still)).max() < 1e-9


@pytest.mark.parametrize(
    "inertial", ['<mass value="-1"/>', '<mass value="nan"/>', '<inertia ixx="-1"/>', ""]
)
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
def test_a_bad_file_is_one_line_with_file_element_and_value(
    tmp_path: Path, old: str, new: str, words: list[str]
):
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


def test_other_bad_files(tmp_path: Path):
    file = tmp_path / "arm.urdf"
    with pytest.raises(UsageError, match="No such file"):
        read_arm(file, "tool")
    file.write_text("<sdf/>")
    with pytest.raises(UsageError, match=r"<sdf>.*<robot>"):
        read_arm(file, "tool")
    file.write_bytes(b"\xff\xfe<\x00")
    with pytest.raises(UsageError, match="UTF-8"):
        read_arm(file, "tool")
    file.write_bytes(b" " * 4_000_001)
    with pytest.raises(UsageError, match="4 MB"):
        read_arm(file, "tool")
    file.write_text(f'<robot name="x">{GRASPING}</robot>')
    with pytest.raises(UsageError, match=r"joint bend.*<mimic>.*tip"):
        read_arm(file, "tip")
    with pytest.raises(UsageError, match=r"--tool-link.*upper.*hand"):
        read_arm(file, "wrist")
    with pytest.raises(UsageError, match="0 joints move link base"):
        read_arm(file, "base")


def test_names_stay_text_in_the_description_for_engines(tmp_path: Path):
    body = GRASPING.replace('name="turn"', 'name="a&quot;&lt;b&gt;"')
    arm = arm_of(tmp_path, body)
    path = JointPath(np.arange(3.0), *np.zeros((3, 3, 3)))
    assert np.abs(joint_efforts_nm(arm, path) - by_pinocchio(arm.urdf(), path)).max() < 1e-9
    assert arm.joint_names[0] == 'a"<b>'


@pytest.mark.parametrize("name", ["payload_mount", "payload", "base", "link_2", "joint_2"])
def test_names_that_the_engine_has_already_do_not_end_it(tmp_path: Path, name: str):
    """In a process of its own: the engine ends it where two names are the same."""
    arm_of(tmp_path, GRASPING.replace('name="turn"', f'name="{name}"'))
    code = (
        "import sys, numpy as np; from pathlib import Path\n"
        "from tunenet_logs.recorders.simulators.arm.description import Payload, read_arm\n"
        "from tunenet_logs.recorders.simulators.arm.payload import joint_efforts_nm\n"
        "from tunenet_logs.recorders.simulators.arm.path import JointPath\n"
        "path = JointPath(np.arange(3.0), *np.zeros((3, 3, 3)))\n"
        "arm = read_arm(Path(sys.argv[1]), 'tool')\n"
        "assert joint_efforts_nm(arm, path, Payload(0.5)).shape == (3, 3)\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "arm.urdf"], capture_output=True, text=True
    )
    assert result.returncode == 0, (result.returncode, result.stderr)


@pytest.mark.parametrize("mass", [-0.1, float("nan"), float("inf"), 1e5])
def test_engines_never_see_a_bad_payload(mass: float):
    with pytest.raises(UsageError, match="payload"):
        Payload(mass)
    with pytest.raises(UsageError, match="payload"):
        Payload(1.0, (0.0, mass * 1e3, 0.0))
