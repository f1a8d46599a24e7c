"""The plan has the slope and the drag that were tuned, and how surely they are known."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.analysis.planning.test_plan import RIG, tuning
from tests.conftest import Command
from tunenet_logs.analysis.planning import plan_shot, read_tuning, signed_gap_m
from tunenet_logs.errors import LogError
from tunenet_logs.recorders.simulators.ball import SpeedLaw
from tunenet_logs.recorders.simulators.shot import passes


@pytest.fixture(scope="module")
def plan(command: Command) -> Command:
    return partial(command, "tunenet-plan")


def tuned(
    path: Path,
    slope: tuple[float, float] | None = None,
    drag: tuple[float, float] | None = None,
    **changed: Any,
) -> Path:
    """A tuning's JSON of e = .7 at 4 m/s with slope and drag, each with a half width."""
    told = json.loads(tuning([(4.0, 0.7, 0.004), (2.8, 0.75, 0.2)], **changed))
    for name, known in (("restitution_slope", slope), ("drag", drag)):
        if known is not None:
            value, half = known
            ends = [value - half, value + half] if half else None
            told["parameters"][name] = {"value": value, "interval95": ends, "unit": "1"}
    path.write_text(json.dumps(told))
    return path


def test_slope_and_drag_are_those_that_were_tuned(tmp_path: Path):
    """What the single bounces say beside them is not asked."""
    ball = read_tuning(tuned(tmp_path / "a.json", (0.08, 0.02), (0.05, 0.01)))
    assert ball.law == SpeedLaw(0.7, 0.08, 4.0)
    assert ball.slope_source == "tuned"
    assert ball.slope_sd == pytest.approx(0.02 / 1.96, rel=1e-3)
    assert (ball.drag_1_m, ball.drag_sd_1_m) == pytest.approx((0.05, 0.01 / 1.96), rel=1e-3)
    assert ball.sd_at(4.0) == pytest.approx(0.004 / 1.96, rel=1e-3)
    lower = ball.law.at(np.array(2.0)) * np.log(2) * 0.02 / 1.96
    assert ball.sd_at(2.0) == pytest.approx(np.hypot(lower, 0.00204 * 2**0.08), rel=0.01)
    made = plan_shot(RIG, ball)
    assert made.rig.ball.air_drag_1_m == 0.05
    assert made.best is not None
    assert made.best.restitution > 0.7
    light = replace(RIG, ball=replace(RIG.ball, drag_1_m=0.05))
    heights = np.array([made.best.height_m])
    assert passes(light, ball.law, heights, np.zeros(1)).offset_m[0, 0] == pytest.approx(
        made.offset_m[made.best.index, 0], abs=1e-6
    )


def test_what_has_no_interval_is_taken_as_unsure(tmp_path: Path):
    ball = read_tuning(tuned(tmp_path / "a.json", (0.08, 0), (0.2, 0)))
    assert ball.slope_sd == pytest.approx(0.1)
    assert ball.drag_sd_1_m == pytest.approx(0.1)


def test_a_tuning_without_slope_and_drag_has_the_rigs_drag_and_the_bounces_slope(tmp_path: Path):
    ball = read_tuning(tuned(tmp_path / "a.json"))
    assert ball.slope_source == "bounces"
    assert ball.drag_1_m is None
    made = plan_shot(RIG, ball, 20)
    assert made.rig == RIG
    ball = read_tuning(tuned(tmp_path / "a.json", (0.08, 0.02), (0.05, 0.01), physical=False))
    assert (ball.slope_source, ball.drag_1_m) == ("bounces", None)


def test_the_ends_of_the_drag_are_true_and_count(tmp_path: Path):
    sure = read_tuning(tuned(tmp_path / "a.json", (0.08, 0.01), (0.15, 0.002)))
    unsure = read_tuning(tuned(tmp_path / "a.json", (0.08, 0.01), (0.15, 0.25)))
    best, loose = plan_shot(RIG, sure).best, plan_shot(RIG, unsure)
    assert best is not None
    assert best.drags_1_m is not None
    low, high = best.drags_1_m
    assert 0 < low < 0.15 < high
    drags = np.array([low + 0.003, high - 0.003, low - 0.003, high + 0.003])
    flights = passes(RIG, sure.law, np.full(4, best.height_m), np.zeros(4), drags)
    gaps = signed_gap_m(flights)
    assert (gaps[:2] > 0).all()
    assert (gaps[2:] < 0).all()
    assert loose.best is not None
    assert loose.best.margin < best.margin
    assert "a drag of 0.15 ± 0.13 /m" in loose.warnings[0]


def test_the_plan_says_where_slope_and_drag_are_from(plan: Command, tmp_path: Path):
    path = tuned(tmp_path / "a.json", (0.08, 0.02), (0.05, 0.01))
    result = plan(path, "--json", tmp_path / "plan.json")
    assert result.returncode == 0, result.stderr
    assert "slope 0.080 ± 0.010 of 0.7000 at 4.00 m/s (tuned)" in result.stdout
    assert "drag 0.0500 ± 0.0051 /m (tuned)" in result.stdout
    assert not result.stderr  # nobody told the built-in rig
    told = json.loads((tmp_path / "plan.json").read_text())
    assert told["ball"]["slope_from"] == told["ball"]["drag_from"] == "tuned"
    assert told["ball"]["drag"] == 0.05
    low, high = told["best"]["tolerance"]["drag"]
    assert low < 0.05 < high
    result = plan("--restitution", 0.7)
    assert "drag 0.0199 /m (the rig's ball: 60 mm, 40 g)" in result.stdout
    result = plan("--restitution", 0.7, "--drag", 0.03, "--slope", 0.1)
    assert "drag 0.0300 /m (told)" in result.stdout
    assert "slope 0.100 of 0.7000 at 3.00 m/s (as told)" in result.stdout


def test_a_rig_that_contradicts_the_tuning_is_told(plan: Command, tmp_path: Path):
    path = tuned(tmp_path / "a.json", (0.08, 0.02), (0.1, 0.01))
    rig = tmp_path / "rig.yaml"
    rig.write_text("ball: {mass_kg: 0.04}")
    result = plan(path, "--rig", rig)
    assert "by the rig's ball the drag is 0.0199 /m, tuned is 0.1 ± 0.0051 /m" in result.stderr
    rig.write_text("ball: {drag_1_m: 0.1}")
    assert not plan(path, "--rig", rig).stderr
    path = tuned(tmp_path / "a.json", (0.08, 0.02), (0.1, 0.01), ball="table-tennis")
    assert "that of the tuning a table-tennis ball of 40 mm, 2.7 g" in plan(path).stderr


@pytest.mark.parametrize(("slope", "drag"), [((3.0, 0.1), None), (None, (-1.0, 0.1))])
def test_a_slope_or_drag_that_no_ball_has_is_refused(
    tmp_path: Path, slope: tuple[float, float] | None, drag: tuple[float, float] | None
):
    with pytest.raises(LogError, match="is not a number from"):
        read_tuning(tuned(tmp_path / "a.json", slope, drag))
