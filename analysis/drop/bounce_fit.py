"""Robust MAP fit of a bounce: Student's t by reweighting, Levenberg-Marquardt steps.

Samples of the ball in the hand are then added, and those at impacts left out. Recorded heights are
fitted flight by flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

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
    Flown,
    Prior,
    Projection,
)
from tunenet_logs.analysis.drop.free_flight import Drop
from tunenet_logs.analysis.estimators.damped import Damping, damped_step
from tunenet_logs.analysis.statistics import correlation_time
from tunenet_logs.episode import Array, median_step

_DAMPING = Damping(tries=6, raised_by=10, lowered_by=10, least=1e-9)


@dataclass(frozen=True, eq=False)
class BounceFit:
    """Bounce fitted to samples."""

    samples: BounceSamples  # what was fitted
    unknowns: Array  # shape (20,), see `bounce_model`
    free: tuple[int, ...]  # which of them were fitted
    residuals: Array  # in the positions' unit, shape (T,)
    scale: float  # robust standard deviation of them, not below the samples' noise

    # the ball at these unknowns, where it was flown for the fit
    _flown: Flown | None = field(default=None, init=False, repr=False)

    @cached_property
    def jacobian(self) -> Array:
        """The residuals' Jacobian over the free unknowns, shape (T, U)."""
        if self._flown is not None and self._flown.free == self.free:
            return self.samples.jacobian_of(self._flown)
        return self.samples.jacobian(self.unknowns, self.free)

    @property
    def effective_sample_factor(self) -> float:
        """Samples that count as one where a lens distorts the picture: that is no noise."""
        together = len(self.residuals) / 16  # its distortion is alike within a 16th of the drop
        return 1 + self.samples.distortion_variance_fraction * max(together - 1, 0.0)

    @cached_property
    def samples_as_one(self) -> float:
        """Samples that count as one, as their residuals hang together, or the lens distorts."""
        correlated = correlation_time(self.residuals, len(self.free))
        return max(correlated, self.effective_sample_factor)

    @property
    def tail_sd(self) -> float:
        """Standard deviation by the 90 % quantile of the absolute residuals."""
        return float(np.quantile(np.abs(self.residuals), 0.9)) / 1.645  # of a normal distribution

    def misfit_cost(self, scale: float) -> float:
        """Return the negative Student's t log likelihood for a position sd, without constants."""
        return _misfit_cost(self.residuals, scale)

    def prior_cost(self) -> float:
        """Return the negative log density of the priors that involve a free unknown."""
        return _prior_cost(self.samples.priors(self.unknowns), self.free)

    def cost(self, scale: float) -> float:
        """Return the negative log posterior density."""
        return self.misfit_cost(scale) + self.prior_cost()

    def normal_equations(self) -> tuple[Array, Array]:
        """Return the reweighted normal matrix with the priors, and minus the cost's gradient."""
        priors = self.samples.priors(self.unknowns)
        return _normal_equations(self.jacobian, self.residuals, self.scale, priors, self.free)

    def with_others(self, held: dict[int, float]) -> Array:
        """Predict all unknowns where some free ones are held elsewhere (conditional normal)."""
        normal, _ = self.normal_equations()
        own = np.array([index in held for index in self.free])
        unknowns, free = self.unknowns.copy(), np.array(self.free)
        unknowns[list(held)] = list(held.values())
        pull = normal[np.ix_(~own, own)] @ (unknowns - self.unknowns)[free[own]]
        unknowns[free[~own]] -= np.linalg.lstsq(normal[np.ix_(~own, ~own)], pull, rcond=None)[0]
        return unknowns

    def projection(self) -> Projection:
        """Return the fitted camera and ball."""
        values, samples = self.unknowns.tolist(), self.samples
        return Projection(
            contact=values[CONTACT],
            span=values[SPAN],
            perspective=values[PERSPECTIVE],
            impact_s=values[IMPACT],
            fall_time_s=float(np.exp(values[FALL])),
            bounce=self.samples.bounce(self.unknowns),
            residual_rms=float(np.sqrt(np.mean(self.residuals**2))),
            moves=tuple(zip(samples.moves_s, samples.rates(self.unknowns).tolist(), strict=True)),
            lift=samples.lift(self.unknowns),
            leans=(samples.seconds, samples.lean(self.unknowns)),
            lens=samples.lens(self.unknowns),
        )


def _misfit_cost(residuals: Array, scale: float) -> float:
    squares = (residuals / scale) ** 2
    squares /= FREEDOM
    robust = 0.5 * (FREEDOM + 1) * np.log1p(squares, out=squares).sum()
    return float(robust) + len(residuals) * float(np.log(scale))


