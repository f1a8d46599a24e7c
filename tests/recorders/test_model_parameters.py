"""What `--tune` names in a model, what range it may have, and what a value of it does there."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tunenet_logs.analysis.sysid.source import ModelSource
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.model.parameters import (
    FIELDS,
    ModelParameter,
    element_names,
    model_parameters,
    movable,
)
from tunenet_logs.recorders.simulators.mujoco import mujoco as library

mujoco = library()

# All that can be tuned.
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
    <position name="servo" joint="hinge" kp="4" kv="0.5" forcerange="-1 1"/>
    <velocity name="speed" joint="slide" kv="3"/>
    <motor name="motor" joint="hinge" gear="2"/>
    <muscle name="muscle" joint="hinge" lengthrange="-1 1"/>
    <damper name="damper" joint="hinge" kv="1" ctrlrange="0 1"/>
    <position name="ratio" joint="slide" kp="5" dampratio="1"/>
  </actuator>
</mujoco>"""


@pytest.fixture(scope="module")
def model() -> Any:
    return mujoco.MjModel.from_xml_string(MODEL)


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


# ---- Addresses and ranges


@pytest.mark.parametrize(
    ("text", "words"),
    [
        # addresses
        ("joint/hinge.damping[1]=0:1", "damping has 1 number"),
        ("geom/block.friction=0:1", "friction[0] to friction[2]"),
        ("geom/block.friction[3]=0:1", "friction[0] to friction[2]"),
        ("geom/block.friction[-1]=0:1", "KIND/NAME.FIELD"),
        ("joint/hinge.dampin=0:1", "damping, frictionloss"),
        ("joint/hing.damping=0:1", "nearest: hinge"),
        ("joint/qqqq.damping=0:1", "nearest: hinge, slide"),
        ("joint.damping=0:1", "hinge"),
        ("joints/hinge.damping=0:1", "KIND/NAME.FIELD"),
        ("option/any.gravity[0]=0:1", "option.gravity[2]"),
        ("hinge", "KIND/NAME.FIELD"),
        ("", "KIND/NAME.FIELD"),
        ("joint/a\nb.damping=0:1", "no such joint"),
        ("joint/\x1b[31m.damping=0:1", "no such joint"),
        ("joint/" + "x" * 100_000 + ".damping=0:1", "no such joint"),
        ("x" * 100_000, "KIND/NAME.FIELD"),
        ("joint/ball.springref=0:1", "no single position"),
        ("body/world.mass=1:2", "cannot move"),
        ("body/bolted.mass=1:2", "cannot move"),
        ("geom/bolted.friction[0]=0:1", "touches nothing"),
        ("actuator/speed.kp=0:1", "write kv"),
        ("actuator/motor.kv=0:1", "no kv"),
        ("actuator/muscle.kp=0:1", "no kp"),
        # ranges
        ("joint/hinge.damping=0:-1", "no LOW:HIGH"),
        ("joint/hinge.damping=1:1", "no LOW:HIGH"),
        ("joint/hinge.damping=nan:1", "no LOW:HIGH"),
        ("joint/hinge.damping=0:inf", "no LOW:HIGH"),
        ("joint/hinge.damping=5", "no LOW:HIGH"),
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
def test_what_is_no_parameter_or_range_is_refused_in_one_line(model: Any, text: str, words: str):
    assert words in refusal(model, text)


@pytest.mark.parametrize(
    "texts",
    [
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
    "关节",
    "a:b=c",
    "-",
    "delay/commands",
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
    odd = mujoco.MjModel.from_xml_string(text)
    assert "is -1 in the model, which tells no range" in refusal(odd, f"joint/odd.{field}")
    assert one(odd, f"joint/odd.{field}=0:1").parameter.initial == 0.0


# ---- What giving a parameter a value does

TURNS = ("hinge", "slide", "ball")
# By kind, the elements whose fields are tuned, in the order of `FIELDS`.
ADDRESSES = {
    "joint": [TURNS, TURNS, TURNS, TURNS, ("hinge", "slide")],
    "body": [("arm", "slider", "bob", "block"), ("arm", "slider"), ("arm", "slider")],
    "geom": [("block",)] * 3,
    "actuator": [("servo", "motor", "ratio"), ("servo", "speed", "ratio"), ("motor",), ("servo",)],
    "tendon": [("belt",)] * 3,
    "option": [(None,)] * 3,
}

# What changes nothing here, by what an axis or the model leaves out.
IDLE = re.compile(r"gear\[[1-5]\]|slider\.inertia|arm\.inertia\[[02]\]|arm\.ipos\[1\]|density")


def every_address() -> list[str]:
    found: list[str] = []
    for kind, elements in ADDRESSES.items():
        # Of sensors and of a mass's spread: tests/analysis/sysid/test_sensors, test_inertial.
        fields = [one for one in FIELDS[kind].items() if one[1].array and one[0] != "spread"]
        for (name, field), names in zip(fields, elements, strict=True):
            for element in names:
                owner = kind if element is None else f"{kind}/{element}"
                ends = [f"[{index}]" for index in range(field.size)] if field.size > 1 else [""]
                found += [f"{owner}.{name}{end}" for end in ends]
    return found


def arrays(model: Any) -> dict[str, Any]:
    """All that a model holds, as bytes."""
    names = [name for name in dir(model) if isinstance(getattr(model, name, None), np.ndarray)]
    held: dict[str, Any] = {name: getattr(model, name).tobytes() for name in names}
    for name in ("gravity", "density", "viscosity"):
        held[name] = np.atleast_1d(getattr(model.opt, name)).tobytes()
    return held


def moved(model: Any, tuned: ModelParameter, value: float) -> Any:
    """Where a short motion goes with this value, shape (nq,)."""
    copy = model.__copy__()
    tuned.put(copy, value)
    data = mujoco.MjData(copy)
    mujoco.mj_setConst(copy, data)
    mujoco.mj_resetData(copy, data)
    data.qvel[:] = 0.3
    data.ctrl[:] = [0.4, 0.2, 0.1, 0.0, 0.0, 0.1]
    for _ in range(100):
        mujoco.mj_step(copy, data)
    assert np.isfinite(data.qpos).all()
    return data.qpos.copy()


@pytest.mark.parametrize("address", every_address())
def test_a_value_reaches_the_model_and_moves_it(model: Any, address: str):
    try:
        tuned = one(model, address)
    except UsageError as error:
        if "tells no range" not in str(error):
            raise
        tuned = one(model, f"{address}=0.1:0.9")
    parameter = tuned.parameter
    assert parameter.name == address
    (low, high), (least, most) = parameter.training_range, parameter.bounds
    assert least <= low < high <= most
    assert low <= parameter.initial <= high
    before = arrays(model)
    copy = model.__copy__()
    for value in (low, high, (low + 2 * high) / 3):  # a value leaves no trace of the one before
        tuned.put(copy, value)
        ends = (max(least, value - 1e-4), min(most, value + 1e-4))
        again = one(copy, f"{address}={ends[0]!r}:{ends[1]!r}")
        assert again.parameter.initial == pytest.approx(value, abs=1e-12)
    fresh = model.__copy__()
    tuned.put(fresh, (low + 2 * high) / 3)
    changed = {name for name, held in arrays(fresh).items() if held != before[name]}
    assert 1 <= len(changed) <= 2
    for name in changed - {"body_inertia"}:
        assert arrays(copy)[name] == arrays(fresh)[name]
    np.testing.assert_allclose(copy.body_inertia, fresh.body_inertia, rtol=1e-12)
    assert arrays(model) == before
    first, last = moved(model, tuned, low), moved(model, tuned, high)
    if IDLE.search(address) is None:
        assert not np.array_equal(first, last)
    if parameter.initial != low:  # the model's own value changes nothing
        tuned.put(fresh, parameter.initial)
        for name in changed:
            found, wanted = (np.frombuffer(one[name]) for one in (arrays(fresh), before))
            np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_a_mass_scales_its_moments_of_inertia_whatever_is_named_first(model: Any):
    inertia = model.body("block").inertia.copy()
    tuned = one(model, "body/block.mass=0.1:9")
    copy = model.__copy__()
    for value in (0.1, 4.0):
        tuned.put(copy, value)
    assert copy.body("block").mass == 4.0
    np.testing.assert_allclose(copy.body("block").inertia, 4 * inertia, rtol=1e-12)
    both = model_parameters(model, ["body/block.inertia[0]=0.001:1", "body/block.mass=1:9"])
    copy = model.__copy__()
    for tuned in both:
        tuned.put(copy, {"mass": 2.0, "inertia": 0.5}[tuned.field])
    np.testing.assert_allclose(copy.body("block").inertia, [0.5, *2 * inertia[1:]], rtol=1e-12)


def test_a_servo_keeps_its_form(model: Any):
    copy = model.__copy__()
    for value in (0.0, 7.0):
        one(model, "actuator/servo.kp=0:9").put(copy, value)
        one(model, "actuator/servo.kv=0:9").put(copy, value / 7)
        one(model, "actuator/speed.kv=0:9").put(copy, value)
    gain, bias = copy.actuator_gainprm, copy.actuator_biasprm
    assert (gain[0, 0], bias[0, 1], bias[0, 2]) == (7.0, -7.0, -1.0)
    assert (gain[1, 0], bias[1, 1], bias[1, 2]) == (7.0, 0.0, -7.0)


def test_what_slides_has_other_units(model: Any):
    fields = ("damping", "frictionloss", "armature", "stiffness", "springref")
    units = {
        joint: [one(model, f"joint/{joint}.{field}=0.1:1").parameter.unit for field in fields]
        for joint in ("hinge", "slide")
    }
    assert units["hinge"] == ["N·m·s/rad", "N·m", "kg·m²", "N·m/rad", "rad"]
    assert units["slide"] == ["N·s/m", "N", "kg", "N/m", "m"]


@pytest.mark.parametrize(("joint", "count"), [("ball", 3), ("block", 6), ("hinge", 1)])
def test_all_degrees_of_freedom_of_a_joint_have_one_damping(model: Any, joint: str, count: int):
    copy = model.__copy__()
    one(model, f"joint/{joint}.damping=0:9").put(copy, 5.5)
    assert int(np.sum(copy.dof_damping == 5.5)) == count
    assert (copy.joint(joint).damping == 5.5).all()


# ---- A tuned centre of mass or moment of inertia moves a model as one that is compiled with it

MASSES = """<mujoco><option timestep="0.002" integrator="{integrator}"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="free" pos="0 0 .4"><freejoint/>
      <inertial pos="{free}" mass="1" diaginertia="{inertia} .02 .03"/>
      <geom type="box" size=".1 .15 .05"/></body>
    <body name="cart" pos="0 3 1"><joint type="slide" axis="1 0 0"/>
      <inertial pos="{cart}" mass="2" diaginertia=".01 .02 .03"/>
      <geom type="box" size=".1 .15 .05"/>
      <body name="pole"><joint axis="0 1 0"/>
        <inertial pos="{pole}" mass="0.5" diaginertia=".01 .02 .03"/>
        <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3"/></body></body>
  </worldbody>
</mujoco>"""

# All bodies begin with their centres of mass where MuJoCo takes short cuts.
GIVEN = {"free": "0 0 0", "cart": "0 0 0", "pole": "0 0 0", "inertia": "0.01"}


def spec_of(**said: str) -> Any:
    return mujoco.MjSpec.from_string(MASSES.format(**{**GIVEN, **said}))


def path_of(model: Any) -> Any:
    """A second of it, thrown, shape (steps, nq)."""
    data = mujoco.MjData(model)
    data.qvel[:] = 0.5
    places = []
    for _ in range(500):
        mujoco.mj_step(model, data)
        places.append(data.qpos.copy())
    return np.array(places)


def with_values(spec: Any, values: dict[str, float]) -> Any:
    """The model, compiled as it is given, with these values."""
    ranges = {"ipos": "-0.5:0.5", "inertia": "0.001:0.5"}
    texts = [f"{one}={ranges[one.partition('.')[2].partition('[')[0]]}" for one in values]
    tuned = model_parameters(spec.compile(), texts)
    model = movable(spec, tuned).compile()
    for one in tuned:
        one.put(model, values[one.parameter.name])
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"body/free.ipos[0]": 0.03, "body/free.ipos[2]": -0.01}, {"free": "0.03 0 -0.01"}),
        ({"body/pole.ipos[2]": -0.12, "body/pole.ipos[0]": 0.01}, {"pole": "0.01 0 -0.12"}),
        ({"body/free.inertia[0]": 0.025}, {"inertia": "0.025"}),
        (
            {"body/free.ipos[1]": 0.02, "body/free.inertia[0]": 0.025},
            {"free": "0 0.02 0", "inertia": "0.025"},
        ),
    ],
)
def test_it_moves_as_a_model_that_is_compiled_with_it(integrator: str, values, said):
    spec = spec_of(integrator=integrator)
    text = spec.to_xml()
    expected = path_of(spec_of(integrator=integrator, **said).compile())
    found = path_of(with_values(spec, values))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    given = spec.compile()
    assert spec.to_xml() == text
    assert given.body("free").simple == 1
    assert np.abs(path_of(given) - expected).max() > 1e-4


def test_a_log_is_simulated_as_by_a_model_that_has_it(tmp_path: Path):
    stamps = np.arange(0, 10**9, 10**7)
    values = np.stack([np.linspace(0, 0.5, 100), np.zeros(100), np.full(100, 0.4)], axis=1)
    pose = Signal("/free/pose", stamps, values, ("x", "y", "z"), "m")
    log, found = Episode(EpisodeInfo(), {pose.name: pose}), []
    for at, value in (("0 0 0", 0.03), ("0.03 0 0", 0.03), ("0 0 0", 0.0)):
        text = MASSES.format(**{**GIVEN, "free": at}, integrator="implicitfast")
        (tmp_path / "m.xml").write_text(text)
        source = ModelSource(tmp_path / "m.xml", ("body/free.ipos[0]=-0.05:0.05",))
        shown = source.connect(log).simulator.rollout({"body/free.ipos[0]": value})
        found.append(shown.signals[pose.name].values)
    tuned, right, other = found
    np.testing.assert_allclose(tuned, right, rtol=0, atol=1e-9)
    assert np.abs(tuned - other).max() > 1e-5
