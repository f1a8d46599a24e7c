"""What a filmed drop says of the restitution: its value and 95 % interval.

Two balls were fitted to the track: one that keeps its restitution, and one whose restitution falls
with speed. As in `bounce_fit` the answer is the average of both, by how well each explains the
samples. How sure each is of its value is by profile likelihood: all else is fitted anew at each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.observe.film import FilmedDrop
from analysis.observe.film_fit import (
    IDEAL,
    PRIORS_SD,
    RESTITUTION,
    SLOPE,
    FilmFit,
    fit_film,
)
from analysis.refine.averaging import TWO_SIDED, Opinion, average, correlation_time
from analysis.refine.rebounds import Rebound, rebounds

Array = NDArray[np.float64]

_REAL = 0.5
"""Prior of a ball that is not ideal."""

_RISE = 0.85 * TWO_SIDED**2 / 2
"""How much less likely the ends are: a t distribution is flatter than the noise of a track."""

_LEAST_SD = 2e-4
_MOST_LOG_ODDS = 50.0


@dataclass(frozen=True)
class FilmValue:
    """The restitution at the first impact.

    Attributes:
        restitution: the average of both balls'.
        interval95: of it.
        real: probability of the ball that is not ideal.
        slope: p of that ball.
        slope_sd: its standard error.
    """

    restitution: float
    interval95: tuple[float, float]
    real: float
    slope: float
    slope_sd: float


def film_value(film: FilmedDrop, initial: float) -> FilmValue:
    """Average the two balls; the network's `initial` is one more start of the ideal one."""
    real = film.real
    begin = film.ideal.unknowns.copy()
    begin[RESTITUTION] = initial
    again = fit_film(film.ideal.samples, begin, IDEAL)
    scale = min(film.ideal.scale_px, real.scale_px, again.scale_px)
    ideal = min(film.ideal, again, key=lambda fit: fit.cost(scale))
    better = min(ideal, real, key=lambda fit: fit.cost(scale))
    worth = correlation_time(better.left_px, len(better.free))
    spreads = [_covariance(fit, scale * np.sqrt(worth)) for fit in (ideal, real)]
    log_odds = _log_density(real, scale, worth) - _log_density(ideal, scale, worth)
    log_odds += 0.5 * (_log_volume(spreads[1]) - _log_volume(spreads[0]))
    extra = real.free[-1]
    log_odds -= np.log(PRIORS_SD[extra])
    odds = _REAL / (1 - _REAL) * np.exp(np.clip(log_odds, -_MOST_LOG_ODDS, _MOST_LOG_ODDS))
    weights = (1 / (1 + odds), odds / (1 + odds))
    opinions = [
        Opinion(float(fit.unknowns[RESTITUTION]), _sds(fit, spread, scale, worth), float(weight))
        for fit, spread, weight in zip((ideal, real), spreads, weights, strict=True)
    ]
    restitution, interval95 = average(opinions)
    return FilmValue(
        restitution=restitution,
        interval95=interval95,
        real=float(weights[1]),
        slope=float(real.unknowns[SLOPE]),
        slope_sd=float(np.sqrt(spreads[1][-1, -1])) if extra == SLOPE else 0.0,
    )


def film_rebounds(film: FilmedDrop, value: FilmValue) -> tuple[Rebound, ...]:
    """Each impact that says something of its own; the first is the value itself."""
    likelier = film.real if value.real > _REAL else film.ideal
    found = rebounds(likelier)
    if not found:
        return ()
    first = replace(found[0], restitution=value.restitution, interval95=value.interval95)
    return (first, *found[1:])


def _covariance(fit: FilmFit, scale_px: float) -> Array:
    """Of the free unknowns, linear about the fit."""
    slopes = fit.samples.slopes(fit.unknowns, fit.free)
    normal = slopes.T @ slopes / scale_px**2
    for at, one in enumerate(fit.free):
        normal[at, at] += PRIORS_SD[one] ** -2 if one in PRIORS_SD else 1e-9
    return np.linalg.inv(normal).astype(np.float64)


def _log_volume(covariance: Array) -> float:
    return float(np.linalg.slogdet(covariance)[1])


def _log_density(fit: FilmFit, scale_px: float, worth: float) -> float:
    """Log posterior density, where so many samples are worth one."""
    priors = sum((fit.unknowns[one] / PRIORS_SD[one]) ** 2 for one in fit.free if one in PRIORS_SD)
    return float(-(fit.cost(scale_px) - 0.5 * priors) / worth - 0.5 * priors)


def _sds(fit: FilmFit, covariance: Array, scale_px: float, worth: float) -> tuple[float, float]:
    """Below and above: where the profile likelihood is as low as 95 % of a normal one ask for."""
    guess = max(float(np.sqrt(covariance[0, 0])), _LEAST_SD)
    below, above = (_profile(fit, side, guess, scale_px, worth) for side in (-1, 1))
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
        held = fit_film(fit.samples, start, others, most=12, gain=1e-5, scale_px=scale_px)
        rise = best - _log_density(replace(held, free=fit.free), scale_px, worth)
        share = float(np.sqrt(max(rise, 0.0) / _RISE))
        reached = abs(at - value) / TWO_SIDED
        if 0.9 < share < 1.1 or (at in {0.0, 1.0} and share < 1):
            return max(reached / max(share, 0.5), _LEAST_SD)
        sd = reached / float(np.clip(share, 0.25, 4.0))
    return max(sd, _LEAST_SD)
