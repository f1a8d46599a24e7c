"""What an engine makes of an exported file: it is run there, and what moves is measured."""

from __future__ import annotations

import math
import re
import runpy
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from tests.analysis.records import ball_tuning, payload_tuning
from tests.conftest import Command
from tests.engines import HAS_PYBULLET, needs_pybullet
from tunenet_logs.analysis.export import drake
from tunenet_logs.analysis.export.exported import ExportedBall, ExportOptions, exported
from tunenet_logs.analysis.export.files import (
    checked,
    effective_restitutions,
    restitutions_at_impacts,
)
from tunenet_logs.analysis.export.mujoco import STEP_S, ball_text, dropped
from tunenet_logs.analysis.export.registry import export_format, usual_suffix
from tunenet_logs.analysis.export.templated import NEWTON, PYBULLET
from tunenet_logs.analysis.record import read_record
from tunenet_logs.recorders.simulators.arm.description import (
    JACO_TOOL_LINK,
    JACO_URDF,
    Payload,
    jaco,
)
from tunenet_logs.recorders.simulators.arm.path import JointPath
from tunenet_logs.recorders.simulators.ball import Bounce, flown
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2


@pytest.fixture(scope="module")
def export(command: Command) -> Command:
    return partial(command, "tunenet-export")


def test_bounces_are_measured_by_their_heights():
    times = np.arange(-1.0, 4.0, 1 / 480)
    for restitution in (0.3, 0.6, 0.9):
        found = effective_restitutions(2.5 * Bounce(restitution).heights(times))
        assert len(found) >= 1
        assert found == pytest.approx([restitution] * len(found), abs=1e-3)
    assert effective_restitutions(np.array([1.0, 0.5, 0.0, 0.001, 0.0, 0.0])) == ()


@needs_pybullet
@pytest.mark.parametrize("restitution", [0.1, 0.3, 0.5, 0.7, 0.9, 1.0])
def test_pybullet_bounces_as_it_was_tuned(export: Command, tmp_path: Path, restitution: float):
    """From any height of 0.3 to 2 m: the file's own loop, which steps plainly."""
    tuning = ball_tuning(tmp_path / "a.json", restitution)
    assert export(tuning, "--to", "pybullet").returncode == 0
    for height_m in (0.3, 0.57, 0.94, 1.43, 2.0):
        seconds = np.sqrt(2 * height_m / 9.8) * (1.1 + 2 * restitution)
        _, heights_m = PYBULLET.dropped(tmp_path / "a.pybullet.py", height_m, float(seconds))
        (first, *_) = effective_restitutions(heights_m) or (0.0,)
        assert first == pytest.approx(restitution, abs=0.01)


@needs_pybullet
def test_the_command_prints_how_the_ball_bounced(export: Command, tmp_path: Path):
    """A drop in air: the engine, which has none, is as far from it as the closed form without."""
    seconds = np.arange(0.0, 2.5, 1 / 120)
    height_m, fall_s, impact_s = 1.2, math.sqrt(2 * 1.2 / GRAVITY_M_S2), 0.6
    places = (seconds - impact_s) / fall_s
    seen = Bounce(0.8, 0.06, 0.13).heights(places)
    airless = Bounce(0.72).heights(places)
    compared = (places >= -1) & (seconds <= 2.0)
    wanted = 100 * np.sqrt(np.mean((seen - airless)[compared] ** 2))
    assert wanted > 2
    curve = (height_m * seen).tolist()
    curves = {"seconds": seconds.tolist(), "observed_m": curve, "simulated_m": curve}
    bounce = {"restitution": 0.8, "interval95": None, "impact_speed": 4.5}
    tuning = ball_tuning(
        tmp_path / "a.json",
        0.8,
        height_m=height_m,
        first=0.72,
        bounces=[{**bounce, "time_s": at_s} for at_s in (impact_s, 2.0)],
        curves={"start_ns": 0, **curves},
    )
    result = export(tuning, "--to", "pybullet")
    assert result.returncode == 0, result.stderr
    rows = re.findall(r"^ +(\d) +([\d.]+) +([\d.]+) +([+-][\d.]+)$", result.stdout, re.MULTILINE)
    assert len(rows) >= 4
    for _, told, found, off in rows:
        assert float(told) == 0.72
        assert float(found) == pytest.approx(0.72, abs=0.01)
        assert float(off) == pytest.approx(float(found) - 0.72, abs=2e-4)
    (rms,) = re.findall(r"off the recording: ([\d.]+) %", result.stdout)
    assert float(rms) == pytest.approx(wanted, abs=0.5)


@needs_pybullet
def test_an_exported_file_runs_as_it_is(export: Command, tmp_path: Path):
    """Alone in another folder with its URDF, without this package."""
    tuning = ball_tuning(tmp_path / "a.json", 0.7)
    assert export(tuning, "--to", "pybullet", "-o", tmp_path / "ball.py").returncode == 0
    (tmp_path / "there").mkdir()
    for name in ("ball.py", "ball.urdf"):
        (tmp_path / name).rename(tmp_path / "there" / name)
    words = [sys.executable, "-I", "there/ball.py"]
    result = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stderr
    (found,) = re.findall(r"restitution ([\d.]+), set 0.7000", result.stdout)
    assert float(found) == pytest.approx(0.7, abs=0.01)


def ball_of(tuning: Path, **options: float) -> ExportedBall:
    item = exported(read_record(tuning), ExportOptions(**options))  # type: ignore[arg-type]
    assert isinstance(item, ExportedBall)
    return item


