"""What is drawn of real balls, what a reference makes of it, and what the simulators are told."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.studies.real_balls import (
    SEEN,
    fit_reference,
    found_by,
    off_motion,
    off_path,
    reference_found,
)
from tunenet_logs.analysis.evaluation.studies.video import tune_track
from tunenet_logs.analysis.evaluation.worlds.ball import (
    CELLS,
    MAX_S,
    MIN_FALL,
    TABLE_BALLS,
    RealBall,
    RecordedDrop,
    WorldCell,
    airless_off,
    best_of_all,
    draw_drop,
    first_rebound,
    parabolas,
    record_drop,
    table_drops,
)
from tunenet_logs.analysis.evaluation.worlds.camera import NOISE_PX, SIZE_PX, filmed
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_episode

IDEAL = RealBall(0.7, 0.0, 0.0, 1.0)


def recorded(ball: RealBall, noise_m: float = 0.001, rate_hz: float = 120.0) -> RecordedDrop:
    return record_drop(ball, rate_hz, noise_m, np.random.default_rng(3))


def test_the_same_number_is_the_same_ball_in_every_cell():
    drops = [draw_drop(cell, 1, 7) for cell in CELLS]
    for cell, drop in zip(CELLS, drops, strict=True):
        ball, first = drop.ball, drops[1].ball
        assert (ball.restitution, ball.drop_m) == (first.restitution, first.drop_m)
        assert ball.slope == pytest.approx(cell.scale * first.slope)
        assert ball.drag_1_m == pytest.approx(cell.scale * first.drag_1_m)
    again = draw_drop(CELLS[0], 1, 7)
    assert np.array_equal(again.positions_m, drops[0].positions_m)
    assert draw_drop(CELLS[0], 1, 8).ball != drops[0].ball


def test_drops_are_from_the_ranges():
    balls = np.array([draw_drop(CELLS[1], 2, at).ball.values for at in range(60)])
    low, high = balls.min(axis=0), balls.max(axis=0)
    assert (low >= [0.3, 0.0, 0.003, 0.3]).all()
    assert (high <= [0.92, 0.12, 0.18, 2.0]).all()
    assert (np.ptp(balls, axis=0) > [0.5, 0.1, 0.1, 1.4]).all()
    assert np.median(balls[:, 2]) == pytest.approx(np.sqrt(0.003 * 0.18), rel=0.6)


def test_a_recording_is_the_truth_with_noise():
    drop = recorded(RealBall(0.8, 0.05, 0.1, 1.0))
    off = drop.positions_m[:, 2] - drop.level_m - drop.truth_m(drop.seconds)
    assert np.std(off) == pytest.approx(0.001, rel=0.15)
    assert np.std(drop.positions_m[:, :2], axis=0) == pytest.approx([0.001, 0.001], rel=0.15)
    assert drop.seconds[0] < -0.25
    assert drop.seconds[-1] <= MAX_S
    assert np.allclose(drop.seconds_of(drop.stamps_ns), drop.seconds, atol=2e-9)
    assert list(drop.episode().signals) == ["/vrpn/ball/pose"]
    assert not drop.episode().info.rig
    half = drop.until(1.0)
    assert half.seconds[-1] <= 1.0 < half.seconds[-1] + 1 / 120
    assert half.last_bounce_s < 1.0 < drop.last_bounce_s


def test_a_bounce_too_low_to_see_is_not_in_view():
    drop = recorded(RealBall(0.3, 0.0, 0.01, 1.0))
    speeds, times = drop.path.impact_speeds_m_s[0], drop.path.impacts_s[0]
    last = np.flatnonzero(times == drop.last_bounce_s)[0]
    assert speeds[last] >= np.sqrt(MIN_FALL) * speeds[0] > speeds[last + 1]
    assert drop.seconds[-1] > drop.last_bounce_s


@pytest.mark.parametrize("cell", [CELLS[1], WorldCell(1.0, 0.005)])
def test_the_reference_finds_what_it_should(cell: WorldCell):
    found = [reference_found(draw_drop(cell, 3, at), cell) for at in range(5)]
    off = np.abs([one.values - one.truth for one in found])
    assert off[:, 0].mean() < {0.001: 0.002, 0.005: 0.006}[cell.noise_m]
    held = [
        (one.interval95[:, 0] <= one.truth) & (one.truth <= one.interval95[:, 1]) for one in found
    ]
    assert np.mean(held) > 0.8
    assert np.median([one.path for one in found]) < {0.001: 3e-4, 0.005: 1.5e-3}[cell.noise_m]


def test_what_a_log_cannot_tell_keeps_to_its_range():
    cell = WorldCell(1.0, 0.005)
    drop = recorded(RealBall(0.35, 0.06, 0.02, 0.3), 0.005, 30.0)
    short = drop.until(float(drop.path.impacts_s[0, 1]))  # one flight
    low, high = fit_reference(short, cell).interval95[1]
    assert 0.0 <= low < 0.01
    assert 0.11 < high <= 0.12


def test_the_airless_tunings_are_right_where_there_is_no_air():
    drop = recorded(IDEAL, 1e-6)
    assert first_rebound(drop) == pytest.approx(0.7, abs=1e-5)
    assert best_of_all(drop) == pytest.approx(0.7, abs=1e-5)
    assert np.abs(airless_off(0.7, drop)).max() < 1e-5
    light = recorded(RealBall(0.9, 0.04, 0.13, 1.0))
    best = np.mean(np.abs(airless_off(best_of_all(light), light)))
    assert 0.005 < best < np.mean(np.abs(airless_off(0.9, light)))
    apex_s = np.array([(1 + 0.9) * np.sqrt(2 / 9.81)])
    assert parabolas(0.9, 1.0, apex_s) == pytest.approx(0.81)


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
    drop = record_drop(IDEAL, 60.0, 0.0, np.random.default_rng(5))
    track = filmed(drop, 0.03, np.random.default_rng(6))
    places = track.places_px[track.found]
    assert track.found.all()
    assert (places >= 0).all()
    assert (places <= np.array(SIZE_PX)).all()
    held = track.places_px[drop.seconds < 0]
    assert np.std(held, axis=0) == pytest.approx([NOISE_PX] * 2, rel=0.4)
    found = found_by(tune_track(track, TuneOptions()), drop)
    assert found.values[0] == pytest.approx(0.7, abs=0.01)
    assert found.path < 0.02


def test_balls_of_the_table_are_plausible():
    for ball in TABLE_BALLS:
        real = ball.dropped(1.0)
        assert 0.3 < real.restitution < 0.95
        assert 0.0 < real.drag_1_m < 0.15
        assert ball.dropped(2.0).restitution <= real.restitution
    light = next(ball for ball in TABLE_BALLS if ball.name == "table tennis")
    assert light.drag_1_m == pytest.approx(0.1317, abs=1e-4)
    # ITTF: 24 to 26 cm from 30.5 cm
    drop = recorded(light.dropped(0.305), 1e-6)
    assert 0.24 < 0.305 * first_rebound(drop) ** 2 < 0.26
    drops = list(table_drops(light, 1, 2))
    assert len(drops) == 6
    assert all(drop.whole.seconds[-1] > 7 for drop in drops)
