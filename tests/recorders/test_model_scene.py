"""What a model looks like, and how it moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tunenet_logs.episode import Signal
from tunenet_logs.recorders.simulators.model.reading import ModelProcess
from tunenet_logs.recorders.simulators.model.rollout import (
    InitialState,
    ModelScene,
    ModelSimulator,
    SensedSignal,
    Sensor,
)
from tunenet_logs.recorders.simulators.mujoco import mujoco

MODEL = """
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
    shown = scene(MODEL.format(group=""))
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


def test_groups_that_a_viewer_hides_are_hidden():
    assert kinds(scene(MODEL.format(group='group="3"'))) == ["box", "capsule", "plane"]


def test_what_is_hidden_is_shown_where_there_is_nothing_else():
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
    positions, rotations = scene(MODEL.format(group="")).poses(np.array([[0.0], [np.pi / 2]]))
    assert positions[:, 2] == pytest.approx(np.array([[0, 0, 0.6], [0.4, 0, 1.0]]))
    assert rotations[1, 1] @ [0, 0, -1] == pytest.approx([1, 0, 0], abs=1e-12)


def test_coordinates_are_what_a_rollout_shows():
    stamps = (np.arange(0.0, 1.0, 0.01) * 1e9).astype(np.int64)
    signal = Signal("/joint_states.position", stamps, np.zeros((100, 1)), ("hinge",), "rad")
    simulator = ModelSimulator(
        mujoco().MjSpec.from_string(MODEL.format(group="")),
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
