"""Sandwich covariance of a least-squares fit with autocorrelated residuals.

Residuals of a simulator are correlated: noise is filtered, and no model is exact. The scores are
summed with Newey-West weights (Econometrica 1987), with Andrews' bandwidth (1991).
"""

from __future__ import annotations

import numpy as np

from analysis.sysid.compared import ComparedColumns
from analysis.sysid.gauss_newton import Solution, ranges_of
from recorders.simulators.base import Parameter
from tunenet_logs.arrays import Array

_MAX_BINS = 2000
_MAX_SHARE = 0.2  # of the log, over which scores are taken to hang together at most
# Precision of a parameter of which nothing is known, in its range: ten of these are one sd.
_FLAT = 1e-2


def covariance(
    solution: Solution, target: ComparedColumns, parameters: tuple[Parameter, ...]
) -> tuple[Array, float]:
    """Return the values' sandwich covariance, shape (P, P), and the effective sample size."""
    scales = ranges_of(parameters)
    weights = solution.chosen / target.per_value(solution.noise) ** 2
    slopes = solution.slopes * scales
    precision = np.array(
        [
            _FLAT if one.prior_sd is None else (scale / one.prior_sd) ** 2
            for one, scale in zip(parameters, scales, strict=True)
        ]
    )
    bread = np.linalg.inv(slopes.T @ (weights[:, None] * slopes) + np.diag(precision))
    scores = _by_moment(slopes * (weights * solution.residuals)[:, None], target)
    span = _bandwidth(scores @ bread)
    meat = scores.T @ scores
    for lag in range(1, span + 1):
        shared = scores[lag:].T @ scores[:-lag]
        meat += (1 - lag / (span + 1)) * (shared + shared.T)
    white = slopes.T @ (weights[:, None] * slopes)
    found = bread @ (_at_least(meat, white) + np.diag(precision)) @ bread
    independent = len(scores) / (1 + span)
    found *= independent / max(independent - len(parameters), 1.0)
    return found * np.outer(scales, scales), independent


def _by_moment(scores: Array, target: ComparedColumns) -> Array:
    """Sum scores over columns in bins of time, shape (K, P)."""
    longest = max(len(column.values) for column in target.columns)
    count = min(longest, _MAX_BINS)
    place = np.minimum((target.seconds / max(target.end_s, 1e-9) * count).astype(int), count - 1)
    sums = np.zeros((count, scores.shape[1]))
    np.add.at(sums, place, scores)
    return sums


def _bandwidth(influences: Array) -> int:
    """Return Andrews' bandwidth by an AR(1) model of each parameter's scores."""
    count = len(influences)
    before, after = influences[:-1], influences[1:]
    power = np.sum(before**2, axis=0)
    share = np.where(power > 0, np.sum(before * after, axis=0) / np.maximum(power, 1e-300), 0.0)
    share = np.clip(share, 0.0, 0.97)
    alpha = 4 * share**2 / ((1 - share) ** 2 * (1 + share) ** 2)
    span = 1.1447 * (float(alpha.max(initial=0.0)) * count) ** (1 / 3)
    return int(np.clip(span, 1, _MAX_SHARE * count))


def _at_least(meat: Array, white: Array) -> Array:
    """Raise the meat so that it is nowhere below that of white noise.

    Anticorrelation by chance must not narrow an interval.
    """
    factor = np.linalg.cholesky(white + (1e-9 * np.trace(white) + 1e-30) * np.eye(len(white)))
    inner = np.linalg.solve(factor, np.linalg.solve(factor, meat).T)
    sizes, axes = np.linalg.eigh((inner + inner.T) / 2)
    kept = axes @ np.diag(np.maximum(sizes, 1.0)) @ axes.T
    return factor @ kept @ factor.T
