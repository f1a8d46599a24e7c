"""Robust MAP fit of a bounce: Student's t by reweighting, Levenberg-Marquardt steps.

Samples of the ball in the hand are then added, and those at impacts left out. Recorded heights are
fitted flight by flight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.drop.bounce_model import (
    CONTACT,
    DRAG,
    FALL,
    FREEDOM,
    HIGH,
    IMPACT,
    LOW,
    PERSPECTIVE,
    RESTITUTION,
    SLOPE,
    SPAN,
    BounceSamples,
    Projection,
)
from tunenet_logs.analysis.drop.free_flight import Drop
from tunenet_logs.analysis.statistics import correlation_time
from tunenet_logs.episode import Array

_BENDS = 16  # pieces of a drop in each of which a lens's distortion is much the same
# How far from its start a fall time or an impact may go: a factor e^1.5, 1.5 fall times.
_FARTHEST = 1.5

# Of Levenberg and Marquardt: damping below which a step is Gauss-Newton's, and dampings a step.
_MIN_DAMPING, _MAX_TRIES = 1e-9, 6


@dataclass(frozen=True, eq=False)
class BounceFit:
    """Bounce fitted to samples.

    Attributes:
        samples: what was fitted.
        unknowns: shape (14,), see `bounce_model`.
        free: which of them were fitted.
        residuals: in the positions' unit, shape (T,).
        scale: robust standard deviation of them, not below the samples' noise.
    """

    samples: BounceSamples
    unknowns: Array
    free: tuple[int, ...]
    residuals: Array
    scale: float

    @property
    def effective_sample_factor(self) -> float:
        """Samples that count as one where a lens distorts the picture: that is no noise."""
        most = max(len(self.residuals) / _BENDS - 1, 0.0)
        return 1 + self.samples.distortion_variance_fraction * most

    @property
    def tail_sd(self) -> float:
        """Standard deviation by the 90 % quantile of the absolute residuals."""
        return float(np.quantile(np.abs(self.residuals), 0.9)) / 1.645

    def misfit_cost(self, scale: float) -> float:
        """Return the negative Student's t log likelihood for a position sd, without constants."""
        squares = (self.residuals / scale) ** 2
        robust = 0.5 * (FREEDOM + 1) * np.log1p(squares / FREEDOM).sum()
        return float(robust + len(self.residuals) * np.log(scale))

    def prior_cost(self) -> float:
        """Return the negative log density of the priors that involve a free unknown."""
        priors = self.samples.priors(self.unknowns)
        return sum(one.cost for one in priors if one.slopes.keys() & set(self.free))

    def cost(self, scale: float) -> float:
        """Return the negative log posterior density."""
        return self.misfit_cost(scale) + self.prior_cost()

    def normal_equations(self) -> tuple[Array, Array]:
        """Return the reweighted normal matrix with the priors, and minus the cost's gradient."""
        jacobian = self.samples.jacobian(self.unknowns, self.free)
        weights = (FREEDOM + 1) / (FREEDOM + (self.residuals / self.scale) ** 2) / self.scale**2
        normal = jacobian.T @ (weights[:, None] * jacobian)
        gradient = -jacobian.T @ (weights * self.residuals)
        for prior in self.samples.priors(self.unknowns):
            row = np.array([prior.slopes.get(index, 0.0) for index in self.free])
            normal += prior.weight * np.outer(row, row)
            gradient -= prior.weight * prior.off * row
        return normal, gradient

    def projection(self) -> Projection:
        """Return the fitted camera and ball."""
        values = self.unknowns.tolist()
        return Projection(
            contact=values[CONTACT],
            span=values[SPAN],
            perspective=values[PERSPECTIVE],
            impact_s=values[IMPACT],
            fall_time_s=float(np.exp(values[FALL])),
            bounce=self.samples.bounce(self.unknowns),
            residual_rms=float(np.sqrt(np.mean(self.residuals**2))),
            residual_max=float(np.abs(self.residuals).max()),
            bends=tuple(
                zip(
                    self.samples.bends_s,
                    self.samples.bend_rates(self.unknowns).tolist(),
                    strict=True,
                )
            ),
        )


