"""Intervals that cover, whether noise is white or hangs together."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import t

from tests.analysis.sysid.toy import SECONDS, line, parameter, target_of
from tunenet_logs.analysis.sysid.fit import Solution, covariance

LOGS = 400


@pytest.mark.parametrize(("memory", "least"), [(0.0, 0.90), (0.6, 0.90), (0.85, 0.90)])
def test_95_percent_intervals_cover(memory: float, least: float):
    """Where few independent moments are left, sums over lags come out a little small."""
    rng = np.random.default_rng(3)
    truth = np.array([1.0, -2.0])
    slopes = np.column_stack([line(row) for row in np.eye(2)])
    parameters = (parameter("a"), parameter("b"))
    inside = np.zeros(2)
    for _ in range(LOGS):
        drawn = rng.normal(size=len(SECONDS) + 200)
        noise = 0.05 * np.asarray(lfilter([1.0], [1.0, -memory], drawn))[200:]
        target = target_of(line(truth) + noise)
        values = np.linalg.lstsq(slopes, target.values, rcond=None)[0].astype(np.float64)
        residuals = line(values) - target.values
        everything = np.ones(len(SECONDS), bool)
        noise_left, no_bends = target.rms(residuals), np.zeros((2, len(SECONDS)))
        solution = Solution(values, residuals, slopes, noise_left, (), everything, no_bends)
        found, independent = covariance(solution, target, parameters)
        half = t.ppf(0.975, max(independent - 2, 1)) * np.sqrt(np.diag(found))
        inside += np.abs(values - truth) < half
    assert (inside / LOGS >= least).all(), inside / LOGS
    assert (inside / LOGS <= 0.985).all(), inside / LOGS
