"""Tuned numbers in a user's own model: nothing else changes, and it moves alike to the last bit."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from difflib import SequenceMatcher
from pathlib import Path

import cv2
import mujoco as stock
import numpy as np
import pytest

from tunenet_logs.recorders.simulators.model.parameters import model_parameters
from tunenet_logs.recorders.simulators.model.reading import ModelFiles, ModelProcess
from tunenet_logs.recorders.simulators.model.writing import (
    WrittenModel,
    differences,
    rollouts_differ,
    write_model,
)

# A picture of one point, in Latin 1.
PICTURE = cv2.imencode(".png", np.zeros((1, 1, 3), np.uint8))[1].tobytes().decode("latin-1")
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


@dataclass(frozen=True)
class Case:
    """A model, and what is tuned of it."""

    name: str
    files: Mapping[str, str]  # its own first
    values: Mapping[str, float]
    kept: tuple[str, ...] = ()  # what is written as it was
    unwritten: Mapping[str, str] = field(default_factory=dict[str, str])  # with a word of why
    is_rounded: bool = False  # whether it is the same but for rounding
    added: tuple[str, ...] = ()  # tags of elements that are added


DEFAULTS = """<mujoco>
  <!-- a comment of the user's -->
  <compiler angle="radian" autolimits="true"/>
  <default>
    <joint damping="0.3" armature="0.01"/>
    <geom friction="0.8 0.01 0.0002" solref="0.03 1.1"/>
    <default class="arm"><joint damping="0.7" frictionloss=".1"/><position kp="30" dampratio="0.9"/>
      <default class="hand"><joint stiffness="2"/></default>
    </default>
    <default class="servo">
      <general biastype="affine" gainprm="20 0 0" biasprm="0 -20 -2"/>
    </default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1"/>
    <body name="upper" childclass="arm" pos="0 0 1">
      <inertial pos=".1 0 0" mass="1.5" diaginertia="0.02 0.02 0.01" euler="0.1 0.2 0.3"/>
      <joint name="shoulder" axis="0 1 0"/><geom name="skin" size=".05"/>
      <body name="lower" pos="0 0 -.4">
        <joint name="elbow" class="hand" axis="0 1 0"
               damping="0.25"
               range="-2 2"/>
        <geom type='capsule' fromto='0 0 0 0 0 -.3' size='.03' name='limb'/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position class="arm" joint="shoulder" name="lift"/>
    <general class="servo" name="bend" joint="elbow"/>
  </actuator>
</mujoco>
"""

MAIN = """<?xml version="1.0" encoding="utf-8"?>
<!-- the whole machine -->
<mujoco model="machine">
  <include file="common/options.xml"/>
  <worldbody>
    <include file="parts/leg.xml"/>
  </worldbody>
  <include file="common/motors.xml"/>
</mujoco>
"""
INCLUDES = {
    "machine.xml": MAIN,
    "common/options.xml": '<mujoco><option timestep="0.001" gravity="0 0 -9.81"/>\n'
    "<default><joint damping='1'/></default></mujoco>",
    "common/motors.xml": '<mujocoinclude>\r\n\t<actuator>\r\n\t\t<position name="hip" joint="hip"'
    ' kp="8"/>\r\n\t</actuator>\r\n</mujocoinclude>\r\n',
    "parts/leg.xml": """<mujocoinclude><body name="leg"><joint name="hip" axis="0 1 0"/>
  <inertial mass="2" pos="0 0 -.2" fullinertia=".03 .025 .02 .001 .002 .0005"/>
  <include file="parts/foot.xml"/>
</body></mujocoinclude>""",
    "parts/foot.xml": """<mujoco>
  <body name="foot" pos="0 0 -.4"><joint name="ankle" axis="0 1 0" frictionloss="0.05"/>
    <geom name="sole" type="box" size=".1 .05 .02" friction="1"/></body>
