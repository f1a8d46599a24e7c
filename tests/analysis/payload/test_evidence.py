"""Priors whose scale the samples decide on: what is not there costs nothing."""

import numpy as np
import pytest

from tunenet_logs.analysis.payload.noise import (
    NormalEquations,
    averaged,
    likeliest_scales,
    posterior,
    scaled,
)


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
    found = posterior(normal, sds)
    expected = np.linalg.inv(normal.precision + np.diag(sds**-2))
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-8)
    np.testing.assert_allclose(found.means, expected @ normal.gradient, rtol=1e-8)


@pytest.mark.parametrize("scale", [0.0, 1.0, 3.0])
def test_the_likeliest_scale_is_the_true_one(scale):
    rng = np.random.default_rng(2)
    normal = samples(rng, scale * 0.5 * rng.normal(0, 1, 20), 0.1)
    groups = {"other": np.arange(1, 21)}
    sds = np.full(21, 0.5) + 5 * (np.arange(21) == 0)
    logs = likeliest_scales(normal, sds, groups, {}, 20)
    assert np.exp(logs["other"]) == pytest.approx(scale, rel=0.4, abs=0.05)
    found = posterior(normal, scaled(sds, groups, logs))
    means, covariance = averaged(found, groups, logs, np.array([0]))
    sd = float(np.sqrt(covariance[0, 0]))
    assert abs(means[0] - 2) < 3 * sd
    assert (sd < 0.04) == (scale == 0)


def test_what_samples_cannot_tell_of_a_scale_widens_the_answer():
    """A slope that is the other's double: only their scales' priors tell them apart."""
    slopes = np.outer(np.ones(30), [1.0, 2.0])
    normal = NormalEquations(slopes.T @ slopes, slopes.T @ np.ones(30))
    groups = {"left": np.array([1])}
    sds = np.array([1.0, 0.5])
    logs = likeliest_scales(normal, sds, groups, {}, 20)
    found = posterior(normal, scaled(sds, groups, logs))
    _, covariance = averaged(found, groups, logs, np.array([0]))
    assert covariance[0, 0] > 1.2 * found.covariance[0, 0]
