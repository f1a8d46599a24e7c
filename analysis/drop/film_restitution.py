"""What a filmed drop says of the restitution: its value, its 95 % interval, that of each impact.

Several balls were fitted to the track: one that keeps its restitution, one whose restitution falls
with speed, one that the air slows. As in `bounce_fit` the answer is their average, by how well each
explains the samples (Bayesian model averaging, Hoeting et al. 1999). The interval of each is by
profile likelihood: all else is fitted anew at each value.

`film_rebounds` fits each impact without a law that binds them. `flight_ratio` needs no camera: in
any picture the flights before and after an impact are smooth curves of time that meet at it, and
how much shorter the second flight is than the first is the restitution of the second impact.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.film import FilmedDrop
from analysis.drop.film_fit import (
    CONTACT,
    DRAGGED,
    FALL,
    IDEAL,
    IMPACT,
    PERSPECTIVE,
    PRIORS_SD,
    RESTITUTION,
    SLOPED,
    SPAN,
    FilmFit,
    fit_film,
)
from analysis.drop.film_search import MOST_IMPACTS, best_of
from analysis.drop.projection import PERSPECTIVE_SD, projected
from analysis.record import Rebound
from analysis.statistics import TWO_SIDED, ModelEstimate, average, correlation_time
from recorders.simulators.closed_form.bounce import Bounce
from recorders.simulators.contact import CALIBRATED
from tunenet_logs.arrays import Array

_PRIORS = {IDEAL: 0.75, SLOPED: 0.23, DRAGGED: 0.02}
"""Of the balls, before the track is looked at: few that people drop are as light as that."""

_RISE = 0.93 * TWO_SIDED**2 / 2
"""How much less likely the ends are: a t distribution is flatter than the noise of a track."""

_LAWS_WIDER = 1.25
"""Factor on the standard error by a law of slope or drag: without it too few intervals cover."""

_LEAST_SD = 2e-4
"""Of a restitution: no lens and no clock are better."""

_MOST_LOG_ODDS, _LEAST_WEIGHT = 50.0, 1e-3
"""Between models, so that no exponential becomes 0; of a model in the average: one of less would
cost a profile and move nothing."""

_CLEAR_HOP = 4.0
"""Standard deviations of a position that a flight has to be high."""

_PRIOR_SD = 0.15
"""Of each restitution about the fit's: no law, but no impact is far from all others."""

_CAMERA = (IMPACT, FALL, CONTACT, SPAN, PERSPECTIVE)
_STEPS = np.array([1e-6, 1e-6, 1e-4, 1e-4, 1e-5])
"""Unknowns that are fitted with the restitutions, and by how much they are differentiated."""

_ITERATIONS = 6
"""Of Gauss-Newton's method: it begins nearly at the end, at the fit."""

_FEWEST_SAMPLES, _PARABOLA, _CUBIC = 4, 5, 9
"""Of a flight: for a restitution of its own (a parabola has three coefficients), for a parabola
through them, and for a cubic, which perspective asks for."""

_OUTLIER = 5.0
"""Standard deviations from the fit, beyond which a sample is not the ball."""


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
    covariances: list[Array] = []
    log_evidences: list[float] = []
    for fit in fits:  # by Laplace's approximation
        jacobian = fit.samples.jacobian(fit.unknowns, fit.free)
        precisions = [PRIORS_SD[index] ** -2 if index in PRIORS_SD else 1e-9 for index in fit.free]
        normal = jacobian.T @ jacobian / (scale * np.sqrt(factor)) ** 2 + np.diag(precisions)
        covariance = np.linalg.inv(normal).astype(np.float64)
        covariances.append(covariance)
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


def film_rebounds(value: FilmValue) -> tuple[Rebound, ...]:
    """Each impact whose flight is seen to its end; the first has the restitution of `value`.

    The camera is fitted with them; no law binds them but that none is far (0.15) from the fit's.
    """
    fit = value.likeliest
    law = fit.samples.bounce(fit.unknowns)
    times = fit.samples.times(fit.unknowns)
    starts, speeds = law.flights(float(times[-1]))
    count = 0  # of flights that are high enough, and seen to their end
    for begin, end, speed in zip(starts[:MOST_IMPACTS], starts[1:], speeds, strict=False):
        hop_px = fit.unknowns[SPAN] * speed**2 / 4
        seen = np.count_nonzero((times > begin) & (times < end))
        if end > times[-1] or hop_px < _CLEAR_HOP * fit.scale_px or seen < _FEWEST_SAMPLES:
            break
        count += 1
    if not count:
        return ()
    arrivals = _impact_speeds(law, speeds[:count])
    first = np.clip(speeds[:count] / arrivals, 0.01, 1.0)
    values, sds = _fitted(fit, law, first)
    each = Bounce(float(values[0]), law.slope, law.drag, tuple(values))
    own_starts, own_speeds = each.flights(float(times[-1]))
    fall_s = float(np.exp(fit.unknowns[FALL]))
    unit_m_s = CALIBRATED.gravity_m_s2 * fall_s / 2
    hits = _impact_speeds(each, own_speeds[:count])
    found = [
        Rebound(
            impact_s=float(fit.unknowns[IMPACT] + fall_s * own_starts[index]),
            restitution=float(values[index]),
            interval95=(
                float(max(values[index] - TWO_SIDED * sds[index], 0.0)),
                float(min(values[index] + TWO_SIDED * sds[index], 1.0)),
            ),
            impact_speed_m_s=float(hits[index]) * unit_m_s,
        )
        for index in range(min(count, len(own_starts)))
    ]
    found[0] = replace(found[0], restitution=value.restitution, interval95=value.interval95)
    return tuple(found)