</mujoco>
""",
}

VECTORS = """<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" solimp=".9 .95"/>
    <body name="puck" pos="0 0 .11"><freejoint name="free"/>
      <geom name="puck" size=".1" friction="  0.7   .01" mass="1.2"/></body>
    <body name="slider" pos="2 0 1"><joint name="rail" type="slide" axis="1 0 0" springref=".2"
      stiffness="50 1 0"/><geom name="knob" size=".1" density="500"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="push" joint="rail" gear="10"/>
    <velocity name="hold" joint="rail" kv="2" gear="1 0 0 0 0 0"/>
  </actuator>
  <tendon>
    <fixed name="line" damping=".1 .2" stiffness="3"><joint joint="rail" coef="2"/></fixed>
  </tendon>
</mujoco>
"""

DEGREES = """<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body name="door"><joint name="hinge" axis="0 0 1" springref="20" stiffness="1.5" ref="5"/>
      <inertial pos="0.3 0 0" quat="1 1 0 0" mass="3" diaginertia="0.03 0.02 0.01"/></body>
  </worldbody>
</mujoco>
"""

MESHES = """<mujoco>
  <compiler meshdir="shapes" texturedir="paint" angle="radian"/>
  <asset>
    <mesh name="wedge" file="deep/wedge.obj" scale="0.1 0.2 0.1"/>
    <texture name="skin" type="2d" file="skin.png"/><material name="painted" texture="skin"/>
  </asset>
  <worldbody>
    <body name="tool" pos="0 0 1"><joint name="wrist" axis="0 1 0" armature="0.001"/>
      <geom name="edge" type="mesh" mesh="wedge" material="painted"/>
    </body>
  </worldbody>
</mujoco>
"""

BY_GEOMS = """<mujoco><compiler inertiafromgeom="true"/>
  <default><geom density="300"/></default>
  <worldbody><body name="bob"><joint name="swing" axis="0 1 0"/>
    <frame pos="0 0 -.2"><geom type="capsule" fromto="0 0 .2 0 0 -.2" size=".01"/></frame>
    <geom name="ball" size=".05" pos="0 0 -.4" mass="0.5"/>
    <body name="tip" pos="0 0 -.5"><joint name="flap" axis="0 1 0"/><geom size=".02 .03 .04"
      type="box"/></body></body></worldbody></mujoco>"""

DERIVED = """<mujoco><compiler fusestatic="true"/>
  <worldbody><body name="cart"><joint name="rail" type="slide" axis="1 0 0"/>
    <inertial pos="0 0 0" mass="2" diaginertia=".1 .1 .1"/>
    <body name="box" pos="0 0 .1"><inertial pos="0 0 0" mass="1" diaginertia=".02 .03 .04"/></body>
    <body name="pole"><joint name="pin" axis="0 1 0" springdamper="0.4 0.6"/>
      <inertial pos="0 0 .5" mass=".4" diaginertia=".01 .01 .001"/></body></body></worldbody>
  <actuator><position joint="rail" kp="90" dampratio="1"/>
    <position name="turn" joint="pin" kp="9" dampratio=".5"/></actuator></mujoco>"""

COPIES = """<mujoco><worldbody>
  <replicate count="2" offset="0 1 0"><body name="post"><joint name="nod" axis="0 1 0"/>
    <geom name="head" size=".1" pos="0 0 .3"/></body></replicate>
  <body name="one" pos="0 3 0"><freejoint name="float"/><geom size=".1"/></body>
</worldbody><actuator><motor name="pull" joint="nod0"/></actuator></mujoco>"""

ROBOT = """<?xml version="1.0"?>
<robot name="r">
  <link name="base"/>
  <link name="upper">
    <inertial><origin xyz="0 0 -0.1" rpy="0 0 0"/><mass value="2.0"/>
      <inertia ixx="0.03" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="gone.dae"/></geometry></visual>
  </link>
  <link name="lower">
    <inertial><origin xyz="0 0 -0.1" rpy="0.1 0 0"/><mass value="1.0"/>
      <inertia ixx="0.011" iyy="0.012" izz="0.003" ixy="0.001" ixz="0.0005" iyz="0"/></inertial>
  </link>
  <link name="flange"><inertial><mass value="0.2"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><dynamics damping="0.1"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 -0.3"/><axis xyz="0 1 0"/></joint>
  <joint name="mount" type="fixed"><parent link="lower"/><child link="flange"/>
    <origin xyz="0 0 -0.2"/></joint>
  <gazebo reference="upper"><mu1>0.2</mu1></gazebo>
