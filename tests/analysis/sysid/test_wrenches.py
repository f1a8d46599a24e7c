"""Wrenches of a load on an arm that MuJoCo alone moves: matched, compared, and with which sign."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tunenet_logs as tn
from tests.driven_logs import (
    JOINT_STATE,
    NUMBERS,
    START_NS,
    WRENCH,
    Sent,
    header,
    numbers,
    wrench,
    write_cdr,
)
from tunenet_logs.analysis.sysid.matching import Match, sensed_wrench
from tunenet_logs.analysis.sysid.source import Connected, ModelSource
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.mujoco import mujoco

LOAD_KG = 0.8
# Of what moves it; commands come every so many steps, and so many later all is measured, from step
# 0 on.
STEP_NS, EVERY, SHIFT, STEPS = 200_000, 50, 30, range(-2500, 20_000)

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
        data.ctrl[0] = 0.6 * np.sin(4 * (step // EVERY * EVERY) * 1e-9 * STEP_NS)
        angle = float(data.qpos[0])
        mujoco().mj_step(model, data)
        if step >= 0 and step % EVERY == SHIFT:
            rows.append((float(data.ctrl[0]), angle, data.sensordata.copy()))
    commands, angles, wrenches = zip(*rows, strict=True)
    return np.array(commands), np.array(angles), np.array(wrenches)


def written(path: Path, sign: float = 1.0, offset_n: float = 0.0) -> Path:
    """Its log, with noise."""
    rng = np.random.default_rng(0)
    sent: list[Sent] = []
    for number, (command, angle, six) in enumerate(zip(*moved(), strict=True)):
        at_ns = number * EVERY * STEP_NS
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


def connected(log: Path, folder: Path, told: Mapping[str, str]) -> Connected:
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
    found = connected(written(tmp_path / "run.mcap", -1.0), tmp_path, {})
    (words,) = found.doubts
    assert "--map /ft=-site/wrist" in words
    assert any("force at site wrist, of its parent on it" in one for one in found.used)
    turned = connected(tmp_path / "run.mcap", tmp_path, {"/ft": "-site/wrist"})
    assert not turned.doubts
    back = connected(written(tmp_path / "a.mcap"), tmp_path, {"/ft": "-site/wrist"})
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


def test_a_frame_of_another_name_is_said():
    model = mujoco().MjModel.from_xml_string(ARM.format(mass=1, sensors=""))
    assert (
        "frame base_link taken"
        in sensed_wrench(force("/wrist.force", frame="base_link"), "", model)[1]
    )
    assert "taken" not in sensed_wrench(force("/wrist.force", frame="tool"), "", model)[1]


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
