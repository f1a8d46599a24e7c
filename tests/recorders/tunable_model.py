"""A model with all that can be tuned, and what an address of `--tune` names in it."""

from __future__ import annotations

from typing import Any

import pytest

from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.model.parameters import ModelParameter, model_parameters
from tunenet_logs.recorders.simulators.mujoco import mujoco

MODEL = """<mujoco><option timestep="0.002" density="500" viscosity="1"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1" friction="0.01 0.005 0.0001" condim="6"/>
    <body name="arm" pos="0 0 1">
      <joint name="hinge" axis="0 1 0" damping="0.1" frictionloss="0.2" armature="0.1"
        stiffness="3" springref="20"/>
      <geom name="arm" type="box" size=".2 .05 .04" pos=".2 0 0" mass="1"/>
      <body name="slider" pos=".4 0 0">
        <joint name="slide" type="slide" axis="1 0 0" damping="1" frictionloss="0.3"
          armature="0.2" stiffness="30" springref="0.05"/>
        <geom name="slider" type="capsule" size=".05 .1" pos="0 .1 0" mass="0.5"/>
        <body name="bob"><joint name="ball" type="ball" damping="0.01" stiffness="0.2"
            frictionloss="0.01" armature="0.01"/>
          <geom name="bob" size=".05" pos="0 0 -.2" mass="0.3"/></body>
      </body>
    </body>
    <body name="block" pos="2 0 0.045">
      <freejoint name="block"/>
      <geom name="block" type="box" size=".1 .1 .05" mass="1" condim="6"
        friction="0.5 0.1 0.1" solref="0.03 0.7" solimp="0.8 0.9 0.01 0.3 3"/>
    </body>
    <body name="bolted"><geom name="bolted" size=".1" contype="0" conaffinity="0"/></body>
  </worldbody>
  <tendon><fixed name="belt" damping="0.2" frictionloss="0.1" stiffness="2" springlength="0.4">
    <joint joint="hinge" coef="1"/><joint joint="slide" coef="2"/></fixed></tendon>
  <actuator>
    <position name="servo" joint="hinge" kp="4" kv="0.5"/>
    <velocity name="speed" joint="slide" kv="3"/>
    <motor name="motor" joint="hinge" gear="2"/>
    <muscle name="muscle" joint="hinge" lengthrange="-1 1"/>
    <damper name="damper" joint="hinge" kv="1" ctrlrange="0 1"/>
    <position name="ratio" joint="slide" kp="5" dampratio="1"/>
  </actuator>
</mujoco>"""


def compiled() -> Any:
    return mujoco().MjModel.from_xml_string(MODEL)


def one(model: Any, text: str) -> ModelParameter:
    return model_parameters(model, [text])[0]


def refusal(model: Any, *texts: str) -> str:
    with pytest.raises(UsageError) as caught:
        model_parameters(model, texts)
    assert caught.value.remedy
    line = str(caught.value)
    assert line.isprintable(), line
    assert len(line) < 600
    return line
