"""What a filmed drop says of the restitution: its value and 95 % interval.

Several balls were fitted to the track: one that keeps its restitution, one whose restitution falls
with speed, one that the air slows. As in `bounce_fit` the answer is their average, by how well each
explains the samples. How sure each is of its value is by profile likelihood: all else is fitted
anew at each value.
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
from analysis.drop.rebounds import Rebound, rebounds
from analysis.model_averaging import TWO_SIDED, ModelEstimate, average, correlation_time
from tunenet_logs.arrays import Array

_PRIORS = {IDEAL: 0.75, SLOPED: 0.23, DRAGGED: 0.02}
"""Of the balls, before the track is looked at: few that people drop are as light as that."""

_RISE = 0.93 * TWO_SIDED**2 / 2
"""How much less likely the ends are: a t distribution is flatter than the noise of a track."""

_LAWS_WIDER = 1.25
"""What a law of slope or drag adds to its standard error, so that its intervals hold as often."""

_LEAST_SD = 2e-4
_MOST_LOG_ODDS = 50.0
_LEAST_WEIGHT = 1e-3


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
    worth = max(correlation_time(best.left_px, len(best.free)), best.worth)
    spreads = [_covariance(fit, scale * np.sqrt(worth)) for fit in fits]
    log_evidence = np.array(
        [
            _log_evidence(fit, spread, scale, worth)
            for fit, spread in zip(fits, spreads, strict=True)
        ]
    )
    evidence = np.exp(np.maximum(log_evidence - log_evidence.max(), -_MOST_LOG_ODDS))
    weights = evidence / evidence.sum()
    opinions = [
        ModelEstimate(
            float(fit.unknowns[RESTITUTION]), _sds(fit, spread, scale, worth), float(weight)
        )
        for fit, spread, weight in zip(fits, spreads, weights, strict=True)
        if weight > _LEAST_WEIGHT
    ]
    restitution, interval95 = average(opinions)
    most = int(weights.argmax())
    return FilmValue(restitution, interval95, fits[most], float(weights[most]))


def film_rebounds(value: FilmValue) -> tuple[Rebound, ...]:
    """Each impact that says something of its own; the first is the value itself."""
    found = rebounds(value.likeliest)
    if not found:
        return ()
    first = replace(found[0], restitution=value.restitution, interval95=value.interval95)
    return (first, *found[1:])


def _log_evidence(fit: FilmFit, covariance: Array, scale_px: float, worth: float) -> float:
    """Of a ball, by Laplace's approximation; what all have in common is left out."""
    own = [PRIORS_SD[one] for one in fit.free if one not in IDEAL]
    volume = 0.5 * float(np.linalg.slogdet(covariance)[1]) - float(np.log(own).sum())
    return _log_density(fit, scale_px, worth) + volume + float(np.log(_PRIORS[fit.free]))


def _covariance(fit: FilmFit, scale_px: float) -> Array:
    """Of the free unknowns, linear about the fit."""
    slopes = fit.samples.slopes(fit.unknowns, fit.free)
    normal = slopes.T @ slopes / scale_px**2
    for at, one in enumerate(fit.free):
        normal[at, at] += PRIORS_SD[one] ** -2 if one in PRIORS_SD else 1e-9
    return np.linalg.inv(normal).astype(np.float64)


def _log_density(fit: FilmFit, scale_px: float, worth: float) -> float:
    """Log posterior density, where so many samples are worth one."""
    priors = sum((fit.unknowns[one] / PRIORS_SD[one]) ** 2 for one in fit.free if one in PRIORS_SD)
    return float(-(fit.cost(scale_px) - 0.5 * priors) / worth - 0.5 * priors)


def _sds(fit: FilmFit, covariance: Array, scale_px: float, worth: float) -> tuple[float, float]:
    """Below and above: where the profile likelihood is as low as 95 % of a normal one ask for."""
    guess = max(float(np.sqrt(covariance[0, 0])), _LEAST_SD)
    wider = 1.0 if fit.free == IDEAL else _LAWS_WIDER
    below, above = (wider * _profile(fit, side, guess, scale_px, worth) for side in (-1, 1))
    return below, above


def _profile(fit: FilmFit, side: int, guess: float, scale_px: float, worth: float) -> float:
    others = tuple(one for one in fit.free if one != RESTITUTION)
    value = float(fit.unknowns[RESTITUTION])
    best = _log_density(fit, scale_px, worth)
    sd = guess
    for _ in range(4):
        at = float(np.clip(value + side * TWO_SIDED * sd, 0.0, 1.0))
        if abs(at - value) < 1e-6:
            return _LEAST_SD
        start = fit.unknowns.copy()
        start[RESTITUTION] = at
        held = fit_film(fit.samples, start, others, most=8, gain=1e-4, scale_px=scale_px)
        rise = best - _log_density(replace(held, free=fit.free), scale_px, worth)
        share = float(np.sqrt(max(rise, 0.0) / _RISE))
        reached = abs(at - value) / TWO_SIDED
        if 0.9 < share < 1.1 or (at in {0.0, 1.0} and share < 1):
            return max(reached / max(share, 0.5), _LEAST_SD)
        sd = reached / float(np.clip(share, 0.25, 4.0))
    return max(sd, _LEAST_SD)
