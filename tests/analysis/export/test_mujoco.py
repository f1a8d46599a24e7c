"""The MJCF of a ball, loaded and stepped plainly, and of a payload."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from tests.analysis.export.tunings import ball_tuning, payload_tuning
from tests.conftest import Command
from tunenet_logs.analysis.export.exported import ExportedBall, ExportOptions, exported
from tunenet_logs.analysis.export.files import restitutions_at_impacts
from tunenet_logs.analysis.export.mujoco import STEP_S, ball_text, dropped
from tunenet_logs.analysis.record import read_record
from tunenet_logs.recorders.simulators.ball import flown
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

library: Any = mujoco

AS_IT_IS = ExportOptions()

HEIGHTS_M = np.geomspace(0.2, 5.0, 40)  # not those that the margin was chosen on
RADII_M = np.geomspace(0.2, 0.01, 40)


def scene(tuning: Path, options: ExportOptions = AS_IT_IS) -> tuple[Any, Any]:
    """The exported ball's model, and a state of it."""
    ball = exported(read_record(tuning), options)
    assert isinstance(ball, ExportedBall)
    model = library.MjModel.from_xml_string(ball_text(ball.in_air()))
    return model, library.MjData(model)


def fallen(model: Any, data: Any, height_m: float, velocity_m_s: tuple[float, float]) -> None:
    """Let go over the floor, moving aside and up, and stepped until the ball rises again."""
    data.qpos[2] = float(model.geom("tuned_ball").size[0]) + height_m
    data.qvel[0], data.qvel[2] = velocity_m_s
    while data.qvel[2] <= 0:
        library.mj_step(model, data)


@pytest.mark.parametrize("every", [5, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("restitution", [0.2, 0.3, 0.5, 0.7, 0.9, 1.0])
def test_rebounds_are_as_tuned(tmp_path: Path, restitution: float, every: int):
    assert STEP_S <= 0.0005
    tuning = ball_tuning(tmp_path / "a.json", restitution)
    for height_m, radius_m in zip(HEIGHTS_M[::every], RADII_M[::every], strict=True):
        model, data = scene(tuning, ExportOptions(radius_m=float(radius_m)))
        assert model.opt.timestep == STEP_S
        fallen(model, data, float(height_m), (0.0, 0.0))
        energy = data.qvel[2] ** 2 / 2 + GRAVITY_M_S2 * (data.qpos[2] - radius_m)
        found = math.sqrt(energy / (GRAVITY_M_S2 * height_m))
        assert found == pytest.approx(restitution, abs=0.005)


@pytest.mark.parametrize("friction", [1.0, 0.1])
@pytest.mark.parametrize("restitution", [0.3, 0.8])
def test_slip_ends_as_a_rigid_balls(tmp_path: Path, restitution: float, friction: float):
    """5/7 of the speed where friction stops the slip, else what Coulomb's law leaves."""
    model, data = scene(ball_tuning(tmp_path / "a.json", restitution))
    model.pair_friction[0, :2] = friction
    for down_m_s in (2.0, 4.0, 9.0):
        for along in (0.05, 0.3, 1.0, 2.0):
            library.mj_resetData(model, data)
            fallen(model, data, 0.01, (along * down_m_s, -down_m_s))
            faster = math.sqrt(down_m_s**2 + 2 * GRAVITY_M_S2 * 0.01)
            aside = along * down_m_s
            left = aside - min(2 / 7 * aside, friction * (1 + restitution) * faster)
            assert data.qvel[0] == pytest.approx(left, rel=0.03)


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.8])
def test_a_ball_comes_to_rest_and_stays(tmp_path: Path, restitution: float):
    model, data = scene(ball_tuning(tmp_path / "a.json", restitution))
    data.qpos[2] = 0.02 + 0.1
    library.mj_step(model, data, round(5 / STEP_S))
    heights_m = []
    for _ in range(1000):  # 10 s
        library.mj_step(model, data, round(0.01 / STEP_S))
        heights_m.append(data.qpos[2] - 0.02)
    assert np.ptp(heights_m) < 1e-4
    assert min(heights_m) > -1e-3


