"""Training learns, repeats itself, and its pairs are what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop import presets as film_presets
from tunenet_logs.analysis.drop.presets import TRAININGS
from tunenet_logs.analysis.tunenet.network import (
    initial_weights,
    mixed_pairs,
    one_step_error,
    train,
)
from tunenet_logs.terminal import Progress

QUIET = Progress(quiet=True)


@pytest.mark.parametrize(
    "name",
    [pytest.param(one, marks=[pytest.mark.slow] * (one != "default")) for one in TRAININGS],
)
def test_a_short_training_beats_no_training(name: str):
    preset = TRAININGS[name]
    pairs = preset.make_pairs(100, 0, 1, QUIET)
    recipe = replace(preset.recipe, epochs=40)
    model = train(preset.network, pairs, recipe, 0, QUIET)
    fresh = preset.make_pairs(100, 99, 1, QUIET)
    rng = np.random.default_rng(0)
    inputs = pairs.observations.shape[1]
    untrained = replace(
        model, weights=initial_weights(preset.network, inputs, preset.purpose.outputs, rng)
    )
    assert one_step_error(model, fresh) < 0.5 * one_step_error(untrained, fresh)


@needs_pybullet
def test_the_papers_pairs_of_films_show_z_beside_the_pictures_y():
    pairs = film_presets.FILM_TRAININGS["paper"].make_pairs(12, 0, 1, QUIET)
    simulated, filmed = pairs.observations[pairs.proposed], pairs.observations[pairs.target]
    assert simulated.shape == filmed.shape == (12, 400, 1)
    assert 0.78 < simulated[:, 0].min() <= simulated[:, 0].max() < 1.02
    assert (simulated[:, 0] > simulated[:, -1]).all()
    assert (filmed >= 0).all()
    assert (filmed <= 1).all()
    assert (filmed[:, 0] < filmed[:, -1]).all()


def test_the_same_seed_gives_the_same_weights():
    preset = TRAININGS["default"]
    pairs = preset.make_pairs(100, 0, 1, QUIET)
    recipe = replace(preset.recipe, epochs=2)
    first, again = (train(preset.network, pairs, recipe, 5, QUIET) for _ in range(2))
    other = train(preset.network, pairs, recipe, 6, QUIET)
    for name, weight in first.weights.items():
        assert np.array_equal(weight, again.weights[name])
    assert not np.array_equal(first.weights["out.weight"], other.weights["out.weight"])


@needs_pybullet
def test_what_one_of_a_pair_lacks_is_not_learnt_from_the_other():
    preset = TRAININGS["paper-code"]
    pairs = preset.make_pairs(50, 0, 1, QUIET)
    whole = pairs.observations
    recipe = replace(preset.recipe, epochs=1)
    trained = []
    for seen, there in ((np.nan, 1.0), (np.nan, 9.0), (2.0, 1.0), (2.0, 9.0)):
        observations = whole.copy()
        observations[pairs.target, 30:60] = seen
        observations[pairs.proposed, 30:60] = there
        model = train(preset.network, replace(pairs, observations=observations), recipe, 0, QUIET)
        trained.append(model.weights["proposed.weight"])
    assert np.array_equal(trained[0], trained[1])
    assert not np.array_equal(trained[2], trained[3])


@needs_pybullet
def test_pairs_do_not_depend_on_the_number_of_processes():
    preset = TRAININGS["paper-code"]
    alone, together = (preset.make_pairs(20, 3, jobs, QUIET) for jobs in (1, 2))
    assert np.array_equal(alone.observations, together.observations)
    assert np.array_equal(alone.residuals, together.residuals)


@needs_pybullet
def test_the_papers_pairs_share_their_height_and_keep_its_range():
    pairs = TRAININGS["paper-code"].make_pairs(30, 0, 1, QUIET)
    first = pairs.observations[:, 0, 0]
    assert np.array_equal(first[pairs.proposed], first[pairs.target])
    assert first.min() > 3.99
    assert first.max() < 5
    assert pairs.values.min() >= 0.3
    assert pairs.values.max() <= 0.7
    assert pairs.observations.shape == (60, 400, 1)


def test_half_of_the_mixed_pairs_are_close_together():
    rng = np.random.default_rng(0)
    values = rng.random((1000, 2))
    proposed, target = mixed_pairs(values, 10_000, rng)
    off = np.abs(values[proposed, 0] - values[target, 0])
    assert 0.4 < np.mean(off < 0.1) < 0.8
    assert off.max() > 0.9
