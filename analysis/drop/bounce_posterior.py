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

import itertools
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tunenet_logs.analysis.drop.bounce_fit import (
    MAX_IMPACTS,
    BounceFit,
    fit_bounce,
    fit_positions,
    noise_floor,
)
from tunenet_logs.analysis.drop.bounce_model import (
    ANY_SCALE_SD,
    CONTACT,
    DRAG,
    FALL,
    FREEDOM,
    IMPACT,
    METRE_SD,
    PERSPECTIVE,
    PERSPECTIVE_SD,
    RESTITUTION,
    SCATTERS,
    SLOPE,
    SPAN,
    TOUCH,
    BounceSamples,
    projected,
)
from tunenet_logs.analysis.drop.free_flight import Drop
from tunenet_logs.analysis.drop.times.readings import (
    KNOWN_DRAG,
    NO_DRAG,
    NO_SLOPE,
    TYPICAL_DRAG_1_M,
)
from tunenet_logs.analysis.record import Rebound
from tunenet_logs.analysis.statistics import (
    TWO_SIDED,
    correlation_time,
    mixture_quantile,
    normalised,
)
from tunenet_logs.episode import Array, median_step
from tunenet_logs.recorders.simulators.ball import Bounce, flown_by
from tunenet_logs.recorders.simulators.base import CALIBRATED, GRAVITY_M_S2

# ---- Contact duration of a heard ball, above 0: a truncated normal distribution
# In a normal approximation the duration is normal for each slope and drag, with the restitution
# linear in it. Its part below 0 is cut off.


@dataclass(frozen=True, eq=False)
class ContactBound:
    """Contact duration before the bound, as a function of slope and drag."""

    value_s: float  # at the likelihood's middle
    moves: Array  # its derivatives by slope and drag, shape (2,)
    sd_s: float  # standard deviation given the two
    # Of the restitution, by the contact alone; negative where a longer contact means a lower
    # restitution.
    restitution_sd: float

    def cut(self, off: Array) -> tuple[Array, Array, Array]:
        """Cut the contact off at 0 for slopes and drags (M, 2) off the likelihood's middle.

        Returns the log probability of a contact above 0, how far the bound moves the restitution
        and by how much it lowers its variance, shape (M,) each.
        """
        from scipy.special import log_ndtr

        above = np.maximum((self.value_s + off @ self.moves) / self.sd_s, -30.0)  # sds above 0
        log_share = np.asarray(log_ndtr(above), dtype=np.float64)
        mean = np.exp(-0.5 * above**2 - log_share) / np.sqrt(2 * np.pi)
        taken = self.restitution_sd**2 * (mean * (mean + above))
        return log_share, self.restitution_sd * mean, taken


# ---- Derivatives of positions and times by each impact's own restitution

_FASTER = 1e-5  # fraction of a restitution by which positions and times are differentiated


def moved_by_own(samples: BounceSamples, unknowns: Array) -> tuple[Array, Array]:
    """Differentiate positions (T, K) and touch times (N, K) by each impact's own restitution.

    Relative, over the K impacts that are seen, or come before the last that is heard.
    """
    assert samples.heard is not None
    numbers = samples.heard.numbers
    ball = samples.bounce(unknowns)
    last = float(samples.times(unknowns)[-1])
    heard_s = float(samples.touches_s(unknowns, numbers[-1:])[0] - unknowns[IMPACT])
    starts, speeds = ball.flights(max(last, heard_s / float(np.exp(unknowns[FALL]))))
    count = max(int(np.searchsorted(starts, last)), int(numbers[-1]))
    kept = (speeds / ball.arrivals(speeds)).tolist()
    balls = [
        replace(ball, each=(*kept[:impact], kept[impact] * (1 + _FASTER)))
        for impact in range(min(count, len(kept)))
    ]
    balls.append(ball)
    seen = samples.seen_of(balls, unknowns)
    heard = np.array([samples.touches_s(unknowns, numbers, one) for one in balls])
    return (seen[:-1] - seen[-1]).T / _FASTER, (heard[:-1] - heard[-1]).T / _FASTER


# ---- Laplace approximation of the likelihood in slope and drag
# Where impacts were heard, each may return the ball a little faster or slower than the law has it:
# unknowns, too, which pictures and sound share. How large they are is left open (`SCATTERS`).

# Standard deviations of slope and drag [1 / drop height] where the samples tell nothing.
WIDEST = (0.3, 0.5)
ANY_RESTITUTION_SD = 0.3  # of a restitution of which the samples tell nothing near the fit