def _prior_cost(priors: Sequence[Prior], free: Sequence[int]) -> float:
    return sum(one.cost for one in priors if not one.slopes.keys().isdisjoint(free))


def _normal_equations(
    jacobian: Array, residuals: Array, scale: float, priors: Sequence[Prior], free: Sequence[int]
) -> tuple[Array, Array]:
    weights = (FREEDOM + 1) / (FREEDOM + (residuals / scale) ** 2) / scale**2
    weighted = weights[:, None] * jacobian
    rows = np.array([[one.slopes.get(index, 0.0) for index in free] for one in priors])
    sure = np.array([one.weight for one in priors])[:, None] * rows
    normal = jacobian.T @ weighted + rows.T @ sure
    return normal, -residuals @ weighted - np.array([one.off for one in priors]) @ sure


class _Tried(NamedTuple):
    """Unknowns that a fit tries, with what costs to compute."""

    flown: Flown
    residuals: Array  # shape (T,)
    priors: Sequence[Prior]
    prior_cost: float

    @classmethod
    def of(cls, samples: BounceSamples, unknowns: Array, free: tuple[int, ...]) -> _Tried:
        flown, priors = samples.flown(unknowns, free), samples.priors(unknowns)
        return cls(flown, samples.residuals_of(flown), priors, _prior_cost(priors, free))

    def cost(self, scale: float) -> float:
        return _misfit_cost(self.residuals, scale) + self.prior_cost


def fit_bounce(
    samples: BounceSamples,
    start: Array,
    free: tuple[int, ...],
    most: int = 30,
    gain: float = 1e-6,
    scale: float | None = None,
) -> BounceFit:
    """Fit the posterior mode: Student's t by reweighting (Lange et al. 1989), Levenberg-Marquardt.

    It starts at all unknowns, shape (20,), fits the `free` ones, and ends after `most` iterations
    or below a `gain` in cost a sample; without a `scale` [positions' unit] that is estimated, too.
    """
    low, high = LOW.copy(), HIGH.copy()
    # The log of a fall time, and the impact in fall times, may go 1.5 from where they start.
    for index, reach in ((FALL, 1.5), (IMPACT, 1.5 * float(np.exp(start[FALL])))):
        low[index], high[index] = start[index] - reach, start[index] + reach
    low[SPAN] = 1e-3 * start[SPAN]
    at = _Tried.of(samples, np.clip(start, low, high), free)
    used = scale or scale_of(at.residuals, samples.noise)
    chosen, count = list(free), len(samples.seconds)

    def stepped(damping: float) -> tuple[_Tried, float] | None:
        """Step by the damped equations: what would leave its bounds ends there, the rest follows.

        A step that is merely cut would leave a narrow valley.
        """
        matrix, unknowns = normal.copy(), at.flown.unknowns.copy()
        diagonal = matrix.reshape(-1)[:: len(matrix) + 1]
        diagonal += damping * (diagonal + 1e-12)  # solvable, if nothing is seen
        begin = unknowns[chosen]
        lowest, highest = low[chosen] - begin, high[chosen] - begin
        step = np.linalg.solve(matrix, gradient)
        out = (step < lowest) | (step > highest)
        if out.any():
            cut = np.minimum(np.maximum(step, lowest), highest)
            if not out.all():
                step[out] = cut[out]
                rest = gradient[~out] - matrix[np.ix_(~out, out)] @ step[out]
                step[~out] = np.linalg.solve(matrix[np.ix_(~out, ~out)], rest)
            step = np.minimum(np.maximum(step, lowest), highest)
        if step @ gradient < 0.01 * gain * count:  # what it can gain, twice
            return None
        unknowns[chosen] += step
        tried = _Tried.of(samples, unknowns, free)
        return tried, tried.cost(used)

    cost, damping = at.cost(used), 1e-3
    for _ in range(most):
        before = cost
        jacobian = samples.jacobian_of(at.flown)
        normal, gradient = _normal_equations(jacobian, at.residuals, used, at.priors, free)
        better, cost, damping = damped_step(stepped, cost, damping, _DAMPING)
        at = better or at
        gained = before - cost
        new = scale or scale_of(at.residuals, samples.noise)
        settled = gained < gain * count and abs(new / used - 1) < 0.01
        if new != used:
            used, cost = new, at.cost(new)
        if settled:
            break
    fit = BounceFit(samples, at.flown.unknowns, free, at.residuals, used)
    vars(fit)["_flown"] = at.flown
    return fit


def best_of(fits: list[BounceFit]) -> BounceFit:
    """Return the likeliest of several fits to the same samples."""
    scale = min(fit.scale for fit in fits)
    return min(fits, key=lambda fit: fit.cost(scale))