@pytest.mark.parametrize(("drag_1_m", "mass_kg"), [(0.12, 0.0027), (0.02, 0.0577)])
def test_the_air_slows_it(tmp_path: Path, drag_1_m: float, mass_kg: float):
    tuning = ball_tuning(tmp_path / "a.json", 0.8, drag=drag_1_m, first=0.7, height_m=3.0)
    model, data = scene(tuning, ExportOptions(radius_m=0.03, mass_kg=mass_kg))
    data.qpos[2] = 3.0
    for step in range(1, 2001):
        library.mj_step(model, data)
        height_m, speed_m_s = flown(3.0, 0.0, step * STEP_S, GRAVITY_M_S2, drag_1_m)
        assert data.qpos[2] == pytest.approx(height_m, abs=0.001)
        assert data.qvel[2] == pytest.approx(speed_m_s, abs=0.002)


def test_in_air_it_is_told_the_tuned_restitution_and_falls_as_far(command: Command, tmp_path: Path):
    tuning = ball_tuning(tmp_path / "a.json", 0.8, slope=0.05, drag=0.1, first=0.7, height_m=2.0)
    result = command("tunenet-export", tuning, "--to", "mujoco")
    assert result.returncode == 0, result.stderr
    assert re.findall(r"\d +0\.8000 +0\.80\d\d", result.stdout)
    _, data = scene(tuning)
    impact_m_s = math.sqrt(2 * GRAVITY_M_S2 * 2.0)  # as the record tells it
    higher_m = -math.log1p(-0.1 * impact_m_s**2 / GRAVITY_M_S2) / 0.2
    assert data.qpos[2] == pytest.approx(0.02 + higher_m, abs=1e-9)
    heights_m = dropped(tmp_path / "a.mujoco.xml", higher_m, 3.0)[1]
    found = restitutions_at_impacts(heights_m, STEP_S)
    assert len(found) >= 3
    assert found == pytest.approx([0.8] * len(found), abs=0.003)


def test_for_a_speed_it_is_told_the_laws(tmp_path: Path):
    tuning = ball_tuning(tmp_path / "a.json", 0.8, slope=0.1, drag=0.1, first=0.7)
    model, _ = scene(tuning, ExportOptions(speed_m_s=2.0))
    wanted = 0.8 * (2.0 / math.sqrt(2 * GRAVITY_M_S2)) ** -0.1
    assert -model.pair_solref[0, 1] * STEP_S - 1 == pytest.approx(wanted, abs=1e-9)
    assert model.geom("tuned_ball").solref[1] == model.pair_solref[0, 1]


@pytest.mark.parametrize("inertias", ["true", "false", "auto"])
def test_its_body_bounces_in_a_scene_of_others(tmp_path: Path, inertias: str):
    """Pasted there: names that are taken, inertias from shapes or not, contacts of all kinds."""
    ball = exported(read_record(ball_tuning(tmp_path / "a.json", 0.7)), ExportOptions(step_s=0.002))
    assert isinstance(ball, ExportedBall)
    (body,) = re.findall(r"<body.*</body>", ball_text(ball.in_air()), re.DOTALL)
    model = library.MjModel.from_xml_string(f"""
        <mujoco>
          <compiler inertiafromgeom="{inertias}"/>
          <option timestep="0.002"/>
          <default><geom friction=".7" solimp="0.9 0.97 0.001" solref=".005 1"/></default>
          <worldbody>
            <geom name="floor" type="plane" size="1 1 1"/>
            <body name="ball"/>
            {body}
          </worldbody>
        </mujoco>""")
    moment_kg_m2 = ball.inertial.inertia_kg_m2[0]
    assert float(model.body("tuned_ball").inertia[0]) == pytest.approx(moment_kg_m2)
    data = library.MjData(model)
    fallen(model, data, 1.0, (0.0, 0.0))
    wanted = 0.7 * math.sqrt(2 * GRAVITY_M_S2)
    assert data.qvel[2] == pytest.approx(wanted, rel=0.01)


def test_a_payload_has_mass_centre_and_inertia(command: Command, tmp_path: Path):
    result = command("tunenet-export", payload_tuning(tmp_path / "a.json"), "--to", "mujoco")
    assert result.returncode == 0, result.stderr
    model = library.MjModel.from_xml_path(str(tmp_path / "a.mujoco.xml"))
    body = model.body("payload")
    assert float(body.mass[0]) == 0.8
    assert body.ipos == pytest.approx([0.01, -0.02, 0.03])
    assert body.inertia == pytest.approx([0.4 * 0.8 * 0.04**2] * 3)