@dataclass(frozen=True, eq=False)
class BallLikelihood:
    """Normal likelihood of slope and drag, without their priors."""

    middle: Array  # most likely slope and drag times drop height, shape (2,)
    precision: Array  # of the two, shape (2, 2)
    value: float  # the restitution there
    moves: Array  # derivatives of the restitution by each of the two, shape (2,)
    restitution_sd: float  # standard deviation given the two
    log_evidence: float = 0.0  # logarithm of the likelihood there, without a constant
    bound: ContactBound | None = None  # on the contact's duration, where impacts were heard

    def at(self, slopes: Array, drags: Array) -> tuple[Array, Array, Array]:
        """Evaluate at slopes and drags * drop height: log density, restitution, loss.

        The density is without a constant, the restitution the likeliest; the loss is of variance,
        by the bound on contacts. Shape (M,) each.
        """
        off = np.column_stack([slopes, drags]) - self.middle
        log = self.log_evidence - 0.5 * np.einsum("mi,ij,mj->m", off, self.precision, off)
        value = self.value + off @ self.moves
        if self.bound is None:
            return log, value, np.zeros(len(off))
        log_share, moved, taken = self.bound.cut(off)
        return log + log_share, value + moved, taken


def _covariance(precision: Array) -> Array:
    """Return the covariance of slope and drag, no wider than where samples tell nothing, (2, 2)."""
    return np.asarray(np.linalg.inv(precision + np.diag(np.array(WIDEST) ** -2)), dtype=np.float64)


