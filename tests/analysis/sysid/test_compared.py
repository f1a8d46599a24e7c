"""Which samples are compared, and the noise of a sampled curve."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.sysid.fit import compared, noise_of
from tunenet_logs.episode import Episode, EpisodeInfo, Signal

SECONDS = np.arange(0, 10, 0.005)


@pytest.mark.parametrize("noise", [1e-9, 1e-3, 0.1, 1e6])
def test_white_noise_comes_back(noise: float):
    rng = np.random.default_rng(0)
    curve = noise * (5 * np.sin(2 * SECONDS) + rng.normal(size=len(SECONDS)))
    assert noise_of(curve) == pytest.approx(noise, rel=0.1)


@pytest.mark.parametrize("step", [1e-4, 0.01])
def test_what_is_rounded_has_no_less_noise_than_its_steps(step: float):
    curve = np.round(np.sin(0.2 * SECONDS) / step) * step
    assert step / 4 < noise_of(curve) < step


@pytest.mark.parametrize("count", [0, 1, 4, 5, 100])
def test_constants_have_none(count: int):
    assert noise_of(np.full(count, 3.0)) == 0.0


def test_a_smooth_curve_has_next_to_none():
    assert noise_of(np.sin(SECONDS)) < 1e-5


@pytest.mark.parametrize("count", [19_999, 20_000, 20_001, 50_000])
def test_long_columns_are_thinned_with_their_stamps(count: int):
    stamps_ns = 1_000_000 * np.arange(count)
    values = np.stack([np.sin(1e-9 * stamps_ns), np.full(count, np.nan)], axis=1)
    values[7, 0] = np.nan
    log = Episode(EpisodeInfo(), {"/x": Signal("/x", stamps_ns, values, ("x", "y"), "m")})
    target = compared(log, log)
    assert len(target.columns) == 1
    assert 15_000 < len(target.values) <= 20_000
    np.testing.assert_allclose(target.values, np.sin(target.seconds), atol=1e-12)
    np.testing.assert_allclose(target.seen_in(log), target.values, atol=1e-12)
