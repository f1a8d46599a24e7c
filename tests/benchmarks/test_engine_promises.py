"""What the engines' promises are measured by."""

from __future__ import annotations

import math

import pytest

from tests.bench.engine_promises import Promised, Throw, slid_in_file, slid_in_simulator
from tests.bench.engines import Row, ball, rebound, tuned
from tunenet_logs.analysis.export.registry import export_format


def test_a_rigid_ball_rolls_on_or_slides_on():
    assert Throw(3.5, 4.0).left_m_s(0.5, 1.0) == pytest.approx(2.5)  # a solid ball keeps 5/7
    assert Throw(8.0, 2.0).left_m_s(0.5, 0.1) == pytest.approx(7.7)  # less .1 of the push, 3 m/s


@pytest.mark.parametrize("friction", [1.0, 0.1])
def test_both_ways_leave_a_throw_what_a_rigid_ball_keeps(friction: float):
    throw = Throw(2.0, 3.0)
    left_m_s = throw.left_m_s(0.6, friction)
    assert slid_in_simulator(throw, 0.6, friction) == pytest.approx(left_m_s, rel=1e-3)
    assert slid_in_file(throw, 0.6, friction) == pytest.approx(left_m_s, rel=0.03)


def test_a_promise_that_is_missed_is_said():
    assert "MISSED" in Promised("what", "mm", 0.1, 0.11).line()
    assert "MISSED" not in Promised("what", "mm", 0.1, 0.1).line()
    assert "MISSED" in Promised("what", "mm", 0.1, math.nan).line()


def test_a_file_of_a_recorded_ball_rebounds_as_that_did():
    engine, row = export_format("mujoco"), Row("mujoco", "")
    item = ball(engine, tuned(0.7), row.options(1.0))
    found, cost_ms = rebound(engine, item, 0.5, row.how)
    assert found == pytest.approx(0.7, abs=0.002)
    assert cost_ms > 0