</robot>
"""

CASES = [
    Case(
        "defaults and classes",
        {"arm.xml": DEFAULTS},
        {
            "joint/shoulder.damping": 0.123456789012345,
            "joint/elbow.damping": 0.31,
            "joint/elbow.stiffness": 2.5,
            "joint/shoulder.frictionloss": 0.0412345678,
            "joint/elbow.armature": 0.0234567,
            "geom/skin.friction[1]": 0.0345,
            "geom/floor.solref[0]": 0.0321,
            "body/upper.mass": 1.62345678,
            "actuator/bend.kp": 23.456789,
            "actuator/bend.kv": 2.3456789,
            "actuator/lift.kp": 31.23456789,
        },
        kept=("actuator/lift.kv",),
    ),
    Case(
        "a body that its geoms weigh",
        {"arm.xml": DEFAULTS},
        {
            "body/lower.mass": 0.345678,
            "body/lower.ipos[0]": 0.0123,
            "body/lower.inertia[2]": 0.0034,
        },
        kept=("actuator/lift.kv",),
        added=("inertial",),
    ),
    Case(
        "includes in includes",
        INCLUDES,
        {
            "joint/hip.damping": 0.87654321,
            "body/leg.mass": 2.2345678,
            "joint/ankle.frictionloss": 0.0612345,
            "geom/sole.friction[2]": 0.000234,
            "actuator/hip.kp": 9.87654321,
            "option.gravity[2]": -9.8066512,
        },
    ),
    Case(
        "vectors, slides and tendons",
        {"puck.xml": VECTORS},
        {
            "geom/puck.friction[0]": 0.654321,
            "geom/floor.solimp[1]": 0.9612345,
            "joint/rail.springref": 0.2345678,
            "joint/rail.stiffness": 51.2345,
            "actuator/push.gear[0]": 9.8765,
            "actuator/hold.kv": 2.3456,
            "tendon/line.damping": 0.1234567,
            "tendon/line.stiffness": 3.21,
            "option.viscosity": 0.0012345,
            "option.density": 1.2345,
        },
        kept=("tendon/line.springlength",),
        added=("option",),
    ),
    Case("an angle", {"door.xml": DEGREES}, {"joint/hinge.springref": 0.34567}),
    Case(
        "an angle of which no number of degrees is the last bit",
        {"door.xml": DEGREES},
        {"joint/hinge.springref": 0.601837},
        is_rounded=True,
    ),
    Case(
        "meshes",
        {"tool.xml": MESHES, "shapes/deep/wedge.obj": TETRAHEDRON, "paint/skin.png": PICTURE},
        {"joint/wrist.armature": 0.00123456, "body/tool.mass": 0.4321},
        added=("inertial",),
    ),
    Case(
        "masses by geoms alone",
        {"bob.xml": BY_GEOMS},
        {"body/bob.mass": 0.654321, "body/tip.mass": 0.0987, "body/tip.ipos[0]": 0.01},
        unwritten={"body/tip.ipos[0]": "inertiafromgeom"},
        is_rounded=True,
    ),
    Case(
        "what MuJoCo derives",
        {"cart.xml": DERIVED},
        {"body/pole.mass": 0.5123, "body/cart.mass": 3.2},
        kept=("actuator/0.kv", "actuator/turn.kv", "joint/pin.damping"),
        is_rounded=True,
    ),
    Case(
        "copies",
        {"posts.xml": COPIES},
        {"joint/nod0.damping": 0.2, "actuator/pull.gear[0]": 2.5, "joint/float.damping": 0.1},
        unwritten={"joint/nod0.damping": "<replicate>", "joint/float.damping": "<freejoint>"},
    ),
    Case(
        "a URDF",
        {"r.urdf": ROBOT},
        {
            "joint/shoulder.damping": 0.123456789,
            "joint/shoulder.frictionloss": 0.0234567,
            "joint/elbow.damping": 0.0345678,
            "joint/elbow.frictionloss": 0.0456789,
            "joint/elbow.armature": 0.01,
            "body/upper.mass": 2.3456789,
            "body/upper.ipos[2]": -0.12345,
            "option.gravity[2]": -9.8,
        },
        unwritten={"joint/elbow.armature": "URDF", "option.gravity[2]": "URDF"},
        added=("dynamics",),
    ),
    Case(
        "fixed links of a URDF",
        {"r.urdf": ROBOT},
        {"body/lower.mass": 1.345678},
        is_rounded=True,
    ),
]
each_case = pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)


def written(case: Case, folder: Path) -> tuple[WrittenModel, Path]:
    """The case's model, with its values, in memory."""
    for name, text in case.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(text.encode("latin-1" if name.endswith(".png") else "utf-8"))
    path = folder / next(iter(case.files))
    files, process = ModelFiles(path), ModelProcess(path)
    model = files.spec(process).compile()
    ranges = [
        f"{address}={min(0.98 * value, 1.02 * value)!r}:{max(0.98 * value, 1.02 * value)!r}"
        for address, value in case.values.items()
    ]
    tuned = model_parameters(model, ranges)
    remarks = {address: f"of {address} -- <!DOCTYPE" for address in case.values}
    return write_model(files, tuned, case.values, remarks, process), path


