"""A user's MuJoCo model or URDF: read wherever its files lie, shown; and refused if it hurts."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import mujoco as stock
import numpy as np
import pytest

from tests.conftest import ROOT
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.model.reading import read_model
from tunenet_logs.recorders.simulators.model.rollout import (
    ModelScene,
)
from tunenet_logs.recorders.simulators.mujoco import mujoco

READS = "from tunenet_logs.recorders.simulators.model.reading import read_model"
MINIMAL = '<mujoco><worldbody><body><joint/><geom size=".1"/></body></worldbody></mujoco>'

TETRAHEDRON = (
    b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"  # of 1/6 m³
)
ARM = """<mujoco model="arm">
  <compiler meshdir="parts" texturedir="paint"/>
  <include file="sub/common.xml"/>
  <asset>
    <mesh file="wedge.obj" scale="0.1 0.1 0.1"/>
    <mesh name="thin" file="deep/Wedge.obj" scale="0.1 0.1 0.05"/>
    <hfield name="floor" file="floor.png" size="1 1 0.1 0.1"/>
    <texture name="skin" type="2d" file="skin.png"/>
    <texture file="gone.png"/>
    <material name="painted" texture="skin"/>
  </asset>
  <worldbody>
    <geom type="hfield" hfield="floor"/>
    <body name="upper"><joint name="elbow" class="stiff"/>
      <geom type="mesh" mesh="wedge" material="painted"/><geom type="mesh" mesh="thin"/>
    </body>
  </worldbody>
