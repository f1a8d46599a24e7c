"""The paper's drops before its cameras: what either network sees, and what ours makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop.presets import PAPER_RESTITUTION, filled, paper_rows
from tunenet_logs.analysis.estimators.base import Estimator, Evaluation, Problem, Step, Trace
from tunenet_logs.analysis.estimators.methods import TuneNetThenLine
from tunenet_logs.analysis.evaluation.studies.baselines import BestVisited
from tunenet_logs.analysis.evaluation.studies.drop_methods import EASY, DropTarget, draw_targets
from tunenet_logs.analysis.evaluation.studies.motion import (
    FilmedProblems,
    as_seen,
    best_map,
    filmed_pairs,
    places_in_view,
    train_ours_on_films,
)
from tunenet_logs.analysis.tracking.frames import Pictures
from tunenet_logs.analysis.tracking.track import track_ball
from tunenet_logs.recorders.simulated import DropOrder, FilmOrder, film_drop
from tunenet_logs.recorders.simulators.ball import TOPIC
from tunenet_logs.recorders.simulators.camera import PinholeCamera
from tunenet_logs.terminal import Progress

QUIET = Progress(quiet=True)
TARGET = DropTarget(4.4, 0.4, 0.62, seed=3)


@pytest.fixture(scope="module")
def films() -> FilmedProblems:
    return FilmedProblems()


@pytest.mark.parametrize("perspective", [-1.2, -0.3, 0.0, 0.8])
def test_the_best_map_is_the_camera(perspective: float):
    heights = np.abs(np.cos(np.linspace(0, 9, 200)))
    grow = np.exp(perspective)
    places = 12 + 40 * grow * heights / (1 + (grow - 1) * heights)
    found = best_map(heights, places, 0.01)
    assert found.perspective == pytest.approx(perspective, abs=0.01)
    assert found.positions(heights) == pytest.approx(places, abs=0.02)
    places[::3] = np.nan  # where a track shows nothing, nothing is asked
    assert best_map(heights, places, 0.01).span == pytest.approx(40, abs=0.1)


def test_noise_leaves_the_perspective_to_what_is_usual():
    heights = np.linspace(0, 1, 20)
    grow = np.exp(-1.5)
    places = 30 * grow * heights / (1 + (grow - 1) * heights)
    assert best_map(heights, places, 0.1).perspective == pytest.approx(-1.5, abs=0.02)
    assert abs(best_map(heights, places, 30.0).perspective) < 0.3


def test_a_simulation_as_seen_does_not_depend_on_the_camera():
    heights = np.abs(np.cos(np.linspace(0, 9, 200))) ** 1.5
    one, other = (12 + 30 * heights, 5 + 80 * np.exp(0.6) * heights / (1 + 0.822 * heights))
    for seen in (one, other):
        places = places_in_view(-seen)
        assert as_seen(heights, places) == pytest.approx(places, abs=2e-3)
    assert places_in_view(-one).min() == 0
    assert places_in_view(-one).max() == 1


@needs_pybullet
def test_what_is_left_of_the_true_simulation_is_noise(films: FilmedProblems):
    problem = films.pose_ours(TARGET)
    noise = 0.2 / np.ptp(100 * films.rows(TARGET))
    at_truth, beside = (
        np.sqrt(np.mean(problem.misfit(problem.evaluate(np.array([value]))) ** 2))
        for value in (TARGET.truth, TARGET.truth - 0.05)
    )
    assert at_truth == pytest.approx(noise, rel=0.15)
    assert beside > 3 * noise


@needs_pybullet
def test_both_see_the_same_rows(films: FilmedProblems):
    rows = films.rows(TARGET)
    papers, ours = films.pose_papers(TARGET).target, films.pose_ours(TARGET).target
    assert np.array_equal(papers.values[:, 0], filled(rows))
    assert np.array_equal(ours.values[:, 0], places_in_view(rows))
    assert np.array_equal(films.rows(TARGET), rows)
    assert not np.array_equal(films.rows(replace(TARGET, seed=4)), rows)
    assert np.array_equal(papers.axis, ours.axis)


def test_a_ball_that_leaves_the_picture_is_not_seen():
    heights = np.full((300, 3), 0.0)
    heights[:, 2] = np.linspace(0.5, 40.0, 300)
    rows = paper_rows(heights, np.random.default_rng(1))
    assert np.isfinite(rows[0])
    assert np.isnan(rows[-1])
    assert np.isfinite(filled(rows)).all()


@needs_pybullet
@pytest.mark.slow
def test_a_row_is_that_of_a_rendered_and_tracked_clip():
    """Targets are projected, not rendered: what that leaves out is part of a pixel."""
    camera = PinholeCamera((5.0, 4.0, 6.5), (0.0, 0.0, 2.0), (100, 100), 60.0)
    order = DropOrder(
        restitution=0.6, height_m=4.0, radius_m=0.5, seconds=2.5, rate_hz=60, preset="paper", seed=7
    )
    episode = film_drop(order, FilmOrder(camera=camera, noise=1.0))
    frames = list(episode.frames())
    episode = replace(episode, open_frames=lambda _topic: iter(frames))
    track = track_ball(Pictures(episode, episode.picture_topics[0]))
    films = FilmedProblems()
    target = DropTarget(4.5, 0.5, 0.6)
    look = films.pose_papers(target).evaluate(np.array([0.6]))
    places = camera.image_from_world(look.episode.signals[TOPIC].values[: len(frames)])
    off = (track.places_px - places[: len(track.places_px)])[track.found]
    assert track.found.mean() > 0.95
    # Not the standard deviation: a picture in which the ball meets its shadow may be 2 px off.
    assert np.quantile(np.abs(off - np.median(off, axis=0)), 0.68, axis=0).max() < 0.2


@needs_pybullet
@pytest.mark.slow
def test_pairs_are_of_one_height_and_equal_ones_do_not_differ():
    pairs = filmed_pairs(60, 1002, 1, QUIET)
    assert pairs.observations.shape == (120, 400, 1)
    assert len(pairs.residuals) == 60
    assert np.abs(pairs.residuals).max() <= 1
    off = pairs.observations[pairs.proposed] - pairs.observations[pairs.target]
    rms = np.sqrt(np.nanmean(off**2, axis=(1, 2)))
    same = np.abs(pairs.residuals[:, 0]) < 1e-12
    assert same.any()
    assert rms[same].max() < 0.02  # noise alone
    assert rms[~same].mean() > 3 * rms[same].mean()


@needs_pybullet
@pytest.mark.slow
def test_a_short_training_finds_restitutions_from_rows_alone(films: FilmedProblems):
    model = train_ours_on_films(1003, 1, QUIET, pairs=4000, epochs=20)
    method = BestVisited(TuneNetThenLine(model))
    off = [
        abs(method.estimate(films.pose_ours(one), 5).estimate[0] - one.truth)
        for one in draw_targets(EASY, 20, -3)
    ]
    width = PAPER_RESTITUTION[1] - PAPER_RESTITUTION[0]
    assert np.mean(off) < 0.02 < width / 12
    seen = films.pose_ours(TARGET).target.values[None]
    assert np.array_equal(model(seen, seen), np.zeros((1, 1)))


class _Wanders(Estimator):
    """Goes past the target, and on."""

    name = "wanders"

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        looks: list[Evaluation] = []
        places = [0.3, 0.5, 0.61, 0.8, 0.9, 1.0][: rollouts + 1]
        looks = [problem.evaluate(np.array([one])) for one in places[:rollouts]]
        judged = [
            Step(np.array([one]), k, look)
            for k, (one, look) in enumerate(zip(places, looks, strict=False))
        ]
        return Trace((*judged, Step(np.array([places[-1]]), rollouts)))


@needs_pybullet
def test_the_best_place_that_was_looked_at_is_kept(films: FilmedProblems):
    problem = films.pose_ours(TARGET)
    trace = BestVisited(_Wanders()).estimate(problem, 5)
    assert trace.estimate[0] == 0.61
    assert trace.after(0)[0] == TARGET.initial
    assert trace.after(2)[0] == 0.5  # the third place is judged by the third rollout
    assert trace.after(5)[0] == 0.61
    assert problem.rollouts == 5