@each_case
def test_it_comes_back_to_the_last_bit(case: Case, tmp_path: Path):
    found, path = written(case, tmp_path)
    assert found.unwritten.keys() == case.unwritten.keys()
    assert all(case.unwritten[name] in why for name, why in found.unwritten.items())
    assert found.kept == case.kept
    assert bool(found.off) == case.is_rounded
    assert all(off < 1e-14 for off in found.off.values())
    apart, _, stopped = rollouts_differ(found.tuned, found.model, ModelProcess(path))
    assert not stopped
    assert apart < (1e-14 if case.is_rounded else 1e-300)


@each_case
def test_the_file_is_the_users_own_with_other_numbers(case: Case, tmp_path: Path):
    found, _ = written(case, tmp_path)
    for name, text in found.xml.texts(head="<!-- head -->").items():
        before, after = name.read_bytes().decode(), text.decode()
        assert after.count("<!-- head -->") == 1
        assert ("\r\n" in after) == ("\r\n" in before)
        assert not re.search("(?<!\r)\n", after) or "\r\n" not in before
        after = after.replace("<!-- head -->", "")
        remarks = re.findall("<!-- tunenet-export: (.*?) =.*?-->", after)
        assert set(remarks) <= {*case.values, *case.kept}
        after = re.sub("<!-- tunenet-export: .*?-->", "", after)
        # Words that are gone, and words that came, numbers aside.
        words = [re.findall(r"[^\s\"'=<>/]+", one) for one in (before, after)]
        gone, came = (list(filter(_is_word, one)) for one in words)
        match = SequenceMatcher(None, gone, came, autojunk=False)
        changes = [one for one in match.get_opcodes() if one[0] != "equal"]
        lost = {word for _, low, high, _, _ in changes for word in gone[low:high]}
        new = {word for _, _, _, low, high in changes for word in came[low:high]}
        assert lost <= {"fullinertia", "dampratio", "springdamper"}
        fields = {one.rpartition(".")[2].partition("[")[0] for one in (*case.values, *case.kept)}
        allowed = {"pos", "mass", "diaginertia", "quat", "density", "stiffness", "friction"}
        assert new <= {*fields, *case.added, *allowed, "gainprm", "biasprm"}