def fit_bounce(
    samples: BounceSamples,
    start: Array,
    free: tuple[int, ...],
    most: int = 30,
    gain: float = 1e-6,
    scale: float | None = None,
) -> BounceFit:
    """Fit the posterior mode: Student's t by reweighting (Lange et al. 1989), Levenberg-Marquardt.

    Args:
        samples: what to explain.
        start: all unknowns, shape (14,).
        free: which of them to fit.
        most: iterations.
        gain: in cost a sample that ends them.
        scale: standard deviation of a position; None to estimate it after each iteration.
    """
    low, high = LOW.copy(), HIGH.copy()
    for index, reach in ((FALL, _FARTHEST), (IMPACT, _FARTHEST * float(np.exp(start[FALL])))):
        low[index], high[index] = start[index] - reach, start[index] + reach
    low[SPAN] = 1e-3 * start[SPAN]
    chosen = list(free)
    unknowns = np.clip(start, low, high)
    residuals = samples.residuals(unknowns)
    first = scale or _scale(residuals, samples.noise)
    fit = BounceFit(samples, unknowns, free, residuals, first)
    cost, damping = fit.cost(first), 1e-3
    for _ in range(most):
        normal, gradient = fit.normal_equations()
        before = cost
        for _ in range(_MAX_TRIES):
            damped = normal + damping * np.diag(np.diag(normal) + 1e-12)
            begin = fit.unknowns[chosen]
            step = _bounded(damped, gradient, low[chosen] - begin, high[chosen] - begin)
            unknowns = fit.unknowns.copy()
            unknowns[chosen] += step
            tried = replace(fit, unknowns=unknowns, residuals=samples.residuals(unknowns))
            tried_cost = tried.cost(fit.scale)
            if tried_cost < cost:
                fit, cost = tried, tried_cost
                damping = max(damping / 10, _MIN_DAMPING)
                break
            damping *= 10
        gained = before - cost
        new = scale or _scale(fit.residuals, samples.noise)
        settled = gained < gain * len(samples.seconds) and abs(new / fit.scale - 1) < 0.01
        fit = replace(fit, scale=new)
        cost = fit.cost(new)
        if settled:
            break
    return fit


def best_of(fits: list[BounceFit]) -> BounceFit:
    """Return the likeliest of several fits to the same samples."""
    scale = min(fit.scale for fit in fits)
    return min(fits, key=lambda fit: fit.cost(scale))


def _bounded(normal: Array, gradient: Array, low: Array, high: Array) -> Array:
    """Solve the normal equations within bounds: what would leave them ends there, the rest follows.

    A step that is merely cut would leave a narrow valley.
    """
    step = np.linalg.lstsq(normal, gradient, rcond=None)[0]
    out = (step < low) | (step > high)
    if out.any() and not out.all():
        step[out] = np.clip(step, low, high)[out]
        rest = gradient[~out] - normal[np.ix_(~out, out)] @ step[out]
        step[~out] = np.linalg.lstsq(normal[np.ix_(~out, ~out)], rest, rcond=None)[0]
    return np.clip(step, low, high).astype(np.float64)


def _scale(residuals: Array, noise: float) -> float:
    """Estimate the standard deviation by the median absolute residual, not below the noise."""
    return max(noise, 1.4826 * float(np.median(np.abs(residuals))))


# ---- Samples that a fitted bounce adds and leaves out: the ball in the hand, and at impacts

# Impacts in a film's fit, and with a restitution of their own: later bounces are too low to tell.
MAX_IMPACTS = 6

MIN_SAMPLES = 12  # for eight unknowns, of which three have priors, and a noise
# A held ball counts from so many fall times before the impact on, if it is within so many standard
# deviations of where it is let go.
_HELD_BACK, _OFF = 3.0, 4.0

_SHORTLY = 0.35  # fall times: a ball that moved before, and was still for less, was in no hand
_AT_IMPACT = 1.5  # samples to either side of an impact that a filter rounds
_NARROW = 0.15  # fraction of a flight, at most, that is left out at either end


def with_pre_release_samples(whole: BounceSamples, fit: BounceFit) -> BounceSamples:
    """Add the samples just before the fall in which the ball is held where it is let go."""
    first = int(np.searchsorted(whole.seconds, fit.samples.seconds[0]))
    fall_s = float(np.exp(fit.unknowns[FALL]))
    earliest_s = float(fit.unknowns[IMPACT]) - _HELD_BACK * fall_s
    begin = int(np.searchsorted(whole.seconds, earliest_s))
    if first == begin:
        return fit.samples
    off = np.abs(whole.part(begin, first).residuals(fit.unknowns))
    held, misses = first, 0
    while held > begin and misses < 3:  # three in a row that are elsewhere: it is not held yet
        held -= 1
        misses = misses + 1 if off[held - begin] > _OFF * fit.scale else 0
    moved = misses >= 3
    held = min(held + misses, first)
    still = float(whole.seconds[first] - whole.seconds[held])
    if whole.in_metres and moved and still < _SHORTLY * fall_s:
        return fit.samples  # at the top of a flight a ball seems to be held, too
    last = int(np.searchsorted(whole.seconds, fit.samples.seconds[-1], side="right"))
    return fit.samples if first == held else whole.part(held, last)


