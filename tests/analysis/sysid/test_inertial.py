"""A body's mass, centre and inertia as one group, of which any values are physical."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tunenet_logs as tn
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.model.parameters import ModelParameter, model_parameters
from tunenet_logs.recorders.simulators.mujoco import mujoco

GIMBAL = """
<mujoco>
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="arm">
      <joint name="pan" axis="0 0 1" damping=".1" armature=".02"/>
      <inertial pos=".1 0 0" mass=".5" diaginertia=".002 .002 .002"/>
      <body name="wrist" pos=".25 0 0">
        <joint name="tilt" axis="0 1 0" damping=".1" armature=".01"/>
        <joint name="roll" axis="1 0 0" damping=".1" armature=".01"/>
        <inertial pos="0 0 0" mass=".2" diaginertia=".001 .001 .001"/>
        <body name="tool" pos=".05 0 0">
          <site name="flange"/>
          <inertial {inertial}/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="pan" joint="pan" kp="60" kv="3"/>
    <position name="tilt" joint="tilt" kp="60" kv="3"/>
    <position name="roll" joint="roll" kp="60" kv="3"/>
  </actuator>
  <sensor><force site="flange"/><torque site="flange"/></sensor>
</mujoco>
"""
TRUE = 'pos=".05 .02 .08" mass=".6" fullinertia=".0025 .0031 .0018 .0004 -.0003 .0005"'
GIVEN = 'pos="0 0 0" mass=".3" diaginertia=".002 .002 .002"'
JOINTS = ("pan", "tilt", "roll")


def compiled(inertial: str) -> Any:
    return mujoco().MjModel.from_xml_string(GIMBAL.format(inertial=inertial))


def inertia_of(model: Any) -> Array:
    """The tool's inertia about its centre in the body's frame, shape (3, 3)."""
    number, turn = model.body("tool").id, np.empty(9)
    mujoco().mju_quat2Mat(turn, model.body_iquat[number])
    axes = turn.reshape(3, 3)
    return axes @ np.diag(model.body_inertia[number]) @ axes.T


def put(model: Any, parameters: Sequence[ModelParameter], values: Sequence[float]) -> None:
    for one, value in zip(parameters, values, strict=True):
        one.put(model, value)


def swung() -> Episode:
    """A log of the true tool by a loop of MuJoCo's own: commands, joints, and a wrench."""
    model = compiled(TRUE)
    model.opt.timestep = 0.0001  # a fifth of the model's: a log is of no steps
    data, rows, told = mujoco().MjData(model), list[Array](), list[Array]()
    for step in range(50_000):
        if step % 100 == 0:
            at = np.full(3, 0.0001 * step)
            told.append(
                np.minimum(at, 1.0)
                * np.array([0.8, 0.9, 1.2])
                * np.sin(at * [2.1, 3.3, 4.7] + [0.0, 0.4, 0.0])
            )
            data.ctrl[:] = told[-1]
        if step % 100 == 40:  # between two commands, at which torques jump
            mujoco().mj_forward(model, data)
            rows.append(np.concatenate([data.qpos, data.sensordata]))
        mujoco().mj_step(model, data)
    seen = np.array(rows)
    seen += 0.01 * np.std(seen, axis=0) * np.random.default_rng(3).standard_normal(seen.shape)
    told_ns = 10**18 + 10_000_000 * np.arange(len(seen))
    stamps_ns = told_ns + 4_000_000
    signals = [
        Signal("/joint_states.position", stamps_ns, seen[:, :3], JOINTS, "rad"),
        Signal("/joint_commands.position", told_ns, np.array(told), JOINTS, "rad"),
        Signal("/ft.force", stamps_ns, seen[:, 3:6], ("x", "y", "z"), "N", frame="flange"),
        Signal("/ft.torque", stamps_ns, seen[:, 6:], ("x", "y", "z"), "N·m", frame="flange"),
    ]
    return Episode(EpisodeInfo(), {one.name: one for one in signals})


def test_a_tool_is_found_whole(tmp_path: Path):
    path = tmp_path / "gimbal.xml"
    path.write_text(GIMBAL.format(inertial=GIVEN))
    tuning = tn.tune(swung(), model=path, parameters=["body/tool.inertial"])
    assert tuning.trace is not None
    model = compiled(GIVEN)
    put(model, model_parameters(model, ["body/tool.inertial"]), tuning.trace.estimate.tolist())
    truth, number = compiled(TRUE), model.body("tool").id
    assert model.body_mass[number] == pytest.approx(0.6, rel=0.01)
    assert model.body_ipos[number] == pytest.approx([0.05, 0.02, 0.08], abs=0.001)
    assert np.abs(inertia_of(model) - inertia_of(truth)).max() < 5e-4
    assert tuning.trace.fit is not None
    expected = [one.given for one in model_parameters(truth, ["body/tool.inertial"])]
    low, high = np.array(tuning.trace.fit.interval95).T
    assert np.sum((low <= expected) & (expected <= high)) >= 9
    tn.export(tuning, "mjcf", tmp_path / "tuned.xml")
    again = mujoco().MjModel.from_xml_path(str(tmp_path / "tuned.xml"))
    assert inertia_of(again) == pytest.approx(inertia_of(model), rel=1e-9, abs=1e-15)


def test_any_values_of_the_group_are_physical():
    model = compiled(GIVEN)
    parameters = model_parameters(model, ["body/tool.inertial"])
    assert len(parameters) == 10
    before = inertia_of(model)
    put(model, parameters, [one.given for one in parameters])
    assert inertia_of(model) == pytest.approx(before, rel=1e-9, abs=1e-12)  # as the model has it
    rng = np.random.default_rng(0)
    low, high = np.array([one.parameter.training_range for one in parameters]).T
    for _ in range(200):
        values = rng.uniform(low, high)
        put(model, parameters, values.tolist())
        sizes = np.sort(model.body_inertia[model.body("tool").id])
        assert sizes[0] > 0
        assert sizes[0] + sizes[1] >= sizes[2] * (1 - 1e-9)  # as of any mass
        found = model_parameters(model, [f"body/tool.spread[{index}]=-9:9" for index in (3, 4, 5)])
        assert [one.given for one in found] == pytest.approx(values[7:], rel=1e-6, abs=1e-9)


def test_a_group_has_no_range_of_its_own():
    with pytest.raises(UsageError, match="a group has no range"):
        model_parameters(compiled(GIVEN), ["body/tool.inertial=0:1"])