</mujoco>"""
COMMON = """<mujocoinclude><default><default class="stiff"><joint damping="3"/></default></default>
  <include file="more.xml"/></mujocoinclude>"""
MORE = '<mujoco><option timestep="0.004"/></mujoco>'


def arm_in(folder: Path) -> Path:
    for name in ("sub", "parts/deep", "paint"):
        (folder / name).mkdir(parents=True)
    (folder / "arm.xml").write_text(ARM)
    (folder / "sub/common.xml").write_text(COMMON)
    (folder / "sub/more.xml").write_text(MORE)
    (folder / "parts/wedge.obj").write_bytes(TETRAHEDRON)
    (folder / "parts/deep/Wedge.obj").write_bytes(TETRAHEDRON)
    heights = np.arange(16, dtype=np.uint8).reshape(4, 4)
    (folder / "parts/floor.png").write_bytes(cv2.imencode(".png", heights)[1].tobytes())
    return folder / "arm.xml"


def urdf(mesh: str, more: str = "") -> str:
    inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    shape = f'<geometry><mesh filename="{mesh}"/></geometry>'
    return (
        f'\n<?xml version="1.0"?><robot name="r">{more}<link name="base"/><link name="tip">'
        f'<inertial><mass value="2"/>{inertia}</inertial><visual>'
        f'<geometry><mesh filename="gone.dae"/></geometry></visual>'
        f"<collision>{shape}</collision></link>"
        '<joint name="j" type="continuous"><parent link="base"/><child link="tip"/></joint>'
        '<gazebo><plugin name="p" filename="libgazebo.so"/></gazebo></robot>'
    )


def test_all_files_of_a_model_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """MuJoCo opens none of them: they are gone when it compiles."""
    path = arm_in(tmp_path / "model")
    spec = read_model(path)
    for file in sorted(path.parent.rglob("*.*"), reverse=True):
        file.unlink()
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    for model in (spec.copy().compile(), spec.compile()):
        assert model.opt.timestep == 0.004
        assert model.dof_damping.tolist() == [3]
        assert [model.mesh(number).name for number in range(2)] == ["wedge", "thin"]
        assert model.body("upper").mass[0] == pytest.approx(1000 * (1e-3 + 5e-4) / 6)
        assert model.hfield_data.max() == 1
        assert model.material("painted").id == 0
    assert os.listdir() == []  # noqa: PTH208


def test_a_model_is_what_mujoco_itself_reads(tmp_path: Path):
    path = arm_in(tmp_path)
    picture = np.zeros((4, 4, 3), np.uint8)
    for name in ("skin.png", "gone.png"):
        (tmp_path / "paint" / name).write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    (tmp_path / "more.xml").write_text(MORE)
    ours, theirs = read_model(path).compile(), stock.MjModel.from_xml_path(str(path))  # pyright: ignore[reportAttributeAccessIssue]
    for name in ("body_mass", "body_inertia", "body_ipos", "geom_pos", "geom_quat", "mesh_vert"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


def test_a_model_that_is_written_in_an_old_way_says_nothing(tmp_path: Path):
    path = tmp_path / "old.xml"
    path.write_text(MINIMAL.replace("<worldbody>", '<compiler settotalmass="2"/><worldbody>'))
    reads = f"from pathlib import Path; {READS}; read_model(Path({str(path)!r})).compile()"
    said = subprocess.run([sys.executable, "-c", reads], capture_output=True, text=True, cwd=ROOT)
    assert (said.returncode, said.stderr) == (0, "")


def test_models_attach_models(tmp_path: Path):
    (tmp_path / "tools").mkdir()
    (tmp_path / "arm.xml").write_text(
        '<mujoco><asset><model name="tool" file="tools/tool.xml"/></asset><worldbody>'
        '<body><joint/><geom size="0.1"/><attach model="tool" body="grip" prefix="left_"/>'
        '<attach model="tool" body="grip" prefix="right_"/></body></worldbody></mujoco>'
    )
    (tmp_path / "tools/tool.xml").write_text(
        '<mujoco><compiler meshdir="m"/><asset><mesh file="a.obj"/>'
        '<model name="n" file="nail.xml"/></asset><worldbody><body name="grip">'
        '<geom type="mesh" mesh="a"/><attach model="n" body="nail" prefix="n_"/>'
        "</body></worldbody></mujoco>"
    )
    (tmp_path / "tools/nail.xml").write_text(
        '<mujoco><worldbody><body name="nail"><geom size="0.1"/></body></worldbody></mujoco>'
    )
    (tmp_path / "tools/m").mkdir()
    (tmp_path / "tools/m/a.obj").write_bytes(TETRAHEDRON)
    model = read_model(tmp_path / "arm.xml").compile()
    assert model.body("right_n_nail").id > 0
    assert model.nmesh >= 1


@pytest.mark.parametrize(
    ("mesh", "at"),
    [
        ("tip.obj", "pkg/urdf/tip.obj"),
        ("../meshes/tip.obj", "pkg/meshes/tip.obj"),
        ("package://pkg/meshes/tip.obj", "pkg/meshes/tip.obj"),
        ("package://pkg/meshes/tip.obj", "pkg/urdf/meshes/tip.obj"),
        ("package://other/meshes/tip.obj", "pkg/urdf/other/meshes/tip.obj"),
        ("package://other/meshes/tip.obj", "pkg/urdf/tip.obj"),
        ("model://pkg/meshes/TIP.OBJ", "pkg/meshes/TIP.OBJ"),
        ("file://{folder}/pkg/meshes/tip.obj", "pkg/meshes/tip.obj"),
        ("meshes\\tip.obj", "pkg/urdf/meshes/tip.obj"),
    ],
)
def test_a_urdf_finds_the_meshes_of_its_package(tmp_path: Path, mesh: str, at: str):
    (tmp_path / "pkg/urdf").mkdir(parents=True)
    (tmp_path / "pkg/package.xml").write_text("<package/>")
    file = tmp_path / at
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(TETRAHEDRON)
    path = tmp_path / "pkg/urdf/robot.urdf"
    path.write_text(urdf(mesh.format(folder=tmp_path)))
    model = read_model(path).compile()
    assert (model.nmesh, model.nv, model.body("tip").mass[0]) == (1, 1, 2)


def test_an_old_model_takes_no_gigabytes(tmp_path: Path):
    size = '<size njmax="8000" nconmax="4000" nkey="2"/>'
    (tmp_path / "m.xml").write_text(f"<mujoco>{size}</mujoco>")
    model = read_model(tmp_path / "m.xml").compile()
    assert (model.narena, model.nkey) == (100 * 1024**2, 2)


def test_other_folders_by_name_links_inside_and_where_a_urdf_says(tmp_path: Path):
    (tmp_path / "a/xml").mkdir(parents=True)
    (tmp_path / "a/tip.obj").write_bytes(TETRAHEDRON)
    path = tmp_path / "a/xml/robot.urdf"
    path.write_text(urdf("../tip.obj"))
    with pytest.raises(UsageError, match="outside"):
        read_model(path)
    assert read_model(path, tmp_path / "a").compile().nmesh == 1
    (tmp_path / "tip.obj").symlink_to(tmp_path / "a/tip.obj")
    path = tmp_path / "robot.urdf"
    path.write_text(urdf("tip.obj"))
    assert read_model(path).compile().nmesh == 1
    # as MuJoCo has it: folders are taken away, and its <compiler> names the one
    path.write_text(urdf("package://x/y/tip.obj", '<mujoco><compiler meshdir="a"/></mujoco>'))
    assert read_model(path).compile().nmesh == 1


# ---- What a model looks like

SHAPES = """
<mujoco>
  <option timestep="0.002"/>
  <asset>
    <mesh name="fin" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/>
    <hfield name="hill" nrow="2" ncol="2" size="1 1 .2 .1" elevation="0 1 0 1"/>
  </asset>
  <worldbody>
    <geom type="plane" size="0 2 .1"/>
    <geom type="hfield" hfield="hill"/>
    <body name="arm" pos="0 0 1"><joint name="hinge" axis="0 -1 0"/>
      <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.4" mass="1"/>
      <geom type="box" size=".1 .2 .3" pos="0 0 -.4" mass="0" {group}/>
      <geom type="cylinder" size=".03 .05" mass="0" {group}/>
      <geom type="sphere" size=".04" mass="0" rgba="1 1 1 0"/>
      <body name="fixed" pos="0 0 -.4">
        <geom type="ellipsoid" size=".1 .2 .3" mass="0" {group}/>
        <geom type="mesh" mesh="fin" mass="0" {group}/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def scene(text: str) -> ModelScene:
    return ModelScene(mujoco().MjModel.from_xml_string(text))