def without_impact_samples(fit: BounceFit) -> BounceSamples:
    """Remove the samples that an impact may be in.

    An exposure shows both of its sides, a filter rounds it, and noise hides on which side a sample
    is: there the residual has a kink, at which a fit would rest and seem surer than it is.
    """
    samples, unknowns = fit.samples, fit.unknowns
    times = samples.times(unknowns)
    ball = samples.bounce(unknowns)
    starts, speeds = ball.flights(float(times[-1]))
    fall_s = float(np.exp(unknowns[FALL]))
    reach = np.maximum(
        samples.exposure_s / 2 / fall_s,
        fit.scale / float(unknowns[SPAN]) / np.maximum(ball.arrivals(speeds) + speeds, 1e-9),
    )
    if correlation_time(fit.residuals, len(fit.free)) > 1:
        reach = np.maximum(reach, _AT_IMPACT * float(np.median(np.diff(times))))
    longest = np.minimum(np.diff(starts, prepend=-1.0), np.diff(starts, append=np.inf))
    least = samples.exposure_s / 2 / fall_s
    reach = np.maximum(np.minimum(reach, _NARROW * longest), least)
    kept = _apart(times, starts, reach) | (times > starts[-1])
    if np.count_nonzero(kept) < max(MIN_SAMPLES, 0.5 * len(times)):
        return samples
    return samples.only(kept)


def _apart(times: Array, impacts: Array, reach: Array) -> NDArray[np.bool_]:
    """Return which times are farther from all impacts than each reaches, shape (T,)."""
    after = np.searchsorted(impacts, times, side="right")
    before, later = np.maximum(after - 1, 0), np.minimum(after, len(impacts) - 1)
    return (np.abs(times - impacts[before]) > reach[before]) & (
        np.abs(impacts[later] - times) > reach[later]
    )


# ---- Fit to recorded heights: more and more flights, as long as one law explains them
# The first flight fixes the restitution to a few thousandths, which is near enough for the second,
# and so on: far ahead the cost has dozens of minima.

_FALL_SEEN = 0.95  # fraction of the fall that is fitted: earlier a hand may still touch the ball
# Fall times of a rest that are fitted: more of them would only repeat the table's level.
_REST_SEEN = 4.0

# Flights that are fitted in turn, as long as one law explains them to within the noise.
_FLIGHTS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 19, 22, 26, 30, 35, 40)

# Standard deviations of the noise that a flight is high, or the ball seems to lie still.
_MIN_HOP = 2.0

_EXACT = 1e-4  # fraction of the drop height that no recording, and no model of a ball, is held to
# Fraction of the drop height: a drop of the engine without noise is off by as much.
_MIN_NOISE = 1e-5

_FIT_SD = 4.0  # standard deviations of a residual variance within which it is noise
# Where the fits begin: what most balls have, the drag times the drop height.
_TYPICAL_SLOPE, _TYPICAL_DRAG = 0.05, 0.03

# Where they begin if parabolas show no restitution.
_RESTITUTIONS = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85)

_ROUGHLY = (12, 1e-4)  # iterations and gain in cost that end the fits which only lead to the next


def samples_of(drop: Drop, drag_1_m: float | None) -> BounceSamples:
    """Convert a drop's heights to samples of a bounce; a drag of a known ball [1/m], or None."""
    return BounceSamples(
        drop.seconds,
        drop.heights_m,
        noise_floor(drop),
        in_metres=True,
        scale_known=drop.scale_known,
        starts_in_flight=drop.launched,
        drag_1_m=drag_1_m,
    )


def noise_floor(drop: Drop) -> float:
    """Return the standard deviation of a height [m]: its noise, or what no recording is held to."""
    return max(drop.noise_m, _MIN_NOISE * drop.drop_height_m)


def fit_positions(drop: Drop, drag_1_m: float | None = None) -> BounceFit | None:
    """Fit a bounce to a drop, flight by flight; None where too little is seen."""
    if not (drop.fall_time_s > 0 and drop.drop_height_m > 0):  # NaN is not
        return None
    whole = samples_of(drop, drag_1_m)
    unknowns = _start(drop)
    same_table = not abs(drop.rest_m - drop.contact_m) > drop.rest_tolerance_m
    rest_seen = _REST_SEEN if same_table else 0.0
    best: BounceFit | None = None
    for flights in _FLIGHTS:
        chosen = _window(whole, unknowns, flights, rest_seen)
        count = int(np.count_nonzero(chosen))
        if count < MIN_SAMPLES or (best is not None and count == len(best.residuals)):
            continue
        samples = whole.only(chosen)
        starts = [unknowns] if best else _first_starts(unknowns)
        fit = best_of([fit_bounce(samples, one, whole.unknowns, *_ROUGHLY) for one in starts])
        if best is not None and not _is_explained(fit, best, drop):
            break
        best, unknowns = fit, fit.unknowns
    return None if best is None else finished(whole, best)


