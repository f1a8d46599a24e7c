"""Balls by name: what the air does to them, and what no ball can be."""

from __future__ import annotations

from math import sqrt

import pytest

from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.known import (
    BALLS,
    Ball,
    ball_named,
    completed,
    recorded_ball,
)


def test_a_table_tennis_ball_falls_no_faster_than_it_does():
    drag = ball_named("table-tennis").drag_1_m
    assert drag is not None
    assert sqrt(9.81 / drag) == pytest.approx(8.7, abs=0.6)  # terminal speeds of 8.1 to 9.3 m/s


@pytest.mark.parametrize(
    ("name", "slowed"),  # by how much air slows the end of a fall from 1 m: about drag * height / 2
    [("table-tennis", 0.066), ("tennis", 0.010), ("golf", 0.0047), ("basketball", 0.011)],
)
def test_light_and_large_balls_are_slowed_most(name: str, slowed: float):
    drag = BALLS[name].drag_1_m
    assert drag is not None
    assert drag / 2 == pytest.approx(slowed, rel=0.1)


@pytest.mark.parametrize("name", sorted(BALLS))
def test_each_ball_of_the_table_is_one(name: str):
    ball = BALLS[name]
    assert ball.density_kg_m3 is not None
    assert 50 < ball.density_kg_m3 < 1300  # hollow, or hard rubber
    assert 0.4 < ball.drag_coefficient < 0.7
    assert not ball.is_denser_than_metal


def test_an_unknown_name_is_told_those_that_there_are():
    with pytest.raises(UsageError, match=r"'cricket'.*table-tennis, tennis, squash"):
        ball_named("cricket")


@pytest.mark.parametrize(
    ("size", "says"),
    [
        ((0.0, 0.01), "diameter is over 0"),
        ((-0.04, None), "diameter is over 0, not -0.04 m"),
        ((0.04, 0.0), "mass is over 0"),
        ((0.04, float("nan")), "mass"),
        ((float("inf"), 0.01), "diameter"),
        ((0.04, 0.00004), "lighter than the air"),
        ((4.0, 0.0027), "diameter in m"),
    ],
)
def test_what_no_ball_can_be_is_refused(size: tuple, says: str):
    with pytest.raises(UsageError, match=says):
        Ball(*size)


def test_a_very_heavy_ball_is_a_ball_that_may_be_a_mistake():
    ball = Ball(0.04, 10.0)
    assert ball.drag_1_m == pytest.approx(3.5e-5, rel=0.05)
    assert ball.is_denser_than_metal
    assert not Ball(0.04, 0.26).is_denser_than_metal  # steel


def test_what_a_log_says_of_its_ball():
    info = EpisodeInfo(notes={"ball": "tennis"}, rig={"ball_mass_kg": 0.058})
    assert recorded_ball(info) == Ball(0.067, 0.058, 0.55)
    assert recorded_ball(EpisodeInfo(notes={"ball": "red rubber"})) == Ball()
    nobody_measured = EpisodeInfo(rig={"ball_diameter_m": 0.04, "ball_mass_kg": 0.0})
    assert recorded_ball(nobody_measured) == Ball(0.04)
    floats = EpisodeInfo(rig={"ball_diameter_m": 4.0, "ball_mass_kg": 0.0027})
    assert recorded_ball(floats) == Ball()


def test_a_user_knows_better_than_the_log():
    recorded = Ball(0.067, 0.058, 0.55)
    assert completed(Ball(), recorded) == recorded
    assert completed(Ball(0.040), recorded) == Ball(0.040, 0.058)
    assert completed(BALLS["golf"], recorded) == BALLS["golf"]
    assert completed(Ball(4.0), Ball(None, 0.0027)) == Ball(4.0)
