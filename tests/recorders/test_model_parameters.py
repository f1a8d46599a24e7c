"""What giving a tuned parameter a value does in the model."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from tests.recorders.tunable_model import compiled, one
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.model.parameters import (
    FIELDS,
    ModelParameter,
    model_parameters,
)
from tunenet_logs.recorders.simulators.mujoco import mujoco as library

mujoco = library()

TURNS = ("hinge", "slide", "ball")
# By kind, the elements whose fields are tuned, in the order of `FIELDS`.
ADDRESSES = {
    "joint": [TURNS, TURNS, TURNS, TURNS, ("hinge", "slide")],
    "body": [("arm", "slider", "bob", "block"), ("arm", "slider"), ("arm", "slider")],
    "geom": [("block",)] * 3,
    "actuator": [("servo", "motor", "ratio"), ("servo", "speed", "ratio"), ("motor",)],
    "tendon": [("belt",)] * 3,
    "option": [(None,)] * 3,
}

# What changes nothing here, by what an axis or the model leaves out.
IDLE = re.compile(r"gear\[[1-5]\]|slider\.inertia|arm\.inertia\[[02]\]|arm\.ipos\[1\]|density")


def every_address() -> list[str]:
    found: list[str] = []
    for kind, elements in ADDRESSES.items():
        for (name, field), names in zip(FIELDS[kind].items(), elements, strict=True):
            for element in names:
                owner = kind if element is None else f"{kind}/{element}"
                ends = [f"[{index}]" for index in range(field.size)] if field.size > 1 else [""]
                found += [f"{owner}.{name}{end}" for end in ends]
    return found


@pytest.fixture(scope="module")
def model() -> Any:
    return compiled()


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
    has_usual = one_or_none(model, address)
    tuned = has_usual or one(model, f"{address}=0.1:0.9")
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


def one_or_none(model: Any, address: str) -> ModelParameter | None:
    """With the model's own range, where it tells one."""
    try:
        return one(model, address)
    except UsageError as error:
        if "tells no range" not in str(error):
            raise
        return None


def test_the_models_value_changes_nothing(model: Any):
    for address in every_address():
        tuned = one_or_none(model, address)
        if tuned is None:
            continue
        copy = model.__copy__()
        tuned.put(copy, tuned.parameter.initial)
        for name, held in arrays(model).items():
            got, kept = (np.frombuffer(each, np.uint8) for each in (arrays(copy)[name], held))
            if got.tobytes() != kept.tobytes():
                array = getattr(copy, name, None)
                assert array is not None
                np.testing.assert_allclose(array, getattr(model, name), rtol=1e-12)


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


def test_a_centre_of_mass_moves_without_the_shapes(model: Any):
    copy = model.__copy__()
    one(model, "body/arm.ipos[0]=0:1").put(copy, 0.05)
    mujoco.mj_setConst(copy, mujoco.MjData(copy))
    data, before = mujoco.MjData(copy), mujoco.MjData(model)
    mujoco.mj_forward(copy, data)
    mujoco.mj_forward(model, before)
    np.testing.assert_allclose(data.geom_xpos, before.geom_xpos, atol=1e-12)
    assert data.body("arm").xipos[0] == pytest.approx(0.05)
