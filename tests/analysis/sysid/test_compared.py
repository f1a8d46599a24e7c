"""The noise of a sampled curve."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.sysid.compared import noise_of

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
