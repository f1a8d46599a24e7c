"""The filmed drop and the network: one canonical observation, whoever looked."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.drop.detection import FilmDetection
from tunenet_logs.analysis.drop.film import canonical_film, find_filmed_drop
from tunenet_logs.analysis.drop.motion import drop_problem
from tunenet_logs.analysis.drop.presets import FILM_TRAININGS
from tunenet_logs.analysis.drop.presets import TRAININGS as DROP_TRAININGS
from tunenet_logs.analysis.estimators.methods import TuneNet
from tunenet_logs.analysis.evaluation.worlds.camera import B, BallRanges, draw_scene, film
from tunenet_logs.analysis.tunenet.network import Model
from tunenet_logs.analysis.tunenet.weights import shipped_model
from tunenet_logs.recorders.simulators.known import Ball

SEED = -78


@pytest.fixture(scope="module")
def model() -> Model:
    return shipped_model(FILM_TRAININGS["default"].purpose)


def test_films_and_positions_share_a_network():
    assert FILM_TRAININGS["default"] is DROP_TRAININGS["default"]


@pytest.mark.parametrize(
    ("noise_px", "most"), [(0.3, 0.006), pytest.param(1.0, 0.015, marks=pytest.mark.slow)]
)
def test_the_network_alone_finds_restitutions_in_tracks(model: Model, noise_px: float, most: float):
    off: list[float] = []
    for number in range(8):
        scene = draw_scene(B, BallRanges((0.2, 0.95), slope=(0.0, 0.1)), noise_px, SEED, number)
        found = FilmDetection(True, "", 0, film(scene), Ball())
        problem = drop_problem(found, np.zeros(3))
        off.append(float(TuneNet(model).estimate(problem, 5).estimate[0]) - scene.ball.restitution)
    assert np.mean(np.abs(off)) < most


@pytest.mark.parametrize("restitution", [0.2, 0.5, 0.95])
def test_equal_observations_do_not_differ(model: Model, restitution: float):
    scene = draw_scene(B, BallRanges((restitution, restitution)), 0.3, SEED, 1)
    seen = canonical_film(find_filmed_drop(film(scene), 0)).values[None]
    assert np.array_equal(model(seen, seen), np.zeros((1, 3)))
