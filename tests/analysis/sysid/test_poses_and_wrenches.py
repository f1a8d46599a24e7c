"""Orientations, positions in frames of bodies, and wrenches: of what MuJoCo alone moves."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tunenet_logs as tn
from tests.message_logs import (
    JOINT_STATE,
    NUMBERS,
    POSE,
    START_NS,
    TF,
    WRENCH,
    Sent,
    header,
    numbers,
    pose,
    transform,
    wrench,
    write_cdr,
)
from tunenet_logs.analysis.sysid.matching import Match, sensed_pose, sensed_wrench
from tunenet_logs.analysis.sysid.source import Connected, ModelSource
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.mujoco import mujoco

STEP_NS, EVERY, COUNT = 200_000, 25, 240
THROWN = """<mujoco><option timestep="0.001"/><worldbody>
  <body name="room" pos="1 2 0" euler="0 0 90"/>
  <body name="bat" pos="0 0 1"><freejoint/>
    <inertial pos="0 0 0" mass="1" diaginertia="{inertia} .004 .006"/></body>
</worldbody></mujoco>"""
ROOM = Rotation.from_euler("z", 90, degrees=True)
SWINGING = """<mujoco><option timestep="0.001"/>
  <default><geom contype="0" conaffinity="0"/></default>
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
    for number, (places, turns) in enumerate(
        samples(SWINGING.format(damping=0.1), {1: spin_rad_s})
    ):
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
    model.write_text(SWINGING.format(damping=0.3))
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
    model.write_text(SWINGING.format(damping=0.3))
    tuning = tn.tune(log, model=model, parameters=["joint/hinge.damping=0:1"])
    assert tuning.verdict == "ok", tuning.reason
    row = tuning.to_frame().loc["joint/hinge.damping"]
    assert abs(row.value - 0.1) < 0.001
    assert row.low < 0.1 < row.high


@pytest.mark.parametrize(
    ("frame", "reference", "words"),
    [
        ("", "", "position of tool"),
        ("/map", "", "position of tool"),
        ("robot/ODOM", "", "position of tool"),
        ("robot/link", "link", "position of tool from link"),
        ("camera", "", "position of tool, frame camera taken for the world"),
        ("x\n\x1b[31m" * 99, "", "taken for the world"),
        ("tool", None, "own frame"),
    ],
)
def test_frames_are_found_by_name(frame: str, reference: str | None, words: str):
    stamps_ns = START_NS + 10_000_000 * np.arange(50)
    values = np.random.default_rng(0).normal(size=(50, 3))
    seen = Signal("/x/tool", stamps_ns, values, ("x", "y", "z"), "m", frame=frame)
    sensed, said = sensed_pose(seen, "", ["world", "link", "tool"])
    assert (sensed is None) == (reference is None)
    if sensed is not None:
        assert {one.reference for one in sensed.sensors} == {reference}
    assert words in said
    assert said.isprintable()
    assert len(said) < 300


LOAD_KG = 0.8
# Of what moves it; commands come every so many steps, and so many later all is measured, from step
# 0 on.
OFTEN, SHIFT, STEPS = 50, 30, range(-2500, 20_000)
ARM = """<mujoco><option timestep="0.001" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody><body name="link"><joint name="hinge" axis="0 1 0" damping=".3"/>
    <geom type="capsule" size=".03" fromto="0 0 0 .4 0 0" mass="1.5"/>
    <body name="tool" pos=".4 0 0"><site name="wrist" euler="0 0 30"/>
      <geom size=".05" pos=".1 0 0" mass="{mass}"/></body></body></worldbody>
  <actuator><position name="servo" joint="hinge" kp="60" kv="6"/></actuator>{sensors}</mujoco>"""
SENSORS = '<sensor><force name="ft_force" site="wrist"/><torque site="wrist"/></sensor>'
TUNE = ("body/tool.mass=.05:3",)


