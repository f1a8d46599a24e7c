"""The bounce shot's simulator against closed forms, an ODE solver, and the laws of physics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.ball import SpeedLaw
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.recorders.simulators.shot import (
    BallStates,
    Hoop,
    Plane,
    Release,
    Rim,
    ShotBall,
    ShotRig,
    collide,
    fly,
    passes,
    read_rig,
    released,
    rig_text,
    shoot,
)

RIG = ShotRig()
NO_AIR = replace(RIG, ball=ShotBall(mass_kg=None))
HEIGHTS = np.linspace(0.25, 0.85, 13)


def after_impact(rig: ShotRig, height_m: float, restitution: float) -> np.ndarray:
    """Forward and up, of a solid ball that grips the plane: 5/7 of the speed along it is left."""
    speed, tilt = np.sqrt(2 * rig.gravity_m_s2 * height_m), np.radians(rig.plane.incline_deg)
    out, along = restitution * speed * np.cos(tilt), 5 / 7 * speed * np.sin(tilt)
    return out * np.array([np.sin(tilt), np.cos(tilt)]) + along * np.array(
        [np.cos(tilt), -np.sin(tilt)]
    )


@pytest.mark.parametrize("restitution", [0.5, 0.7, 0.85])
def test_without_air_it_flies_on_the_parabola_of_the_closed_form(restitution: float):
    flights = passes(NO_AIR, SpeedLaw(restitution), HEIGHTS, np.zeros(len(HEIGHTS)))
    for index, height_m in enumerate(HEIGHTS):
        forward, up = after_impact(NO_AIR, height_m, restitution)
        fall = NO_AIR.touch_m[2] - NO_AIR.hoop.up_m
        seconds = (up + np.sqrt(up**2 + 2 * GRAVITY_M_S2 * fall)) / GRAVITY_M_S2
        wanted = NO_AIR.touch_m[0] + forward * seconds - NO_AIR.hoop.forward_m
        assert flights.offset_m[index, 0] == pytest.approx(wanted, abs=5e-5)
        assert flights.offset_m[index, 1] == 0
    speeds = np.sqrt(2 * GRAVITY_M_S2 * HEIGHTS) * np.cos(np.radians(25))
    assert np.allclose(flights.impact_m_s, speeds, rtol=1e-6)


def test_the_air_slows_it_as_an_ode_solver_says():
    flights = passes(RIG, SpeedLaw(0.7), np.array([0.6]), np.zeros(1))
    drag = RIG.ball.air_drag_1_m
    assert drag == pytest.approx(0.5 * 1.2 * 0.47 * np.pi * 0.03**2 / 0.040)

    def motion(_: float, state: np.ndarray) -> list[float]:
        fast = np.hypot(state[2], state[3])
        return [state[2], state[3], -drag * fast * state[2], -GRAVITY_M_S2 - drag * fast * state[3]]

    def touch(_: float, state: np.ndarray) -> float:
        return state[1]

    def through(_: float, state: np.ndarray) -> float:
        return state[1] + RIG.touch_m[2] - RIG.hoop.up_m

    touch.terminal = through.terminal = True  # type: ignore[attr-defined]
    fall = solve_ivp(motion, (0, 2), [0, 0.6, 0, 0], events=touch, rtol=1e-10, atol=1e-12).y[:, -1]
    assert flights.impact_m_s[0] == pytest.approx(-fall[3] * np.cos(np.radians(25)), abs=1e-6)
    equal_height_m = fall[3] ** 2 / (2 * GRAVITY_M_S2)
    start = [RIG.touch_m[0], 0, *after_impact(RIG, equal_height_m, 0.7)]
    end = solve_ivp(motion, (0, 2), start, events=through, rtol=1e-10, atol=1e-12).y[:, -1]
    assert flights.offset_m[0, 0] == pytest.approx(end[0] - 0.45, abs=5e-5)
    without = passes(NO_AIR, SpeedLaw(0.7), np.array([0.6]), np.zeros(1))
    assert without.offset_m[0, 0] - flights.offset_m[0, 0] > 0.005


def test_a_hundredth_of_restitution_moves_it_by_about_nine_millimetres():
    heights = np.array([0.432, 0.432])
    offset = passes(RIG, SpeedLaw(0.6), heights, np.array([0.0, 0.01])).offset_m[:, 0]
    assert offset[1] - offset[0] == pytest.approx(0.009, abs=0.001)


def test_the_restitution_is_that_of_its_own_speed():
    law = SpeedLaw(0.7, slope=0.1, at_m_s=3.0)
    speed = np.sqrt(2 * GRAVITY_M_S2 * 0.4) * np.cos(np.radians(25))
    slow = passes(NO_AIR, law, np.array([0.4]), np.zeros(1))
    same = passes(NO_AIR, SpeedLaw(0.7 * (speed / 3) ** -0.1), np.array([0.4]), np.zeros(1))
    assert slow.offset_m[0, 0] == pytest.approx(same.offset_m[0, 0], abs=1e-9)


def test_the_rim_is_a_torus_that_nothing_enters():
    flights = shoot(RIG, SpeedLaw(0.7), np.linspace(0.25, 0.85, 100))
    gaps = np.array([Rim(RIG).gaps_m(places) for places in flights.positions_m])
    assert gaps.min() > -1e-8
    assert 10 < np.count_nonzero(flights.has_touched) < 60
    free = passes(RIG, SpeedLaw(0.7), np.linspace(0.25, 0.85, 100), np.zeros(100))
    would = free.gap_m < 0
    assert np.array_equal(would, flights.has_touched)
    inside = np.hypot(*free.offset_m.T) < 0.066 - 0.03
    assert np.count_nonzero(inside & ~free.is_through) == 0
    # A point would pass where this ball hits the rim.
    point = np.hypot(*free.offset_m.T) < 0.066
    assert np.count_nonzero(point & flights.has_touched) > 5


@pytest.mark.parametrize("step_s", [5e-4, pytest.param(1e-4, marks=pytest.mark.slow)])
def test_smooth_and_elastic_it_keeps_its_energy_through_all_impacts(step_s: float):
    rig = ShotRig(
        ball=ShotBall(mass_kg=None),
        plane=Plane(friction=0.0),
        hoop=Hoop(forward_m=0.7, restitution=1.0, friction=0.0),
    )
    heights, law = np.linspace(0.25, 0.45, 21), SpeedLaw(1.0)
    start, shifts = released(rig, heights), np.zeros(21)
    flights = fly(rig, law, start, shifts, has_rim=True, step_s=step_s, keep=True)
    places = flights.positions_m
    assert flights.has_touched.any()
    speed = np.linalg.norm(places[2:] - places[:-2], axis=2) / (2 * step_s)
    energy = speed**2 / 2 + GRAVITY_M_S2 * places[1:-1, :, 2]
    at_rest = GRAVITY_M_S2 * (heights + rig.touch_m[2])
    flying = np.abs(np.diff(places, 2, axis=0)[:, :, 2] + GRAVITY_M_S2 * step_s**2) < 1e-12
    assert np.abs(energy - at_rest)[flying].max() < 1e-6


def test_before_the_impact_nothing_counts():
    """A hoop above the impact point, beside the fall: only a ball that bounced is through."""
    rig = replace(RIG, hoop=Hoop(forward_m=0.35, up_m=0.15, free_radius_m=0.1))
    flights = shoot(rig, SpeedLaw(0.85), HEIGHTS)
    assert np.isfinite(flights.impact_m_s).all()
    assert flights.is_through.any()
    never = shoot(rig, SpeedLaw(0.1), HEIGHTS)
    assert np.isnan(never.offset_m).all()
    assert not never.is_through.any()


def test_friction_stops_the_slip_or_takes_coulombs_share():
    normal = np.array([[0.0, 0.0, 1.0]])
    for friction, sticks in ((0.25, True), (0.05, False)):
        balls = BallStates(np.zeros((1, 3)), np.array([[1.0, 0.5, -3.0]]), np.zeros((1, 3)))
        collide(balls, np.array([0]), normal, np.array([0.7]), friction, ShotBall(0.03))
        slip = balls.velocity_m_s + np.cross(balls.spin_rad_s, -0.03 * normal)
        assert balls.velocity_m_s[0, 2] == pytest.approx(2.1)
        before, after = np.hypot(1.0, 0.5), np.linalg.norm(balls.velocity_m_s[0, :2])
        if sticks:
            assert np.abs(slip[0, :2]).max() < 1e-12
            assert after == pytest.approx(5 / 7 * before)
        else:
            assert after == pytest.approx(before - friction * 5.1)
            assert slip[0, :2] @ [1.0, 0.5] > 0


@pytest.mark.parametrize(
    "restitutions",
    [[0.5, 0.7, 0.85], pytest.param(np.arange(0.50, 0.851, 0.05), marks=pytest.mark.slow)],
    ids=["three balls", "eight balls"],
)
def test_some_height_scores_for_every_ball(restitutions: np.ndarray):
    heights = np.linspace(RIG.release.lowest_m, RIG.release.highest_m, 100)
    for restitution in restitutions:
        flights = passes(RIG, SpeedLaw(float(restitution)), heights, np.zeros(100))
        assert (flights.is_through & (flights.gap_m > 0)).any(), restitution


def test_a_rig_is_what_its_file_says(tmp_path: Path):
    rig = ShotRig(
        ball=ShotBall(0.02, None, 0.5, 0.6),
        plane=Plane(30.0, 0.2, 0.4),
        hoop=Hoop(0.5, -0.05, 0.07, 0.008, 0.5, 0.3),
        release=Release(0.2, 0.9, 0.003),
        gravity_m_s2=9.8,
    )
    path = tmp_path / "rig.yaml"
    path.write_text(rig_text(rig))
    assert read_rig(path) == rig
    path.write_text("hoop:\n  forward_m: 0.5\n")
    assert read_rig(path) == replace(RIG, hoop=Hoop(forward_m=0.5))
    path.write_text("# nothing\n")
    assert read_rig(path) == RIG
    path.write_text("ball: {mass_kg: null, drag_1_m: 0.13}")  # it replaces that of size and mass
    rig = read_rig(path)
    assert rig.ball.air_drag_1_m == 0.13
    path.write_text(rig_text(rig))
    assert read_rig(path) == rig
    assert NO_AIR.ball.air_drag_1_m == 0
    with pytest.raises(UsageError, match=r"ball.drag_1_m -1 is not a number"):
        RIG.with_drag(-1.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gone", "cannot be read"),
        ("#" * 30_000, "larger than"),
        ("hoop: {forward_m: a}", "hoop.forward_m a is not a number"),
        ("hoop: {forward_m: yes}", "hoop.forward_m"),
        ("hoop: {forward_m: .inf}", "hoop.forward_m inf is not a number from"),
        ("plane: {downhill_m: 0}", "plane.downhill_m 0 is not a number from 0.001 to 10"),
        ("hop: {}", "hop is nothing of the file; there is: ball"),
        ("hoop: {forward: 1}", "forward is nothing of hoop"),
        ("hoop: 3", "hoop is not a list of names with values"),
        ("a: b: c", "no YAML in line 1"),
        ("hoop: {}\nhoop: {}", "no YAML in line 2"),
        ("!!python/object/apply:os.system [ls]", "holds &, * or !"),
        ("[" * 1000, "over 64 brackets"),
        pytest.param("[" * 100_000, "larger than 20 kB", marks=pytest.mark.slow),
        ("\x00", "no YAML"),
        ("ball: {radius_m: 0.07}", "lets no ball"),
        ("ball: {mass_kg: 0.0001}", "lighter than the air"),
        ("hoop: {forward_m: 0.05}", "in the ball's way"),
        ("hoop: {forward_m: 0.03, up_m: 0.2}", "hoop.forward_m 0.03: the hoop hangs in"),
        ("hoop: {forward_m: 0.1, up_m: 0.9}", "in the ball's way"),
        ("release: {lowest_m: 0.9}", "is not below release.highest_m"),
        ("gravity_m_s2: -9.81", "gravity_m_s2"),
        ("ball: {radius_m: null}", "ball.radius_m"),
        ("ball: {radius_m: 1" + "0" * 400 + "}", "ball.radius_m"),
    ],
)
def test_a_bad_file_is_refused_by_name_and_value(tmp_path: Path, text: str, said: str):
    path = tmp_path / "rig.yaml"
    if text != "gone":
        path.write_text(text)
    with pytest.raises(UsageError) as error:
        read_rig(path)
    assert str(error.value).startswith(f"{path}: ")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_each_ball_may_have_a_drag_of_its_own():
    heights, drags = np.full(3, 0.6), np.array([0.0, 0.02, 0.3])
    together = passes(RIG, SpeedLaw(0.7), heights, np.zeros(3), drags).offset_m[:, 0]
    alone = [
        passes(RIG.with_drag(drag), SpeedLaw(0.7), heights[:1], np.zeros(1)).offset_m[0, 0]
        for drag in drags.tolist()
    ]
    assert together == pytest.approx(alone, abs=1e-9)
    assert together[0] > together[1] > together[2]