def kinds(shown: ModelScene) -> list[str]:
    return sorted(one.kind for one in shown.shapes)


def test_every_kind_of_shape():
    shown = scene(SHAPES.format(group=""))
    assert kinds(shown) == ["box", "box", "capsule", "cylinder", "ellipsoid", "mesh", "plane"]
    sizes = {one.kind: one.size_m.tolist() for one in shown.shapes if one.body}
    assert sizes["box"] == [0.1, 0.2, 0.3]
    assert sizes["cylinder"] == [0.03, 0.03, 0.05]
    assert sizes["capsule"] == pytest.approx([0.02, 0.02, 0.2])
    (plane,) = [one for one in shown.shapes if one.kind == "plane"]
    assert plane.size_m.tolist() == [0.0, 2.0, 0.0]
    (mesh,) = [one for one in shown.shapes if one.kind == "mesh"]
    assert mesh.vertices_m is not None
    assert mesh.triangles is not None
    corners = mesh.vertices_m @ mesh.rotation.T + mesh.position_m
    tetrahedron = [[0, 0, 0], [0, 0, 0.1], [0, 0.1, 0], [0.1, 0, 0]]
    assert sorted(corners.round(6).tolist()) == tetrahedron
    assert mesh.triangles.max() < len(corners)
    assert shown.moving == (1, 2)


def test_groups_that_a_viewer_hides_are_hidden_where_there_is_anything_else():
    assert kinds(scene(SHAPES.format(group='group="3"'))) == ["box", "capsule", "plane"]
    text = '<mujoco><worldbody><body><joint/><geom size="1" group="4"/></body></worldbody></mujoco>'
    assert kinds(scene(text)) == ["ellipsoid"]


# ---- Models that strangers made to hurt: refused in one line, in bounded time and memory


def world(body: str) -> str:
    return f"<mujoco><worldbody>{body}</worldbody></mujoco>"