def test_why_an_engine_does_not_run_a_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    ball = ball_of(ball_tuning(tmp_path / "a.json"))
    assert "nothing here runs" in str(checked(export_format("urdf"), tmp_path / "a.urdf", ball))
    path = tmp_path / "a.py"
    path.write_text("raise RuntimeError('a broken\\x1b file')")
    if HAS_PYBULLET:
        said = checked(export_format("pybullet"), path, ball)
        assert said == "pybullet ended with: RuntimeError: a broken\\x1b file"
    monkeypatch.setattr(PYBULLET, "LIBRARY", "no_such_library")
    assert checked(export_format("pybullet"), path, ball) == "pybullet is not installed"


@pytest.mark.parametrize("restitution", [0.3, 0.9])
@pytest.mark.parametrize(("engine", "tolerance"), [(drake, 0.003), (NEWTON, 0.01)])
def test_drake_and_newton_bounce_as_their_files_say(
    export: Command, tmp_path: Path, monkeypatch, engine, tolerance: float, restitution: float
):
    pytest.importorskip(engine.LIBRARY, reason="needs tunenet-logs[engines]")
    tuning = ball_tuning(tmp_path / "a.json", restitution, height_m=1.0)
    with monkeypatch.context() as patch:
        patch.setattr(engine, "LIBRARY", None)
        assert export(tuning, "--to", engine.NAME).returncode == 0
    path = tmp_path / f"a{usual_suffix(engine)}"
    _, heights_m = engine.dropped(path, 1.0, 0.5 + 0.9 * restitution)
    (first, *_) = effective_restitutions(heights_m)
    assert first == pytest.approx(restitution, abs=tolerance)


library: Any = mujoco  # whose types are not told
HEIGHTS_M = np.geomspace(0.2, 5.0, 40)  # not those that the margin was chosen on
RADII_M = np.geomspace(0.2, 0.01, 40)


def scene(tuning: Path, **options: float) -> tuple[Any, Any]:
    """The exported ball's model in MuJoCo, and a state of it."""
    model = library.MjModel.from_xml_string(ball_text(ball_of(tuning, **options).in_air()))
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
        model, data = scene(tuning, radius_m=float(radius_m))
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
    model, data = scene(tuning, radius_m=0.03, mass_kg=mass_kg)
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
    model, _ = scene(tuning, speed_m_s=2.0)
    wanted = 0.8 * (2.0 / math.sqrt(2 * GRAVITY_M_S2)) ** -0.1
    assert -model.pair_solref[0, 1] * STEP_S - 1 == pytest.approx(wanted, abs=1e-9)
    assert model.geom("tuned_ball").solref[1] == model.pair_solref[0, 1]


@pytest.mark.parametrize("inertias", ["true", "false", "auto"])
def test_its_body_bounces_in_a_scene_of_others(tmp_path: Path, inertias: str):
    """Pasted there: names that are taken, inertias from shapes or not, contacts of all kinds."""
    ball = ball_of(ball_tuning(tmp_path / "a.json", 0.7), step_s=0.002)
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


POSE_RAD = (0.3, 2.5, 0.2, 1.5, 0.4, 1.9, 0.1)
STANDARD_M_S2 = (0.0, 0.0, -9.80665)


def held_nm(bullet, client: int, arm: int) -> np.ndarray:
    """Torques that hold the pose, shape (7,)."""
    joints = range(len(POSE_RAD))
    for _ in range(600):
        bullet.setJointMotorControlArray(
            arm,
            joints,
            bullet.POSITION_CONTROL,
            targetPositions=POSE_RAD,
            forces=[500.0] * len(joints),
            positionGains=[0.3] * len(joints),
            physicsClientId=client,
        )
        bullet.stepSimulation(physicsClientId=client)
    return np.array([state[3] for state in bullet.getJointStates(arm, joints, client)])


@needs_pybullet
def test_mounting_it_changes_the_torques_as_it_should(command: Command, tmp_path: Path):
    from tunenet_logs.recorders.simulators.pybullet import inverse_dynamics, pybullet

    mass_kg, com_m = 0.8, (0.01, -0.02, 0.03)
    tuning = payload_tuning(tmp_path / "a.json", mass_kg, com_m)
    assert command("tunenet-export", tuning, "--to", "pybullet").returncode == 0
    bullet = pybullet()
    client = bullet.connect(bullet.DIRECT)
    bullet.setGravity(*STANDARD_M_S2, physicsClientId=client)
    flags = bullet.URDF_USE_INERTIA_FROM_FILE
    arm = bullet.loadURDF(str(JACO_URDF), useFixedBase=True, flags=flags, physicsClientId=client)
    links = {
        bullet.getJointInfo(arm, joint, physicsClientId=client)[12].decode(): joint
        for joint in range(bullet.getNumJoints(arm, physicsClientId=client))
    }
    for joint, angle_rad in enumerate(POSE_RAD):
        bullet.resetJointState(arm, joint, angle_rad, physicsClientId=client)
    empty_nm = held_nm(bullet, client, arm)
    mount = runpy.run_path(str(tmp_path / "a.pybullet.py"))["mount"]
    mount(arm, links[JACO_TOOL_LINK], client)
    more_nm = held_nm(bullet, client, arm) - empty_nm
    bullet.disconnect(client)
    still = np.zeros((1, len(POSE_RAD)))
    path = JointPath(np.zeros(1), np.array([POSE_RAD]), still, still)
    wanted_nm = np.diff(
        [
            inverse_dynamics(jaco(), path, payload, STANDARD_M_S2)[0]
            for payload in (None, Payload(mass_kg, com_m))
        ],
        axis=0,
    )[0]
    assert np.abs(wanted_nm).max() > 1
    assert more_nm == pytest.approx(wanted_nm, abs=0.01)
