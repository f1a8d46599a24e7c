"""The quantile of a mixture of normal distributions."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.statistics import mixture_quantile

MIDDLES, SDS, WEIGHTS = np.array([0.7, 0.74, 9.0]), np.full(3, 0.01), np.array([0.6, 0.3, 1e-13])


def ends(weights: np.ndarray) -> list[float]:
    return [mixture_quantile(at, MIDDLES, SDS, weights) for at in (0.025, 0.975)]


@pytest.mark.parametrize("scale", [0.5, 1.0, 3.0])
def test_weights_need_not_add_up_to_one(scale: float):
    assert ends(scale * WEIGHTS) == pytest.approx(ends(WEIGHTS), abs=1e-7)


def test_the_interval_is_that_of_the_mixture():
    rng = np.random.default_rng(1)
    drawn = np.concatenate([rng.normal(0.7, 0.01, 400_000), rng.normal(0.74, 0.01, 200_000)])
    assert ends(WEIGHTS) == pytest.approx(np.quantile(drawn, (0.025, 0.975)), abs=3e-4)
