"""What sensors add to what they measure is found beside the model's own numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tunenet_logs as tn
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.mujoco import mujoco

RATE_HZ, LENGTH_S, STEP_S = 100, 6.0, 0.0001  # a fifth of the model's step: a log is of no steps
ARM = """
<mujoco>
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="pan" axis="0 0 1" damping=".5" armature=".02"/>
      <inertial pos=".15 0 0" mass="1" diaginertia=".002 .01 .01"/>
      <body name="fore" pos=".3 0 0">
        <joint name="roll" axis="1 .2 0" damping=".3" armature=".02"/>
        <inertial pos=".1 0 0" mass=".6" diaginertia=".002 .004 .004"/>
        <body name="tool" pos=".2 0 0">
          <site name="wrist"/>
          <inertial pos=".05 .02 .01" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="pan" joint="pan" kp="60" kv="3"/>
    <position name="roll" joint="roll" kp="40" kv="2"/>
  </actuator>
  <sensor><force site="wrist"/><torque site="wrist"/></sensor>
</mujoco>
"""
MASS_KG, OFFSET_N, OFFSET_NM, GAIN, BIAS_NM = 0.5, (3.0, -1.5, 2.2), (0.1, 0.0, -0.2), 1.3, 0.4


def arm(mass_kg: float) -> str:
    """The arm with a tool of this mass and its inertia, which go together."""
    return ARM.format(mass=mass_kg, inertia=0.002 * mass_kg)


def swung(seconds: Array) -> Array:
    """Commands of both joints, shape (T, 2)."""
    ways = np.column_stack([0.8 * np.sin(2.2 * seconds), 1.4 * np.sin(3.1 * seconds)])
    return ways * np.minimum(seconds, 1.0)[:, None]


@pytest.fixture(scope="module")
def tracked() -> Episode:
    """The arm's log by a loop of MuJoCo's own, with noise and with what its sensors add."""
    model = mujoco().MjModel.from_xml_string(arm(MASS_KG))
    model.opt.timestep = STEP_S
    data = mujoco().MjData(model)
    rows: list[Array] = []
    every = round(1 / RATE_HZ / STEP_S)
    for step in range(round(LENGTH_S / STEP_S)):
        data.ctrl[:] = swung(np.array([step // every * every * STEP_S]))[0]
        if step % every == every // 2:  # between two commands, at which efforts jump
            mujoco().mj_forward(model, data)
            tool_m = data.body("tool").xpos
            rows.append(np.concatenate([data.qpos, data.qfrc_actuator, data.sensordata, tool_m]))
        mujoco().mj_step(model, data)
    seen = np.array(rows)
    seen[:, 2] = GAIN * seen[:, 2] + BIAS_NM
    seen[:, 4:7] += OFFSET_N
    seen[:, 7:10] += OFFSET_NM
    seen += 0.005 * np.std(seen, axis=0) * np.random.default_rng(1).standard_normal(seen.shape)
    seconds = np.arange(len(seen)) / RATE_HZ
    told_ns = 10**18 + np.round(1e9 * seconds).astype(np.int64)
    stamps_ns = told_ns + round(1e9 * STEP_S * (every // 2))
    joints = ("pan", "roll")
    signals = [
        Signal("/joint_states.position", stamps_ns, seen[:, :2], joints, "rad"),
        Signal("/joint_states.effort", stamps_ns, seen[:, 2:4], joints, "N·m"),
        Signal("/joint_commands.position", told_ns, swung(seconds), joints, "rad"),
        Signal("/ft.force", stamps_ns, seen[:, 4:7], ("x", "y", "z"), "N", frame="wrist"),
        Signal("/ft.torque", stamps_ns, seen[:, 7:10], ("x", "y", "z"), "N·m", frame="wrist"),
        Signal("/mocap/tool", stamps_ns, seen[:, 10:], ("x", "y", "z"), "m"),
    ]
    return Episode(EpisodeInfo(), {one.name: one for one in signals})


@pytest.fixture(scope="module")
def log(tracked: Episode) -> Episode:
    """The same without the tool's place."""
    seen = {name: one for name, one in tracked.signals.items() if name != "/mocap/tool"}
    return Episode(EpisodeInfo(), seen)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """The arm with another tool."""
    path = tmp_path / "arm.xml"
    path.write_text(arm(0.3))
    return path


def found(log: Episode, model: Path, *wanted: str) -> Mapping[str, tuple[float, float, float]]:
    """Tune; return each value with its interval."""
    tuning = tn.tune(log, model=model, parameters=wanted)
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.interval95 is not None
    assert tuning.trace is not None
    ends = (pair for pair in tuning.interval95)
    return {
        one.name: (value, *pair)
        for one, value, pair in zip(
            tuning.parameters, tuning.trace.estimate.tolist(), ends, strict=True
        )
    }


