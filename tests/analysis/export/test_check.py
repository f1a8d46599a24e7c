"""The check: an exported file is run by its engine, and its bounces are measured."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.export.tunings import ball_tuning
from tests.conftest import Command
from tests.engines import needs_pybullet
from tunenet_logs.analysis.export.exported import ExportedBall, ExportOptions, exported
from tunenet_logs.analysis.export.files import checked, effective_restitutions
from tunenet_logs.analysis.export.registry import export_format
from tunenet_logs.analysis.export.templated import PYBULLET
from tunenet_logs.analysis.record import read_record
from tunenet_logs.recorders.simulators.ball import Bounce
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2


@pytest.fixture(scope="module")
def export(command: Command) -> Command:
    return partial(command, "tunenet-export")


@pytest.mark.parametrize("restitution", [0.3, 0.6, 0.9])
def test_bounces_are_measured_by_their_heights(restitution: float):
    times = np.arange(-1.0, 4.0, 1 / 480)
    heights = Bounce(restitution).heights(times)
    found = effective_restitutions(2.5 * heights)
    assert len(found) >= 1
    assert found == pytest.approx([restitution] * len(found), abs=1e-3)


def test_a_ball_that_does_not_bounce_has_no_bounces():
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
    bounces = [
        {"restitution": 0.8, "interval95": None, "impact_speed": 4.5, "time_s": at_s}
        for at_s in (impact_s, 2.0)
    ]
    tuning = ball_tuning(
        tmp_path / "a.json",
        0.8,
        height_m=height_m,
        first=0.72,
        bounces=bounces,
        curves={
            "start_ns": 0,
            "seconds": seconds.tolist(),
            "observed_m": curve,
            "simulated_m": curve,
        },
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


def ball_of(tuning: Path) -> ExportedBall:
    item = exported(read_record(tuning), ExportOptions())
    assert isinstance(item, ExportedBall)
    return item


def test_an_engine_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    ball = ball_of(ball_tuning(tmp_path / "a.json"))
    monkeypatch.setattr(PYBULLET, "LIBRARY", "no_such_library")
    said = checked(export_format("pybullet"), tmp_path / "a.py", ball)
    assert said == "pybullet is not installed"
    assert "nothing here runs" in str(checked(export_format("urdf"), tmp_path / "a.urdf", ball))


@needs_pybullet
def test_a_file_that_fails_is_said(tmp_path: Path):
    ball = ball_of(ball_tuning(tmp_path / "a.json"))
    path = tmp_path / "a.py"
    path.write_text("raise RuntimeError('a broken\\x1b file')")
    said = checked(export_format("pybullet"), path, ball)
    assert said == "pybullet ended with: RuntimeError: a broken\\x1b file"