def scale_of(residuals: Array, noise: float) -> float:
    """Estimate the standard deviation by the median absolute residual, not below the noise."""
    if not len(residuals):
        return noise
    low, high = (len(residuals) - 1) // 2, len(residuals) // 2
    ordered = np.partition(np.abs(residuals), (low, high))
    return max(noise, 1.4826 * float(ordered[low] + ordered[high]) / 2)  # of a normal distribution


# ---- Samples that a fitted bounce adds and leaves out: the ball in the hand, and at impacts

# Impacts in a film's fit, and with a restitution of their own: later bounces are too low to tell.
MAX_IMPACTS = 6
MIN_SAMPLES = 12  # for eight unknowns, of which three have priors, and a noise


def with_pre_release_samples(whole: BounceSamples, fit: BounceFit, gain: float = 1e-6) -> BounceFit:
    """Refit with the samples just before the fall in which the ball is held where it is let go."""
    if whole.starts_in_flight:
        return fit
    first = int(np.searchsorted(whole.seconds, fit.samples.seconds[0]))
    fall_s = float(np.exp(fit.unknowns[FALL]))
    earliest_s = float(fit.unknowns[IMPACT]) - 3.0 * fall_s  # before that it was carried
    begin = int(np.searchsorted(whole.seconds, earliest_s))
    if first == begin:
        return fit
    off = np.abs(whole.part(begin, first).residuals(fit.unknowns))
    held, misses = first, 0
    while held > begin and misses < 3:  # three in a row that are elsewhere: it is not held yet
        held -= 1
        misses = misses + 1 if off[held - begin] > 4.0 * fit.scale else 0
    moved = misses >= 3
    held = min(held + misses, first)
    still_s = float(whole.seconds[first] - whole.seconds[held])
    # At the top of a flight a ball seems to be held for a third of a fall time, too.
    if first == held or (whole.in_metres and moved and still_s < 0.35 * fall_s):
        return fit
    last = int(np.searchsorted(whole.seconds, fit.samples.seconds[-1], side="right"))
    longer = fit_bounce(whole.part(held, last), fit.unknowns, fit.free, gain=gain)
    # A hand that moves after all stands out of the noise by half.
    return longer if longer.tail_sd < 1.5 * max(fit.tail_sd, whole.noise) else fit


def without_impact_samples(fit: BounceFit) -> BounceSamples:
    """Remove the samples that an impact may be in.

    An exposure shows both of its sides, a filter rounds it, and noise hides on which side a sample
    is: there the residual has a kink, at which a fit would rest and seem surer than it is.
    """
    samples, unknowns = fit.samples, fit.unknowns
    times = samples.times(unknowns)
    ball = samples.bounce(unknowns)
    starts, speeds = ball.flights(float(times[-1]))
    least = samples.exposure_s / 2 / float(np.exp(unknowns[FALL]))
    noise = fit.scale / float(unknowns[SPAN])
    reach = np.maximum(least, noise / np.maximum(ball.arrivals(speeds) + speeds, 1e-9))
    if correlation_time(fit.residuals, len(fit.free)) > 1:
        # A filter rounds the samples beside an impact.
        reach = np.maximum(reach, 1.5 * median_step(times))
    begins = starts - ball.contact
    longest = np.minimum(np.diff(begins, prepend=-1.0), np.diff(begins, append=np.inf))
    reach = np.maximum(np.minimum(reach, 0.15 * longest), least)  # most of a flight stays
    # Which times are farther from all impacts than each reaches, shape (T,).
    after = np.searchsorted(begins, times, side="right")
    before, later = np.maximum(after - 1, 0), np.minimum(after, len(starts) - 1)
    kept = (
        ((times < begins[before]) | (times - starts[before] > reach[before]))
        & ((times > begins[later]) | (begins[later] - times > reach[later]))
    ) | (times > starts[-1])
    few = np.count_nonzero(kept) < max(MIN_SAMPLES, 0.5 * len(times))
    return samples if few else samples.only(kept)


# ---- Fit to recorded heights: more and more flights, as long as one law explains them
# The first flight fixes the restitution to a few thousandths, which is near enough for the second,
# and so on: far ahead the cost has dozens of minima.


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
    """Return a height's standard deviation [m]: its noise, at least that of a noiseless engine."""
    return max(drop.noise_m, 1e-5 * drop.drop_height_m)


_FLIGHTS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 19, 22, 26, 30, 35, 40)  # in turn


