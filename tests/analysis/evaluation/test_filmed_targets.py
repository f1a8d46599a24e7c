"""The paper's drops before its cameras: what either network sees, and what ours makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop.presets import FILM_TRAININGS, TRAININGS
from tunenet_logs.analysis.estimators.methods import TuneNet
from tunenet_logs.analysis.evaluation.studies import motion
from tunenet_logs.analysis.evaluation.studies.drop_methods import EASY, DropTarget, draw_targets
from tunenet_logs.analysis.tracking.frames import Pictures
from tunenet_logs.analysis.tracking.track import track_ball
from tunenet_logs.analysis.tunenet.weights import shipped_model
from tunenet_logs.recorders.simulated import DropOrder, FilmOrder, film_drop
from tunenet_logs.recorders.simulators.ball import TOPIC
from tunenet_logs.recorders.simulators.camera import PinholeCamera
from tunenet_logs.terminal import Progress


@pytest.mark.parametrize("perspective", [-1.2, -0.3, 0.0, 0.8])
def test_the_best_map_is_the_camera_unless_noise_leaves_it_to_what_is_usual(perspective: float):
    heights = np.abs(np.cos(np.linspace(0, 9, 200)))
    grow = np.exp(perspective)
    places = 12 + 40 * grow * heights / (1 + (grow - 1) * heights)
    found = motion.best_map(heights, places, 0.01)
    assert found.perspective == pytest.approx(perspective, abs=0.01)
    assert found.positions(heights) == pytest.approx(places, abs=0.02)
    assert abs(motion.best_map(heights[::10], places[::10], 30.0).perspective) < 0.3
    places[::3] = np.nan  # where a track shows nothing, nothing is asked
    assert motion.best_map(heights, places, 0.01).span == pytest.approx(40, abs=0.1)


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
    films = motion.FilmedProblems()
    target = DropTarget(4.5, 0.5, 0.6)
    look = films.pose_papers(target).evaluate(np.array([0.6]))
    places = camera.image_from_world(look.episode.signals[TOPIC].values[: len(frames)])
    off = (track.places_px - places[: len(track.places_px)])[track.found]
    assert track.found.mean() > 0.95
    # Not the standard deviation: a picture in which the ball meets its shadow may be 2 px off.
    assert np.quantile(np.abs(off - np.median(off, axis=0)), 0.68, axis=0).max() < 0.2


# ---- Where the ball will be: one step of the engine, and the rows of the table.


@needs_pybullet
@pytest.mark.slow
def test_zero_and_untuned_rows():
    model, filmed = (
        shipped_model(preset.purpose)
        for preset in (TRAININGS["paper-code"], FILM_TRAININGS["paper"])
    )
    tuners = motion.Tuners(model, TuneNet(model), filmed, TuneNet(filmed))
    found = motion.tuning_errors(draw_targets(EASY, 100, 0), tuners, Progress(quiet=True))
    assert found["zero"].percent == pytest.approx(100)
    assert found["zero"].cm == pytest.approx(97.0, abs=2)  # the paper's
    # Not the paper's 20.57 %, 13.8 cm: those need another guess than U(.3, .7), see below.
    assert found["untuned"].percent == pytest.approx(10.9, abs=1.2)
    assert found["untuned"].cm == pytest.approx(8.9, abs=0.8)
    assert found["tunenet-gt"].percent < 1.08 * 1.6
    assert found["tunenet-gt"].cm < 0.7 * 1.6
    assert found["ours"] == found["tunenet-gt"]  # the same method here
    assert 2 < found["tunenet-obs"].percent < 12  # the paper's: 6.03, of one seed
    # What gives the published row: one restitution for every ball.
    rng = np.random.default_rng(1)
    release_m, truth = rng.uniform(4, 5, 200), rng.uniform(0.3, 0.7, 200)
    fixed, true = (motion.record_states(release_m, one) for one in (np.full(200, 0.665), truth))
    published = motion.motion_error(fixed[:, 1:, 0], true[:, 1:, 0])
    assert published.percent == pytest.approx(20.57, rel=0.08)
    assert published.cm == pytest.approx(13.8, rel=0.08)


@needs_pybullet
def test_one_step_from_any_state_is_that_of_an_uninterrupted_run():
    for restitution in (0.3, 0.5, 0.7):
        run = motion.record_states(np.array([4.3]), np.array([restitution]))[0]
        engine = motion.EngineStep(restitution)
        backwards = np.arange(400)[::-1]  # no state follows the one before it
        np.testing.assert_allclose(engine(run[backwards]), run[backwards + 1], rtol=0, atol=1e-12)
        free = motion.predict(motion.Memoryless(engine), run[None], 0)
        np.testing.assert_allclose(free, run[None, 1:, 0], rtol=0, atol=1e-12)
    assert np.ptp(run[300:, 0]) < 0.05  # the ball came to rest: resting contacts are among them


def test_a_prediction_sees_what_it_is_said_to_see():
    truth = np.cumsum(np.ones((1, 6, 2)), axis=1)  # 1, 2, ... 6
    still = motion.Memoryless(motion.stand_still)
    assert motion.predict(still, truth, 5).tolist() == [[1, 2, 3, 4, 5]]
    assert motion.predict(still, truth, 2).tolist() == [[1, 2, 3, 3, 3]]
    assert motion.predict(still, truth, 0).tolist() == [[1, 1, 1, 1, 1]]
