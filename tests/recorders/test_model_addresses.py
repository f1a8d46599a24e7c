"""What an address of `--tune` names in a model, and what it says where it names nothing."""

from __future__ import annotations

from typing import Any

import pytest

from tests.recorders.tunable_model import compiled, one, refusal
from tunenet_logs.recorders.simulators.model.parameters import element_names
from tunenet_logs.recorders.simulators.mujoco import mujoco as library

mujoco = library()


@pytest.fixture(scope="module")
def model() -> Any:
    return compiled()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("joint/hinge.damping[1]=0:1", "damping has 1 number"),
        ("geom/block.friction=0:1", "friction[0] to friction[2]"),
        ("geom/block.friction[3]=0:1", "friction[0] to friction[2]"),
        ("geom/block.friction[300]=0:1", "friction[0] to friction[2]"),
        ("option.gravity=0:1", "gravity[0] to gravity[2]"),
        ("geom/block.friction[-1]=0:1", "KIND/NAME.FIELD"),
        ("joint/hinge.dampin=0:1", "damping, frictionloss"),
        ("joint/hing.damping=0:1", "nearest: hinge"),
        ("joint/Hinge.damping=0:1", "nearest: hinge"),
        ("joint/qqqq.damping=0:1", "nearest: hinge, slide"),
        ("joint.damping=0:1", "hinge"),
        ("joint/arm.damping=0:1", "hinge"),
        ("joints/hinge.damping=0:1", "KIND/NAME.FIELD"),
        ("option/any.gravity[0]=0:1", "option.gravity[2]"),
        ("option.timestep=0:1", "gravity, density"),
        ("hinge", "KIND/NAME.FIELD"),
        ("", "KIND/NAME.FIELD"),
        ("\n", "KIND/NAME.FIELD"),
        ("joint/a\nb.damping=0:1", "no such joint"),
        ("joint/\x1b[31m.damping=0:1", "no such joint"),
        ("joint/" + "x" * 100_000 + ".damping=0:1", "no such joint"),
        ("x" * 100_000, "KIND/NAME.FIELD"),
        ("=" * 10_000, "KIND/NAME.FIELD"),
        ("joint/ball.springref=0:1", "no single position"),
        ("joint/block.springref=0:1", "no single position"),
        ("body/world.mass=1:2", "cannot move"),
        ("body/bolted.mass=1:2", "cannot move"),
        ("geom/bolted.friction[0]=0:1", "touches nothing"),
        ("actuator/speed.kp=0:1", "write kv"),
        ("actuator/motor.kv=0:1", "no kv"),
        ("actuator/muscle.kp=0:1", "no kp"),
        ("actuator/muscle.kv=0:1", "no kv"),
        ("actuator/damper.kp=0:1", "no kp"),
    ],
)
def test_what_is_no_parameter_is_refused_in_one_line(model: Any, text: str, words: str):
    assert words in refusal(model, text)


@pytest.mark.parametrize(
    "texts",
    [
        ("joint/hinge.damping=0:1", "joint/hinge.damping=0:2"),
        ("joint/hinge.damping=0:1", "joint/hinge.damping[0]=0:2"),
        ("geom/block.friction[0]", "geom/block.friction[00]"),
        ("delay/commands", " delay/commands=0:0.1"),
    ],
)
def test_nothing_is_named_twice(model: Any, texts: tuple[str, ...]):
    assert "named twice" in refusal(model, *texts)


NAMES = [
    "a.damping",
    "robot/arm/elbow",
    "left elbow",
    "j[0]",
    "gelenk_ü",
    "关节",
    "a=b",
    "a:b=c",
    "-",
    "delay/commands",
    "x" * 200,
]


@pytest.mark.parametrize("name", NAMES)
def test_any_name_can_be_written(name: str):
    spec = mujoco.MjSpec()
    for each in (name, "other"):
        body = spec.worldbody.add_body(name=each, mass=1, inertia=[1, 1, 1])
        body.explicitinertial = True
        body.add_joint(name=each, damping=[2.0, 0.0, 0.0])
    model = spec.compile()
    for address in (f"joint/{name}.damping", f"body/{name}.mass"):  # one name of two kinds
        for text in (address, f"{address}=0.5:9", f" {address} = 0.5 : 9 "):
            tuned = one(model, text)
            assert tuned.parameter.name == address
            assert tuned.owner == address.rpartition(".")[0]
    copy = model.__copy__()
    one(model, f"joint/{name}.damping=0:9").put(copy, 7.0)
    assert copy.dof_damping.tolist() == [7.0, 2.0]


def test_what_has_no_name_cannot_be_named():
    xml = "<body><joint/><geom size='.1'/></body>" * 2
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{xml}</worldbody></mujoco>")
    assert element_names(model, "joint") == ["", ""]
    for text in ("joint/0.damping=0:1", "joint.damping=0:1"):
        assert "name the joint in the model" in refusal(model, text)
    assert "KIND/NAME.FIELD" in refusal(model, "joint/.damping=0:1")
