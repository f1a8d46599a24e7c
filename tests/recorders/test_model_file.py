"""A user's MuJoCo model or URDF: read wherever its files lie, shown, and moved."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import cv2
import mujoco as stock
import numpy as np
import pytest

from tests.conftest import ROOT
from tunenet_logs.episode import Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.model.reading import ModelProcess, read_model
from tunenet_logs.recorders.simulators.model.rollout import (
    InitialState,
    ModelScene,
    ModelSimulator,
    SensedSignal,
    Sensor,
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


def test_includes_meshes_and_height_fields_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
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


# ---- What a model looks like, and how it moves

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


def test_bodies_without_shapes_are_shown_by_their_masses():
    text = """<mujoco><worldbody><body><joint/><inertial pos="0 .3 -.4" mass="1"
    diaginertia=".1 .1 .1"/></body></worldbody></mujoco>"""
    ball, rod = sorted(scene(text).shapes, key=lambda one: -one.size_m[0])
    assert ball.position_m.tolist() == [0, 0.3, -0.4]
    assert (rod.position_m + rod.rotation[:, 2] * rod.size_m[2]).tolist() == pytest.approx(
        [0, 0.3, -0.4]
    )


def test_poses_are_those_of_the_coordinates():
    positions, rotations = scene(SHAPES.format(group="")).poses(np.array([[0.0], [np.pi / 2]]))
    assert positions[:, 2] == pytest.approx(np.array([[0, 0, 0.6], [0.4, 0, 1.0]]))
    assert rotations[1, 1] @ [0, 0, -1] == pytest.approx([1, 0, 0], abs=1e-12)


def test_coordinates_are_what_a_rollout_shows():
    stamps = (np.arange(0.0, 1.0, 0.01) * 1e9).astype(np.int64)
    signal = Signal("/joint_states.position", stamps, np.zeros((100, 1)), ("hinge",), "rad")
    simulator = ModelSimulator(
        mujoco().MjSpec.from_string(SHAPES.format(group="")),
        (),
        (SensedSignal(signal, ("hinge",), (Sensor("jointpos", "hinge"),)),),
        (),
        InitialState(0, np.array([1.0]), np.zeros(1)),
        int(stamps[-1]),
        process=ModelProcess(Path("pendulum.xml")),
    )
    seconds, qpos = simulator.coordinates(np.zeros(0))
    seen = simulator.rollout({}).signals[signal.name].values[:, 0]
    assert np.interp(stamps * 1e-9, seconds, qpos[:, 0]) == pytest.approx(seen, abs=1e-9)
    assert np.ptp(seen) > 1