def _impact_speeds(ball: Bounce, leaving: Array) -> Array:
    """Of the impacts that the ball leaves with these speeds [drop heights, sqrt(2 H / g)]."""
    later = [ball.flight(float(speed))[1] for speed in leaving[:-1]]
    return np.array([ball.impact_speed, *later])


def _fitted(fit: FilmFit, law: Bounce, first: Array) -> tuple[Array, Array]:
    """Restitutions and their standard errors by Gauss-Newton's method, without outliers.

    Args:
        fit: of the law.
        law: the ball.
        first: restitutions to begin with, shape (N,).
    """
    weights = np.where(np.abs(fit.residuals_px) < 4 * fit.scale_px, 1.0, 0.0)
    scale = fit.scale_px * np.sqrt(correlation_time(fit.residuals_px, len(fit.free)))
    camera = fit.unknowns[list(_CAMERA)]
    values = np.concatenate([camera, first])
    steps = np.concatenate([_STEPS, np.full(len(first), 1e-6)])
    prior = np.concatenate([[0, 0, 0, 0, PERSPECTIVE_SD**-2], np.full(len(first), _PRIOR_SD**-2)])
    target = np.concatenate([np.zeros(5), first])
    covariance = np.eye(len(values))
    for _ in range(_ITERATIONS):
        moves = np.diag(steps)
        trials: list[Array] = []
        for trial in (values, *(values + moves), *(values - moves)):
            impact_s, log_fall, contact, span, perspective = trial[:5]
            ball = Bounce(law.restitution, law.slope, law.drag, tuple(trial[5:]))
            heights = ball.heights((fit.samples.seconds - impact_s) / np.exp(log_fall))
            positions = contact + span * projected(heights, float(perspective))
            trials.append(positions - fit.samples.positions_px)
        residuals, above, below = np.split(np.column_stack(trials), [1, 1 + len(steps)], axis=1)
        jacobian = (above - below) / (2 * steps)
        normal = jacobian.T @ (weights[:, None] * jacobian) / scale**2 + np.diag(prior)
        gradient = -jacobian.T @ (weights * residuals[:, 0]) / scale**2 - prior * (values - target)
        covariance = np.linalg.pinv(normal)
        values = values + covariance @ gradient
        values[5:] = np.clip(values[5:], 0.01, 1.0)
    return values[5:], np.sqrt(np.diag(covariance))[5:]


@dataclass(frozen=True)
class FlightRatio:
    """Duration of the second flight over that of the first.

    Attributes:
        value: as seen.
        fitted: as the fitted ball has it.
        sd: standard error of the value.
    """

    value: float
    fitted: float
    sd: float


def flight_ratio(fit: FilmFit) -> FlightRatio | None:
    """From the first three impacts; None where they are not seen well enough."""
    times = fit.samples.times(fit.unknowns)
    starts, _ = fit.samples.bounce(fit.unknowns).flights(float(times[-1]))
    if len(starts) < 4 or starts[2] > times[-1]:
        return None
    edges = np.array([-1.0, *starts[:4]])
    edges[-1] = min(edges[-1], times[-1])
    half = 0.5 * float(np.median(np.diff(times)))
    flights: list[_Flight] = []
    for begin, end in itertools.pairwise(edges):
        inside = (times > begin + half) & (times < end - half)
        inside &= np.abs(fit.residuals_px) < _OUTLIER * fit.scale_px
        count = int(np.count_nonzero(inside))
        if count < _PARABOLA:
            return None
        middle = float(times[inside].mean())
        columns = np.vander(times[inside] - middle, 4 if count >= _CUBIC else 3)
        powers, *_ = np.linalg.lstsq(columns, fit.samples.positions_px[inside], rcond=None)
        covariance = np.linalg.pinv(columns.T @ columns) * fit.scale_px**2
        flights.append(_Flight(middle, powers.astype(np.float64), covariance.astype(np.float64)))
    reach = 4 * half + 0.03
    impacts: list[tuple[float, float]] = []
    for (before, after), near in zip(itertools.pairwise(flights), starts[:3], strict=True):
        impact = before.meets(after, near, reach)
        if impact is None:
            return None
        impacts.append(impact)
    (first, second, third), sds = np.array(impacts).T
    ratio = (third - second) / (second - first)
    slopes = np.array([ratio, -1 - ratio, 1.0]) / (second - first)
    fitted = float((starts[2] - starts[1]) / starts[1])
    return FlightRatio(float(ratio), fitted, float(np.linalg.norm(slopes * sds)))


@dataclass(frozen=True, eq=False)
class _Flight:
    """One flight as a polynomial of time.

    Attributes:
        middle: time that it is about [fall times].
        powers: coefficients [px], highest power first, shape (3,) or (4,).
        covariance: of them.
    """

    middle: float
    powers: Array
    covariance: Array

    def meets(self, then: _Flight, near: float, reach: float) -> tuple[float, float] | None:
        """When this flight ends in the next, and the standard error; None if it does not."""
        grid = np.linspace(near - reach, near + reach, 201)
        apart = np.polyval(self.powers, grid - self.middle)
        apart = apart - np.polyval(then.powers, grid - then.middle)
        crossed = np.flatnonzero((apart[:-1] > 0) & (apart[1:] <= 0))
        if not len(crossed):
            return None
        at = int(min(crossed, key=lambda index: abs(grid[index] - near)))
        slope = (apart[at + 1] - apart[at]) / (grid[1] - grid[0])
        when = float(grid[at] - apart[at] / slope)
        variance = sum(
            float(row @ flight.covariance @ row)
            for flight in (self, then)
            for row in [np.vander([when - flight.middle], len(flight.powers))[0]]
        )
        return when, float(np.sqrt(variance) / abs(slope))