def ball_likelihoods(fit: BounceFit) -> list[BallLikelihood]:
    """Marginalise a fit's likelihood; if impacts are heard, by scatter."""
    if fit.samples.heard is None:
        linear = _Linear.of(fit)
        return [_of_law(fit, *linear.equations(*linear.weights()))]
    law = replace(fit.samples, heard=replace(fit.samples.heard, scatter=0.0))
    linear = _Linear.of(replace(fit, samples=law))
    own = np.arange(len(fit.free), linear.jacobian.shape[1])
    # The least that is known of a fit's unknowns, as weights.
    least = {RESTITUTION: ANY_RESTITUTION_SD, SLOPE: WIDEST[0], DRAG: WIDEST[1]}
    sds = [least.get(index, np.inf) for index in fit.free] + [np.inf] * len(own)
    known = np.diag(np.array(sds) ** -2)
    # Each scatter's log prior, with the normalisation of so many deviations.
    log_priors = np.log(list(SCATTERS.values())) - len(own) * np.log(list(SCATTERS))

    def scattered(normal: Array) -> list[Array]:
        """Add each scatter as the standard deviation of the impacts' deviations."""
        found = [normal.copy() for _ in SCATTERS]
        for one, scatter in zip(found, SCATTERS, strict=True):
            one[own, own] += scatter**-2
        return found

    weights = linear.weights()[0], np.ones(len(linear.off))
    for _ in range(6):  # reweighting by the residuals, which the deviations explain
        normal, gradient = linear.equations(*weights)
        peaks = [_peak(one + known, gradient) for one in scattered(normal)]
        log = np.array([peak[1] for peak in peaks]) + log_priors
        likely = np.exp(log - log.max())
        weights = linear.weights(likely @ np.array([peak[0] for peak in peaks]) / likely.sum())
    normal, gradient = linear.equations(*weights)
    found = [_of_law(fit, one, gradient) for one in scattered(normal)]
    return [
        replace(one, log_evidence=one.log_evidence + float(prior))
        for one, prior in zip(found, log_priors, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _Linear:
    """Samples and priors of a fit, linearised in its unknowns."""

    # Of the positions over the fit's unknowns, and over each impact's deviation from the law where
    # impacts were heard, shape (T, U).
    jacobian: Array
    residuals: Array  # shape (T,)
    scale: float  # of a residual
    factor: float  # how many samples count as one
    rows: Array  # of the priors, in their standard deviations, shape (P, U)
    off: Array  # likewise, shape (P,)
    freedom: Array  # of each prior's t, shape (P,)

    @classmethod
    def of(cls, fit: BounceFit) -> _Linear:
        """Linearise a fit, without the priors of slope and drag."""
        samples, free = fit.samples, fit.free
        priors = [
            one
            for one in samples.priors(fit.unknowns)
            if one.measured or {SLOPE, DRAG}.isdisjoint(one.slopes)
        ]
        rows = np.array([[one.slopes.get(index, 0.0) / one.sd for index in free] for one in priors])
        jacobian = fit.jacobian
        if samples.heard is not None:
            own, touches = moved_by_own(samples, fit.unknowns)
            beside = np.zeros((len(rows), own.shape[1]))
            beside[[one.measured for one in priors]] = samples.heard.whitening @ touches
            jacobian, rows = np.hstack([jacobian, own]), np.hstack([rows, beside])
        off = np.array([one.off / one.sd for one in priors])
        freedom = np.array([one.freedom for one in priors])
        return cls(jacobian, fit.residuals, fit.scale, fit.samples_as_one, rows, off, freedom)

    def weights(self, step: Array | None = None) -> tuple[Array, Array]:
        """Reweight samples and priors by how far they are off after a step, shape (U,)."""
        residuals, off = self.residuals, self.off
        if step is not None:
            residuals, off = residuals + self.jacobian @ step, off + self.rows @ step
        seen = (FREEDOM + 1) / (FREEDOM + (residuals / self.scale) ** 2)
        is_normal = np.isinf(self.freedom)
        freedom = np.where(is_normal, 1.0, self.freedom)
        likely = np.where(is_normal, 1.0, (freedom + 1) / (freedom + off**2))
        return seen / (self.scale**2 * self.factor), likely

    def equations(self, seen: Array, likely: Array) -> tuple[Array, Array]:
        """Return the normal matrix and minus the gradient for such weights."""
        normal = self.jacobian.T @ (seen[:, None] * self.jacobian)
        normal += self.rows.T @ (likely[:, None] * self.rows)
        gradient = -self.jacobian.T @ (seen * self.residuals) - self.rows.T @ (likely * self.off)
        return normal, gradient


def _peak(normal: Array, gradient: Array) -> tuple[Array, float]:
    """Return a normal likelihood's mode and the logarithm of its integral."""
    diagonal = np.diag(normal)
    unit = np.where(diagonal > 0, diagonal, 1.0) ** -0.5
    # Unknowns that no sample moves stay where they are.
    scaled = normal * np.outer(unit, unit) + 1e-12 * np.eye(len(unit))
    step = unit * np.linalg.solve(scaled, unit * gradient)
    log = 0.5 * gradient @ step - 0.5 * np.linalg.slogdet(scaled)[1] + np.log(unit).sum()
    return step, float(log)


def _of_law(fit: BounceFit, normal: Array, gradient: Array) -> BallLikelihood:
    """Marginalise all unknowns but slope and drag."""
    free = list(fit.free)
    normal = normal.copy()
    known = free.index(RESTITUTION)
    normal[known, known] += ANY_RESTITUTION_SD**-2  # a hop that is not seen tells little
    order = np.array([free.index(SLOPE), free.index(DRAG)])
    others = np.delete(np.arange(len(normal)), order)
    inverse = np.linalg.pinv(normal[np.ix_(others, others)])
    across = normal[np.ix_(others, order)]
    precision = normal[np.ix_(order, order)] - across.T @ inverse @ across
    pull = gradient[order] - across.T @ inverse @ gradient[others]
    step = _covariance(precision) @ pull
    log = _peak(normal[np.ix_(others, others)], gradient[others])[1]

    def alone(index: int) -> tuple[float, Array, int]:
        """Return an unknown's likeliest value, how it moves with the two, and its row."""
        at = int(np.flatnonzero(others == free.index(index))[0])
        moves = -(inverse @ across)[at]
        value = fit.unknowns[index] + (inverse @ gradient[others])[at] + moves @ step
        return float(value), moves, at

    value, moves, at = alone(RESTITUTION)
    found = BallLikelihood(
        fit.unknowns[[SLOPE, DRAG]] + step,
        precision,
        value,
        moves,
        float(np.sqrt(inverse[at, at])),
        log + float(pull @ step - 0.5 * step @ precision @ step),
    )
    if fit.samples.heard is None:
        return found
    lasts_s, lasts_moves, row = alone(TOUCH)
    sd_s = float(np.sqrt(inverse[row, row]))
    bound = ContactBound(lasts_s, lasts_moves, sd_s, float(inverse[at, row]) / sd_s)
    return replace(found, bound=bound)


# ---- Model average over slope and drag on a grid, and the profile likelihood's width

# Prior probabilities of a ball that keeps its restitution, and of one that the air does not slow:
# simulators drop such balls. In a picture lens and blur look like a little drag, too.
_NO_SLOPE, _NO_DRAG, _NO_DRAG_IN_PICTURE = 0.4, 0.5, 0.85
# Prior of another ball's slope: half normal, with a little room below 0.
_SLOPE_SD, _NEGATIVE_SD = 0.12, 0.01
_LOG_DRAG_SD = 1.3  # of the log of another ball's drag: less narrow than of balls that are heard
_NODES, _REACH_SDS = 45, 4.5  # of the grid along one axis, and how far it goes
# How much less likely the ends are: a t distribution is flatter than the noise of a track.
_RISE = 0.93 * TWO_SIDED**2 / 2


@dataclass(frozen=True, eq=False)
class BallPosterior:
    """Posterior of a ball's restitution, slope and drag."""

    values: Array  # posterior means of restitution, slope, drag [1/m], shape (3,)
    interval95: Array  # shape (3, 2)
    fit: BounceFit  # the fit, with slope and drag held at these values, all else fitted to them
    correlation: float  # of slope and drag by the samples alone: near -1 or 1 these trade places
    # How much narrower than its prior each interval of slope and drag is, from 0 (the prior's) to
    # 1, shape (2,).
    told: Array


def ball_posterior(fit: BounceFit) -> BallPosterior:
    """Compute a ball's posterior by Bayesian model averaging over slope, drag and scatter."""
    axes, covariance = _averaged(fit)
    values = _means(axes)
    ends = np.array([[mixture_quantile(at, *axis) for at in (0.025, 0.975)] for axis in axes])
    # Without these factors too few intervals of films cover.
    in_picture = 1.4 if fit.samples.moves_s else 1.25 if fit.samples.is_soft else 1.1
    wider = _profile_factors(fit) * (1 if fit.samples.in_metres else in_picture)
    ends[0] = values[0] + (ends[0] - values[0]) * wider
    ends = np.clip(ends, [[0.0], [-np.inf], [0.0]], [[1.0], [np.inf], [np.inf]])
    final = _held_at(values, fit)
    values[0] = np.clip(values[0], 0.0, 1.0)
    # The prior 95 % widths of slope and drag [1/m].
    drag_width = TYPICAL_DRAG_1_M * np.exp(TWO_SIDED * _LOG_DRAG_SD)
    if fit.samples.drag_1_m is not None:
        drag_width = 2 * TWO_SIDED * KNOWN_DRAG * fit.samples.drag_1_m
    told = 1 - np.ptp(ends[1:], axis=1) / np.array([TWO_SIDED * _SLOPE_SD, drag_width])
    correlation = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    return BallPosterior(values, ends, final, float(correlation), np.clip(told, 0.0, 1.0))


def averaged_ball(fit: BounceFit) -> BounceFit:
    """Fit all else to the posterior means of slope and drag, as a posterior's `fit`."""
    return _held_at(_means(_averaged(fit)[0]), fit)


# A mixture of normal distributions: their middles, standard deviations and weights, shape (M,).
_Axis = tuple[Array, Array, Array]


def _averaged(fit: BounceFit) -> tuple[list[_Axis], Array]:
    """Mix the likelihoods of a fit: restitution, slope and drag [1/m].

    Returns the covariance of slope and drag by the likeliest of them, (2, 2), too.
    """
    likelihoods = ball_likelihoods(fit)
    grids = [_weighed_grid(one, fit) for one in likelihoods]
    shares, _ = normalised(np.array([log for _, log in grids]))
    axes: list[_Axis] = []
    for parts in zip(*(of_one for of_one, _ in grids), strict=True):
        middles, sds, weights = zip(*parts, strict=True)
        shared = [share * one for share, one in zip(shares, weights, strict=True)]
        axes.append((np.concatenate(middles), np.concatenate(sds), np.concatenate(shared)))
    return axes, _covariance(likelihoods[int(shares.argmax())].precision)


def _means(axes: list[_Axis]) -> Array:
    return np.array([weights @ middles for middles, _, weights in axes])


def _held_at(values: Array, fit: BounceFit) -> BounceFit:
    """Refit with slope and drag [1/m] held at some values, near their restitution."""
    restitution, slope, drag = values.tolist()
    start = fit.with_others({SLOPE: slope, DRAG: drag * _height_m(fit)})
    start[RESTITUTION] = restitution
    rest = tuple(index for index in fit.free if index not in (SLOPE, DRAG))
    return replace(fit_bounce(fit.samples, start, rest), free=fit.free)


def _height_m(fit: BounceFit) -> float:
    """Return the height of the fall by its duration [m]."""
    return GRAVITY_M_S2 * float(np.exp(2 * fit.unknowns[FALL])) / 2


def _weighed_grid(likelihood: BallLikelihood, fit: BounceFit) -> tuple[list[_Axis], float]:
    """Weigh balls on a grid around a likelihood's mode, with those of no slope and of no drag.

    Returns the axes of restitution, slope and drag [1/m], and the log of the mean likelihood.
    """
    middle, sds = likelihood.middle, np.sqrt(np.diag(_covariance(likelihood.precision)))
    height_m = _height_m(fit)
    slopes, slope_step = _nodes(float(middle[0]), float(sds[0]), -0.05, 0.45)
    drags, drag_step = _nodes(float(middle[1]) / height_m, float(sds[1]) / height_m, 0.0, 1.0)
    is_heard = fit.samples.heard is not None
    no_slope = NO_SLOPE if is_heard else _NO_SLOPE
    sds = np.where(slopes < 0, _NEGATIVE_SD, _SLOPE_SD)
    total = np.sqrt(np.pi / 2) * (_NEGATIVE_SD + _SLOPE_SD)
    slope_prior = (np.exp(-0.5 * (slopes / sds) ** 2) / total) * slope_step * (1 - no_slope)
    known = fit.samples.drag_1_m
    if known is None:
        none = _NO_DRAG if fit.samples.in_metres else _NO_DRAG_IN_PICTURE
        none = NO_DRAG if is_heard else none
        off = np.log(drags / TYPICAL_DRAG_1_M) / _LOG_DRAG_SD
        drag_prior = (
            (np.exp(-0.5 * off**2) / (np.sqrt(2 * np.pi) * _LOG_DRAG_SD * drags))
            * drag_step
            * (1 - none)
        )
        drags, drag_prior = np.append(drags, 0.0), np.append(drag_prior, none)
    else:
        drags, drag_step = _nodes(known, KNOWN_DRAG * known, 0.0, 2 * known)
        drag_prior = np.exp(-0.5 * ((drags - known) / (KNOWN_DRAG * known)) ** 2)
    slopes, slope_prior = np.append(slopes, 0.0), np.append(slope_prior, no_slope)
    both = np.meshgrid(slopes, drags, indexing="ij")
    flat_slopes, flat_drags = (one.ravel() for one in both)
    prior = np.outer(slope_prior, drag_prior).ravel()
    log, restitution, taken = likelihood.at(flat_slopes, flat_drags * height_m)
    weights, log_evidence = normalised(log + np.log(np.maximum(prior, 1e-300)))
    sd = likelihood.restitution_sd
    if likelihood.bound is not None:
        sd = float(np.sqrt(max(sd**2 - float(weights @ taken), 0.0)))
    sd = float(np.hypot(sd, _least_sd(fit)))
    axes: list[_Axis] = [(restitution, np.full(len(restitution), sd), weights)]
    # Of slope and drag each value once, a cell as its standard deviation, and its weight.
    for values, step in ((flat_slopes, slope_step), (flat_drags, drag_step)):
        once, which = np.unique(values, return_inverse=True)
        total = np.bincount(which, weights).astype(np.float64)
        axes.append((once, np.full(len(once), step), total))
    return axes, log_evidence


def _least_sd(fit: BounceFit) -> float:
    """Return the least standard deviation of a restitution: no lens, clock or engine is better."""
    return 1e-5 if fit.samples.in_metres else 2e-4


def _nodes(middle: float, sd: float, low: float, high: float) -> tuple[Array, float]:
    """Return the middles of even cells about a value, within bounds, and their width."""
    first, last = middle - _REACH_SDS * sd, middle + _REACH_SDS * sd
    if last <= low or first >= high:  # only a bound can be meant
        first, last = (low, low + 2 * sd) if last <= low else (high - 2 * sd, high)
    edges = np.linspace(max(first, low), min(last, high), _NODES + 1)
    return (edges[1:] + edges[:-1]) / 2, float(edges[1] - edges[0])


def _profile_factors(fit: BounceFit) -> Array:
    """Return the profile likelihood's half widths over the normal ones, shape (2,).

    All else is fitted anew where the normal likelihood ends. Impacts that are heard, too, keep the
    normal one: a fit has no unknowns for each impact's own restitution.
    """
    if fit.samples.heard is not None:
        return np.ones(2)
    least = _least_sd(fit)
    normal, _ = fit.normal_equations()
    normal[0, 0] += ANY_RESTITUTION_SD**-2
    variance = float(np.linalg.pinv(normal)[0, 0]) * fit.samples_as_one
    sd = max(float(np.sqrt(max(variance, 0.0))), least)
    # Farther off than this factor it found another minimum, or none yet.
    if sd < 0.03 or fit.unknowns[RESTITUTION] > 0.3:
        return np.array([np.clip(_profiled(fit, side, sd), 0.8, 2.5) for side in (-1, 1)])
    # Near 0 a rebound grows with its square, which no normal likelihood describes: search the ends.
    factors: list[float] = []
    for side in (-1, 1):
        reach = 1.0
        for _ in range(4):
            found = _profiled(fit, side, reach * sd)
            reach = max(reach * float(np.clip(found, 0.25, 4.0)), least / sd)
            if abs(found - 1) < 0.1:  # near enough
                break
        factors.append(reach)
    return np.array(factors)


def _profiled(fit: BounceFit, side: int, sd: float) -> float:
    """Return the profile likelihood's end to a side over 1.96 of `sd`; 1 at a bound."""
    value = float(fit.unknowns[RESTITUTION])
    at = float(np.clip(value + side * TWO_SIDED * sd, 0.0, 1.0))
    reached = abs(at - value)
    if reached < 0.5 * TWO_SIDED * sd:
        return 1.0
    start = fit.with_others({RESTITUTION: at})
    others = tuple(index for index in fit.free if index != RESTITUTION)
    most = 30 if fit.samples.moves_s else 10
    held = fit_bounce(fit.samples, start, others, most=most, gain=1e-4, scale=fit.scale)
    held, factor = replace(held, free=fit.free), fit.samples_as_one
    best = fit.misfit_cost(fit.scale) / factor + fit.prior_cost()
    rise = held.misfit_cost(fit.scale) / factor + held.prior_cost() - best
    fraction = float(np.sqrt(max(rise, 0.0) / _RISE)) * TWO_SIDED * sd / reached
    return 1 / max(fraction, 1e-6)


# ---- Recorded drop: widened by a second estimate if the ball was thrown
# The air bends a spinning ball's flight, and a marker off its middle wobbles. Parabolas next to the
# impact have other errors: where they differ beyond chance, the interval covers both.


@lru_cache(maxsize=64)
def drop_posterior(drop: Drop, drag_1_m: float | None) -> BallPosterior | None:
    """Compute the ball's posterior; None where the samples are too few for a fit.

    The search, the problem and the checks all ask for it: it is cached.
    """
    fit = fit_positions(drop, drag_1_m)
    if fit is None:
        return None
    posterior = ball_posterior(fit)
    return _widened(drop, posterior) if drop.launched else posterior


def _widened(drop: Drop, posterior: BallPosterior) -> BallPosterior:
    """Widen the interval to hold what parabolas next to the impact say, too."""
    beyond = max(_beyond_chance(drop, posterior, near) for near in (0.2, 0.27, 0.35))  # fall times
    ends = posterior.interval95.copy()
    reach = np.hypot(ends[0] - posterior.values[0], TWO_SIDED * beyond)
    # How far the restitution depends on where in a long touch its speeds are taken.
    period_s = median_step(drop.seconds)
    impacts = len(posterior.fit.projection().impacts(float(drop.seconds[-1])))
    half_s = drop.touching * period_s / max(impacts, 1) / 2
    gained = drop.gravity_m_s2 * half_s / drop.impact_speed_m_s
    reach = np.hypot(reach, float(gained * (1 + posterior.values[0]) / 2))
    ends[0] = np.clip(posterior.values[0] + reach * np.array([-1, 1]), 0.0, 1.0)
    return replace(posterior, interval95=ends)


def _beyond_chance(drop: Drop, posterior: BallPosterior, near: float) -> float:
    """Return how far the parabolas' restitution is off, without what chance makes of it."""
    view = posterior.fit.projection()
    since = drop.seconds - view.impact_s
    touching_s = median_step(drop.seconds)  # within it the ball may touch the ground
    starts = view.impacts(float(drop.seconds[-1]))
    next_s = float(starts[1]) * view.fall_time_s if len(starts) > 1 else np.inf
    near_s = near * view.fall_time_s
    before = (since < -touching_s) & (since > -near_s)
    after = (since > touching_s) & (since < min(near_s, next_s - touching_s))
    # Too few for a parabola with an error of its own.
    if min(np.count_nonzero(before), np.count_nonzero(after)) < 6:
        return 0.0
    ball_m = view.ball(drop.seconds)
    noise_m = max(noise_floor(drop), posterior.fit.scale)
    # The speeds of parabolas at the impact as seen and of the ball, and the error [m/s].
    sides: list[tuple[float, float, float]] = []
    for side in (before, after):
        row = np.linalg.pinv(np.vander(since[side], 3))[1]
        error = noise_m * np.linalg.norm(row)
        sides.append((float(row @ drop.heights_m[side]), float(row @ ball_m[side]), float(error)))
    (fall, ball_fall, fall_sd), (rise, ball_rise, rise_sd) = sides
    if fall >= 0 or ball_fall >= 0:
        return 0.0
    apart = rise / -fall - ball_rise / -ball_fall
    chance = float(np.hypot(rise_sd, fall_sd * ball_rise / ball_fall)) / -ball_fall
    # What two estimates may be apart by chance.
    return max(apart**2 - (2.0 * chance) ** 2, 0.0) ** 0.5


# ---- Restitution of each impact without a law, and the ratio of two flights' durations
# `flight_ratio` needs no camera and no scale: flights are smooth curves that meet at impacts, and
# the second one's duration over the first's is the restitution of the second impact.


def fitted_rebounds(posterior: BallPosterior) -> tuple[Rebound, ...]:
    """Fit the restitution of each impact whose flight is seen to its end, by Gauss-Newton.

    The first has the posterior's. The camera is fitted with them; no law binds them but that none
    is far (0.15) from the fit's.
    """
    fit = posterior.fit
    law = fit.samples.bounce(fit.unknowns)
    times = fit.samples.times(fit.unknowns)
    starts, speeds = law.flights(float(times[-1]))
    count = 0  # of flights that are high enough, and seen to their end
    for begin, end, speed in zip(starts[:MAX_IMPACTS], starts[1:], speeds, strict=False):
        hop = fit.unknowns[SPAN] * speed**2 / 4
        seen = np.count_nonzero((times > begin) & (times < end))
        # A parabola has three coefficients, and has to be 4 standard deviations high.
        if end > times[-1] or hop < 4.0 * fit.scale or seen < 4:
            break
        count += 1
    if not count:
        return ()
    arrivals = _impact_speeds(law, speeds[:count])
    first = np.clip(speeds[:count] / arrivals, 0.01, 1.0)
    values, sds = _fitted(fit, law, first)
    # What slope and drag leave open of the first one's restitution, they leave open of each.
    open_sd = float(np.ptp(posterior.interval95[0])) / 2 / TWO_SIDED
    sds = np.hypot(sds, np.sqrt(max(open_sd**2 - sds[0] ** 2, 0.0)))
    each = replace(law, restitution=float(values[0]), each=tuple(values), constant_below=0.0)
    own_starts, own_speeds = each.flights(float(times[-1]))
    fall_s = float(np.exp(fit.unknowns[FALL]))
    unit_m_s = CALIBRATED.gravity_m_s2 * fall_s / 2
    hits = _impact_speeds(each, own_speeds[:count])
    impacts_s = (fit.unknowns[IMPACT] + fall_s * own_starts).tolist()
    ends = np.clip(values[:, None] + TWO_SIDED * sds[:, None] * np.array([-1, 1]), 0.0, 1.0)
    values[0], ends[0] = posterior.values[0], posterior.interval95[0]
    return tuple(
        Rebound(impact_s, value, (low, high), speed_m_s)
        for impact_s, value, (low, high), speed_m_s in zip(
            impacts_s, values.tolist(), ends.tolist(), (hits * unit_m_s).tolist(), strict=False
        )
    )


def first_rebound(posterior: BallPosterior) -> Rebound:
    """Return the first impact, whose flight need not be seen to its end."""
    view = posterior.fit.projection()
    low, high = posterior.interval95[0].tolist()
    unit_m_s = CALIBRATED.gravity_m_s2 * view.fall_time_s / 2
    speed_m_s = view.bounce.impact_speed * unit_m_s
    return Rebound(view.impact_s, float(posterior.values[0]), (low, high), speed_m_s)


def _impact_speeds(ball: Bounce, leaving: Array) -> Array:
    """Return the speeds before impacts left with these speeds [drop heights, sqrt(2 H / g)]."""
    later = [ball.flight(float(speed))[1] for speed in leaving[:-1]]
    return np.array([ball.impact_speed, *later])


def _fitted(fit: BounceFit, law: Bounce, first: Array) -> tuple[Array, Array]:
    """Fit N restitutions and their standard errors by Gauss-Newton's method, without outliers."""
    weights = np.where(np.abs(fit.residuals) < 4 * fit.scale, 1.0, 0.0)
    scale = fit.scale * np.sqrt(correlation_time(fit.residuals, len(fit.free)))
    camera = fit.unknowns[[IMPACT, FALL, CONTACT, SPAN, PERSPECTIVE]]
    seconds, view = fit.samples.seconds, fit.projection()
    seen = fit.samples.positions
    seen = view.straightened(seen, seconds) if view.moves or view.lens.distortion else seen
    values = np.concatenate([camera, first])
    # It begins nearly at the end: a step that goes on for this far is no camera's.
    fall_s, span = float(np.exp(camera[1])), float(camera[3])
    reach = np.array([fall_s / 2, 0.5, span, 0.9 * span, 2.0])
    lowest = np.concatenate([camera - reach, np.full(len(first), 0.01)])
    highest = np.concatenate([camera + reach, np.full(len(first), 1.0)])
    free = [0.0, 0.0, 0.0, 0.0, PERSPECTIVE_SD**-2]
    if fit.samples.in_metres:  # this camera is known, and as far as metres are metres its scale
        metre_sd = METRE_SD if fit.samples.scale_known else ANY_SCALE_SD
        free[3:] = [(metre_sd * camera[3]) ** -2, 1e12]  # the last one is known
    # Of each about the fit's: no law, but no impact is far from all others.
    prior = np.concatenate([free, np.full(len(first), 0.15**-2)])
    target = np.concatenate([[0.0, 0.0, 0.0, camera[3], 0.0], first])
    covariance = np.eye(len(values))
    for _ in range(6):
        (impact_s, log_fall, contact, span, perspective), each = values[:5].tolist(), values[5:]
        fall_s, grow = np.exp(log_fall), np.exp(perspective)
        times = (seconds - impact_s) / fall_s
        # The ball, and one for each impact that it leaves a little faster.
        trials = np.vstack([each, each + _FASTER * np.eye(len(each))]).tolist()
        balls = [replace(law, each=tuple(trial), constant_below=0.0) for trial in trials]
        (heights, *faster), (speeds, *_) = flown_by(balls, np.tile(times, (len(balls), 1)))
        depth = 1 + (grow - 1) * heights
        per_height = span * grow / depth**2
        columns = [
            -per_height * speeds / fall_s,
            -per_height * speeds * times,
            np.ones(len(times)),
            grow * heights / depth,
            per_height * heights * (1 - heights),
            *(per_height * (moved - heights) / _FASTER for moved in faster),
        ]
        jacobian = np.column_stack(columns)
        residuals = contact + span * projected(heights, perspective) - seen
        normal = jacobian.T @ (weights[:, None] * jacobian) / scale**2 + np.diag(prior)
        gradient = -jacobian.T @ (weights * residuals) / scale**2 - prior * (values - target)
        covariance = np.linalg.pinv(normal)
        step = covariance @ gradient
        values = np.clip(values + step, lowest, highest)
        if np.all(np.abs(step) <= 1e-5 * np.sqrt(np.diag(covariance))):  # standard errors
            break
    return values[5:], np.sqrt(np.diag(covariance))[5:]


class FlightRatio(NamedTuple):
    """Ratio of the second flight's duration to the first's."""

    value: float  # as seen
    fitted: float  # as the fitted ball has it
    sd: float  # standard error of the value


def flight_ratio(fit: BounceFit) -> FlightRatio | None:
    """Measure the ratio by the first three impacts; None where they are not seen well enough."""
    times = fit.samples.times(fit.unknowns)
    starts, _ = fit.samples.bounce(fit.unknowns).flights(float(times[-1]))
    if len(starts) < 4 or starts[2] > times[-1]:
        return None
    edges = np.array([-1.0, *starts[:4]])
    edges[-1] = min(edges[-1], times[-1])
    half = 0.5 * median_step(times)
    flights: list[_Flight] = []
    for begin, end in itertools.pairwise(edges):
        inside = (times > begin + half) & (times < end - half)
        inside &= np.abs(fit.residuals) < 5.0 * fit.scale  # farther off it is not the ball
        count = int(np.count_nonzero(inside))
        if count < 5:
            return None
        middle = float(times[inside].mean())
        # With perspective, a cubic.
        columns = np.vander(times[inside] - middle, 4 if count >= 9 else 3)
        powers, *_ = np.linalg.lstsq(columns, fit.samples.positions[inside], rcond=None)
        covariance = np.linalg.pinv(columns.T @ columns) * fit.scale**2
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
    """Flight as a polynomial of time."""

    middle: float  # time that it is about [fall times]
    powers: Array  # coefficients [px], highest power first, shape (3,) or (4,)
    covariance: Array  # of them

    def meets(self, then: _Flight, near: float, reach: float) -> tuple[float, float] | None:
        """Return when this flight ends in the next, and the standard error; None if it does not."""
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


# ---- Parameters that a log cannot determine: slope and drag that only their priors say

SLOPE_AND_DRAG = 2  # index of the last of the parameters that this is about, in the task's order


def unidentifiable(posterior: BallPosterior) -> tuple[str, ...]:
    """Return one sentence for each parameter that the samples leave to its prior."""
    # A log has to take half of a prior's width away, or it tells little of a parameter.
    names = ("slope", "drag")
    unknown = [name for name, told in zip(names, posterior.told, strict=True) if told < 0.5]
    if not unknown:
        return ()
    if abs(posterior.correlation) > 0.9:  # from there on they trade places
        # How many flights the fit has, the one that is cut off too.
        seconds, view = posterior.fit.samples.seconds, posterior.fit.projection()
        count = len(view.impacts(float(seconds[-1]))) if len(seconds) else 0
        words = ("one flight", "two flights", "three flights", "four flights", "five flights")
        if 0 < count <= len(words):
            seen = words[count - 1]
        else:  # more have other reasons than their number
            correlation = f"their correlation is {np.round(posterior.correlation, 2):+.2f}"
            seen = "6 flights" if count == 6 else correlation
        return (f"drag and slope cannot be separated in this log: {seen}",)
    return tuple(
        f"this log cannot determine the {name}: its interval is what is known of balls, from "
        f"{low:.3f} to {high:.3f}"
        for name, (low, high) in zip(names, posterior.interval95[1:].tolist(), strict=True)
        if name in unknown
    )