def fit_positions(drop: Drop, drag_1_m: float | None = None) -> BounceFit | None:
    """Fit a bounce to a drop, flight by flight; None where too little is seen."""
    if not (drop.fall_time_s > 0 and drop.drop_height_m > 0):  # NaN is not
        return None
    whole = samples_of(drop, drag_1_m)
    # It starts by the parabolas of fall and flight; from several restitutions where they saw none.
    unknowns = np.zeros(len(LOW))
    restitution = np.nan_to_num(np.clip(drop.flight_restitution, 0.02, 0.99))
    unknowns[[RESTITUTION, IMPACT, FALL]] = restitution, drop.impact_s, np.log(drop.fall_time_s)
    unknowns[[CONTACT, SPAN]] = drop.contact_m, drop.drop_height_m
    unknowns[[SLOPE, DRAG]] = 0.05, 0.03  # what most balls have
    tried = (restitution,) if restitution else (0.1, 0.25, 0.4, 0.55, 0.7, 0.85)  # none was seen
    starts = list(np.tile(unknowns, (len(tried), 1)))
    for one, value in zip(starts, tried, strict=True):
        one[RESTITUTION] = value
    same_table = not abs(drop.rest_m - drop.contact_m) > drop.rest_tolerance_m
    # Fall times of a rest: more would only repeat the table's level.
    rest_seen = 4.0 if same_table else 0.0
    best: BounceFit | None = None
    parts = _parts(whole, unknowns, rest_seen)
    for stage in range(len(_FLIGHTS)):
        first, last = parts[stage]
        if last - first < MIN_SAMPLES or (best is not None and last - first == len(best.residuals)):
            continue
        samples = whole.part(first, last)
        # Roughly: it only leads to the next.
        fit = best_of([fit_bounce(samples, one, whole.unknowns, 12, 1e-4) for one in starts])
        if best is not None:
            # One more flight has to leave residuals that are noise, within 4 standard deviations of
            # a variance; no recording, and no model of a ball, is held to 1e-4 of the drop height.
            noise = max(drop.noise_m, _spread(best))
            freedom = max(len(fit.residuals) - len(fit.free), 1)
            allowed = noise**2 * (1 + 4.0 * np.sqrt(2 / freedom))
            if not _spread(fit) ** 2 < allowed + (1e-4 * fit.unknowns[SPAN]) ** 2:
                break
        best, starts = fit, [fit.unknowns]
        parts = _parts(whole, fit.unknowns, rest_seen)
    if best is None:
        return None
    best = with_pre_release_samples(whole, best, 1e-4)
    samples = without_impact_samples(best)
    return fit_bounce(samples, best.unknowns, best.free, most=60, gain=1e-7)


def fitted_drop(drop: Drop, fit: BounceFit) -> Drop:
    """Replace impact, contact and fall of a drop by a fit's: from rest, and through the air.

    The last, low bounces look like a rest: as high as they are by the fit, it is none too high.
    """
    view = fit.projection()
    resting = drop.seconds >= drop.rest_s
    rest_m = drop.rest_m
    if resting.any():
        ball_m = view.ball(drop.seconds[resting])
        rest_m = view.contact + float(np.median(drop.heights_m[resting] - ball_m))
    release_s = view.impact_s - view.fall_time_s * view.bounce.fall_time
    release_m = view.contact + view.span
    if drop.launched:
        release_s, release_m = float(drop.seconds[0]), float(view.ball(drop.seconds[:1])[0])
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


def _parts(whole: BounceSamples, unknowns: Array, rest_seen: float) -> list[tuple[int, int]]:
    """Bound the samples from most of the fall to the end of each number of flights, and of a rest.

    Returns the first index, and the one after the last.
    """
    times = whole.times(unknowns)
    ball = whole.bounce(unknowns)
    starts, speeds = ball.flights(float(times[-1]))
    hops = float(unknowns[SPAN]) * speeds**2 / 4
    low = np.flatnonzero(hops < 2.0 * whole.noise)  # the ball seems to lie still
    rest = int(low[0]) if len(low) else len(starts) - 1
    end = starts[rest] + rest_seen if len(low) else np.inf
    ends = [starts[flights] if flights < rest else end for flights in _FLIGHTS]
    # Earlier in the fall a hand may still touch the ball.
    is_fall = whole.starts_in_flight | (times > -0.95 * ball.fall_time)
    first = int(np.argmax(is_fall)) if is_fall.any() else len(times)
    return [(first, int(last)) for last in np.maximum(np.searchsorted(times, ends), first)]


def _spread(fit: BounceFit) -> float:
    """Return the standard deviation of the residuals."""
    freedom = max(len(fit.residuals) - len(fit.free), 1)
    return float(np.sqrt(np.sum(fit.residuals**2) / freedom))
