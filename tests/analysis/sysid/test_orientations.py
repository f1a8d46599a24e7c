"""Orientations, and positions in frames of bodies: of what MuJoCo alone throws and turns."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tunenet_logs as tn
from tests.driven_logs import POSE, START_NS, TF, Sent, pose, transform, write_cdr
from tunenet_logs.analysis.sysid.matching import sensed_pose
from tunenet_logs.analysis.sysid.source import Connected, ModelSource
from tunenet_logs.episode import Array, Signal
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.mujoco import mujoco

STEP_NS, EVERY, COUNT = 200_000, 25, 240

THROWN = """<mujoco><option timestep="0.001"/><worldbody>
  <body name="room" pos="1 2 0" euler="0 0 90"/>
  <body name="bat" pos="0 0 1"><freejoint/>
    <inertial pos="0 0 0" mass="1" diaginertia="{inertia} .004 .006"/></body>
</worldbody></mujoco>"""
ROOM = Rotation.from_euler("z", 90, degrees=True)

ARM = """<mujoco><option timestep="0.001"/><default><geom contype="0" conaffinity="0"/></default>
  <worldbody><body name="link" pos="0 0 1"><joint name="hinge" axis="0 1 0" damping="{damping}"/>
    <geom type="capsule" size=".03" fromto="0 0 0 .4 0 0" mass="1"/>
    <body name="tool" pos=".4 0 0"><joint name="wrist" axis="0 0 1" damping=".002"/>
      <geom size=".02" pos="0 .1 0" mass=".3"/></body></body></worldbody></mujoco>"""


def samples(text: str, speeds: Mapping[int, float], turn: Any = None) -> list[tuple[Any, Any]]:
    """Positions and rotations of all bodies, at each of COUNT moments."""
    model = mujoco().MjModel.from_xml_string(text)
    model.opt.timestep = 1e-9 * STEP_NS
    data = mujoco().MjData(model)
    if turn is not None:
        data.qpos[3:7] = np.roll(Rotation.from_rotvec(turn).as_quat(), 1)
    for place, speed in speeds.items():
        data.qvel[place] = speed
    found: list[tuple[Array, Array]] = []
    for step in range(EVERY * COUNT):
        if step % EVERY == 0:
            mujoco().mj_forward(model, data)
            found.append((data.xpos.copy(), data.xmat.reshape(-1, 3, 3).copy()))
        mujoco().mj_step(model, data)
    return found


def shaken(rotation: Rotation, rng: np.random.Generator) -> Array:
    """A quaternion x, y, z, w with noise, of either sign."""
    noisy = rotation * Rotation.from_rotvec(0.005 * rng.standard_normal(3))
    return noisy.as_quat() * rng.choice([-1, 1])


def thrown(path: Path, frame: str = "") -> Path:
    """The log of a body that flies and tumbles, as the world or the room sees it."""
    rng = np.random.default_rng(0)
    speeds = {0: 1.0, 2: 6.0, 3: 3.0, 4: 5.0, 5: -1.5}
    sent: list[Sent] = []
    for number, (places, turns) in enumerate(
        samples(THROWN.format(inertia=0.003), speeds, (1, -2, 1))
    ):
        at_ns = number * EVERY * STEP_NS
        where, how = places[2] + 0.001 * rng.standard_normal(3), Rotation.from_matrix(turns[2])
        if frame == "room":
            where, how = ROOM.inv().apply(where - [1, 2, 0]), ROOM.inv() * how
        fields = pose(START_NS + at_ns, where, shaken(how, rng), frame)
        sent.append(("/mocap/bat", POSE, at_ns, fields))
    return write_cdr(path, sent)


@pytest.mark.parametrize("frame", ["map", "room", "optitrack"])
def test_a_tumbling_bodys_inertia_is_found(frame: str, tmp_path: Path):
    log, model = thrown(tmp_path / "a.mcap", frame), tmp_path / "bat.xml"
    model.write_text(THROWN.format(inertia=0.0045))
    tune = ["body/bat.inertia[0]=.002:.009"]
    tuning = tn.tune(log, model=model, parameters=tune)
    assert tuning.verdict == "ok", tuning.reason
    row = tuning.to_frame().loc["body/bat.inertia[0]"]
    assert abs(row.value - 0.003) < 0.00002
    assert row.low < 0.003 < row.high
    (words,) = [one for one in tuning.detection.connected.used if one.startswith("/mocap/bat:")]
    said = {"map": "of bat", "room": "of bat from room", "optitrack": "frame optitrack taken"}
    assert said[frame] in words


def swung(path: Path, tracker: Rotation, spin_rad_s: float = 3.0) -> Path:
    """The log of a link in the world and its tool as the link sees it, by a turned tracker."""
    rng = np.random.default_rng(0)
    sent: list[Sent] = []
    for number, (places, turns) in enumerate(samples(ARM.format(damping=0.1), {1: spin_rad_s})):
        at_ns = number * EVERY * STEP_NS
        link, tool = (Rotation.from_matrix(turns[one]) for one in (1, 2))
        where = link.inv().apply(places[2] - places[1]) + 0.0005 * rng.standard_normal(3)
        moved = [
            transform(START_NS + at_ns, places[1], shaken(link, rng), "world", "link"),
            transform(
                START_NS + at_ns, where, shaken(link.inv() * tool * tracker, rng), "link", "tool"
            ),
        ]
        sent.append(("/tf", TF, at_ns, {"transforms": moved}))
    return write_cdr(path, sent)


def connected(log: Path, folder: Path, told: Mapping[str, str] | None = None) -> Connected:
    model = folder / "arm.xml"
    model.write_text(ARM.format(damping=0.3))
    source = ModelSource(model, ("joint/hinge.damping=0:1",), told or {})
    return source.connect(read_episode(log))


def test_a_tool_is_seen_from_its_link(tmp_path: Path):
    found = connected(swung(tmp_path / "a.mcap", Rotation.identity()), tmp_path)
    assert "/tf.tool: compared with position of tool from link" in found.used
    assert "/tf.tool.orientation: compared with orientation of tool from link" in found.used
    assert "/tf.link.orientation: compared with orientation of link" in found.used
    truth = found.rollouts(
        np.array([[0.1, *(one.initial for one in found.simulator.parameters[1:])]])
    )
    left = found.target.rms(found.target.seen_in(truth[0]) - found.target.values)
    for column, rms in zip(found.target.columns, left, strict=True):
        if column.signal == "/tf.tool":
            assert rms < 0.001, column.label  # of .4 m, whatever the wrist does


def test_turned_axes_are_told_and_not_compared(tmp_path: Path):
    log = swung(tmp_path / "a.mcap", Rotation.from_euler("x", 74, degrees=True))
    found = connected(log, tmp_path)
    (words,) = found.unused
    assert "/tf.tool.orientation: turned by 74 degrees from body/tool" in words
    as_told = connected(log, tmp_path, {"/tf.tool.orientation": "body/tool"})
    assert not as_told.unused
    place_alone = connected(log, tmp_path, {"/tf.tool": "body/tool"})
    assert len(place_alone.unused) == 1


def test_a_swinging_link_is_tuned_by_its_poses_alone(tmp_path: Path):
    log, model = swung(tmp_path / "a.mcap", Rotation.identity(), 0.0), tmp_path / "arm.xml"
    model.write_text(ARM.format(damping=0.3))
    tuning = tn.tune(log, model=model, parameters=["joint/hinge.damping=0:1"])
    assert tuning.verdict == "ok", tuning.reason
    row = tuning.to_frame().loc["joint/hinge.damping"]
    assert abs(row.value - 0.1) < 0.001
    assert row.low < 0.1 < row.high


def at(frame: str, columns: str = "xyz") -> Signal:
    stamps_ns = START_NS + 10_000_000 * np.arange(50)
    values = np.random.default_rng(0).normal(size=(50, len(columns)))
    unit = "m" if columns == "xyz" else "1"
    return Signal("/x/tool", stamps_ns, values, tuple(columns), unit, frame=frame)


@pytest.mark.parametrize(
    ("frame", "reference", "words"),
    [
        ("", "", "position of tool"),
        ("/map", "", "position of tool"),
        ("robot/ODOM", "", "position of tool"),
        ("robot/link", "link", "position of tool from link"),
        ("camera", "", "position of tool, frame camera taken for the world"),
        ("x\n\x1b[31m" * 99, "", "taken for the world"),
    ],
)
def test_frames_are_found_by_name(frame: str, reference: str, words: str):
    sensed, said = sensed_pose(at(frame), "", ["world", "link", "tool"])
    assert sensed is not None
    assert {one.reference for one in sensed.sensors} == {reference}
    assert words in said
    assert said.isprintable()
    assert len(said) < 300


def test_a_body_in_its_own_frame_is_not_compared():
    sensed, said = sensed_pose(at("tool"), "", ["world", "link", "tool"])
    assert sensed is None
    assert "own frame" in said
