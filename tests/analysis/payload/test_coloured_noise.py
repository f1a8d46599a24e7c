"""White noise and a wandering part: as dense matrices have it, and found again in residuals."""

import numpy as np
import pytest

from tunenet_logs.analysis.payload.noise import SeriesNoise, estimated, unknown

SECONDS = np.cumsum(np.random.default_rng(0).uniform(0.005, 0.02, 400))


def covariance(white: float, wander: float, time_s: float) -> np.ndarray:
    apart = np.abs(SECONDS[:, None] - SECONDS)
    return white**2 * np.eye(len(SECONDS)) + wander**2 * np.exp(-apart / time_s)


@pytest.mark.parametrize("wander", [0.0, 0.3])
def test_it_weighs_as_the_inverse_covariance_does(wander):
    noise = SeriesNoise(SECONDS, np.ones(len(SECONDS)), 0.2, wander, 0.4)
    dense = covariance(0.2, wander, 0.4)
    columns = np.random.default_rng(1).normal(0, 1, (len(SECONDS), 3))
    np.testing.assert_allclose(noise.weighed(columns), np.linalg.solve(dense, columns), rtol=1e-6)
    expected = -0.5 * columns[:, 0] @ np.linalg.solve(dense, columns[:, 0])
    expected -= 0.5 * np.linalg.slogdet(dense)[1]
    assert noise.log_likelihood(columns[:, 0]) == pytest.approx(expected, rel=1e-8)


def test_what_wanders_is_found_and_white_noise_stays_white():
    rng = np.random.default_rng(2)
    root = np.linalg.cholesky(covariance(0.1, 0.3, 0.5))
    residual = np.column_stack(
        [root @ rng.normal(0, 1, len(SECONDS)), 0.2 * rng.normal(0, 1, len(SECONDS))]
    )
    before = (unknown(SECONDS, 0.3), unknown(SECONDS, 0.3))
    wandering, white = estimated(before, residual, np.zeros(2), np.full(2, 1e-4), roughly=False)
    assert wandering.white_nm == pytest.approx(0.1, rel=0.25)
    assert wandering.wander_nm == pytest.approx(0.3, rel=0.5)
    assert 0.1 < wandering.time_s < 2
    total = np.hypot(white.white_nm, white.wander_nm)
    assert total == pytest.approx(0.2, rel=0.1)


def test_spikes_count_for_less():
    residual = 0.1 * np.random.default_rng(3).normal(0, 1, (len(SECONDS), 1))
    residual[::50] += 10
    noise = estimated(
        (unknown(SECONDS, 0.3),), residual, np.zeros(1), np.full(1, 1e-4), roughly=False
    )[0]
    assert noise.weights[::50].max() < 0.01
    assert np.hypot(noise.white_nm, noise.wander_nm) < 0.2


def test_rounding_shows_no_correlation():
    """Residuals of exact torques are smooth by chance, whatever the number of threads."""
    residual = 1e-13 * np.sin(SECONDS)[:, None]
    before = (unknown(SECONDS, 0.3),)
    (noise,) = estimated(before, residual, np.zeros(1), np.full(1, 1e-4), roughly=False)
    assert noise.wander_nm == 0
