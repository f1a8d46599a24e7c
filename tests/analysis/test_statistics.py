"""Several models' opinions become one: a mean and an interval that hold what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tunenet_logs.analysis.statistics import ModelEstimate, average

OPINIONS = [ModelEstimate(0.7, (0.01, 0.01), 0.6), ModelEstimate(0.74, (0.02, 0.03), 0.3)]


def test_what_is_left_out_of_the_weights_moves_nothing():
    """Models that hardly count are dropped before: what is left need not add up to 1."""
    for scale in (0.5, 0.999, 1.0, 3.0):
        scaled = [replace(one, weight=scale * one.weight) for one in OPINIONS]
        mean, ends = average(scaled)
        assert mean == pytest.approx(0.7 * 2 / 3 + 0.74 / 3, abs=1e-12)
        assert ends == pytest.approx(average(OPINIONS)[1], abs=1e-7)


def test_one_opinion_is_its_own_mean_and_interval():
    mean, (low, high) = average([ModelEstimate(0.7402, (0.001, 0.002), 0.984)])
    assert mean == 0.7402
    assert (low, high) == pytest.approx((0.7402 - 1.96e-3, 0.7402 + 3.92e-3), abs=1e-6)


def test_the_interval_is_that_of_the_mixture():
    rng = np.random.default_rng(1)
    both = [replace(one, sds=(0.01, 0.01)) for one in OPINIONS]
    drawn = np.concatenate([rng.normal(0.7, 0.01, 400_000), rng.normal(0.74, 0.01, 200_000)])
    mean, ends = average(both)
    assert mean == pytest.approx(drawn.mean(), abs=2e-4)
    assert ends == pytest.approx(np.quantile(drawn, (0.025, 0.975)), abs=3e-4)
