"""The filmed drop's networks: what they see, what they were trained on, how exact they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis.drop.detection import FilmDetection
from analysis.drop.film import canonical_film
from analysis.drop.film_presets import TRAININGS, FilmPlan, any_rig, film_of
from analysis.drop.from_film import DropFromFilm
from analysis.estimators.tunenet import TuneNet
from analysis.tunenet.checkpoint import shipped_model
from analysis.tunenet.network import Model
from recorders.simulators.balls import Ball
from recorders.simulators.contact import CALIBRATED
from recorders.simulators.drop import DropRig, DropSimulator
from tunenet_logs.terminal import Progress

RIG = DropRig(1.0, 0.03, 60.0, 180, 0.2)
EXPERIMENT = DropFromFilm()


@pytest.fixture(scope="module")
def simulator() -> DropSimulator:
    return DropSimulator(RIG, CALIBRATED)


@pytest.fixture(scope="module")
def model() -> Model:
    return shipped_model(TRAININGS["default"].purpose)


def network_alone(model: Model, plan: FilmPlan, simulator: DropSimulator) -> float:
    film = film_of(plan, simulator)
    assert film is not None
    found = FilmDetection(True, "", 0, film.track, Ball())
    return float(TuneNet(model).estimate(EXPERIMENT.problem(found, np.zeros(1)), 5).estimate[0])


@pytest.mark.parametrize(
    ("noise_px", "most"), [(0.3, 0.006), pytest.param(1.0, 0.015, marks=pytest.mark.slow)]
)
def test_the_network_alone_finds_restitutions_in_tracks(
    model: Model, simulator: DropSimulator, noise_px: float, most: float
):
    """Any rig and camera. Of 200 such films the mean error is a third of this."""
    rng = np.random.default_rng([1010, int(10 * noise_px)])
    off = []
    for truth in np.linspace(0.15, 0.95, 10):
        plan = FilmPlan(any_rig(rng), float(truth), int(rng.integers(2**62)), noise_px)
        off.append(abs(network_alone(model, plan, simulator) - truth))
    assert np.mean(off) < most


def test_of_a_real_ball_it_is_the_first_impacts_that_is_found(
    model: Model, simulator: DropSimulator
):
    off = []
    for seed, truth in enumerate((0.4, 0.6, 0.8)):
        plan = FilmPlan(RIG, truth, seed + 1000, 0.1, slope=0.15)
        off.append(abs(network_alone(model, plan, simulator) - truth))
    assert np.mean(off) < 0.008


def test_a_real_ball_bounces_higher_and_higher_of_what_it_has(simulator: DropSimulator):
    plan = FilmPlan(RIG, 0.6, 1000, 0.1)
    ideal, real = film_of(plan, simulator), film_of(replace(plan, slope=0.2), simulator)
    assert ideal is not None
    assert real is not None
    second = slice(50, 70)  # both fly for the second time, 1.6 to 2.2 fall times after the impact
    higher = canonical_film(real).values[second] - canonical_film(ideal).values[second]
    assert higher.mean() > 0.02


@pytest.mark.parametrize("restitution", [0.1, 0.5, 0.95])
def test_equal_observations_do_not_differ(
    model: Model, simulator: DropSimulator, restitution: float
):
    film = film_of(FilmPlan(RIG, restitution, 1001, 0.5), simulator)
    assert film is not None
    seen = canonical_film(film).values[None]
    assert np.array_equal(model(seen, seen), np.zeros((1, 1)))


def test_training_pairs_are_of_a_simulation_and_a_film():
    pairs = TRAININGS["default"].make_pairs(16, 1011, 1, Progress(quiet=True))
    simulated = pairs.observations[pairs.proposed]
    assert np.isfinite(simulated).all()
    assert set(pairs.proposed) <= set(range(16))
    assert set(pairs.target) <= set(range(16, 32))
    assert np.abs(pairs.residuals).max() <= 1
    near = np.abs(pairs.residuals[:, 0]) < 0.02
    far = np.abs(pairs.residuals[:, 0]) > 0.2
    off = np.nanmean(np.abs(simulated - pairs.observations[pairs.target]), axis=(1, 2))
    assert off[far].mean() > 2 * off[near].mean()


def test_drag_asked_of_one_flight_is_said_to_be_little_known():
    for samples, warned in ((72, True), (180, False)):
        simulator = DropSimulator(replace(RIG, samples=samples), CALIBRATED)
        film = film_of(FilmPlan(simulator.rig, 0.8, 1000, 0.1), simulator)
        assert film is not None
        found = FilmDetection(True, "", 0, film.track, Ball(), fit_drag=True)
        assert any("one flight tells little" in one for one in found.warnings) == warned
