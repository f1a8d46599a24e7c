"""What a filmed drop says of the restitution: its value and 95 % interval.

Several balls were fitted to the track: one that keeps its restitution, one whose restitution falls
with speed, one that the air slows. As in `bounce_fit` the answer is their average, by how well each
explains the samples (Bayesian model averaging, Hoeting et al. 1999). The interval of each is by
profile likelihood: all else is fitted anew at each value.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.film import FilmedDrop
from analysis.drop.film_fit import (
    DRAGGED,
    IDEAL,
    PRIORS_SD,
    RESTITUTION,
    SLOPED,
    FilmFit,
    fit_film,
)
from analysis.drop.film_search import best_of
from analysis.drop.rebounds import rebounds
from analysis.model_averaging import TWO_SIDED, ModelEstimate, average, correlation_time
from analysis.record import Rebound
from tunenet_logs.arrays import Array

_PRIORS = {IDEAL: 0.75, SLOPED: 0.23, DRAGGED: 0.02}
"""Of the balls, before the track is looked at: few that people drop are as light as that."""

_RISE = 0.93 * TWO_SIDED**2 / 2
"""How much less likely the ends are: a t distribution is flatter than the noise of a track."""

_LAWS_WIDER = 1.25
"""Factor on the standard error by a law of slope or drag: without it too few intervals cover."""

_LEAST_SD = 2e-4
"""Of a restitution: no lens and no clock are better."""

_MOST_LOG_ODDS = 50.0
"""Between models, so that no exponential becomes 0."""

_LEAST_WEIGHT = 1e-3
"""A model of less has no part in the average: that would cost a profile, and move nothing."""


@dataclass(frozen=True, eq=False)
class FilmValue:
    """The restitution at the first impact.

    Attributes:
        restitution: the average of all balls'.
        interval95: of it.
        likeliest: the fit that counts most.
        weight: of that one.
    """

    restitution: float
    interval95: tuple[float, float]
    likeliest: FilmFit
    weight: float


def film_value(film: FilmedDrop, initial: float) -> FilmValue:
    """Average the balls; the network's `initial` is one more start of the ideal one."""
    ideal, *others = film.fits
    begin = ideal.unknowns.copy()
    begin[RESTITUTION] = initial
    fits = (best_of([ideal, fit_film(ideal.samples, begin, IDEAL)]), *others)
    best = best_of(fits)
    scale = min(fit.scale_px for fit in fits)
    factor = max(correlation_time(best.residuals_px, len(best.free)), best.effective_sample_factor)
    covariances = [_covariance(fit, scale * np.sqrt(factor)) for fit in fits]
    log_evidences: list[float] = []
    for fit, covariance in zip(fits, covariances, strict=True):  # by Laplace's approximation
        own = [PRIORS_SD[index] for index in fit.free if index not in IDEAL]
        volume = 0.5 * float(np.linalg.slogdet(covariance)[1]) - float(np.log(own).sum())
        density = _log_density(fit, scale, factor)
        log_evidences.append(density + volume + float(np.log(_PRIORS[fit.free])))
    evidence = np.exp(np.maximum(np.array(log_evidences) - max(log_evidences), -_MOST_LOG_ODDS))
    weights = evidence / evidence.sum()
    estimates: list[ModelEstimate] = []
    for fit, covariance, weight in zip(fits, covariances, weights, strict=True):
        if weight > _LEAST_WEIGHT:
            guess = max(float(np.sqrt(covariance[0, 0])), _LEAST_SD)
            wider = 1.0 if fit.free == IDEAL else _LAWS_WIDER
            sds = [wider * _profile_sd(fit, side, guess, scale, factor) for side in (-1, 1)]
            value = float(fit.unknowns[RESTITUTION])
            estimates.append(ModelEstimate(value, (sds[0], sds[1]), float(weight)))
    restitution, interval95 = average(estimates)
    most = int(weights.argmax())
    return FilmValue(restitution, interval95, fits[most], float(weights[most]))


def film_rebounds(value: FilmValue) -> tuple[Rebound, ...]:
    """Each impact that says something of its own; the first is the value itself."""
    found = rebounds(value.likeliest)
    if not found:
        return ()
    first = replace(found[0], restitution=value.restitution, interval95=value.interval95)
    return (first, *found[1:])


def _covariance(fit: FilmFit, scale_px: float) -> Array:
    """Of the free unknowns, linear about the fit, shape (len(free), len(free))."""
    jacobian = fit.samples.jacobian(fit.unknowns, fit.free)
    normal = jacobian.T @ jacobian / scale_px**2
    for at, index in enumerate(fit.free):
        normal[at, at] += PRIORS_SD[index] ** -2 if index in PRIORS_SD else 1e-9
    return np.linalg.inv(normal).astype(np.float64)


def _log_density(fit: FilmFit, scale_px: float, factor: float) -> float:
    """Log posterior density, where `factor` samples count as one."""
    bound = [index for index in fit.free if index in PRIORS_SD]
    priors = sum((fit.unknowns[index] / PRIORS_SD[index]) ** 2 for index in bound)
    return float(-(fit.cost(scale_px) - 0.5 * priors) / factor - 0.5 * priors)


def _profile_sd(fit: FilmFit, side: int, guess: float, scale_px: float, factor: float) -> float:
    """Standard deviation to one side, by where the profile likelihood falls to that of 95 %.

    By the secant on the root of its fall, which grows all but straight.

    Args:
        fit: of all unknowns.
        side: -1 for below, 1 for above.
        guess: standard deviation to begin with.
        scale_px: standard deviation of a position.
        factor: how many samples count as one.
    """
    others = tuple(index for index in fit.free if index != RESTITUTION)
    value = float(fit.unknowns[RESTITUTION])
    best = _log_density(fit, scale_px, factor)
    sd = guess
    for _ in range(4):
        at = float(np.clip(value + side * TWO_SIDED * sd, 0.0, 1.0))
        if abs(at - value) < 1e-6:
            return _LEAST_SD
        start = fit.unknowns.copy()
        start[RESTITUTION] = at
        held = fit_film(fit.samples, start, others, most=8, gain=1e-4, scale_px=scale_px)
        rise = best - _log_density(replace(held, free=fit.free), scale_px, factor)
        fraction = float(np.sqrt(max(rise, 0.0) / _RISE))
        reached = abs(at - value) / TWO_SIDED
        if 0.9 < fraction < 1.1 or (at in {0.0, 1.0} and fraction < 1):
            return max(reached / max(fraction, 0.5), _LEAST_SD)
        sd = reached / float(np.clip(fraction, 0.25, 4.0))
    return max(sd, _LEAST_SD)
