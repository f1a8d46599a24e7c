"""Priors whose scale the samples decide on: what is not there costs nothing."""

import numpy as np
import pytest

from analysis.payload.evidence import Level, NormalEquations, posterior, weighted_models

OFF_OR_ON = (Level(0.0, 0.5), Level(1.0, 0.5))


def samples(rng, nuisances, noise):
    """One value of interest, 2, in the first column; 20 nuisances beside it."""
    slopes = rng.normal(0, 1, (60, 21))
    slopes[:, 1:] += slopes[:, :1]
    target = slopes @ np.concatenate([[2.0], nuisances]) + noise * rng.normal(0, 1, 60)
    return NormalEquations(slopes.T @ slopes / noise**2, slopes.T @ target / noise**2)


def test_a_single_model_is_least_squares_with_a_prior():
    rng = np.random.default_rng(1)
    normal = samples(rng, 0.3 * rng.normal(0, 1, 20), 0.1)
    sds = np.full(21, 0.5)
    means, covariance = posterior(normal, sds)
    expected = np.linalg.inv(normal.precision + np.diag(sds**-2))
    np.testing.assert_allclose(covariance, expected, rtol=1e-8)
    np.testing.assert_allclose(means, expected @ normal.gradient, rtol=1e-8)


@pytest.mark.parametrize("scale", [0.0, 1.0])
def test_the_likeliest_model_is_the_true_one(scale):
    rng = np.random.default_rng(2)
    normal = samples(rng, scale * 0.5 * rng.normal(0, 1, 20), 0.1)
    groups = {"other": np.arange(1, 21)}
    models = weighted_models(
        normal, np.full(21, 0.5) + 5 * (np.arange(21) == 0), groups, {"other": OFF_OR_ON},
        np.array([0]),
    )  # fmt: skip
    assert models[0].levels == {"other": scale}
    assert models[0].weight > 0.99
    sd = float(np.sqrt(models[0].covariance[0, 0]))
    assert abs(models[0].means[0] - 2) < 3 * sd
    assert (sd < 0.02) == (scale == 0)


def test_weights_add_up():
    rng = np.random.default_rng(3)
    normal = samples(rng, 0.02 * rng.normal(0, 1, 20), 0.3)
    groups = {"left": np.arange(1, 11), "right": np.arange(11, 21)}
    models = weighted_models(
        normal, np.ones(21), groups, {"left": OFF_OR_ON, "right": OFF_OR_ON}, np.array([0])
    )
    assert sum(one.weight for one in models) == pytest.approx(1)