def asset(element: str) -> str:
    return f"<mujoco><asset>{element}</asset></mujoco>"


def mesh(name: str) -> str:
    return (
        f'<mujoco><asset><mesh name="a" file="{name}"/></asset>'
        '<worldbody><geom type="mesh" mesh="a"/></worldbody></mujoco>'
    )


def included(name: str) -> str:
    return f'<mujoco><include file="{name}"/></mujoco>'


BALL = '<geom size="0.1"/>'
COPIED = '<replicate count="1000" offset="1 0 0">'
HINGES = "".join(f'<body><joint axis="{a}"/>{BALL}</body>' for a in ["1 0 0", "0 1 0"] * 101)
MOTOR = '<motor joint="j"/>'
HELD = f'<body><joint name="j"/>{BALL}</body>'

PLUGIN = '<mujoco><extension><plugin plugin="mujoco.pid"/></extension></mujoco>'

# A model's text, and the words of the refusal.
TEXTS = [
    ("hello", "is not XML"),
    ("", "is not XML"),
    ("<sdf/>", "begins with <sdf>; --model takes"),
    ('<!DOCTYPE m [<!ENTITY a "b"><!ENTITY c "&a;&a;">]><mujoco model="&c;"/>', "document type"),
    ('<robot name="${n}"/>', "expand it first"),
    (world("<body>" * 300 + "</body>" * 300), "over 200 deep"),
    (world(BALL * 100_001), "over 100000 tags"),
    (world("x" * 4_000_001), "is larger than 4 MB"),
    (
        world(f'<replicate count="1000000000" offset="1 0 0">{BALL}</replicate>'),
        "over 100000 elements, copies of <replicate>",
    ),
    (world(COPIED * 4 + BALL + "</replicate>" * 4), "over 100000 elements"),
    (
        world('<flexcomp name="a" type="grid" count="1000 1000 1000" dim="3"/>'),
        "copies of <flexcomp>",
    ),
    (PLUGIN, "plugins run code of others"),
    (world('<body><plugin instance="a"/></body>'), "plugins run code"),
    (world('<geom size="nan"/>'), '<geom size="nan"> is not finite'),
    (world('<body><geom size="1e200" mass="1e300"/></body>'), "not finite"),
    ('<mujoco><size memory="1T"/></mujoco>', "over 400 MB"),
    ('<mujoco><size memory="350M"/></mujoco>', "367 MB of working"),
    ('<mujoco><size nkey="2000000000"/></mujoco>', "over the limit of 100000"),
    ('<mujoco><size nuser_body="2000000000"/></mujoco>', "over the limit"),
    (asset('<hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/>'), "over 400 MB"),
    (asset('<texture name="t" builtin="flat" width="1000000" height="1000000"/>'), "over 400 MB"),
    ('<mujoco><sensor><user dim="2000000000"/></sensor></mujoco>', "over 400 MB"),
    (
        f"<mujoco><worldbody>{HELD}</worldbody><actuator>"
        '<general joint="j" dyntype="user" actdim="2000000000"/></actuator></mujoco>',
        "over 400 MB",
    ),
    (world(HINGES), "202 degrees of freedom, over the limit of 200"),
    (world(f"<body>{BALL}</body>" * 2001), "2002 bodies, over the limit of 2000"),
    (world(BALL * 10_001), "10001 geoms, over the limit of 10000"),
    (
        f"<mujoco><worldbody>{HELD}</worldbody><actuator>{MOTOR * 2001}</actuator></mujoco>",
        "2001 actuators, over the limit of 2000",
    ),
    (
        asset('<hfield name="h" nrow="4000" ncol="4000" size="1 1 1 1"/>'),
        "64 MB when compiled, over the limit of 30",
    ),
    ('<mujoco><option timestep="0"/></mujoco>', "timestep of 0 s; give one of 1e-05"),
    ('<mujoco><option timestep="1"/></mujoco>', "timestep of 1 s"),
    (world("<body><joint/></body>"), "give that body or link a mass"),
    (world("<goem/>"), "unrecognized element; Element 'goem'; correct"),
    (world(f'<body name="{"x" * 3000}"><joint/></body>'), "…"),
    (world('<body name="&#13;&#10;a"><joint/></body>'), "give that body or link"),
    (mesh("gone.stl"), 'names "gone.stl", which is not there'),
    (mesh(""), "cannot be a mesh"),
    (mesh("../secret.stl"), 'names "../secret.stl", which is outside the model'),
    (included("/etc/passwd"), "which is outside"),
    ('<mujoco><INCLUDE file="/etc/passwd"/></mujoco>', "which is outside"),
    (mesh("link.stl"), "which is outside"),
    (
        '<mujoco><compiler meshdir="/"/><asset><mesh file="etc/passwd"/></asset></mujoco>',
        "which is outside",
    ),
    (urdf("package://a/../../secret.stl"), "which is outside"),
    (urdf("file:///etc/passwd"), "which is outside"),
    (urdf("https://127.0.0.1/a.stl"), "is not there"),
    (
        world('<geom size="1" file="/etc/passwd"/>'),
        "names a file, which MuJoCo reads in no such element",
    ),
    (mesh("pipe.stl"), "is no regular file"),
    (mesh("folder.stl"), "cannot be read"),
    (mesh("hole.stl"), "is larger than 64 MB"),
    (asset("".join(f'<mesh name="{n}" file="hole{n}.stl"/>' for n in range(5))), "over 256 MB"),
    (included("m.xml"), "twice, or in itself"),
    (included("circle_a.xml"), "twice, or in itself"),
    (included("row0.xml"), "over 16 deep"),
    (included("secret.xml"), "begins with <secret>"),
    (asset('<model file="m.xml"/>'), "attaches itself"),
    (asset('<model file="plugin.xml"/>'), "plugins run code"),
    (asset('<model file="reader.xml"/>'), "which is outside"),
    (urdf("shape.dae"), "cannot be a mesh; MuJoCo reads .stl, .obj, .msh; convert"),
    (mesh("forged.stl"), "number of faces"),
    (mesh("short.stl"), "wrong size"),
    (mesh("empty.stl"), "is empty"),
    (mesh("forged.msh"), "too large sizes"),
    (mesh("wild.msh"), "does not exist"),
    (mesh("wild.obj"), "does not take it"),
    (mesh("nan.obj"), "not finite"),
    (asset('<hfield file="h.bin" size="1 1 1 1"/>'), "does not take it"),
    (asset('<hfield file="h.png" size="1 1 1 1"/>'), "does not take it"),
    (asset('<skin file="s.skn"/>'), "too large sizes"),
]


