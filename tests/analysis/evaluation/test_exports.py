"""Balls of exported files and of MuJoCo: what the study of them measures by."""

from __future__ import annotations

import math

import pytest

from tunenet_logs.analysis.evaluation.studies.exports import (
    Use,
    kept_m_s,
    promised,
    rebound,
    slid_in_file,
    slid_in_simulator,
    tuned,
)
from tunenet_logs.analysis.export.registry import export_format


def test_a_rigid_ball_rolls_on_or_slides_on():
    assert kept_m_s(3.5, 4.0, 0.5, 1.0) == pytest.approx(2.5)  # a solid ball keeps 5/7
    assert kept_m_s(8.0, 2.0, 0.5, 0.1) == pytest.approx(7.7)  # less .1 of the push, 3 m/s


@pytest.mark.parametrize("friction", [1.0, 0.1])
def test_both_ways_leave_a_throw_what_a_rigid_ball_keeps(friction: float):
    throw = (2.0, 3.0, 0.6, friction)
    assert slid_in_simulator(*throw) == pytest.approx(kept_m_s(*throw), rel=1e-3)
    assert slid_in_file(*throw) == pytest.approx(kept_m_s(*throw), rel=0.03)


@pytest.mark.parametrize(("seen", "kept"), [(0.1, True), (0.11, False), (math.nan, False)])
def test_a_promise_that_is_missed_is_said(seen: float, kept: bool):
    assert promised("what", "mm", 0.1, seen)["kept"] is kept


def test_a_file_of_a_recorded_ball_rebounds_as_that_did():
    found, cost_ms = rebound(export_format("mujoco"), Use("mujoco", ""), tuned(0.7), 0.5)
    assert found == pytest.approx(0.7, abs=0.002)
    assert cost_ms > 0
