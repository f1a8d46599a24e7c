"""Balls of one engine, tuned in another or exported: what is measured, and what it means."""

from __future__ import annotations

import numpy as np
import pytest

from tests.strangers import bounce_heights
from tunenet_logs.analysis.evaluation.studies import engines, exports
from tunenet_logs.analysis.evaluation.studies.drop_methods import HARD
from tunenet_logs.analysis.evaluation.worlds.ball import RealBall
from tunenet_logs.analysis.export.registry import export_format
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.recorders.simulators.known import ENGINES


@pytest.mark.parametrize("drop_m", [0.3, 4.5])
@pytest.mark.parametrize("restitution", [0.02, 0.1, 0.5, 0.9, 0.999])
def test_a_rebound_is_measured_by_its_height(restitution: float, drop_m: float):
    seconds = engines.fine_seconds(drop_m)
    heights_m = bounce_heights(restitution, drop_m, seconds, GRAVITY_M_S2)
    assert engines.rebound_restitution(heights_m) == pytest.approx(restitution, abs=1e-5)
    for stays in ([1.0, 0.6, 0.1, 0.0, 0.0, 0.0], [1.0, 0.6, 0.1]):
        assert engines.rebound_restitution(np.array(stays)) == 0


@pytest.mark.parametrize("ball", [(0.2, 0.0, 0.0), (0.7, 0.1, 0.15), (0.9, 0.03, 0.02)])
def test_the_exact_engine_moves_as_the_integrator(ball: tuple[float, float, float]):
    """Which know nothing of each other; in air what rebounds is less than what is set."""
    falls = RealBall(*ball, 2.0)
    seconds = np.arange(0.0, 3.0, 1 / 120)
    with engines.simulated_in(engines.EXACT):
        heights_m = engines.simulated_m(engines.EXACT, falls, seconds)
        found = engines.rebound_restitution(
            engines.simulated_m(engines.EXACT, falls, engines.fine_seconds(2.0))
        )
    assert np.abs(heights_m - engines.integrated_m(falls, seconds)).max() < 2e-4
    assert (found < ball[0] - 0.01) if ball[2] else (found == pytest.approx(ball[0], abs=1e-5))
    assert engines.EXACT not in ENGINES


@pytest.mark.parametrize(
    ("source", "engine"), [("mujoco", engines.EXACT), (engines.EXACT, "mujoco")]
)
def test_a_ball_of_one_engine_is_tuned_in_another(source: str, engine: str):
    targets = (
        engines.drawn_targets(HARD.name, 1, 3)[0],
        engines.drawn_targets(engines.REAL, 1, 3)[0],
    )
    rows = engines.tuned_targets(engines.Portion(source, engine, targets))
    assert [row["method"] for row in rows] == 2 * list(engines.METHODS)
    for default in rows[1::2]:
        assert default["found"] == pytest.approx(default["wanted"], abs=1e-4)
        assert default["apart_percent"] < 0.01
        assert default["wanted"] > 0.05
    assert rows[2]["wanted"] < targets[1].ball.restitution - 1e-3  # in air, not what was set


# ---- Balls of exported files.


def test_a_rigid_ball_rolls_on_or_slides_on():
    assert exports.kept_m_s(3.5, 4.0, 0.5, 1.0) == pytest.approx(2.5)  # a solid ball keeps 5/7
    assert exports.kept_m_s(8.0, 2.0, 0.5, 0.1) == pytest.approx(7.7)  # less .1 of the push, 3 m/s


def test_a_file_of_a_recorded_ball_rebounds_as_that_did():
    found, _ = exports.rebound(
        export_format("mujoco"), exports.Use("mujoco", ""), exports.tuned(0.7), 0.5
    )
    assert found == pytest.approx(0.7, abs=0.002)