def write_strange_files(folder: Path) -> Path:
    own = folder / "model"
    (own / "folder.stl").mkdir(parents=True)
    (folder / "secret.stl").write_bytes(b"secret")
    (own / "link.stl").symlink_to(folder / "secret.stl")
    os.mkfifo(own / "pipe.stl")
    for name, size in [("hole.stl", 64_000_001), *[(f"hole{n}.stl", 60_000_000) for n in range(5)]]:
        with open(own / name, "wb") as file:
            file.truncate(size)
    texts = {f"row{n}.xml": included(f"row{n + 1}.xml") for n in range(20)} | {
        "circle_a.xml": included("circle_b.xml"),
        "circle_b.xml": included("circle_a.xml"),
        "secret.xml": "<secret/>",
        "plugin.xml": PLUGIN,
        "reader.xml": mesh("../secret.stl"),
        "shape.dae": "<COLLADA/>",
        "wild.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 2000000000\n",
        "nan.obj": TETRAHEDRON.decode().replace("1", "nan", 1),
    }
    for name, text in texts.items():
        (own / name).write_text(text)
    counts: dict[str, tuple[int, ...]] = {
        "forged.msh": (2**30,) * 4,
        "wild.msh": (4, 0, 0, 2, *range(1, 13), 0, 1, 2**30, -7, 1, 2),
        "h.bin": (10**9, 10**9),
        "s.skn": (2**30,) * 4,
    }
    for name, numbers in counts.items():
        (own / name).write_bytes(struct.pack(f"<{len(numbers)}i", *numbers))
    (own / "empty.stl").touch()
    (own / "forged.stl").write_bytes(bytes(80) + struct.pack("<I", 2**31) + bytes(50))
    (own / "short.stl").write_bytes(bytes(80) + struct.pack("<I", 200_000) + bytes(50))
    (own / "h.png").write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + b"\x7f\xff" * 8)
    return own


