"""Balls of one engine, tuned in another: what is measured, and that a tuning means the same."""

from __future__ import annotations

import numpy as np
import pytest

from tests.strangers import bounce_heights
from tunenet_logs.analysis.evaluation.studies.drop_methods import EASY, HARD
from tunenet_logs.analysis.evaluation.studies.engines import (
    EXACT,
    METHODS,
    REAL,
    Portion,
    apart_percent,
    drawn_targets,
    fine_seconds,
    integrated_m,
    missing_engine,
    rebound_restitution,
    simulated_in,
    simulated_m,
    tuned_targets,
)
from tunenet_logs.analysis.evaluation.worlds.ball import RealBall
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.recorders.simulators.known import ENGINES


@pytest.mark.parametrize("drop_m", [0.3, 4.5])
@pytest.mark.parametrize("restitution", [0.02, 0.1, 0.5, 0.9, 0.999])
def test_a_rebound_is_measured_by_its_height(restitution: float, drop_m: float):
    seconds = fine_seconds(drop_m)
    heights_m = bounce_heights(restitution, drop_m, seconds, GRAVITY_M_S2)
    assert rebound_restitution(heights_m) == pytest.approx(restitution, abs=1e-5)


def test_a_ball_that_stays_down_has_no_rebound():
    assert rebound_restitution(np.array([1.0, 0.6, 0.1, 0.0, 0.0, 0.0])) == 0
    assert rebound_restitution(np.array([1.0, 0.6, 0.1])) == 0


def test_motions_are_compared_over_the_bounces_in_view():
    seconds = np.arange(0.0, 8.0, 0.01)
    heights_m = bounce_heights(0.5, 2.0, seconds)
    assert apart_percent(heights_m, heights_m) == 0
    assert apart_percent(heights_m, heights_m + 0.1) == pytest.approx(5.0)
    at_rest = np.where(seconds > 4.0, 0.1, 0.0)
    assert apart_percent(heights_m, heights_m + at_rest) == 0


@pytest.mark.parametrize("restitution", [0.1, 0.6, 0.95])
def test_the_integrator_falls_with_the_engines_gravity(restitution: float):
    ball = RealBall(restitution, 0.0, 0.0, 1.3)
    seconds = np.arange(0.0, 3.0, 0.01)
    exact_m = bounce_heights(restitution, 1.3, seconds, GRAVITY_M_S2)
    assert integrated_m(ball, seconds) == pytest.approx(exact_m, abs=1e-6)


@pytest.mark.parametrize("ball", [(0.2, 0.0, 0.0), (0.7, 0.1, 0.15), (0.9, 0.03, 0.02)])
def test_the_exact_engine_moves_as_the_integrator(ball: tuple[float, float, float]):
    """Which know nothing of each other; in air what rebounds is less than what is set."""
    falls = RealBall(*ball, 2.0)
    seconds = np.arange(0.0, 3.0, 1 / 120)
    with simulated_in(EXACT):
        heights_m = simulated_m(EXACT, falls, seconds)
        found = rebound_restitution(simulated_m(EXACT, falls, fine_seconds(2.0)))
    assert np.abs(heights_m - integrated_m(falls, seconds)).max() < 2e-4
    assert (found < ball[0] - 0.01) if ball[2] else (found == pytest.approx(ball[0], abs=1e-5))
    assert EXACT not in ENGINES


@pytest.mark.parametrize(("source", "engine"), [("mujoco", EXACT), (EXACT, "mujoco")])
def test_a_ball_of_one_engine_is_tuned_in_another(source: str, engine: str):
    targets = (drawn_targets(HARD.name, 1, 3)[0], drawn_targets(REAL, 1, 3)[0])
    rows = tuned_targets(Portion(source, engine, targets))
    assert [row["method"] for row in rows] == 2 * list(METHODS)
    for default in rows[1::2]:
        assert default["found"] == pytest.approx(default["wanted"], abs=1e-4)
        assert default["apart_percent"] < 0.01
        assert default["wanted"] > 0.05
    assert rows[2]["wanted"] < targets[1].ball.restitution - 1e-3  # in air, not what was set


def test_targets_are_the_papers_and_the_same_for_every_pair():
    for name, (low, high) in ((EASY.name, EASY.target), (HARD.name, HARD.target)):
        drawn = drawn_targets(name, 50, 1)
        assert drawn == drawn_targets(name, 50, 1)
        assert drawn[:3] != drawn_targets(name, 3, 2)
        truths = [one.ball.restitution for one in drawn]
        assert low <= min(truths) < low + 0.1
        assert high - 0.1 < max(truths) <= high
        assert all(3.5 <= one.ball.drop_m <= 4.5 and len(one.seconds) == 400 for one in drawn)
    assert all(one.ball.drag_1_m > 0 for one in drawn_targets(REAL, 10, 1))


def test_an_engine_that_is_missing_is_found(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(ENGINES, "absent", "tests.recorders.absent_engine")
    assert missing_engine(EXACT, "absent") == "absent"
    assert missing_engine(EXACT, "mujoco") is None
