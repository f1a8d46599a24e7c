"""Values that nothing measures do not come into an analysis."""

from __future__ import annotations

import numpy as np

from tunenet_logs.analysis.experiment import drop_invalid_samples
from tunenet_logs.episode import Episode, EpisodeInfo, Signal


def episode_of(*heights: float) -> Episode:
    values = np.zeros((len(heights), 3))
    values[:, 2] = heights
    signal = Signal("/ball", np.arange(len(heights)), values, ("x", "y", "z"), "m")
    return Episode(EpisodeInfo(), {"/ball": signal})


def test_an_honest_log_is_the_same_object():
    episode = episode_of(1.0, np.nan, -3e6, 0.0)
    assert drop_invalid_samples(episode) is episode


def test_what_is_beyond_all_measuring_is_left_out_and_counted():
    seen = drop_invalid_samples(episode_of(1.0, 1e308, -1e300, np.inf, 1e-320, 2.0))
    heights = seen.signals["/ball"].values[:, 2]
    assert np.array_equal(heights, [1.0, np.nan, np.nan, np.nan, 0.0, 2.0], equal_nan=True)
    assert "/ball: 3 values beyond 1e+12 were left out" in seen.warnings[0]
