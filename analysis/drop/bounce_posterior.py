"""Posterior of a ball: restitution, slope and drag, each with its 95 % credible interval.

Near the fit the likelihood is normal in all unknowns (Laplace approximation), and all but slope and
drag are marginalised in closed form. Over those two it is multiplied with the priors of balls, on a
grid: many keep their restitution or hardly feel the air, none gains by speed, few are as light as a
table-tennis ball. So a ball that shows neither slope nor drag is taken for what it is, one that
shows both gets both, and where the samples cannot tell, the interval covers what they leave open
(Bayesian model averaging, Hoeting et al. 1999). The ends of the restitution's interval then move
by as much as the profile likelihood is wider, or narrower, than the normal one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.bounce_fit import BounceFit, fit_bounce
from analysis.drop.bounce_likelihood import ANY_RESTITUTION_SD, BallLikelihood, ball_likelihoods
from analysis.drop.bounce_model import DRAG, FALL, KNOWN_DRAG, RESTITUTION, SLOPE
from analysis.drop.times.impact_prior import NO_DRAG, NO_SLOPE
from analysis.statistics import TWO_SIDED, correlation_time, mixture_quantile
from recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.arrays import Array

# Prior probabilities of a ball that keeps its restitution, and of one that the air does not slow:
# simulators drop such balls. In a picture lens and blur look like a little drag, too.
_NO_SLOPE, _NO_DRAG, _NO_DRAG_IN_PICTURE = 0.4, 0.5, 0.85

# Prior of another ball's slope: half normal, with a little room below 0.
_SLOPE_SD, _NEGATIVE_SD = 0.12, 0.01

# Prior of another ball's drag: log normal. A steel ball has .002, a table-tennis ball .13.
_TYPICAL_DRAG_1_M, _LOG_DRAG_SD = 0.03, 1.3

_NODES, _REACH_SDS = 45, 4.5  # of the grid along one axis, and how far it goes
_MIN_SD = 1e-5  # of a restitution: no lens, no clock and no simulator are better
_MIN_SD_IN_PICTURE = 2e-4  # the same of a film
_FILM_WIDER = 1.1  # factor on a film's intervals of the restitution: without it too few cover
# How much less likely the ends are: a t distribution is flatter than the noise of a track.
_RISE = 0.93 * TWO_SIDED**2 / 2

# Standard deviation of a restitution beyond which the ends are searched for, in so many steps: near
# 0 a rebound grows with its square, and no normal likelihood describes it.
_UNSURE, _SEARCHED = 0.03, 4

# Most that a profile changes a normal interval: beyond that it found another minimum.
_NARROWER, _WIDER = 0.8, 2.5


@dataclass(frozen=True, eq=False)
class BallPosterior:
    """Posterior of a ball's restitution, slope and drag.

    Attributes:
        values: posterior means of restitution, slope, drag [1/m], shape (3,).
        interval95: shape (3, 2).
        fit: the fit, with slope and drag held at these values, all else fitted to them.
        correlation: of slope and drag by the samples alone: near -1 or 1 these trade places.
        told: how much narrower than its prior each interval of slope and drag is, from 0 (the
            prior's) to 1, shape (2,).
    """

    values: Array
    interval95: Array
    fit: BounceFit
    correlation: float
    told: Array


def ball_posterior(fit: BounceFit) -> BallPosterior:
    """Compute a ball's posterior by Bayesian model averaging over slope, drag and scatter."""
    height_m = GRAVITY_M_S2 * float(np.exp(2 * fit.unknowns[FALL])) / 2
    factor = max(correlation_time(fit.residuals, len(fit.free)), fit.effective_sample_factor)
    likelihoods = ball_likelihoods(fit, factor)
    grids = [_Grid.of(one, fit, height_m) for one in likelihoods]
    logs = np.array([grid.log_evidence for grid in grids])
    shares = np.exp(logs - logs.max()) / np.exp(logs - logs.max()).sum()
    axes = [_mixed(axis, shares) for axis in zip(*(grid.axes for grid in grids), strict=True)]
    means = [float(weights @ middles) for middles, _, weights in axes]
    ends = np.array([[mixture_quantile(at, *axis) for at in (0.025, 0.975)] for axis in axes])
    wider = _profile_factors(fit, factor) * (1 if fit.samples.in_metres else _FILM_WIDER)
    ends[0] = means[0] + (ends[0] - means[0]) * wider
    ends = np.clip(ends, [[0.0], [-np.inf], [0.0]], [[1.0], [np.inf], [np.inf]])
    held = fit.unknowns.copy()
    held[[RESTITUTION, SLOPE, DRAG]] = means[0], means[1], means[2] * height_m
    rest = tuple(index for index in fit.free if index not in (SLOPE, DRAG))
    final = replace(fit_bounce(fit.samples, held, rest), free=fit.free)
    values = np.array([np.clip(means[0], 0.0, 1.0), means[1], means[2]])
    width = np.ptp(ends[1:], axis=1)
    return BallPosterior(
        values,
        ends,
        final,
        likelihoods[int(shares.argmax())].correlation,
        np.clip(1 - width / _prior_widths(fit), 0.0, 1.0),
    )


# A mixture of normal distributions: their middles, standard deviations and weights, shape (M,).
_Axis = tuple[Array, Array, Array]


@dataclass(frozen=True, eq=False)
class _Grid:
    """Balls on a grid over slope and drag, weighted by one likelihood.

    Attributes:
        axes: of the restitution, the slope and the drag [1/m].
        log_evidence: logarithm of the likelihood, averaged over them.
    """

    axes: tuple[_Axis, _Axis, _Axis]
    log_evidence: float

    @classmethod
    def of(cls, likelihood: BallLikelihood, fit: BounceFit, height_m: float) -> _Grid:
        """Build the grid around the likelihood's mode, with balls of no slope and of no drag."""
        middle, sds = likelihood.middle, likelihood.sds
        slopes, slope_step = _nodes(float(middle[0]), float(sds[0]), -0.05, 0.45)
        drags, drag_step = _nodes(float(middle[1]) / height_m, float(sds[1]) / height_m, 0.0, 1.0)
        is_heard = fit.samples.heard is not None
        no_slope = NO_SLOPE if is_heard else _NO_SLOPE
        slope_prior = _slope_density(slopes) * slope_step * (1 - no_slope)
        known = fit.samples.drag_1_m
        if known is None:
            none = _NO_DRAG if fit.samples.in_metres else _NO_DRAG_IN_PICTURE
            none = NO_DRAG if is_heard else none
            drag_prior = _drag_density(drags) * drag_step * (1 - none)
            drags, drag_prior = np.append(drags, 0.0), np.append(drag_prior, none)
        else:
            drags, drag_step = _nodes(known, KNOWN_DRAG * known, 0.0, 2 * known)
            drag_prior = np.exp(-0.5 * ((drags - known) / (KNOWN_DRAG * known)) ** 2)
        slopes, slope_prior = np.append(slopes, 0.0), np.append(slope_prior, no_slope)
        both = np.meshgrid(slopes, drags, indexing="ij")
        flat_slopes, flat_drags = (one.ravel() for one in both)
        prior = np.outer(slope_prior, drag_prior).ravel()
        log = likelihood.log_density(flat_slopes, flat_drags * height_m)
        log += np.log(np.maximum(prior, 1e-300))
        weights = np.exp(log - log.max())
        log_evidence = float(log.max() + np.log(weights.sum()))
        weights /= weights.sum()
        restitution = likelihood.restitution(flat_slopes, flat_drags * height_m)
        sd = likelihood.sd_of_all(flat_slopes, flat_drags * height_m, weights)
        sd = float(np.hypot(sd, _least_sd(fit)))
        axes = (
            (restitution, np.full(len(restitution), sd), weights),
            _marginal(flat_slopes, slope_step, weights),
            _marginal(flat_drags, drag_step, weights),
        )
        return cls(axes, log_evidence)


def _mixed(axes: tuple[_Axis, ...], shares: Array) -> _Axis:
    """Mix several axes, each with its share."""
    middles, sds, weights = zip(*axes, strict=True)
    shared = [share * one for share, one in zip(shares, weights, strict=True)]
    return np.concatenate(middles), np.concatenate(sds), np.concatenate(shared)


def _marginal(values: Array, sd: float, weights: Array) -> _Axis:
    """Return each value once, the standard deviation about it, and its total weight."""
    once, which = np.unique(values, return_inverse=True)
    return once, np.full(len(once), sd), np.bincount(which, weights).astype(np.float64)


def _least_sd(fit: BounceFit) -> float:
    return _MIN_SD if fit.samples.in_metres else _MIN_SD_IN_PICTURE


def _nodes(middle: float, sd: float, low: float, high: float) -> tuple[Array, float]:
    """Return the middles of even cells about a value, within bounds, and their width."""
    first, last = middle - _REACH_SDS * sd, middle + _REACH_SDS * sd
    if last <= low or first >= high:  # only a bound can be meant
        first, last = (low, low + 2 * sd) if last <= low else (high - 2 * sd, high)
    edges = np.linspace(max(first, low), min(last, high), _NODES + 1)
    return (edges[1:] + edges[:-1]) / 2, float(edges[1] - edges[0])


def _slope_density(slopes: Array) -> Array:
    sds = np.where(slopes < 0, _NEGATIVE_SD, _SLOPE_SD)
    total = np.sqrt(np.pi / 2) * (_NEGATIVE_SD + _SLOPE_SD)
    return np.exp(-0.5 * (slopes / sds) ** 2) / total


def _drag_density(drags: Array) -> Array:
    """Return the log-normal prior density of positive drags [1/m]."""
    off = np.log(drags / _TYPICAL_DRAG_1_M) / _LOG_DRAG_SD
    return np.exp(-0.5 * off**2) / (np.sqrt(2 * np.pi) * _LOG_DRAG_SD * drags)


def _prior_widths(fit: BounceFit) -> Array:
    """Return the prior 95 % widths of slope and drag [1/m], shape (2,)."""
    slope = TWO_SIDED * _SLOPE_SD
    if fit.samples.drag_1_m is not None:
        return np.array([slope, 2 * TWO_SIDED * KNOWN_DRAG * fit.samples.drag_1_m])
    return np.array([slope, _TYPICAL_DRAG_1_M * np.exp(TWO_SIDED * _LOG_DRAG_SD)])


def _profile_factors(fit: BounceFit, factor: float) -> Array:
    """Return the profile likelihood's half widths over the normal ones, shape (2,).

    All else is fitted anew where the normal likelihood ends. Impacts that are heard, too, keep the
    normal one: a fit has no unknowns for each impact's own restitution.
    """
    if fit.samples.heard is not None:
        return np.ones(2)
    least = _least_sd(fit)
    normal, _ = fit.normal_equations()
    normal[0, 0] += ANY_RESTITUTION_SD**-2
    variance = float(np.linalg.pinv(normal)[0, 0]) * factor
    sd = max(float(np.sqrt(max(variance, 0.0))), least)
    if sd < _UNSURE:
        return np.array(
            [np.clip(_profiled(fit, factor, side, sd), _NARROWER, _WIDER) for side in (-1, 1)]
        )
    factors: list[float] = []
    for side in (-1, 1):
        reach = 1.0
        for _ in range(_SEARCHED):
            found = _profiled(fit, factor, side, reach * sd)
            reach = max(reach * float(np.clip(found, 0.25, 4.0)), least / sd)
            if abs(found - 1) < 0.1:
                break
        factors.append(reach)
    return np.array(factors)


def _profiled(fit: BounceFit, factor: float, side: int, sd: float) -> float:
    """Return the profile likelihood's end to a side over 1.96 of `sd`; 1 at a bound."""
    value = float(fit.unknowns[RESTITUTION])
    at = float(np.clip(value + side * TWO_SIDED * sd, 0.0, 1.0))
    reached = abs(at - value)
    if reached < 0.5 * TWO_SIDED * sd:
        return 1.0
    start = fit.unknowns.copy()
    start[RESTITUTION] = at
    others = tuple(index for index in fit.free if index != RESTITUTION)
    held = fit_bounce(fit.samples, start, others, most=10, gain=1e-5, scale=fit.scale)
    held = replace(held, free=fit.free)
    best = fit.misfit_cost(fit.scale) / factor + fit.prior_cost()
    rise = held.misfit_cost(fit.scale) / factor + held.prior_cost() - best
    fraction = float(np.sqrt(max(rise, 0.0) / _RISE)) * TWO_SIDED * sd / reached
    return 1 / max(fraction, 1e-6)
