"""Fit a drop by least squares with the known model: the best that a log allows.

It fits the integrator of `physics` to the heights, from the truth on, and knows gravity, the noise
and the ranges that the balls were drawn from. Around its best values the model is taken as linear:
what is left to find is integrated over, and the ranges of slope and drag are kept to exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.evaluation.real_balls.drops import RecordedDrop, WorldCell
from analysis.evaluation.real_balls.physics import RealBall, fallen
from tunenet_logs.arrays import Array

_STEPS = 12  # of half a flight: within some micrometres of the truth's
# For derivatives: of restitution, slope, drag, drop, release and level.
_NUDGES = np.array([1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-4])

_GRID = 121  # slopes and drags that the ranges are kept to on
_ENDS = (0.025, 0.5, 0.975)


@dataclass(frozen=True, eq=False)
class ReferenceFit:
    """Fitted restitution, slope and drag [1/m], in this order.

    Attributes:
        values: medians, shape (3,).
        interval95: lower and upper ends, shape (3, 2).
        ball: of the best path.
        release_s: of the best path, on the drop's clock: 0 is the truth.
    """

    values: Array
    interval95: Array
    ball: RealBall
    release_s: float

    def heights_m(self, seconds: Array) -> Array:
        """Return the best path over its contact, at times on the drop's clock, shape (T,)."""
        since = seconds - self.release_s
        return fallen(self.ball.values[None], float(since[-1])).at(since[None])[0]


def fit_reference(drop: RecordedDrop, cell: WorldCell) -> ReferenceFit:
    """Fit one drop whose slope and drag are from the ranges of `cell`."""
    from scipy.optimize import least_squares

    truth = drop.ball
    start = np.array([*truth.values, 0.0, drop.level_m])
    low = np.array([0.0, cell.slopes[0], cell.drags_1_m[0], 0.01, -1.0, -np.inf])
    high = np.array([1.0, cell.slopes[1], cell.drags_1_m[1], np.inf, 1.0, np.inf])

    def residuals(values: Array) -> Array:
        return _residuals(values[None], drop)[0]

    def slopes(values: Array) -> Array:
        there = np.concatenate([values + np.diag(_NUDGES), values - np.diag(_NUDGES)])
        above, below = np.split(_residuals(there, drop), 2)
        return ((above - below) / (2 * _NUDGES[:, None])).T

    margin = 1e-9 * (high[1:3] - low[1:3])
    start[1:3] = np.clip(start[1:3], low[1:3] + margin, high[1:3] - margin)
    # the stubs know "2-point" and the like alone
    by: Any = slopes
    best = least_squares(
        *(residuals, start, by),
        bounds=(low, high),
        x_scale="jac",
        ftol=1e-6,  # of a sum of some hundred squares: nothing beside the noise
        xtol=1e-6,
        max_nfev=30,
    )
    values, interval95 = _posterior(best.x[:3], best.fun, best.jac, cell)
    e, p, k, height, release, _ = (float(value) for value in best.x)
    return ReferenceFit(values, interval95, RealBall(e, p, k, height), release)


def _residuals(values: Array, drop: RecordedDrop) -> Array:
    """Return residuals of B sets of values, over the noise, shape (B, T)."""
    seconds = drop.seconds - values[:, 4:5]
    paths = fallen(values[:, :4], float(seconds.max()), _STEPS)
    heights = paths.at(seconds) + values[:, 5:6]
    return (heights - drop.positions_m[:, 2]) / drop.noise_m


def _posterior(best: Array, misfit: Array, slopes: Array, cell: WorldCell) -> tuple[Array, Array]:
    """Return medians, shape (3,), and 95 % intervals, shape (3, 2), of the parameters.

    Args:
        best: restitution, slope and drag of the best path, shape (3,).
        misfit: its residuals over the noise, shape (T,).
        slopes: their derivatives by these three and by what else is fitted, shape (T, 6).
        cell: whose ranges are kept to.
    """
    others, _ = np.linalg.qr(slopes[:, 3:])
    own = slopes[:, :3] - others @ (others.T @ slopes[:, :3])
    misfit = misfit - others @ (others.T @ misfit)
    # Given slope and drag, the restitution is normal; their own weight is what that leaves.
    unit = own[:, 0] / (own[:, 0] @ own[:, 0])
    deviation = 1 / float(np.linalg.norm(own[:, 0]))
    shift = -unit @ np.column_stack([misfit, own[:, 1:]])
    rest = np.column_stack([misfit, own[:, 1:]])
    rest = rest + np.outer(own[:, 0], shift)
    precision = rest.T @ rest

    def over(low: float, high: float, at: float, weight: float) -> Array:
        reach = 8 / np.sqrt(max(weight, 1e-12))
        return np.linspace(max(low, at - reach), min(high, at + reach), _GRID)

    ranges = np.array([np.ptp(cell.slopes), np.ptp(cell.drags_1_m)])
    spread = np.linalg.inv(precision[1:, 1:] + np.diag(ranges**-2))
    slope = over(*cell.slopes, float(best[1]), 1 / spread[0, 0])
    drag = over(*cell.drags_1_m, float(best[2]), 1 / spread[1, 1])
    off = np.stack(np.meshgrid(slope - best[1], drag - best[2], indexing="ij"))
    squares = 2 * np.einsum("a,aij->ij", precision[0, 1:], off)
    squares += np.einsum("ab,aij,bij->ij", precision[1:, 1:], off, off)
    weights = np.exp(-(squares - squares.min()) / 2) / drag
    weights /= weights.sum()
    centres = best[0] + shift[0] + np.einsum("a,aij->ij", shift[1:], off)
    found = np.array(
        [
            _normal_quantiles(centres.ravel(), deviation, weights.ravel()),
            _grid_quantiles(slope, weights.sum(axis=1)),
            _grid_quantiles(drag, weights.sum(axis=0)),
        ]
    )
    return found[:, 1], found[:, [0, 2]]


def _grid_quantiles(grid: Array, weights: Array) -> Array:
    """Return the quantiles of a density on an even grid, by trapezia, shape (3,)."""
    mass = np.concatenate([[0.0], np.cumsum((weights[1:] + weights[:-1]) / 2)])
    return np.interp(_ENDS, mass / mass[-1], grid)


def _normal_quantiles(centres: Array, deviation: float, weights: Array) -> Array:
    """Return the quantiles of a mixture of normals of one deviation, shape (3,)."""
    from scipy.special import ndtr

    kept = weights > 1e-7 * weights.max()
    centres, weights = centres[kept], weights[kept] / weights[kept].sum()
    grid = np.linspace(centres.min() - 5 * deviation, centres.max() + 5 * deviation, 401)
    mass = np.array([weights @ ndtr((at - centres) / deviation) for at in grid])
    return np.interp(_ENDS, mass, grid)
