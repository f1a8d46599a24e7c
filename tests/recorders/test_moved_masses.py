"""A tuned centre of mass or moment of inertia moves a model as one that is compiled with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tunenet_logs.analysis.sysid.source import ModelSource
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.recorders.simulators.model.parameters import model_parameters, movable
from tunenet_logs.recorders.simulators.mujoco import mujoco as library

mujoco = library()

MODEL = """<mujoco><option timestep="0.002" integrator="{integrator}"/>
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
    return mujoco.MjSpec.from_string(MODEL.format(**{**GIVEN, **said}))


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
def test_it_moves_as_a_model_that_is_compiled_with_it(
    integrator: str, values: dict[str, float], said: dict[str, str]
):
    spec = spec_of(integrator=integrator)
    expected = path_of(spec_of(integrator=integrator, **said).compile())
    found = path_of(with_values(spec, values))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    given = spec.compile()
    assert given.body("free").simple == 1
    assert np.abs(path_of(given) - expected).max() > 1e-4


def test_a_body_that_only_slides_takes_it_too():
    found = with_values(spec_of(integrator="Euler"), {"body/cart.ipos[2]": 0.05})
    expected = spec_of(integrator="Euler", cart="0 0 0.05").compile()
    np.testing.assert_allclose(path_of(found), path_of(expected), rtol=0, atol=1e-9)
    data = mujoco.MjData(found)
    mujoco.mj_forward(found, data)
    assert data.body("cart").xipos[2] == pytest.approx(1.05)


def test_the_model_that_was_given_stays_as_it_is():
    spec = spec_of(integrator="Euler")
    before = spec.to_xml()
    tuned = model_parameters(spec.compile(), ["body/free.ipos[0]=-0.5:0.5"])
    assert not movable(spec, tuned).compile().body("free").simple
    assert spec.to_xml() == before


def test_a_log_is_simulated_as_by_a_model_that_has_it(tmp_path: Path):
    given, moved = tmp_path / "given.xml", tmp_path / "moved.xml"
    given.write_text(MODEL.format(**GIVEN, integrator="implicitfast"))
    moved.write_text(MODEL.format(**{**GIVEN, "free": "0.03 0 0"}, integrator="implicitfast"))
    stamps = np.arange(0, 10**9, 10**7)
    values = np.stack([np.linspace(0, 0.5, 100), np.zeros(100), np.full(100, 0.4)], axis=1)
    pose = Signal("/free/pose", stamps, values, ("x", "y", "z"), "m")
    log = Episode(EpisodeInfo(), {pose.name: pose})
    wanted = "body/free.ipos[0]=-0.05:0.05"
    tuned = ModelSource(given, (wanted,)).connect(log).simulator
    expected = ModelSource(moved, (wanted,)).connect(log).simulator
    found, right, other = (
        simulator.rollout({"body/free.ipos[0]": value}).signals[pose.name].values
        for simulator, value in ((tuned, 0.03), (expected, 0.03), (tuned, 0.0))
    )
    np.testing.assert_allclose(found, right, rtol=0, atol=1e-9)
    assert np.abs(found - other).max() > 1e-5
