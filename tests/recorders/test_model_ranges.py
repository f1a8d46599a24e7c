"""Where a model's parameter is looked for, and what no range may reach."""

from __future__ import annotations

import math
from typing import Any

import pytest

from tests.recorders.tunable_model import MODEL, compiled, one, refusal
from tunenet_logs.recorders.simulators.model.parameters import model_parameters
from tunenet_logs.recorders.simulators.mujoco import mujoco


@pytest.fixture(scope="module")
def model() -> Any:
    return compiled()


def test_a_range_is_the_models_value_and_five_times_more_and_less(model: Any):
    ranges = {
        "joint/hinge.damping": (0.02, 0.5),
        "option.gravity[2]": (-9.81 * 5, -9.81 / 5),
        "geom/block.friction[0]": (0.0, 1.5),
        "geom/block.solimp[0]": (0.16, 1.0),
        "delay/commands": (0.0, 0.2),
    }
    for address, expected in ranges.items():
        assert one(model, address).parameter.training_range == pytest.approx(expected)
    assert math.isclose(one(model, "joint/hinge.damping=1:2").parameter.initial, 1.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("joint/hinge.damping=0:-1", "no LOW:HIGH"),
        ("joint/hinge.damping=1:1", "no LOW:HIGH"),
        ("joint/hinge.damping=nan:1", "no LOW:HIGH"),
        ("joint/hinge.damping=0:inf", "no LOW:HIGH"),
        ("joint/hinge.damping=0:1e999", "no LOW:HIGH"),
        ("joint/hinge.damping=a:b", "no LOW:HIGH"),
        ("joint/hinge.damping=5", "no LOW:HIGH"),
        ("joint/hinge.damping=", "no LOW:HIGH"),
        ("joint/hinge.damping=:", "no LOW:HIGH"),
        ("joint/hinge.damping=1:2:3", "no LOW:HIGH"),
        ("joint/hinge.damping=0:1e12", "over 1e+09"),
        ("joint/hinge.damping=-1:1", "below 0"),
        ("body/arm.mass=0:1", "below 1e-06"),
        ("body/arm.inertia[0]=0:1", "below 1e-09"),
        ("geom/block.solimp[0]=0:2", "over 1"),
        ("geom/block.solimp[4]=0:2", "below 1"),
        ("delay/commands=0:2", "over 1"),
        ("delay/commands=-1:0.1", "below 0"),
        ("joint/block.damping", "tells no range"),
        ("joint/hinge.frictionloss=-1:1", "below 0"),
        ("joint/hinge.armature=-1:1", "below 0"),
        ("joint/hinge.stiffness=-2:-1", "below 0"),
        ("joint/hinge.damping=-2:-1", "below 0"),
        ("body/arm.mass=-2:-1", "below 1e-06"),
        ("geom/block.friction[0]=-1:1", "below 0"),
        ("actuator/servo.kp=-1:1", "below 0"),
        ("actuator/servo.kv=-2:-1", "below 0"),
        ("tendon/belt.damping=-1:1", "below 0"),
        ("option.density=-1:1", "below 0"),
        ("geom/block.solref[0]=-1000:1", "above 0 it is a time constant, below 0 a stiffness"),
        ("geom/block.solref[0]=0:1", "two laws"),
        ("geom/block.solref[1]=-1:1", "above 0 it is a damping ratio, below 0 a damping"),
        ("geom/block.solref[0]=-1000:-10", "geom/block.solref[1] is 0.7"),
        ("geom/block.solref[1]=-1000:-10", "geom/block.solref[0] is 0.03"),
    ],
)
def test_what_is_no_range_is_refused_in_one_line(model: Any, text: str, words: str):
    assert words in refusal(model, text)


def test_a_solref_keeps_the_law_of_its_sign(model: Any):
    for index in (0, 1):
        parameter = one(model, f"geom/block.solref[{index}]=0.001:2").parameter
        assert parameter.bounds == (1e-9, 1e9)
    texts = ["geom/block.solref[0]=-1e5:-100", "geom/block.solref[1]=-1000:-10"]
    both = model_parameters(model, texts)
    assert [tuned.parameter.bounds for tuned in both] == [(-1e9, -1e-9)] * 2
    assert "solref of two signs" in refusal(model, texts[0], "geom/block.solref[1]=0.1:2")


@pytest.mark.parametrize("field", ["damping", "stiffness", "armature", "frictionloss"])
def test_what_physics_forbids_in_a_model_tells_no_range(field: str):
    text = MODEL.replace('<joint name="hinge"', '<joint name="other"').replace(
        '<body name="bolted">', f'<body name="odd" pos="9 0 0"><joint name="odd" {field}="-1"/>'
    )
    text = text.replace('joint="hinge"', 'joint="other"')
    odd = mujoco().MjModel.from_xml_string(text)
    assert "is -1 in the model, which tells no range" in refusal(odd, f"joint/odd.{field}")
    assert one(odd, f"joint/odd.{field}=0:1").parameter.initial == 0.0