def _is_word(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return True
    return False


@each_case
def test_another_reader_finds_all_that_it_names(case: Case, tmp_path: Path):
    """MuJoCo itself reads the file, written beside the model, with its includes and meshes."""
    found, path = written(case, tmp_path)
    output = path.with_name(f"{path.stem}.tuned{path.suffix}")
    renamed = found.xml.renames(output)
    before = {one: one.read_bytes() for one in tmp_path.rglob("*") if one.is_file()}
    names = {one: new.name for one, new in renamed.items()}
    for one, text in found.xml.texts(names, "<!-- head -->").items():
        assert renamed[one] not in before
        renamed[one].write_bytes(text)
    assert output.is_file()
    assert all(one.read_bytes() == data for one, data in before.items())
    ours = ModelFiles(output).spec().compile()
    assert differences(found.model, ours) == {}
    if path.suffix == ".xml":
        theirs = stock.MjModel.from_xml_path(str(output))  # pyright: ignore[reportAttributeAccessIssue]
        drawn = ("tex", "mat")  # pictures are left out by ours
        off = differences(found.model, theirs)
        sizes = {"ntexdata", "nbuffer", "npaths", "narena"}
        assert {name for name in off if not name.startswith(drawn)} <= sizes


def test_an_earlier_remark_on_the_same_number_goes(tmp_path: Path):
    case = CASES[4]
    found, path = written(case, tmp_path)
    [text] = found.xml.texts(head="<!-- head -->").values()
    again, path = written(replace(case, files={path.name: text.decode()}), tmp_path)
    [twice] = again.xml.texts(head="<!-- new -->").values()
    assert twice == text.replace(b"<!-- head -->", b"<!-- new -->\n<!-- head -->")


def test_what_does_not_come_back_is_named_and_the_rest_is_written(tmp_path: Path):
    model = DEGREES.replace("<option", '<compiler boundmass="3"/><option')
    values = {"body/door.mass": 2.1, "joint/hinge.stiffness": 1.6}
    found, _ = written(Case("weighed", {"door.xml": model}, values), tmp_path)
    assert list(found.unwritten) == ["body/door.mass"]
    assert "body_" in found.unwritten["body/door.mass"]
    [text] = found.xml.texts().values()
    assert b'stiffness="1.6"' in text
    assert b'mass="3"' in text


BODY = "<body name='a'><joint name='j'/><geom size='.1'/></body>"


@pytest.mark.parametrize(
    "model",
    [
        f"\ufeff  <mujoco><worldbody>{BODY}</worldbody></mujoco>",
        f"<mujoco><worldbody>{BODY}</worldbody></mujoco>\n<!-- end -->".replace(
            "name='j'/>", "\n\tname = 'j'\n\tdamping\n=\n'0.2'\n></joint>"
        ),
        f"<mujoco model='é>&lt;\"'><worldbody>{BODY}</worldbody></mujoco>".replace("'a'", "'ä>'"),
        f"<mujoco><worldbody/><worldbody><body><joint name='k'/>{BODY}<geom size='.1'/></body>"
        "</worldbody><default><joint damping='.1'/></default><equality/></mujoco>",
        f"<m:mujoco xmlns:m='urn:m'><m:worldbody>{BODY}</m:worldbody></m:mujoco>".replace(
            "<body", "<m:body"
        )
        .replace("</body", "</m:body")
        .replace("<joint", "<m:joint")
        .replace("<geom", "<m:geom"),
    ],
)
def test_xml_as_people_write_it(model: str, tmp_path: Path):
    found, path = written(Case("any", {"a.xml": model}, {"joint/j.damping": 0.321}), tmp_path)
    assert not found.unwritten
    [text] = found.xml.texts(head="<!-- head -->").values()
    path.write_bytes(text)
    assert differences(found.tuned, ModelFiles(path).spec().compile()) == {}
    assert text.count(b"0.321") == 1
