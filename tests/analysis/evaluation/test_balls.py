"""Worlds of balls beside closed forms, SciPy and one another, and what is recorded of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tunenet_logs.analysis.evaluation.studies.real_balls import (
    SEEN,
    found_by,
    off_motion,
    off_path,
    reference_found,
)
from tunenet_logs.analysis.evaluation.studies.video import tune_track
from tunenet_logs.analysis.evaluation.worlds import ball as world
from tunenet_logs.analysis.evaluation.worlds.camera import NOISE_PX, SIZE_PX, filmed
from tunenet_logs.analysis.evaluation.worlds.clips import film_of, track_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.planning import KnownBall, plan_shot
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.recorders.simulators.ball import Bounce, SpeedLaw
from tunenet_logs.recorders.simulators.shot import ShotRig

# ---- Balls that bounce in air.

BALLS = [
    world.RealBall(0.9, 0.05, 0.36, 2.0),
    world.RealBall(0.9, 0.05, 0.131, 1.0),
    world.RealBall(0.5, 0.12, 0.02, 0.3),
    world.RealBall(0.92, 0.0, 0.003, 0.5),
]


def impacts_in_closed_form(ball: world.RealBall, count: int) -> np.ndarray:
    """Times [s] and speeds [m/s], shape (count, 2).

    Falling, d(v²)/dh = 2 g - 2 k v² over the way fallen: v² = g/k (1 - exp(-2 k h)), and v(t) is
    sqrt(g/k) tanh(t sqrt(g k)). Rising, v(t) = sqrt(g/k) tan(phase), 2 k h = ln(1 + k v²/g).
    """
    k = ball.drag_1_m
    terminal, rate = np.sqrt(world.GRAVITY_M_S2 / k), np.sqrt(world.GRAVITY_M_S2 * k)
    clock, height, first = 0.0, ball.drop_m, 0.0
    rows = []
    for _ in range(count):
        speed = terminal * np.sqrt(-np.expm1(-2 * k * height))
        clock += np.arctanh(speed / terminal) / rate
        rows.append((clock, speed))
        first = first or speed
        kept = min(ball.restitution * (max(speed, 0.05) / first) ** -ball.slope, 1.0)
        clock += np.arctan(kept * speed / terminal) / rate
        height = np.log1p((kept * speed / terminal) ** 2) / (2 * k)
    return np.array(rows)


@pytest.mark.parametrize("ball", BALLS)
def test_impacts_are_those_of_the_closed_form(ball: world.RealBall):
    path = world.fallen(ball.values[None], 3.0)
    count = int(((path.impacts_s[0] < 3.0) & (path.impact_speeds_m_s[0] > 0)).sum())
    known = impacts_in_closed_form(ball, count)
    assert count >= 5
    assert np.allclose(path.impacts_s[0, :count], known[:, 0], atol=2e-7)
    assert np.allclose(path.impact_speeds_m_s[0, :count], known[:, 1], atol=3e-7)


@pytest.mark.parametrize("restitution", [0.1, 0.5, 0.95])
@pytest.mark.parametrize(("slope", "drag"), [(0.0, 0.0), (0.2, 0.0), (0.0, 0.3), (0.1, 0.05)])
def test_heights_are_those_that_a_simulator_has_in_closed_form(
    restitution: float, slope: float, drag: float
):
    unit_m, seconds = world.GRAVITY_M_S2 / 2, np.linspace(-0.5, 8.0, 400)  # a fall lasts a second
    fall = world.drop_ball(world.RealBall(restitution, slope, drag / unit_m, unit_m), seconds)
    exact = Bounce(restitution, slope, drag).heights(seconds - fall.impacts_s[0])
    assert fall.heights_m / unit_m == pytest.approx(exact, abs=1e-6)


def test_a_ball_comes_to_rest_and_none_gives_more_than_it_takes():
    slow = world.fallen(np.array([[0.6, 0.1, 0.02, 0.5]]), 10.0)
    assert slow.at(slow.rests_s[:, None] + 1.0) == 0.0
    lively = world.fallen(np.array([[0.92, 0.3, 0.0, 2.0]]), 5.0)
    assert (np.diff(lively.impact_speeds_m_s[0]) <= 1e-9).all()
    assert np.isinf(lively.rests_s[0])


def test_balls_together_move_as_each_alone():
    times = np.tile(np.linspace(-0.1, 2.0, 300), (2, 1))
    both = world.fallen(np.array([ball.values for ball in BALLS[1:3]]), 2.0).at(times)
    for at, ball in enumerate(BALLS[1:3]):
        assert np.allclose(
            both[at], world.fallen(ball.values[None], 2.0).at(times[:1])[0], atol=1e-7
        )


# ---- Balls that are heard.

ORDER = world.BounceOrder(height_m=1.1, restitution=0.8, slope=0.05, drag_1_m=0.13, contact_s=0.002)


def test_flights_are_those_of_the_equation_of_motion():
    """Integrated by SciPy, from each impact to the next."""

    def moved(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -world.GRAVITY_M_S2 - ORDER.drag_1_m * state[1] * abs(state[1])]

    def lands(_: float, state: np.ndarray) -> float:
        return float(state[0])

    lands.terminal, lands.direction = True, -1  # type: ignore[attr-defined]
    history = world.bounced(ORDER)
    ups = history.speeds_m_s * history.restitutions
    for at in range(4):
        flown = solve_ivp(moved, (0, 3), [1e-12, ups[at]], events=lands, rtol=1e-10, atol=1e-12)
        begin_s = history.touches_s[at] + history.contacts_s[at]
        assert history.touches_s[at + 1] - begin_s == pytest.approx(flown.t[-1], abs=1e-6)
        assert history.speeds_m_s[at + 1] == pytest.approx(-flown.y[1, -1], abs=1e-6)


# ---- Recorded drops, what a reference makes of them, and what simulators are told.

IDEAL = world.RealBall(0.7, 0.0, 0.0, 1.0)


def recorded(
    ball: world.RealBall, noise_m: float = 0.001, rate_hz: float = 120.0
) -> world.RecordedDrop:
    return world.record_drop(ball, rate_hz, noise_m, np.random.default_rng(3))


def test_drops_are_from_the_ranges_and_the_same_number_is_the_same_ball_in_every_cell():
    first, *others = [world.draw_drop(cell, 1, 7) for cell in (world.CELLS[1], *world.CELLS)]
    for cell, drop in zip(world.CELLS, others, strict=True):
        expected = (first.ball.restitution, cell.scale * first.ball.slope, first.ball.drop_m)
        assert (drop.ball.restitution, drop.ball.slope, drop.ball.drop_m) == expected
        assert drop.ball.drag_1_m == pytest.approx(cell.scale * first.ball.drag_1_m)
    assert np.array_equal(world.draw_drop(world.CELLS[1], 1, 7).positions_m, first.positions_m)
    balls = np.array([world.draw_drop(world.CELLS[1], 2, at).ball.values for at in range(60)])
    low, high = balls.min(axis=0), balls.max(axis=0)
    assert (low >= [0.3, 0.0, 0.003, 0.3]).all()
    assert (high <= [0.92, 0.12, 0.18, 2.0]).all()
    assert (high - low > [0.5, 0.1, 0.1, 1.4]).all()
    assert np.median(balls[:, 2]) == pytest.approx(np.sqrt(0.003 * 0.18), rel=0.6)


def test_a_recording_is_the_truth_with_noise():
    drop = recorded(world.RealBall(0.8, 0.05, 0.1, 1.0))
    off = drop.positions_m - [*np.median(drop.positions_m[:, :2], axis=0), drop.level_m]
    off[:, 2] -= drop.truth_m(drop.seconds)
    assert np.std(off, axis=0) == pytest.approx([0.001] * 3, rel=0.15)
    assert drop.seconds[0] < -0.25
    assert drop.seconds[-1] <= world.MAX_S
    assert np.allclose(drop.seconds_of(drop.stamps_ns), drop.seconds, atol=2e-9)
    assert list(drop.episode().signals) == ["/vrpn/ball/pose"]
    assert not drop.episode().info.rig
    half = drop.until(1.0)
    assert half.seconds[-1] <= 1.0 < half.seconds[-1] + 1 / 120
    assert half.last_bounce_s < 1.0 < drop.last_bounce_s


@pytest.mark.parametrize(
    ("cell", "off", "path"),
    [(world.CELLS[1], 0.002, 3e-4), (world.WorldCell(1.0, 0.005), 0.006, 1.5e-3)],
    ids=["1 mm", "5 mm"],
)
def test_the_reference_finds_what_it_should(cell: world.WorldCell, off: float, path: float):
    found = [reference_found(world.draw_drop(cell, 3, at), cell) for at in range(5)]
    assert np.mean([abs(one.values - one.truth)[0] for one in found]) < off
    ends = [(*one.interval95.T, one.truth) for one in found]
    assert np.mean([(low <= truth) & (truth <= high) for low, high, truth in ends]) > 0.8
    assert np.median([one.path for one in found]) < path


def test_an_ideal_ball_is_tuned_and_moves_alike():
    drop = recorded(IDEAL)
    tuning = tune_episode(drop.episode(), TuneOptions())
    found = found_by(tuning, drop)
    assert found.verdict == "ok"
    assert found.values[0] == pytest.approx(0.7, abs=1e-3)
    assert found.path < 1e-3
    off = off_path(tuning, drop)
    assert off is not None
    assert np.abs(off).max() < 0.01
    seen = drop.until(SEEN * drop.last_bounce_s)
    ahead = off_motion(tune_episode(seen.episode(), TuneOptions()), drop)
    assert ahead is not None
    assert len(ahead) == pytest.approx(drop.last_bounce_s * 120, abs=2)
    assert np.mean(np.abs(ahead)) < 2e-3


def test_an_ideal_ball_is_tuned_from_its_film():
    drop = world.record_drop(IDEAL, 60.0, 0.0, np.random.default_rng(5))
    track = filmed(drop, 0.03, np.random.default_rng(6))
    assert track.found.all()
    assert ((track.places_px >= 0) & (track.places_px <= np.array(SIZE_PX))).all()
    held = track.places_px[drop.seconds < 0]
    assert np.std(held, axis=0) == pytest.approx([NOISE_PX] * 2, rel=0.4)
    found = found_by(tune_track(track, TuneOptions()), drop)
    assert found.values[0] == pytest.approx(0.7, abs=0.01)
    assert found.path < 0.02


# ---- The hidden world of the bounce shot.

GEL = world.HiddenBall("red gel", 0.74, 0.08)
PLAIN = world.HiddenBall("ball", 0.68, 0.0)


def test_a_fall_takes_what_the_closed_form_says():
    run = world.run_ball(GEL, (0.0, 0.0, 1.03), (world.plane(),), 2.0, np.random.default_rng(1))
    ball = world.RealBall(1.0, GEL.slope, world.DRAG_1_M, 1.0)
    ((_, speed),) = impacts_in_closed_form(ball, 1)
    ball = replace(ball, restitution=GEL.restitution_at(speed))
    (first_s, _), (second_s, again) = impacts_in_closed_form(ball, 2)
    assert world.impact_seconds(run)[:2] == pytest.approx([first_s, second_s], abs=1.1e-3)
    assert run.positions_m[:, 2].min() > 0.03 - 1e-6
    apex_m = -math.log1p(-world.DRAG_1_M * again**2 / world.GRAVITY_M_S2) / (2 * world.DRAG_1_M)
    after = run.positions_m[int(first_s * 960) + 1 :, 2]
    assert after.max() - 0.03 == pytest.approx(apex_m, rel=2e-4)


@pytest.mark.parametrize(
    ("restitution", "slope"),
    [
        (0.68, 0.03),
        pytest.param(0.55, 0.12, marks=pytest.mark.slow),
        pytest.param(0.79, 0.08, marks=pytest.mark.slow),
    ],
)
def test_the_planners_simulator_and_the_hidden_world_agree(restitution: float, slope: float):
    """They share no code: a height planned with the true law passes where the plan says."""
    rig = ShotRig()
    known = KnownBall(SpeedLaw(restitution, slope, 3.0), np.diag([1e-5, 0.0]))
    plan = plan_shot(rig, known)
    assert plan.best is not None
    ball, rng = world.HiddenBall("ball", restitution, slope), np.random.default_rng(1)
    shot = world.take_shot(ball, rig, plan.best.height_m, rng, errs=False)
    assert (shot.is_through, shot.has_touched) == (True, False)
    assert abs(shot.miss_m or 1) == pytest.approx(plan.best.miss_m, abs=5e-4)


def test_a_shot_far_off_misses_and_one_on_the_rim_touches_it():
    rig, rng = ShotRig(), np.random.default_rng(2)
    plan = plan_shot(rig, KnownBall(SpeedLaw(0.68, 0.0, 3.0), np.diag([1e-5, 0.0])))
    assert plan.best is not None
    low, high = plan.best.heights_m
    for height_m in (low - 0.01, high + 0.01):
        assert world.take_shot(PLAIN, rig, height_m, rng, errs=False).has_touched
    far = world.take_shot(PLAIN, rig, 0.85, rng, errs=False)
    assert not far.is_through
    assert far.miss_m == pytest.approx(plan.miss_m[-1], abs=1e-3)  # beyond


@pytest.mark.parametrize("mishap", world.MISHAPS)
def test_what_leaves_the_table_leaves_it(mishap: str):
    for seed in range(8):
        rng = np.random.default_rng(seed)
        drop = world.drop_of(GEL, mishap, rng)
        lowest_m = drop.path.positions_m[:, 2].min()
        track = track_of(film_of(drop, rng))
        if mishap == "out of view":
            assert lowest_m > 0.029
            assert drop.leaves_s is not None
            after = track.stamps_ns * 1e-9 - 0.25 > drop.leaves_s + 0.1
            assert not track.found[after].any()
            assert track.found[~after].sum() > 10
        else:
            assert lowest_m < -0.2
    good = world.drop_of(GEL, None, np.random.default_rng(1)).path.positions_m
    assert good[:, 2].min() > 0.029
    assert np.abs(good[:, :2]).max() < 0.01