def test_a_wrench_is_off_and_the_tool_is_weighed(log: Episode, model: Path):
    wrench = {f"site/wrist.force_offset[{axis}]": OFFSET_N[axis] for axis in range(3)}
    wrench |= {f"site/wrist.torque_offset[{axis}]": OFFSET_NM[axis] for axis in range(3)}
    efforts = {"joint/pan.effort_gain": GAIN, "joint/pan.effort_offset": BIAS_NM}
    truth = {"body/tool.mass": MASS_KG, **wrench, **efforts}
    values = found(log, model, "body/tool.mass=.1:1", *wrench, *efforts)
    held = 0
    for name, expected in truth.items():
        value, low, high = values[name]
        held += low <= expected <= high
        assert value == pytest.approx(expected, rel=0.02, abs=0.02), name
    assert held >= 8


def test_without_the_offsets_the_log_is_doubted(log: Episode, model: Path):
    tuning = tn.tune(log, model=model, parameters=["body/tool.mass=.1:1"])
    assert tuning.verdict != "ok"


def test_what_no_sensor_measures_cannot_be_told(log: Episode, model: Path):
    seen = {name: one for name, one in log.signals.items() if "ft" not in name}
    wanted = ["body/tool.mass=.1:1", "site/wrist.force_offset[0]"]
    tuning = tn.tune(Episode(EpisodeInfo(), seen), model=model, parameters=wanted)
    [check] = [one for one in tuning.checks if one.name == "every parameter is identifiable"]
    assert not check.passed
    assert "site/wrist.force_offset[0]" in check.detail


def test_an_offset_needs_its_axis(log: Episode, model: Path):
    with pytest.raises(UsageError, match=r"force_offset has 3 numbers.*force_offset\[0\]"):
        tn.tune(log, model=model, parameters=["site/wrist.force_offset"])


OFFSETS = [f"site/wrist.{of}_offset[{axis}]" for of in ("force", "torque") for axis in range(3)]
ADDED = ("body/tool.mass=.1:1", *OFFSETS, "joint/pan.effort_gain", "joint/pan.effort_offset")


STATES, EFFORTS = "/joint_states.position", "/joint_states.effort"
COMMANDS, WRENCH, TOOL = "/joint_commands.position", "/ft", "/mocap/tool"


def late(log: Episode, by_s: Mapping[str, float]) -> Episode:
    """A log whose signals that begin so have later stamps; no others."""
    return Episode(
        EpisodeInfo(),
        {
            name: replace(one, stamps_ns=one.stamps_ns + round(1e9 * later_s))
            for name, one in log.signals.items()
            for begin, later_s in by_s.items()
            if name.startswith(begin)
        },
    )


@pytest.mark.parametrize(
    ("begin", "kind", "by_s"), [(WRENCH, "wrenches", 0.1374), (TOOL, "poses", 0.0263)]
)
def test_a_sensor_is_late_and_commands_are_too(
    tracked: Episode, model: Path, begin: str, kind: str, by_s: float
):
    """Commands 21.2 ms before their effect, efforts 12.3 ms after theirs."""
    seen = late(tracked, {COMMANDS: -0.0212, STATES: 0.0, EFFORTS: 0.0123, begin: by_s})
    truth = {"delay/commands": 0.0212, "delay/efforts": 0.0123, f"delay/{kind}": by_s}
    added = ADDED if kind == "wrenches" else [one for one in ADDED if "offset[" not in one]
    values = found(seen, model, *added, *truth)
    for name, expected in truth.items():
        value, low, high = values[name]
        assert value == pytest.approx(expected, abs=1e-3), name
        assert low <= expected <= high, name


def test_a_sensor_may_be_early(tracked: Episode, model: Path):
    seen = late(tracked, {COMMANDS: 0.0, STATES: 0.0, TOOL: -0.0263})
    values = found(seen, model, "joint/pan.damping", "delay/poses=-.1:.1")
    value, low, high = values["delay/poses"]
    assert value == pytest.approx(-0.0263, abs=1e-3)
    assert low <= -0.0263 <= high


def test_without_positions_delays_are_told_only_together(tracked: Episode, model: Path):
    seen = late(tracked, {COMMANDS: 0.0, WRENCH: 0.0374})
    wanted = [*ADDED[:7], "delay/wrenches", "delay/commands"]
    tuning = tn.tune(seen, model=model, parameters=wanted)
    [check] = [one for one in tuning.checks if one.name == "every parameter is identifiable"]
    assert not check.passed
    assert "delay/wrenches (only together with delay/commands)" in check.detail


def test_when_a_free_body_begins_its_poses_tell(tmp_path: Path):
    path = tmp_path / "ball.xml"
    ball = '<body name="ball"><freejoint/><geom size=".1"/></body>'
    path.write_text(f"<mujoco><worldbody>{ball}</worldbody></mujoco>")
    stamps_ns = 10**18 + 10_000_000 * np.arange(100)
    places = np.random.default_rng(0).normal(size=(100, 3))
    seen = Signal("/mocap/ball", stamps_ns, places, ("x", "y", "z"), "m")
    with pytest.raises(UsageError, match="they tell where body ball begins"):
        tn.tune(Episode(EpisodeInfo(), {seen.name: seen}), model=path, parameters=["delay/poses"])