_READ_ALL = """
import json, resource, sys
from pathlib import Path
from tunenet_logs.recorders.simulators.model.reading import read_model
from tunenet_logs.errors import UsageError

def cpu_s():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime

said = []
folder, cases = Path(sys.argv[1]), json.load(sys.stdin)
for text in cases:
    path = folder / ("m.urdf" if text.lstrip().startswith(("<robot", "<?xml")) else "m.xml")
    path.write_text(text)
    before = cpu_s()
    try:
        read_model(path)
    except UsageError as error:
        said.append([text, str(error), error.remedy, cpu_s() - before])
    path.unlink()
json.dump([said, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss], sys.stdout)
"""


def test_a_hostile_model_is_refused_in_one_line_with_a_bound_of_time_and_memory(tmp_path: Path):
    """In a fresh process: until it runs, a child counts what its parent has."""
    folder = write_strange_files(tmp_path)
    words = [sys.executable, "-c", _READ_ALL, folder]
    cases = json.dumps([text for text, _ in TEXTS])
    done = subprocess.run(words, input=cases, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    refused, peak_kib = json.loads(done.stdout)
    assert [text for text, *_ in refused] == [text for text, _ in TEXTS]
    for (case, told), (_, said, remedy, cpu_s) in zip(TEXTS, refused, strict=True):
        assert told in said, case[:200]
        assert said.startswith(f"{folder}/"), case[:200]
        assert said.isprintable(), case[:200]
        assert len(said.replace(str(folder), "")) < 600, case[:200]
        assert remedy or ";" in said, case[:200]
        assert cpu_s < 12, case[:200]
    assert peak_kib < 0.6 * 1024**2


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: None, "cannot be read (No such file"),
        (lambda path: path.mkdir(), "cannot be read (Is a directory"),
        (os.mkfifo, "is no regular file"),
        (lambda path: path.symlink_to(path), "cannot be read"),
        (lambda path: path.symlink_to("/dev/zero"), "is no regular file"),
        (lambda path: path.write_bytes(b"\xff\xfe<\0"), "no text in UTF-8"),
    ],
)
def test_what_is_no_file_is_no_model(tmp_path: Path, make: Callable[[Path], object], words: str):
    make(tmp_path / "m.xml")
    with pytest.raises(UsageError) as caught:
        read_model(tmp_path / "m.xml")
    assert words in str(caught.value)


def test_a_home_is_no_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A mesh of package://NAME may be in a folder of that name above, but not in all of a home."""
    (tmp_path / "somebody/models").mkdir(parents=True)
    (tmp_path / "somebody/key.obj").write_bytes(TETRAHEDRON)
    path = tmp_path / "somebody/models/m.urdf"
    path.write_text(urdf("package://somebody/key.obj"))
    assert read_model(path).compile().nmesh == 1
    monkeypatch.setenv("HOME", str(tmp_path / "somebody"))
    with pytest.raises(UsageError, match="is not there"):
        read_model(path)


@pytest.mark.slow
def test_what_never_ends_is_ended(tmp_path: Path):
    """Copies of a model that is attached: only its compiling tells how many there are."""
    (tmp_path / "part.xml").write_text(world(f'<body name="b">{BALL * 300}</body>'))
    (tmp_path / "m.xml").write_text(
        '<mujoco><asset><model name="c" file="part.xml"/></asset><worldbody>'
        '<replicate count="9000" offset="1 0 0"><attach model="c" body="b" prefix="x"/>'
        "</replicate></worldbody></mujoco>"
    )
    with pytest.raises(UsageError, match=r"takes MuJoCo over (10 s|400 MB)"):
        read_model(tmp_path / "m.xml")