def moved() -> tuple[Array, Array, Array]:
    """Commands, angles and wrenches as MuJoCo's own sensors have them, shape (T, 1, 1 or 6)."""
    model = mujoco().MjModel.from_xml_string(ARM.format(mass=LOAD_KG, sensors=SENSORS))
    model.opt.timestep = 1e-9 * STEP_NS
    data = mujoco().MjData(model)
    rows: list[tuple[float, float, Array]] = []
    for step in STEPS:
        data.ctrl[0] = 0.6 * np.sin(4 * (step // OFTEN * OFTEN) * 1e-9 * STEP_NS)
        angle = float(data.qpos[0])
        mujoco().mj_step(model, data)
        if step >= 0 and step % OFTEN == SHIFT:
            rows.append((float(data.ctrl[0]), angle, data.sensordata.copy()))
    commands, angles, wrenches = zip(*rows, strict=True)
    return np.array(commands), np.array(angles), np.array(wrenches)


def written(path: Path, sign: float = 1.0, offset_n: float = 0.0) -> Path:
    """Its log, with noise."""
    rng = np.random.default_rng(0)
    sent: list[Sent] = []
    for number, (command, angle, six) in enumerate(zip(*moved(), strict=True)):
        at_ns = number * OFTEN * STEP_NS
        seen_ns = at_ns + SHIFT * STEP_NS
        force = sign * six[:3] + 0.05 * rng.standard_normal(3) + offset_n
        torque = sign * six[3:] + 0.01 * rng.standard_normal(3)
        fields: dict[str, Any] = {"header": header(START_NS + seen_ns), "name": ["hinge"]}
        seen_rad = float(angle + 0.001 * rng.standard_normal())
        fields |= {"position": [seen_rad], "velocity": [], "effort": []}
        sent.append(("/servos/commands", NUMBERS, at_ns, numbers(float(command))))
        sent.append(("/joint_states", JOINT_STATE, seen_ns, fields))
        measured = wrench(START_NS + seen_ns, force.tolist(), torque.tolist(), "wrist")
        sent.append(("/ft", WRENCH, seen_ns, measured))
    return write_cdr(path, sent)


def model_file(folder: Path, sensors: str = "") -> Path:
    """The owner's model, with another load."""
    path = folder / "arm.xml"
    path.write_text(ARM.format(mass=0.3, sensors=sensors))
    return path


def loaded(log: Path, folder: Path, told: Mapping[str, str]) -> Connected:
    return ModelSource(model_file(folder), TUNE, told).connect(read_episode(log))


@pytest.mark.parametrize(
    ("sign", "told"), [(1.0, {}), (1.0, {"/ft": "site/wrist"}), (-1.0, {"/ft": "-site/wrist"})]
)
def test_a_load_is_found_by_its_wrench(sign: float, told: Mapping[str, str], tmp_path: Path):
    log = written(tmp_path / "run.mcap", sign)
    tuning = tn.tune(log, model=model_file(tmp_path), parameters=TUNE, mapping=told)
    assert tuning.verdict == "ok", tuning.reason
    row = tuning.to_frame().loc["body/tool.mass"]
    assert abs(row.value - LOAD_KG) < 0.004
    assert row.low < LOAD_KG < row.high
    assert {column.signal for column in tuning.detection.connected.target.columns} >= {
        "/ft.force",
        "/ft.torque",
    }


def test_a_sign_that_is_the_other_one_is_said_and_not_turned(tmp_path: Path):
    found = loaded(written(tmp_path / "run.mcap", -1.0), tmp_path, {})
    (words,) = found.doubts
    assert "--map /ft=-site/wrist" in words
    assert any("force at site wrist, of its parent on it" in one for one in found.used)
    turned = loaded(tmp_path / "run.mcap", tmp_path, {"/ft": "-site/wrist"})
    assert not turned.doubts
    back = loaded(written(tmp_path / "a.mcap"), tmp_path, {"/ft": "-site/wrist"})
    assert "--map /ft=site/wrist" in back.doubts[0]


def test_an_offset_is_not_fitted_and_is_seen(tmp_path: Path):
    log = written(tmp_path / "run.mcap", offset_n=5.0)
    tuning = tn.tune(log, model=model_file(tmp_path), parameters=TUNE)
    assert tuning.verdict != "ok"


def test_a_load_at_rest_is_held_up():
    """The sign that is documented: with the weight hanging, z points up."""
    model = mujoco().MjModel.from_xml_string(ARM.format(mass=2, sensors=SENSORS))
    data = mujoco().MjData(model)
    data.qacc[:] = 0
    mujoco().mj_inverse(model, data)
    assert data.sensordata[:3] == pytest.approx([0, 0, 2 * 9.81])


def force(name: str = "/ft.force", unit: str = "N", frame: str = "") -> Signal:
    stamps_ns = START_NS + 10_000_000 * np.arange(50)
    values = np.random.default_rng(0).normal(size=(50, 3))
    return Signal(name, stamps_ns, values, ("x", "y", "z"), unit, drives=True, frame=frame)


@pytest.mark.parametrize(
    ("signal", "expected"),
    [
        (force("/ft.force"), "site wrist"),  # by the sensor's name
        (force("/ft/raw.torque", "N·m"), "site wrist"),
        (force("/wrist.force"), "site wrist"),
        (force("/sensor.force", frame="robot/Wrist"), "site wrist"),
        (force("/tool.force"), "body tool"),
        (force("/sensor.force", frame="tool"), "body tool"),
        (force("/wrist.force", frame="tool"), "site wrist"),  # a site goes before a body
        (
            force("/wrist.force", frame="base_link"),
            "site wrist, of its parent on it, frame base_link",
        ),
        (force("/else.force"), "no force sensor, site or body"),
        (force("/else.force", frame="world"), "no force sensor, site or body"),
        (force("/loose.force"), "hangs on nothing"),
    ],
)
def test_places_are_found_by_name(signal: Signal, expected: str):
    loose = '<body name="loose"><freejoint/><geom size=".1"/></body></worldbody>'
    text = ARM.format(mass=1, sensors=SENSORS).replace("</worldbody>", loose)
    sensed, words = sensed_wrench(signal, "", mujoco().MjModel.from_xml_string(text))
    assert expected in words
    assert (sensed is not None) == expected.startswith(("site", "body"))


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("site/wrong", "there is: commands, states, -, site/wrist"),
        ("-site/wrong", "no part of the model"),
        ("-joint/hinge", "no part of the model"),
        ("-", ""),
        ("-body/tool", ""),
    ],
)
def test_what_a_user_says_of_a_wrench(target: str, words: str):
    model = mujoco().MjModel.from_xml_string(ARM.format(mass=1, sensors=""))
    states = Signal("/j.position", force().stamps_ns, force().values[:, :1], ("hinge",), "rad")
    log = Episode(EpisodeInfo(), {one.name: one for one in (force(), states)})
    if words:
        with pytest.raises(UsageError) as caught:
            Match(log, model, {"/ft": target})
        assert words in f"{caught.value} {caught.value.remedy}"
    else:
        assert len(Match(log, model, {"/ft": target}).sensed) == (1 if target == "-" else 2)
    with pytest.raises(UsageError, match="is no force in N"):
        Match(log, model, {"/j": "site/wrist"})
