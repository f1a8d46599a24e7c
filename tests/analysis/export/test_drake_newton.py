"""Drake and Newton: what their files hold, and, where they are installed, how the ball bounces."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.analysis.export.test_values import COM_M, MASS_KG, MOMENT_KG_M2, constants
from tests.analysis.export.tunings import ball_tuning, payload_tuning
from tests.conftest import Command
from tunenet_logs.analysis.export import drake
from tunenet_logs.analysis.export.drake import MIN_RESTITUTION, dissipation, restitution
from tunenet_logs.analysis.export.files import effective_restitutions
from tunenet_logs.analysis.export.registry import usual_suffix
from tunenet_logs.analysis.export.templated import NEWTON
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

DRAKE = "{http://drake.mit.edu}"


@pytest.fixture
def exported(command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Exports a tuning without running the engine; the file's path."""

    def make(engine, tuning: Path, *words: object) -> Path:
        with monkeypatch.context() as patch:
            patch.setattr(engine, "LIBRARY", None)
            result = command("tunenet-export", tuning, "--to", engine.NAME, *words)
        assert result.returncode == 0, result.stderr
        return tmp_path / f"a{usual_suffix(engine)}"

    return make


def simulated_restitution(damping_s_m: float, speed_m_s: float) -> float:
    """Of F = k x (1 + d x'), integrated; k over m is 1e6 /s²."""

    def slope(_: float, state: np.ndarray) -> list[float]:
        depth, speed = state
        return [speed, -1e6 * depth * (1 + damping_s_m * speed)]

    def is_out(_: float, state: np.ndarray) -> float:
        return state[0]

    is_out.terminal, is_out.direction = True, -1  # type: ignore[attr-defined]
    found = solve_ivp(slope, (0, 1), [0.0, speed_m_s], events=is_out, rtol=1e-9, atol=1e-12)
    return -found.y[1, -1] / speed_m_s


@pytest.mark.parametrize("wanted", [0.1, 0.3, 0.5, 0.75, 0.9, 0.99])
@pytest.mark.parametrize("speed_m_s", [0.5, 4.0])
def test_the_dissipation_gives_the_restitution(wanted: float, speed_m_s: float):
    """By the contact's own motion; at other speeds too, the formula is what happens."""
    damping_s_m = dissipation(wanted, speed_m_s)
    assert simulated_restitution(damping_s_m, speed_m_s) == pytest.approx(wanted, abs=1e-4)
    for factor in (0.5, 2.0):
        found = simulated_restitution(damping_s_m, factor * speed_m_s)
        assert restitution(damping_s_m, factor * speed_m_s) == pytest.approx(found, abs=1e-4)


def test_extreme_restitutions_have_a_dissipation():
    assert dissipation(1.0, 3.0) == pytest.approx(0.0, abs=1e-9)
    assert dissipation(0.0, 3.0) == dissipation(MIN_RESTITUTION, 3.0)
    assert math.isfinite(dissipation(0.0, 3.0))


@pytest.mark.parametrize("words", [(), ("--speed", 2.0)])
def test_drakes_file_has_the_restitution_at_its_speed(exported, tmp_path: Path, words):
    path = exported(drake, ball_tuning(tmp_path / "a.json", 0.7, 0.05, height_m=1.0), *words)
    speed_m_s = words[1] if words else math.sqrt(2 * GRAVITY_M_S2)
    wanted = 0.7 * (speed_m_s / math.sqrt(2 * GRAVITY_M_S2)) ** -0.05
    root = ET.fromstring(path.read_text())
    values = [float(one.text or "nan") for one in root.iter(f"{DRAKE}hunt_crossley_dissipation")]
    assert len(values) == 2
    assert values[0] == values[1]
    assert simulated_restitution(values[0], speed_m_s) == pytest.approx(wanted, abs=1e-4)
    for factor in (0.5, 1.0, 2.0):
        found = simulated_restitution(values[0], factor * speed_m_s)
        assert f"{found:.3f}" in path.read_text()


def test_drakes_stiffness_lets_the_ball_in_by_a_twentieth(exported, tmp_path: Path):
    words = ("--radius", 0.1, "--mass", 0.5)
    path = exported(drake, ball_tuning(tmp_path / "a.json", 1.0, height_m=2.0), *words)
    *_, stiffness = ET.fromstring(path.read_text()).iter(f"{DRAKE}point_contact_stiffness")
    depth_m = math.sqrt(2 * GRAVITY_M_S2 * 2.0 * 0.5 / float(stiffness.text or "nan"))
    assert depth_m == pytest.approx(0.1 / 20)


def test_a_step_is_refused_for_drake(command: Command, tmp_path: Path):
    tuning = ball_tuning(tmp_path / "a.json")
    result = command("tunenet-export", tuning, "--to", "drake", "--step", 0.001)
    assert result.returncode == 2


def test_newtons_file_has_the_tuned_numbers(exported, tmp_path: Path):
    words = ("--radius", 0.03, "--mass", 0.05, "--step", 0.002)
    found = constants(exported(NEWTON, ball_tuning(tmp_path / "a.json", 0.7, height_m=2.0), *words))
    assert (found["RESTITUTION"], found["RADIUS_M"], found["MASS_KG"]) == (0.7, 0.03, 0.05)
    assert found["MOMENT_KG_M2"] == pytest.approx(0.4 * 0.05 * 0.03**2)
    assert found["DROP_HEIGHT_M"] == pytest.approx(2.0)
    assert found["STEP_S"] == 0.002


def test_newtons_payload(exported, tmp_path: Path):
    found = constants(exported(NEWTON, payload_tuning(tmp_path / "a.json", MASS_KG, COM_M)))
    assert (found["MASS_KG"], found["COM_M"]) == (MASS_KG, COM_M)
    moment = pytest.approx(MOMENT_KG_M2)
    assert np.array(found["INERTIA_KG_M2"]).reshape(3, 3).diagonal().tolist() == [moment] * 3


def test_drakes_payload_is_gazebos(exported, tmp_path: Path):
    inertial = ET.fromstring(exported(drake, payload_tuning(tmp_path / "a.json")).read_text())
    assert inertial.findtext("model/link/inertial/mass") == repr(MASS_KG)


@pytest.mark.parametrize("restitution_set", [0.3, 0.9])
@pytest.mark.parametrize(("engine", "tolerance"), [(drake, 0.003), (NEWTON, 0.01)])
def test_the_engine_bounces_as_its_file_says(
    exported, tmp_path: Path, engine, tolerance: float, restitution_set: float
):
    pytest.importorskip(engine.LIBRARY, reason="needs tunenet-logs[engines]")
    path = exported(engine, ball_tuning(tmp_path / "a.json", restitution_set, height_m=1.0))
    _, heights_m = engine.dropped(path, 1.0, 0.5 + 0.9 * restitution_set)
    (first, *_) = effective_restitutions(heights_m)
    assert first == pytest.approx(restitution_set, abs=tolerance)
