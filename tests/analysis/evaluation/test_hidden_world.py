"""The hidden world: physics by closed forms, drops that leave, films, and who decides on them."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.studies.bounce_shot import draw_trials
from tunenet_logs.analysis.evaluation.studies.video import tune_track
from tunenet_logs.analysis.evaluation.worlds import ball as ground_truth_sim
from tunenet_logs.analysis.evaluation.worlds.ball import (
    DROP_M,
    MISHAPS,
    HiddenBall,
    drop_of,
    impact_seconds,
    plane,
    run_ball,
    take_shot,
)
from tunenet_logs.analysis.evaluation.worlds.clips import film_of, record_film, track_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.planning import KnownBall, plan_shot
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.recorders.simulators.ball import SpeedLaw
from tunenet_logs.recorders.simulators.known import Ball
from tunenet_logs.recorders.simulators.shot import ShotRig

BALL = HiddenBall("red gel", 0.74, 0.08)


def test_a_fall_takes_what_the_closed_form_says():
    rng = np.random.default_rng(1)
    run = run_ball(BALL, (0.0, 0.0, 1.03), (plane(),), 2.0, rng)
    drag = ground_truth_sim.DRAG_1_M
    fall_s = math.acosh(math.exp(drag)) / math.sqrt(9.81 * drag)
    speed = math.sqrt(9.81 / drag * (1 - math.exp(-2 * drag)))
    up = BALL.restitution_at(speed) * speed
    flight_s = math.atan(up * math.sqrt(drag / 9.81)) / math.sqrt(9.81 * drag)
    apex_m = math.log1p(drag * up**2 / 9.81) / (2 * drag)
    flight_s += math.acosh(math.exp(drag * apex_m)) / math.sqrt(9.81 * drag)
    first, second = impact_seconds(run)[:2]
    assert first == pytest.approx(fall_s, abs=1.1e-3)
    assert second - first == pytest.approx(flight_s, abs=1.1e-3)
    assert run.positions_m[:, 2].min() > 0.03 - 1e-6
    after = run.positions_m[int(first * 960) :, 2]
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
    ball, rng = HiddenBall("ball", restitution, slope), np.random.default_rng(1)
    shot = take_shot(ball, rig, plan.best.height_m, rng, errs=False)
    assert shot.is_through
    assert not shot.has_touched
    assert abs(shot.miss_m or 1) == pytest.approx(plan.best.miss_m, abs=5e-4)


def test_a_shot_far_off_misses_and_one_on_the_rim_touches_it():
    rig, rng = ShotRig(), np.random.default_rng(2)
    known = KnownBall(SpeedLaw(0.68, 0.0, 3.0), np.diag([1e-5, 0.0]))
    plan = plan_shot(rig, known)
    assert plan.best is not None
    ball = HiddenBall("ball", 0.68, 0.0)
    low, high = plan.best.heights_m
    for height_m in (low - 0.01, high + 0.01):
        assert take_shot(ball, rig, height_m, rng, errs=False).has_touched
    far = take_shot(ball, rig, 0.85, rng, errs=False)
    assert not far.is_through
    assert far.miss_m == pytest.approx(plan.miss_m[-1], abs=1e-3)  # beyond


def test_balls_out_of_round_scatter():
    rig, rng = ShotRig(), np.random.default_rng(3)
    aside = [
        take_shot(HiddenBall("ball", 0.68, 0.0, off), rig, 0.36, rng, errs=False).miss_m
        for off in [0.0] * 5 + [2.0] * 40
    ]
    assert len(set(aside[:5])) == 1
    assert np.std([one for one in aside[5:] if one is not None]) > 0.01


@pytest.mark.parametrize("mishap", MISHAPS)
def test_what_leaves_the_table_leaves_it(mishap: str):
    for seed in range(8):
        rng = np.random.default_rng(seed)
        drop = drop_of(BALL, mishap, rng)
        heights = drop.path.positions_m[:, 2]
        track = track_of(film_of(drop, rng))
        if mishap == "out of view":
            assert heights.min() > 0.029
            assert drop.leaves_s is not None
            after = track.stamps_ns * 1e-9 - 0.25 > drop.leaves_s + 0.1
            assert not track.found[after].any()
            assert track.found[~after].sum() > 10
        else:
            assert heights.min() < -0.2
    good = drop_of(BALL, None, np.random.default_rng(1)).path.positions_m
    assert good[:, 2].min() > 0.029
    assert np.abs(good[:, :2]).max() < 0.01


@pytest.mark.slow
def test_a_film_of_the_hidden_world_is_tuned_to_its_truth(tmp_path: Path):
    """Recorded, tracked and fitted by what users run; the truth is the hidden ball's."""
    rng = np.random.default_rng(4)
    drop = drop_of(BALL, None, rng)
    film = film_of(drop, rng)
    path = tmp_path / "drop.mcap"
    record_film(film, path)
    tuning = tune_log(path, TuneOptions())
    assert tuning.verdict == "ok"
    assert tuning.estimate is not None
    truth = BALL.restitution_at(math.sqrt(2 * 9.81 * DROP_M))
    assert tuning.estimate[0] == pytest.approx(truth, abs=0.008)
    selection = TuneOptions(ball=Ball(0.06, 0.04))
    by_track = tune_track(track_of(film), selection)
    assert by_track.estimate is not None
    assert by_track.estimate[0] == pytest.approx(float(tuning.estimate[0]), abs=0.004)


def test_a_campaign_is_as_it_was_ordered():
    trials = draw_trials(1)
    assert len(trials) == 60
    assert sum(one.mishap is not None for one in trials) == 22
    assert Counter(one.ball.name for one in trials) == dict.fromkeys(
        ("red gel", "racquetball", "tennis", "foam", "lacrosse", "super"), 10
    )
    assert sorted({one.ball.restitution for one in trials}) == [0.55, 0.62, 0.68, 0.74, 0.79, 0.84]
    assert len({one.ball.name for one in trials if not one.ball.is_round}) == 2
    assert [one.attempt for one in trials[:10]] == list(range(1, 11))
    assert all(0.03 <= one.ball.slope <= 0.12 for one in trials)
    assert draw_trials(1) == trials
    assert draw_trials(2) != trials