def fitted_drop(drop: Drop, fit: BounceFit) -> Drop:
    """Replace impact, contact and fall of a drop by a fit's: from rest, and through the air.

    The last, low bounces look like a rest: as high as they are by the fit, it is none too high.
    """
    view = fit.projection()
    resting = drop.seconds >= drop.rest_s
    rest_m = drop.rest_m
    if resting.any():
        at_s = drop.seconds[resting]
        ball_m = view.positions(view.bounce.heights(view.fall_times(at_s)), at_s)
        rest_m = view.contact + float(np.median(drop.heights_m[resting] - ball_m))
    release_s = view.impact_s - view.fall_time_s * view.bounce.fall_time
    release_m = view.contact + view.span
    if drop.launched:
        release_s = float(drop.seconds[0])
        at_s = drop.seconds[:1]
        release_m = float(view.positions(view.bounce.heights(view.fall_times(at_s)), at_s)[0])
    return replace(
        drop,
        impact_s=view.impact_s,
        contact_m=view.contact,
        release_s=release_s,
        release_m=release_m,
        impact_speed_m_s=2 * view.span / view.fall_time_s,
        gravity_m_s2=2 * view.span / view.fall_time_s**2,
        rest_m=rest_m,
    )


def finished(whole: BounceSamples, fit: BounceFit) -> BounceFit:
    """Refit to the end: with the ball in the hand before, without the samples at impacts."""
    samples = fit.samples if whole.starts_in_flight else with_pre_release_samples(whole, fit)
    if samples is not fit.samples:
        held = fit_bounce(samples, fit.unknowns, fit.free)
        if held.tail_sd < 1.5 * max(fit.tail_sd, whole.noise):
            fit = held
    return fit_bounce(without_impact_samples(fit), fit.unknowns, fit.free, most=60, gain=1e-8)


def _start(drop: Drop) -> Array:
    """Return start unknowns by fall and flight parabolas, shape (14,); restitution 0 if unseen."""
    start = np.zeros(len(LOW))
    restitution = np.nan_to_num(np.clip(drop.flight_restitution, 0.02, 0.99))
    start[[RESTITUTION, IMPACT, FALL]] = restitution, drop.impact_s, np.log(drop.fall_time_s)
    start[[CONTACT, SPAN]] = drop.contact_m, drop.drop_height_m
    start[[SLOPE, DRAG]] = _TYPICAL_SLOPE, _TYPICAL_DRAG
    return start


def _first_starts(start: Array) -> list[Array]:
    """Return a start with the restitution of parabolas, or several where they saw none."""
    if start[RESTITUTION]:
        return [start]
    starts = [start.copy() for _ in _RESTITUTIONS]
    for one, restitution in zip(starts, _RESTITUTIONS, strict=True):
        one[RESTITUTION] = restitution
    return starts


def _window(
    whole: BounceSamples, unknowns: Array, flights: int, rest_seen: float
) -> NDArray[np.bool_]:
    """Select the samples from most of the fall to the end of `flights` flights, and of a rest."""
    times = whole.times(unknowns)
    ball = whole.bounce(unknowns)
    starts, speeds = ball.flights(float(times[-1]))
    hops = float(unknowns[SPAN]) * speeds**2 / 4
    low = np.flatnonzero(hops < _MIN_HOP * whole.noise)
    rest = len(starts) - 1 if not len(low) else int(low[0])
    if flights < min(len(starts), rest):
        end = starts[flights]
    elif len(low):
        end = starts[rest] + rest_seen
    else:
        end = np.inf
    return (whole.starts_in_flight | (times > -_FALL_SEEN * ball.fall_time)) & (times < end)


def _is_explained(fit: BounceFit, before: BounceFit, drop: Drop) -> bool:
    """Return whether one more flight leaves residuals that are noise."""
    noise = max(drop.noise_m, _spread(before))
    freedom = max(len(fit.residuals) - len(fit.free), 1)
    allowed = noise**2 * (1 + _FIT_SD * np.sqrt(2 / freedom))
    return bool(_spread(fit) ** 2 < allowed + (_EXACT * fit.unknowns[SPAN]) ** 2)


def _spread(fit: BounceFit) -> float:
    """Return the standard deviation of the residuals."""
    freedom = max(len(fit.residuals) - len(fit.free), 1)
    return float(np.sqrt(np.sum(fit.residuals**2) / freedom))
