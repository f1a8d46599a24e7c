"""Find a drop in the track of a filmed ball, and fit ball and camera to it.

From each impact that may be the first, fits of a bounce start from the best points of a grid. Late
faults of clock or flights are cut off. A track without a drop says why. What was found is fitted
once more with the lens's distortion, to the track's own noise. Finally, pictures whose stamps are
in doubt are placed by the ball's flight.

The scale is time: a fall that lasts T0 is g T0^2 / 2 high. So a film's frame rate must be its true
one for the heights to be true; the restitution does not depend on it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.drop import FILM_MORE
from tunenet_logs.analysis.drop.bounce_fit import (
    MAX_IMPACTS,
    MIN_SAMPLES,
    BounceFit,
    best_of,
    fit_bounce,
    scale_of,
    with_pre_release_samples,
    without_impact_samples,
)
from tunenet_logs.analysis.drop.bounce_model import (
    CONTACT,
    DRAG,
    FALL,
    FREEDOM,
    IDEAL,
    IMPACT,
    LOW,
    MAX_MOVES,
    MOVE_SD,
    PERSPECTIVE,
    RESTITUTION,
    ROLL,
    SLOPE,
    SPAN,
    TOUCH,
    TOUCH_S,
    USUAL_FOCAL,
    BounceSamples,
    Projection,
    ideal_heights,
    projected,
    since_moves,
)
from tunenet_logs.analysis.drop.bounce_posterior import BallPosterior, ball_posterior
from tunenet_logs.analysis.drop.free_flight import Drop, run_slopes, slope_corners
from tunenet_logs.analysis.drop.presets import canonical_axis, canonical_observation, paper_axis
from tunenet_logs.analysis.estimators.base import Observation, resample
from tunenet_logs.analysis.statistics import correlation_time, noise_of, robust_regression
from tunenet_logs.analysis.tracking.track import Track
from tunenet_logs.episode import Array, median_step
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.base import CALIBRATED
from tunenet_logs.recorders.simulators.known import Ball
from tunenet_logs.timing.arrivals import Conversion, CorrectedStamps, conversions

# ---- Starting points: a grid over ball, fall time and camera, as the cost has dozens of minima


def grid_starts(seconds: Array, along: Array, impact_s: float, count: int) -> list[Array]:
    """Find the best points of a grid over ideal ball, fall time and perspective, best first.

    `seconds` and `along` (up positive), (T,), hold the fall and the bounces; each start has shape
    (20,), contact and span in closed form, and no two are neighbours on the grid.
    """
    seen_s = impact_s - float(seconds[0])
    near = seconds < impact_s + 5.0 * seen_s
    every = max(1, -(-int(near.sum()) // 96))  # more samples cost more than they gain
    clock, positions = seconds[near][::every] - impact_s, along[near][::every]
    # Fall times in durations of the part of the fall that is seen; perspectives within about one
    # standard deviation of their prior.
    restitutions = np.linspace(0.02, 0.995, 40)
    falls = seen_s * np.exp(np.linspace(np.log(0.92), np.log(3.2), 22))
    perspectives = np.array([-0.8, -0.25, 0.3, 0.9])
    heights = ideal_heights(restitutions[:, None, None], clock / falls[:, None])
    shapes = projected(heights, perspectives[:, None, None, None])
    middle = shapes.mean(axis=-1, keepdims=True)
    off, about = shapes - middle, positions - positions.mean()
    spread = (off**2).sum(axis=-1)
    spans = (off @ about) / np.maximum(spread, 1e-12)
    squares = float(about @ about) - spans**2 * spread
    squares = np.where(spans > 0, squares, np.inf) + 1e-9
    starts: list[Array] = []
    taken = np.zeros(squares.shape, dtype=bool)
    while len(starts) < count and not taken.all():
        at = np.unravel_index(np.where(taken, np.inf, squares).argmin(), squares.shape)
        if not np.isfinite(squares[at]):
            break
        view, ball, fall = (int(index) for index in at)
        span = float(spans[at])
        contact = float(positions.mean() - span * middle[view, ball, fall, 0])
        start = np.zeros(len(LOW))
        start[[RESTITUTION, IMPACT, FALL]] = restitutions[ball], impact_s, np.log(falls[fall])
        start[[CONTACT, SPAN, PERSPECTIVE]] = contact, span, perspectives[view]
        starts.append(start)
        taken[:, max(0, ball - 1) : ball + 2, max(0, fall - 2) : fall + 3] = True
    return starts


# ---- Late faults in the clock (Rao's score test) or in a flight: what comes later is left out
# A picture that was lost, or a flight that hits an edge, touches what comes after it. As long as
# the first flight is whole, so is its result.

MAX_CLOCK_GAIN = 12.0  # log likelihood ratio: of 120 tries chance alone reaches about 5
_MIN_COUNT = 12  # samples for a test of the clock


def clock_test(fit: BounceFit) -> tuple[Array, Array]:
    """Test for a jump of the clock, and for another rate, by Rao's score.

    Returns the log likelihood gained by each from each moment on, and the moments [s], shape (M,).
    It is one more unknown, linear about the fit. Samples count as little as in the fit where they
    are far off: a picture of an impact is no jump.
    """
    samples = fit.samples
    seconds = samples.seconds
    if len(seconds) < _MIN_COUNT:
        return np.zeros(1), seconds[:1]
    weights = np.sqrt((FREEDOM + 1) / (FREEDOM + (fit.residuals / fit.scale) ** 2))
    known, _ = np.linalg.qr(weights[:, None] * samples.jacobian(fit.unknowns, fit.free))
    speed = -samples.jacobian(fit.unknowns, (IMPACT,))[:, 0]
    # About 60 moments, but for three samples at either end, where no jump can be told.
    moments = seconds[3 : -3 : max(1, len(seconds) // 60)]
    since = seconds[:, None] - moments
    shifts = np.hstack([since > 0, np.maximum(since, 0.0)]) * (weights * speed)[:, None]
    new = shifts - known @ (known.T @ shifts)
    power = np.maximum((new**2).sum(axis=0), 1e-9 * (shifts**2).sum(axis=0) + 1e-12)
    gains = (new.T @ (weights * fit.residuals)) ** 2 / power / fit.scale**2
    return gains / fit.effective_sample_factor / 2, np.tile(moments, 2)


def late_fault(fit: BounceFit) -> tuple[float, int | None] | None:
    """Find when a fitted track cannot be trusted any more, after its second impact at the earliest.

    Returns the time [s], and how many flights are whole before one that is not the ball's, None
    where the clock is at fault; None without a fault.
    """
    # All impacts, as far as samples go [s].
    samples, fall_s = fit.samples, float(np.exp(fit.unknowns[FALL]))
    starts, _ = samples.bounce(fit.unknowns).flights(float(samples.times(fit.unknowns)[-1]))
    seconds = float(fit.unknowns[IMPACT]) + fall_s * starts
    impacts_s = seconds[seconds < samples.seconds[-1]]
    if len(impacts_s) < 2:
        return None
    gains, moments = clock_test(fit)
    if gains.max() > MAX_CLOCK_GAIN:
        # Down to 4 below the largest gain an earlier moment may be as likely.
        first_s = float(moments[gains > gains.max() - 4.0].min())
        if first_s >= impacts_s[1]:  # what it sets astray is no other bounce
            return first_s, None
    # Else the first flight most of whose samples, four or more, are 5 standard deviations off.
    seconds, off = samples.seconds, np.abs(fit.residuals) / fit.scale
    for flights, begin in enumerate(impacts_s[1:], start=1):
        end = impacts_s[flights + 1] if flights + 1 < len(impacts_s) else np.inf
        flight = off[(seconds > begin) & (seconds < end)]
        if len(flight) >= 4 and np.median(flight) > 5.0:
            return float(begin), flights
    return None


def long_steps(fit: BounceFit, noise_px: float) -> int:
    """Count steps of the ball between pictures that are far longer than the others.

    There pictures are missing of which no stamp tells. Steps over an impact, of slow parts, and
    over stamped gaps are not counted. `noise_px` is the standard deviation of a position.
    """
    samples = fit.samples
    times, period_s = samples.times(fit.unknowns), np.diff(samples.seconds)
    usual_s = float(np.median(period_s))
    starts, _ = samples.bounce(fit.unknowns).flights(float(times[-1]))
    apart = np.abs(times[:, None] - starts).min(axis=1) * float(np.exp(fit.unknowns[FALL]))
    flight = np.searchsorted(starts, times)
    expected = np.diff(samples.positions + fit.residuals)
    chosen = (flight[1:] == flight[:-1]) & (times[:-1] > -1) & (period_s < 1.5 * usual_s)
    chosen &= np.minimum(apart[1:], apart[:-1]) > usual_s / 2
    # Steps of 6 px and 3 % of the fall tell; one that is 30 % and 5 sds longer is too long. Missing
    # pictures scatter the steps themselves, so the sds are of the noise.
    chosen &= np.abs(expected) > max(6.0, 0.03 * float(fit.unknowns[SPAN]))
    if np.count_nonzero(chosen) < _MIN_COUNT:
        return 0
    ratios = np.diff(samples.positions)[chosen] / expected[chosen]
    off = ratios - np.median(ratios)
    sds = np.sqrt(2) * noise_px / np.abs(expected[chosen])
    return int(np.count_nonzero(off > np.maximum(0.3, 5.0 * sds)))


# ---- Pictures that a converter left out or doubled, placed by their pattern and the ball's flight

_SURE_GAIN = 10.0  # log likelihood by which a conversion must explain a track better than none
_SURE_MARGIN = 6.0  # and better than one that places other pictures
_ANY_GAIN = 3.0  # from which on it is looked at closely
_UNEXPLAINED = 4.0  # log likelihood that a doubled picture costs that a conversion does not double
_COMPARED = 6  # conversions that are fitted, the likeliest by the linearised equations
_PLACED_APART = 0.25  # pictures of the source: by so much a picture is placed elsewhere
_FEW_APART = 0.1  # fraction of the pictures: two conversions that place fewer apart are as one


@dataclass(frozen=True)
class ConvertedFilm:
    """Conversion that a film went through, by the ball's flight."""

    how: Conversion  # the likeliest
    gain: float  # log likelihood by which it explains the track better than even stamps do
    is_sure: bool  # whether the pictures are placed by it

    def placed(self, track: Track) -> Track:
        """Stamp the pictures of a track by the source's clock, each of the source once."""
        stamps_ns, rows = np.unique(self.how.placed_ns(track.stamps_ns), return_index=True)
        return replace(track.some(rows), stamps_ns=stamps_ns)


def with_noise(samples: BounceSamples, span: float, least_px: float) -> BounceSamples:
    """Estimate the noise of a film's positions [px], of which the track spans so much."""
    # Of a picture that is shown twice, one.
    seconds, first = np.unique(samples.seconds, return_index=True)
    noise_px = max(noise_of(samples.positions[first], seconds), least_px)
    distortion_px = 0.0015 * span  # by which a good lens may distort the vertical
    return replace(
        samples,
        noise=max(noise_px, distortion_px),
        distortion_variance_fraction=max(0.0, 1 - (noise_px / distortion_px) ** 2),
    )


def converted_film(
    whole: BounceSamples,
    fit: BounceFit,
    stamps_ns: NDArray[np.int64],
    start_ns: int,
    noisy: Callable[[BounceSamples], BounceSamples],
) -> ConvertedFilm | None:
    """Compare all conversions that may have made a film's stamps by their likelihood ratio.

    None where none of them explains the track clearly better than its even stamps do.
    """
    samples = fit.samples
    own_ns = start_ns + np.round(1e9 * samples.seconds).astype(np.int64)

    def moved(how: Conversion) -> BounceFit:
        """Return the fit on a source's clock, by one step of the linearised equations."""
        seconds = (how.placed_ns(own_ns) - start_ns) * 1e-9
        there = noisy(replace(samples, seconds=seconds))
        off = there.residuals(fit.unknowns)
        slopes = there.jacobian(fit.unknowns, fit.free)
        for _ in range(3):  # reweighted: at an impact few samples are far off
            scale = scale_of(off, there.noise)
            weights = np.sqrt((FREEDOM + 1) / (FREEDOM + (off / scale) ** 2))
            known, _ = np.linalg.qr(weights[:, None] * slopes)
            off = off - (known @ (known.T @ (weights * off))) / weights
        return replace(fit, samples=there, residuals=off, scale=scale_of(off, there.noise))

    def from_scratch(how: Conversion, there: BounceFit) -> BounceFit:
        """Return the fit from where one to the whole track on a source's clock begins."""
        placed_ns = how.placed_ns(start_ns + np.round(1e9 * whole.seconds).astype(np.int64))
        placed_ns, rows = np.unique(placed_ns, return_index=True)
        placed = replace(whole.only(rows), seconds=(placed_ns - start_ns) * 1e-9)
        try:
            found, _ = _find_fit(noisy(placed))
        except _NoDropError:
            return there
        start = np.append(found.fit.unknowns[: DRAG + 1], fit.unknowns[DRAG + 1 :])
        again = fit_bounce(there.samples, start, fit.free)
        return min(there, again, key=lambda one: one.cost(one.scale))

    within_ns = stamps_ns[(stamps_ns >= own_ns[0]) & (stamps_ns <= own_ns[-1])]
    every = {how: _UNEXPLAINED * how.unexplained(within_ns) for how in conversions(stamps_ns)}
    rough = {how: moved(how) for how in every}
    hows = sorted(every, key=lambda how: every[how] + rough[how].misfit_cost(rough[how].scale))
    hows = hows[:_COMPARED]
    surprise = np.array([every[how] for how in hows])
    fits = [fit_bounce(rough[how].samples, fit.unknowns, fit.free) for how in hows]
    likely = _likeliest(fit, hows, fits, surprise)
    if likely is None or likely.gain < _ANY_GAIN:
        return None
    if not likely.is_sure:
        # By even stamps a fit may end in a wrong minimum, from which no conversion finds back.
        fits = [from_scratch(how, one) for how, one in zip(hows, fits, strict=True)]
        likely = _likeliest(fit, hows, fits, surprise)
    return likely if likely is not None and likely.gain > _SURE_GAIN else None


def _likeliest(
    even: BounceFit, hows: Sequence[Conversion], fits: Sequence[BounceFit], surprise: Array
) -> ConvertedFilm | None:
    """Return the likeliest conversion by fits to the same pictures, and what is not explained."""
    if not fits:
        return None
    costs = np.array([one.cost(one.scale) for one in fits]) + surprise
    best = int(costs.argmin())
    how, fit = hows[best], fits[best]
    gains = (costs - costs[best]) / fit.samples_as_one
    gain = float((even.cost(even.scale) - costs[best]) / fit.samples_as_one)
    apart = [one.samples.seconds - fit.samples.seconds for one in fits]
    far = [np.abs(one - np.median(one)) * how.source_hz > _PLACED_APART for one in apart]
    others = [other for other, one in zip(gains, far, strict=True) if one.mean() > _FEW_APART]
    if not is_good(fit):  # what is left is no noise: it may be something else
        return ConvertedFilm(how, min(gain, _ANY_GAIN), is_sure=False)
    return ConvertedFilm(
        how, gain, gain > _SURE_GAIN and min(others, default=np.inf) > _SURE_MARGIN
    )


# ---- Bounce fitted from an impact on: the samples and flights that one law explains

_ROUGHLY = (10, 1e-4)  # iterations and gain in cost that end fits which are only compared
_MIN_FALL_SAMPLES = 4  # samples of a fall, and of what follows it
_TYPICAL = {SLOPE: 0.08, DRAG: 0.05}  # what most balls have: where the fit of a law begins
_HOPELESS = 0.12  # fraction of the fall, rms: a rough fit with more becomes no drop's
_LIFTED = 1.15  # fraction of the fall: higher up the ball is lifted


class FilmFit(NamedTuple):
    """Bounce fitted to a film."""

    fit: BounceFit  # of all unknowns
    # How many are explained of a ball that then bounces otherwise; None where all are.
    flights: int | None = None


def fit_from(whole: BounceSamples, impacts: Sequence[int]) -> BounceFit | None:
    """Fit a bounce whose first impact is the first of these; None where no fall is seen before."""
    index, last = impacts[0], bounces_end(whole.seconds, whole.positions, impacts)
    best: BounceFit | None = None
    for fraction in (0.96, 0.8, 0.6):  # lower parts of a descent that are tried as its free fall
        first = fall_start(whole.positions, index, fraction, whole.noise)
        if index - first < _MIN_FALL_SAMPLES or last - index < _MIN_FALL_SAMPLES:
            continue
        rough = _rough_fits(whole.part(first, last), float(whole.seconds[index]))
        if not rough:
            continue
        view = rough[0].projection()
        hopeful = view.residual_rms / view.span < _HOPELESS
        fit = _finished(whole, rough) if hopeful else rough[0]
        if best is None or misfit(fit) < 0.7 * misfit(best):
            best = fit
        if is_good(fit):
            fit = with_contact(whole, without_hand(whole, fit))
            return with_contact(whole, likelier(fit, with_moves(fit)))
    return best


def _fit_sideways(
    whole: BounceSamples, impacts: Sequence[int], start: BounceFit | None
) -> BounceFit | None:
    """Fit a ball that goes sideways, as far as its size confirms that; None where none fits.

    It starts at a fit of a straight way, or, where that is better, at one to positions that the
    ball's size makes straight.
    """
    if start is not None and misfit(start) >= _HOPELESS:
        start = None
    straight, index = straightened(whole, impacts), impacts[0]
    if straight is not None:
        first = fall_start(straight.positions, index, 0.8, whole.noise)
        last = bounces_end(whole.seconds, straight.positions, impacts)
        enough = min(index - first, last - index) >= _MIN_FALL_SAMPLES
        part, at_s = straight.part(first, last), float(whole.seconds[index])
        rough = _rough_fits(part, at_s) if enough else []
        fit = _finished(straight, rough) if rough else None
        if fit is not None and (start is None or misfit(fit) < misfit(start)):
            at = np.searchsorted(whole.seconds, fit.samples.seconds)
            start = replace(fit, samples=whole.only(at))
    if start is None:
        return None
    moved = with_contact(whole, without_hand(whole, with_moves(start)))
    # Else a ball that bounces otherwise at each impact would be one that goes sideways.
    is_confirmed = np.abs(moved.samples.off_by_size(moved.unknowns)).max() < 4.0
    return moved if is_good(moved) and is_confirmed else None


def _of_first_flights(whole: BounceSamples, impacts: Sequence[int], fit: BounceFit) -> FilmFit:
    """Fit as many flights as one law explains, or keep the fit to all if it explains none.

    A ball that is out of round, or later hits an edge, is a ball up to there.
    """
    start_s, end_s = fit.samples.seconds[[0, -1]]
    first = int(np.searchsorted(whole.seconds, start_s))
    for flights in range(min(len(impacts), MAX_IMPACTS) - 1, 0, -1):
        end = impacts[flights]
        if whole.seconds[end] >= end_s or end - impacts[0] < _MIN_FALL_SAMPLES:
            continue
        begun = whole.part(0, end)
        rough = _rough_fits(begun.part(first, end), float(whole.seconds[impacts[0]]))
        shorter = _finished(begun, rough) if rough else None
        if shorter is None or not is_good(shorter, 0.001):
            continue
        # Few flights are explained by many laws: this one must be usual for balls, and release the
        # ball where it is seen held.
        times = whole.times(shorter.unknowns)
        held = (times > -1.5) & (times < -1.0)
        off = np.median(whole.residuals(shorter.unknowns)[held]) if np.any(held) else 0.0
        if abs(shorter.unknowns[SLOPE]) < 0.25 and abs(off) < 0.05 * shorter.unknowns[SPAN]:
            return FilmFit(shorter, flights)
    return FilmFit(fit)


_CLEARLY = 5.0  # log likelihood gained by unknowns that are there: any noise bends a way a little


def with_moves(fit: BounceFit) -> BounceFit:
    """Refit a ball that may also go sideways, otherwise from its release and each impact on."""
    samples = replace(fit.samples, moves_s=_move_times_s(fit))
    by_size = _moves_by_size(samples, fit)
    starts = [fit.unknowns.copy()]
    if by_size is not None:
        rates, covariance, perspective = by_size
        samples = replace(samples, sized=(rates, covariance))
        # Where the ball is seen from is hard to find beside its way: from several views.
        for tried in (perspective, *_VIEWS):
            start = fit.unknowns.copy()
            start[list(samples.moving)], start[PERSPECTIVE] = rates, tried
            start[list(_TYPICAL)] = list(_TYPICAL.values())
            held = (RESTITUTION, IMPACT, FALL, CONTACT, SPAN, ROLL)
            starts.append(fit_bounce(samples, start, held, *_ROUGHLY).unknowns)
    moved = best_of([fit_bounce(samples, one, samples.unknowns, 40, 1e-5) for one in starts])
    for _ in range(3):  # it says better than a straight way when the ball was let go
        known_s = samples.moves_s
        samples = replace(samples, moves_s=_move_times_s(moved)[: len(known_s)])
        if len(samples.moves_s) < len(known_s):
            samples = samples.moving_until(len(samples.moves_s))
        moved = fit_bounce(samples, moved.unknowns, samples.unknowns, most=60)
        if abs(samples.moves_s[0] - known_s[0]) < 0.02 * float(np.exp(moved.unknowns[FALL])):
            break
    return moved


def _move_times_s(fit: BounceFit) -> tuple[float, ...]:
    """Return when a ball may begin to go otherwise sideways: its release, and impacts [s]."""
    view = fit.projection()
    impacts_s = view.impact_s + view.fall_time_s * view.impacts(float(fit.samples.seconds[-1]))
    release_s = view.impact_s - view.fall_time_s * view.bounce.fall_time
    release_s = max(release_s, float(fit.samples.seconds[0]))
    return (release_s, *impacts_s.tolist())[:MAX_MOVES]


_VIEWS = (-0.4, -0.1)  # perspectives: a camera a little higher than the ball
_LEAST_SIZES = 3 * MIN_SAMPLES  # of a ball, for its distance by them


def straightened(whole: BounceSamples, impacts: Sequence[int]) -> BounceSamples | None:
    """Estimate where a ball would be seen if it kept its distance; None where sizes tell nothing.

    It is as far as its size says, with a rate of its own from each impact on; and all impacts are
    on one table, however the camera looks at it.
    """
    known, seconds, along = whole.sized_samples, whole.seconds, whole.positions
    if np.count_nonzero(known) < _LEAST_SIZES or len(impacts) < 2:
        return None
    speed, low = np.abs(np.gradient(along, seconds)), along.min()
    moves_s = seconds[[fall_start(along, impacts[0], 0.96, whole.noise), *impacts[:MAX_IMPACTS]]]
    since = since_moves(seconds, moves_s.tolist())
    columns = [np.ones(len(along)), speed / speed.max(), (along - low) / np.ptp(along), *since.T]
    found = robust_regression(np.column_stack(columns)[known], whole.log_radii[known])[0]
    depth = np.exp(np.clip(-(since @ found[3:]), -1.0, 1.0))
    straight = whole.center + (along - whole.center) * depth
    table = np.column_stack([np.ones(len(impacts)), depth[impacts] - 1])
    slope = np.linalg.lstsq(table, straight[impacts], rcond=None)[0][1]
    return replace(whole, positions=straight - slope * (depth - 1))


def _moves_by_size(samples: BounceSamples, fit: BounceFit) -> tuple[Array, Array, float] | None:
    """Regress the ball's size on its moves: their rates, with covariance, and k.

    None where too few sizes are known. Light and blur change an outline, too, so that no rate is
    surer than `_SIZE_SD`.
    """
    seconds, known = samples.seconds, samples.sized_samples
    if np.count_nonzero(known) < _LEAST_SIZES:
        return None
    view, fall_s = fit.projection(), float(np.exp(fit.unknowns[FALL]))
    sizes, speed = samples.log_radii[known], np.abs(np.gradient(samples.positions, seconds))[known]
    heights = np.clip(view.heights(samples.positions, seconds), 0.0, 1.2)[known]
    since = since_moves(seconds, samples.moves_s)[known] / fall_s
    rates, grow, unit = np.zeros(since.shape[1]), 0.0, MOVE_SD
    covariance = np.eye(len(rates))
    for _ in range(4):
        # Linear in depth about the last; a mean of the two heights' logarithms would not be.
        depth = np.maximum(1 + grow * heights + since @ rates, 0.2)
        columns = np.column_stack([np.ones(len(sizes)), speed / speed.max(), -heights / depth])
        columns = np.hstack([columns, -since / depth[:, None]])
        off = sizes + np.log(depth)
        off += columns[:, 2] * grow + columns[:, 3:] @ rates
        _, residuals, spread, weights = robust_regression(columns, off)
        together = spread**2 * correlation_time(residuals, columns.shape[1])
        normal = (columns * weights[:, None]).T @ (columns * weights[:, None]) / together
        # Of a flight with few sizes the rate is what few balls exceed.
        known_of = [0.0, 0.0, 1.0, *[_FEW_EXCEED**-2] * len(rates)]
        inverse = np.linalg.inv(normal + np.diag(known_of))
        found = inverse @ ((columns * weights[:, None]).T @ (off * weights)) / together
        grow, rates = float(np.clip(found[2], -0.8, 3.0)), np.clip(found[3:], -1.0, 1.0)
        covariance = inverse[3:, 3:]
    # Blur and light change an outline, too.
    covariance = 4.0 * covariance + _SIZE_SD**2 * np.eye(len(rates))
    return rates / unit, covariance / unit**2, float(np.log1p(grow))


# Of a rate by the ball's size [a fall time]: the least standard deviation, and that of all balls.
_SIZE_SD, _FEW_EXCEED = 0.04, 0.15


def with_contact(whole: BounceSamples, fit: BounceFit) -> BounceFit:
    """Refit with contacts that last, and without the samples in them, if pictures show that."""
    if fit.samples.is_soft:
        return fit
    samples = replace(fit.samples, is_soft=True)
    # Rao's score: what a fit would gain.
    known, _ = np.linalg.qr(fit.samples.jacobian(fit.unknowns, fit.free))
    column = samples.jacobian(fit.unknowns, (TOUCH,))[:, 0]
    new = column - known @ (known.T @ column)
    slope = float(new @ fit.residuals)
    gain = slope**2 / max(float(new @ new), 1e-9) / fit.scale**2 / fit.samples_as_one / 2
    if slope > 0 or gain < _CLEARLY / 2:
        return fit
    seconds = whole.seconds
    inside = (seconds >= samples.seconds[0]) & (seconds <= samples.seconds[-1])
    every = whole.only(inside)
    every = replace(every, is_soft=True, moves_s=samples.moves_s, sized=samples.sized)
    start = fit.unknowns.copy()
    start[TOUCH] = TOUCH_S
    soft, outside = fit_bounce(samples, start, samples.unknowns), samples
    for _ in range(2):
        outside = without_impact_samples(
            replace(soft, samples=every, residuals=every.residuals(soft.unknowns))
        )
        soft = fit_bounce(outside, soft.unknowns, outside.unknowns, most=60)
    hard = fit_bounce(replace(outside, is_soft=False), fit.unknowns, fit.free, most=60)
    return likelier(hard, soft) if is_good(soft) else fit


# ---- Hand that still moves the ball when it falls

_LEAST_FREE = 0.55  # fall times before the impact in which a ball must be free


def flies_from_s(whole: BounceSamples, fit: BounceFit) -> float | None:
    """Return when a ball begins to fly freely that is not let go at rest; None where it is.

    Between a fall from rest, for what it becomes, and that moment a hand still moves it: two
    samples in a row are 4 standard deviations above the flight, or four are 2.5 in the mean. A hand
    that gives way gains less speed than a fall, so that at its end it is above.
    """
    times = whole.times(fit.unknowns)
    falls = np.flatnonzero((times > -fit.projection().bounce.fall_time) & (times < 0))
    if len(falls) < 2:
        return None
    own = fit.samples
    moved = replace(whole.only(falls), moves_s=own.moves_s, sized=own.sized, is_soft=own.is_soft)
    # With what the fit leaves open of samples that it did not see.
    slopes = moved.jacobian(fit.unknowns, fit.free)
    inverse = np.linalg.pinv(fit.normal_equations()[0])
    unsure = np.einsum("ti,ij,tj->t", slopes, inverse, slopes)
    above = -moved.residuals(fit.unknowns) / np.sqrt(fit.scale**2 + unsure)
    held = above > 4.0
    held[1:] &= held[:-1]  # one alone is a wrong position
    if len(above) >= 4:
        held[:-3] |= np.convolve(above, np.full(4, 0.25), mode="valid") > 2.5
    last = np.flatnonzero(held & (times[falls] < -_LEAST_FREE))
    if not len(last) or last[-1] + 1 >= len(falls):
        return None
    return float(whole.seconds[falls[last[-1] + 1]])


def without_hand(whole: BounceSamples, fit: BounceFit) -> BounceFit:
    """Refit without the samples in which a hand still moves the ball.

    Few pictures of a hand bend a fit so that it follows them; one to the lower part of the fall,
    and to the bounces, foretells where a free ball would have been.
    """
    times = fit.samples.times(fit.unknowns)
    lower = fit.samples.only(times > -_LEAST_FREE)
    if len(lower.seconds) >= MIN_SAMPLES and np.count_nonzero(np.abs(times) < _LEAST_FREE) >= 6:
        low = fit_bounce(lower, fit.unknowns, fit.free, most=40)
        free_s = flies_from_s(whole, low)
        if free_s is not None:
            samples = fit.samples.only(fit.samples.seconds >= free_s)
            fit = fit_bounce(samples, low.unknowns, fit.free, most=60)
    for _ in range(4):
        free_s = flies_from_s(whole, fit)
        if free_s is None or free_s <= fit.samples.seconds[0]:
            break
        samples = fit.samples.only(fit.samples.seconds >= free_s)
        if len(samples.seconds) < MIN_SAMPLES:
            break
        fit = fit_bounce(samples, fit.unknowns, fit.free, most=60)
    return fit


_BESIDE = (-0.03, -0.012, 0.012, 0.03)  # of restitution: as far as minima are that look alike


def _likeliest_beside(fit: BounceFit) -> BounceFit:
    """Return the likeliest of minima beside each other: late bounces fit in several ways."""
    others = tuple(index for index in fit.free if index != RESTITUTION)
    fits = [fit]
    for by in _BESIDE:
        start = fit.unknowns.copy()
        start[RESTITUTION] += by
        start = fit_bounce(fit.samples, start, others, *_ROUGHLY).unknowns
        fits.append(fit_bounce(fit.samples, start, fit.free, most=60))
    return best_of(fits)


def likelier(fit: BounceFit, other: BounceFit, by: float = _CLEARLY) -> BounceFit:
    """Return the other fit to the same samples if it explains clearly more."""
    scale = min(fit.scale, other.scale)
    gained = (fit.misfit_cost(scale) - other.misfit_cost(scale)) / other.samples_as_one
    return other if gained - other.prior_cost() + fit.prior_cost() > by else fit


def _rough_fits(samples: BounceSamples, impact_s: float) -> list[BounceFit]:
    """Fit the ideal ball from the best points of the grid, best first."""
    # From six points: the best alone ends in the wrong minimum at times.
    starts = grid_starts(samples.seconds, samples.positions, impact_s, 6)
    fits = [fit_bounce(samples, start, IDEAL, *_ROUGHLY) for start in starts]
    scale = min((fit.scale for fit in fits), default=1.0)
    return sorted(fits, key=lambda fit: fit.cost(scale))


def _finished(whole: BounceSamples, rough: list[BounceFit]) -> BounceFit:
    """Fit the bounces that count and the ball before it was let go."""
    same = np.array([0.01, 0.02, 0.05])  # starts that differ by less lead to the same end
    starts: list[Array] = []
    for start in (fit.unknowns for fit in rough[:3]):
        apart = [np.abs(start - kept)[[RESTITUTION, FALL, PERSPECTIVE]] for kept in starts]
        if not any(np.all(one < same) for one in apart):
            starts.append(start)
    fit = _from_any(rough[0].samples, starts, *_ROUGHLY)
    # Remove the bounces after the sixth, and most of a rest.
    impact_s, fall_s = float(fit.unknowns[IMPACT]), float(np.exp(fit.unknowns[FALL]))
    seconds = fit.samples.seconds
    last = float((seconds[-1] - impact_s) / fall_s)
    hits, speeds = whole.bounce(fit.unknowns).flights(last)
    if len(hits) > MAX_IMPACTS:
        end = float(hits[MAX_IMPACTS])
    else:
        end = float(hits[-1]) if speeds[-1] == 0 else np.inf
    first = int(np.searchsorted(whole.seconds, seconds[0]))
    end_s = min(impact_s + fall_s * (end + 2.0), float(seconds[-1]))  # of a rest
    last_at = int(np.searchsorted(whole.seconds, end_s, side="right"))
    samples = whole.part(first, last_at) if last_at - first > MIN_SAMPLES else fit.samples
    fit = _from_any(samples, [fit.unknowns])
    fit = with_pre_release_samples(whole, fit)
    return _from_any(without_impact_samples(fit), [fit.unknowns, rough[0].unknowns])


def _from_any(
    samples: BounceSamples, starts: Sequence[Array], most: int = 30, gain: float = 1e-6
) -> BounceFit:
    """Fit from all starts and keep the best, with a usual slope and drag where they have none.

    From too steep a law a fit may not find back to a slight one, so a slight one is tried too.
    """
    fits: list[BounceFit] = []
    for start in starts:
        unset = not any(start[law] for law in _TYPICAL)
        for fraction in (1.0, 0.2) if unset else (1.0,):
            begin = start.copy()
            for law, usual in _TYPICAL.items():
                begin[law] = begin[law] or fraction * usual
            fits.append(fit_bounce(samples, begin, samples.unknowns, most, gain))
    return best_of(fits)


def misfit(fit: BounceFit) -> float:
    """Return the tail of the residuals, as a fraction of the fall."""
    return fit.tail_sd / float(fit.unknowns[SPAN])


def is_good(fit: BounceFit, little: float = 0.004) -> bool:
    """Return whether the residuals are noise, or this little of the fall beyond it."""
    return misfit(fit) < 1.5 * fit.samples.noise / float(fit.unknowns[SPAN]) + little


def film_impacts(seconds: Array, along_px: Array, noise_px: float) -> list[int]:
    """Locate the samples at which a fast fall ends, in order; positions (T,) are up positive.

    The slopes are taken over as many samples as the noise (the sd of a position) requires.
    """
    period_s = median_step(seconds)
    width = 2
    while True:
        if len(along_px) <= 2 * width + 1:
            return []
        slopes = run_slopes(seconds, along_px, width)
        half = (width + 1) // 2
        noise = noise_px * np.sqrt(2 / half) / ((width + 1 - half) * period_s)
        if noise < -0.06 * slopes.min() or 8 * width > len(along_px):
            break
        width += max(1, width // 3)
    # Higher than for recorded positions: a picture has perspective, and other things that move.
    return slope_corners(slopes, width, 0.25 * min(slopes.min(), 0.0), 0.25)


def fall_start(along_px: Array, index: int, fraction: float, noise_px: float) -> int:
    """Locate the first sample of the fall to an impact at `index`: only a lower fraction is kept.

    Higher up, where it is slow, a hand may still be. Positions are up positive, shape (T,).
    """
    low = float(along_px[max(index - 1, 0) : index + 2].min())
    top, first = low, index
    while first > 0 and along_px[first - 1] > top - 4 * noise_px - 0.03 * (top - low):
        first -= 1
        top = max(top, float(along_px[first]))
    high = np.flatnonzero(along_px[first:index] > low + fraction * (top - low))
    return first + (int(high[-1]) + 1 if len(high) else 0)


def bounces_end(seconds: Array, along_px: Array, impacts: Sequence[int]) -> int:
    """Locate where the bounces from `impacts[0]` on end: lifted, or long not found."""
    index = impacts[0]
    low = float(along_px[max(index - 1, 0) : index + 2].min())
    top = float(along_px[max(0, index - 200) : index].max())
    last = len(along_px)
    limits = [(index, low + _LIFTED * (top - low))]
    if len(impacts) > 1 and impacts[1] > index + 2:  # no bounce is higher than the first
        apex = float(along_px[index : impacts[1]].max())
        limits.append((impacts[1], apex + (_LIFTED - 1) * (top - low)))
    for begin, most in limits:
        above = np.flatnonzero(along_px[begin:last] > most)
        if len(above):
            lying = np.flatnonzero(along_px[begin : begin + above[0]] < low + 0.05 * (top - low))
            last = begin + int(lying[-1] if len(lying) else above[0])
    gaps = np.flatnonzero(np.diff(seconds[index:last]) > 1.0)  # not found for longer
    return index + int(gaps[0]) + 1 if len(gaps) else last


# ---- Reasons why a track shows no drop, in words that say what to do

MIN_FREE = 0.1  # fraction of a way that is free flight below which nothing is let go
_FEW_SHOWN = 8  # pictures of a fall: of fewer no free flight is told from a carried ball


class FreeFlight(NamedTuple):
    """Share of a track that is free flight."""

    # Of the short parts of the way in which the ball moves, one about each picture, those that bend
    # as the flight does by which the ball was found.
    share: float
    flights: int  # how many there are, one after another
    is_carried: bool  # whether the ball is carried by a hand, or rolls


def free_flight(
    track: Track, chosen: NDArray[np.bool_] | None = None, impacts_s: Array | None = None
) -> FreeFlight:
    """Compare accelerations in short windows of the `chosen` pictures, (T,), with the flight's.

    Windows over impacts at known stamps [s], shape (N,), tell nothing.
    """
    known = np.flatnonzero(track.found if chosen is None else track.found & chosen)
    if len(known) < MIN_SAMPLES:
        return FreeFlight(0.0, 0, is_carried=False)
    seconds, places = track.stamps_ns[known] * 1e-9, track.places_px[known]
    radius = float(np.nanmedian(track.radius_px[known]))
    gravity = float(np.linalg.norm(track.gravity_px))
    period_s = median_step(seconds)
    # A fall sags by more in a window than noise does.
    wide_s = np.sqrt(8 * max(3.0, 0.3 * radius) / gravity)
    half = max(2, round(wide_s / period_s / 2))
    down_px = places @ track.gravity_px / gravity
    least = max(2.0, 0.2 * radius, 5.0 * noise_of(down_px, seconds.astype(np.float64)))
    free: list[bool] = []
    for middle in range(half, len(seconds) - half):
        part = slice(middle - half, middle + half + 1)
        clock, way = seconds[part] - seconds[middle], places[part]
        gapped = float(np.ptp(clock)) > 3 * half * period_s
        if impacts_s is not None and np.any(
            np.diff(impacts_s.searchsorted(seconds[part][[0, -1]]))
        ):
            continue
        if gapped or np.linalg.norm(np.ptp(way, axis=0)) < least:
            continue
        bend = 2 * np.polyfit(clock, way, 2)[0] - track.gravity_px
        free.append(bool(np.linalg.norm(bend) < 0.4 * gravity))
    runs = [(is_free, len(list(run))) for is_free, run in groupby(free)]
    # Fewer windows between two flights are a wrong position.
    parted = [is_free or length >= 3 for is_free, length in runs]
    kinds = [is_free for (is_free, _), kept in zip(runs, parted, strict=True) if kept]
    flights = sum(kind for kind, _ in groupby(kinds))
    share = sum(free) / max(len(free), 1)
    # Of 20 parts or more: short flights of a dull ball fill few.
    return FreeFlight(share, flights, is_carried=len(free) >= 20 and share < MIN_FREE)


def too_small(track: Track, span: float) -> str:
    """Explain that the ball moves by only `span` px along the image's vertical."""
    down = track.gravity_px / np.linalg.norm(track.gravity_px)
    across = track.places_px[track.found] @ np.array([down[1], -down[0]])
    wide_px = float(np.ptp(across))
    if wide_px > 3.0 * max(span, 1.0) and wide_px > 4 * np.nanmedian(track.radius_px):
        return (
            f"the ball never falls: it goes {wide_px:.0f} px across the picture and {span:.0f} "
            "px down, as a ball that rolls, or is filmed from above; at the next drop: let it fall "
            "onto the table, filmed from the side"
        )
    return f"the ball moves by only {span:.0f} px; at the next drop: film it larger, from closer"


def why_not(track: Track, whole: BounceSamples, impacts: list[int], *, fitted: bool) -> str:
    """Explain why no bounce could be fitted; `fitted` if any impact follows a free fall."""
    flight = free_flight(track)
    one_flight = flight.flights == 1 and flight.share > 0.6
    fall_s = np.sqrt(2 * np.ptp(whole.positions) / np.linalg.norm(track.gravity_px))
    shown = float(fall_s) / median_step(whole.seconds)  # pictures of a fall from the highest place
    is_out = bool(impacts) and _leaves_at(track, whole, impacts[0])
    if shown < _FEW_SHOWN and not (is_out or one_flight):
        return (
            f"no bounce is told: {shown:.0f} pictures show a fall, and no more a bounce; at the "
            "next drop: film at more pictures a second, 60 or more, and from higher"
        )
    if flight.is_carried:
        return (
            "no bounce is seen: the ball hardly flies, it is carried, held or rolls (free flight "
            f"in {100 * flight.share:.0f} % of its way); at the next drop: let go above the "
            "table, in view, the camera still"
        )
    if is_out:
        return (
            "no bounce is seen: the ball falls out of the picture, and where it hits is not in "
            "view; at the next drop: keep the table in view"
        )
    if not impacts or one_flight:
        return (
            "no bounce is seen: the ball never falls onto anything in view; at the next drop: "
            "keep the table in view"
        )
    after = len(whole.seconds) - impacts[-1]
    if len(impacts) == 1 and after < MIN_SAMPLES:
        return (
            f"the recording, or what is seen of the ball, ends {after} pictures after the impact; "
            "at the next drop: record until the ball lies still, all in view"
        )
    if not fitted:
        return (
            "no free fall is seen before an impact (carried, caught, or too few pictures); at the "
            "next drop: let go above the table, in view, and record until the ball lies still"
        )
    return (
        "what the ball does is no drop: it does not bounce along parabolas of one acceleration; at "
        "the next drop: let it bounce on a flat table, untouched, the camera still"
    )


def _leaves_at(track: Track, whole: BounceSamples, impact: int) -> bool:
    """Return whether a fall goes on beyond the picture's edge, without the ball about its end."""
    seconds = whole.seconds
    first = max(impact - 1, 0)
    gaps_s = np.diff(seconds[first : impact + 2])
    if gaps_s.max(initial=0.0) < 1.9 * median_step(seconds):  # no picture of the ball is missing
        return False
    at, gap_s = first + int(gaps_s.argmax()), float(gaps_s.max())
    down = track.gravity_px / np.linalg.norm(track.gravity_px)
    axis = int(np.argmax(np.abs(down)))
    size, toward = track.size_px[axis] - 1, np.sign(down[axis])
    # Distances of the ball's middle from the edge below it, and its speeds toward it [px/s].
    places = track.places_px[track.found][:, axis]
    room = size - places if toward > 0 else places
    speeds = -np.diff(room) / np.diff(seconds)
    falls = float(speeds[max(at - 1, 0)]) + abs(float(track.gravity_px[axis])) * gap_s / 2
    rises = max(-float(speeds[at + 1]), 0.0) if at + 1 < len(speeds) else 0.0
    # Lines before the gap and after it meet where the ball turns.
    turns_s = (room[at] - room[at + 1] + rises * gap_s) / max(falls + rises, 1e-9)
    lowest = float(room[at]) - falls * float(np.clip(turns_s, 0.0, gap_s))
    return lowest < float(np.nanmedian(track.radius_px))


# ---- Films that repeat, as pictures made to loop do: the first pass is the film

_SAME_PX = 1.5  # within which the ball is at one place in two passes: several times the noise


def pass_length(track: Track) -> int:
    """Return how many pictures a pass of a film takes that repeats; all where it does not.

    It repeats where the ball is in the same places again, wherever it moves.
    """
    places, count = track.places_px, len(track.stamps_ns)
    moved = np.linalg.norm(np.diff(places, axis=0, prepend=places[:1]), axis=1)
    quick = np.flatnonzero(moved > 3 * _SAME_PX)  # [px] a picture: no neighbour is as near
    if len(quick) < MIN_SAMPLES:
        return count
    probes = quick[:16:2]
    for length in range(MIN_SAMPLES, count - int(probes[-1])):
        if np.linalg.norm(places[probes + length] - places[probes], axis=1).max() > _SAME_PX:
            continue
        both = quick[quick + length < count]
        apart = np.linalg.norm(places[both + length] - places[both], axis=1)
        is_seen = np.isfinite(apart)
        if np.count_nonzero(is_seen) >= MIN_SAMPLES and np.mean(apart[is_seen] < _SAME_PX) > 0.9:
            return length
    return count


# ---- Drop of a track: the first plausible bounce, its camera, and its heights


@dataclass(frozen=True, eq=False)
class FilmedDrop:
    """One drop in a track, and its camera."""

    track: Track  # the ball in every picture
    down_px: Array  # unit vector of the image's vertical, shape (2,)
    searched: BounceFit  # the fit by which it was found, its lens without an unknown
    posterior: BallPosterior  # of the ball, with its fit
    projection: Projection  # where its heights are in the picture, by that fit; on the log's time
    # When what the ball does after its first impact ends: lifted, or long not found.
    end_s: float
    used: NDArray[np.bool_]  # which pictures the drop is made of, shape (T,) of the track
    sideways: Array  # distance from the image's vertical [drop heights], shape (used pictures,)
    across_px: float  # mean position across the vertical, from which its samples' are counted
    drop: Drop  # its heights by the projection, contact at 0
    # How many impacts are before it, after deeper falls, that no drop could be fitted from.
    left_out: int
    later_s: tuple[float, ...]  # impacts after it, after falls as deep, on the drop's clock
    # How many it is made of where the ball bounces otherwise after them; None where not.
    flights: int | None = None
    # When its clock jumps: what comes later is left out; None where it does not.
    uneven_s: float | None = None
    converted: ConvertedFilm | None = None  # how the film was converted; None where it was not
    passes: float = 1.0  # how often the film shows the same again, of which the first is used


class _NoDropError(Exception):
    """No bounce could be fitted to a track."""

    def __init__(self, impacts: list[int], fitted: bool) -> None:
        super().__init__()
        self.impacts = impacts  # samples at which a fall may end
        self.fitted = fitted  # whether any of them follows a free fall


def find_filmed_drop(track: Track, start_ns: int, ball: Ball | None = None) -> FilmedDrop:
    """Find and fit the first drop in a track; its clock is 0 at `start_ns`.

    Pictures of a film that was converted are placed on the clock of its source, where that is sure;
    of one that repeats the first pass is used.
    """
    length, count = pass_length(track), len(track.stamps_ns)
    first = track if length == count else track.some(slice(length))
    drop = _find_drop(first, start_ns, ball, None)
    return replace(drop, passes=count / length)


def _find_drop(
    track: Track, start_ns: int, ball: Ball | None, converted: ConvertedFilm | None
) -> FilmedDrop:
    # The pictures in which the ball is found, each later than the one before.
    known = np.flatnonzero(np.isfinite(track.places_px).all(axis=1))
    latest_ns = np.maximum.accumulate(track.stamps_ns[known])
    known = known[np.diff(latest_ns, prepend=latest_ns[:1] - 1) > 0]
    known = known if np.linalg.norm(track.gravity_px) > 0 else known[:0]
    if len(known) < MIN_SAMPLES:
        raise NotFoundError(
            f"the ball is seen in {len(known)} pictures: too few for a drop", FILM_MORE
        )
    seconds = (track.stamps_ns[known] - start_ns).astype(np.float64) * 1e-9
    down = track.gravity_px / np.linalg.norm(track.gravity_px)
    along = -(track.places_px[known] @ down)
    across = track.places_px[known] @ np.array([down[1], -down[0]])
    span = float(np.ptp(along))
    if span < 15.0:  # no bounce is told from the noise of a track; the checks ask for 40
        raise NotFoundError(too_small(track, span))
    # Rounding to whole pixels is no noise: a ball that lies still is always rounded the same way.
    least_px = 0.45 if not np.any(track.places_px[known] % 1) else 0.1
    noisy = partial(with_noise, span=span, least_px=least_px)
    whole = noisy(
        BounceSamples(
            seconds=seconds,
            positions=along,
            noise=least_px,
            drag_1_m=ball.drag_1_m if ball else None,
            exposure_s=min(track.exposure_s, median_step(seconds)),
            across=across - across.mean(),
            radii=track.radius_px[known],
            center=-float((np.array(track.size_px) - 1) / 2 @ down),
            usual_focal=USUAL_FOCAL * max(track.size_px),
        )
    )
    # What is judged is all that is seen; what is fitted is without the ball's shadow.
    seen, whole = whole, whole.only(~_merged(track, known, along))
    try:
        first = _find_fit(whole)
        if converted is None:
            converted = converted_film(whole, first[0].fit, track.stamps_ns, start_ns, noisy)
            if converted is not None and converted.is_sure:
                return _find_drop(converted.placed(track), start_ns, ball, converted)
        found, impacts, uneven_s = _trusted_fit(whole, first)
        # A way to the side may explain a hand's, too.
        if found.fit.samples.moves_s and free_flight(track).is_carried:
            raise _NoDropError(impacts, fitted=True)
    except _NoDropError as error:
        impacts = np.searchsorted(seconds, whole.seconds[error.impacts]).tolist()
        reason = why_not(track, seen, impacts, fitted=error.fitted)
        raise NotFoundError(reason) from error
    # In little light a shutter is open for most of a picture.
    step_s = median_step(seconds)
    if whole.exposure_s and step_s > whole.exposure_s and not is_good(found.fit):
        with suppress(_NoDropError):
            blurred = replace(whole, exposure_s=step_s)
            other = _trusted_fit(blurred, _find_fit(blurred))
            if misfit(other[0].fit) < 0.8 * misfit(found.fit):
                found, impacts, uneven_s = other
    posterior = ball_posterior(_likeliest_beside(_through_lens(found.fit)))
    fit = posterior.fit
    projection = fit.projection()
    free_s = flies_from_s(whole, found.fit)
    impacts = np.searchsorted(seconds, whole.seconds[impacts]).tolist()
    end_s = float(seconds[bounces_end(seconds, along, impacts) - 1])
    before_s = projection.impact_s - projection.fall_time_s / 4
    before = seen.part(0, int(np.searchsorted(seconds, before_s)))
    later = seen.part(int(np.searchsorted(seconds, fit.samples.seconds[-1])), len(seconds))
    # Half a second more is seen in a review.
    begin = int(np.searchsorted(seconds, fit.samples.seconds[0] - 0.5))
    last = int(np.searchsorted(seconds, fit.samples.seconds[-1], side="right"))
    used = np.zeros(len(track.stamps_ns), dtype=bool)
    used[known[begin:last]] = True
    return FilmedDrop(
        track=track,
        down_px=down,
        searched=found.fit,
        posterior=posterior,
        projection=projection,
        end_s=end_s if uneven_s is None else min(end_s, uneven_s),
        used=used,
        sideways=(across[begin:last] - np.median(across[begin:last])) / projection.span,
        across_px=float(across.mean()),
        drop=_drop(seconds[begin:last], along[begin:last], projection, whole.noise, begin, free_s),
        left_out=len(_deep_falls_s(before, 1.1 * projection.span)),
        later_s=tuple(_deep_falls_s(later, 0.8 * projection.span)),
        flights=found.flights,
        uneven_s=uneven_s,
        converted=converted,
    )


# A ball that is seen in one with its shadow: by how much larger it looks than in flight, how many
# times worse its picture fits, and how near the table that is [radii].
_LARGER, _WORSE, _NEAR = 1.02, 4.0, 1.5
_LEAST_WAY_PX = 1.0  # between two pictures, of a ball that flies: a hand's shadow is on one held


def _merged(track: Track, known: NDArray[np.intp], along: Array) -> NDArray[np.bool_]:
    """Return in which of the `known` pictures the ball is seen in one with its shadow, (N,).

    Near the table it touches what it casts: the outline around both is larger than the ball's in
    flight, fits worse, and its centre is up to half a radius off.
    """
    radii, cost = track.radius_px[known], -np.log(np.maximum(track.confidence[known], 1e-9))
    above = (along - np.quantile(along, 0.02)) / np.nanmedian(radii)
    flies = (above > 2 * _NEAR) & (np.abs(np.gradient(along)) > _LEAST_WAY_PX)
    if np.count_nonzero(flies) < MIN_SAMPLES:
        return np.zeros(len(known), dtype=bool)
    worse = cost > _WORSE * np.median(cost[flies])
    # A camera above the table sees a ball smaller there.
    columns = np.column_stack([np.ones(len(above)), above])
    law, *_ = robust_regression(columns[flies], np.log(radii[flies]))
    return (above < _NEAR) & worse & (np.log(radii) - columns @ law > np.log(_LARGER))


def canonical_film(film: FilmedDrop) -> Observation:
    """Return the fall and the flights that were seen, on the canonical grid of `canonical`.

    They are the fitted ball's, not the samples: those carry the noise of a track, which counts for
    much where a bounce is small.
    """
    axis, fit, drop = canonical_axis(), film.projection, film.drop
    values = fit.bounce.heights(axis)
    first, last = fit.fall_times(drop.seconds[[0, -1]]).tolist()
    seen = last if np.isnan(drop.rest_m) else np.inf
    values[(axis < first) | (axis > seen)] = np.nan
    return canonical_observation(values)


def image_rows(film: FilmedDrop, start_s: float) -> Observation:
    """Return y in the picture, 0 at the top and 1 at the bottom: what the paper's network sees.

    The paper's 400 samples at 60 Hz start at `start_s`, on the drop's clock. A recording that ends
    with the ball at rest goes on with it at rest; else what is missing is NaN.
    """
    rows = film.track.places_px[film.used, 1] / film.track.size_px[1]
    wanted = start_s + paper_axis()
    seconds = film.drop.seconds
    values = resample(seconds, rows, wanted)
    if not np.isnan(film.drop.rest_m):
        values[wanted > seconds[-1]] = rows[-1]
    return Observation(values[:, None], paper_axis(), "time [s]", ("y [picture heights]",))


def drop_by(film: FilmedDrop, posterior: BallPosterior, *, from_rest: bool = False) -> Drop:
    """Reconstruct a film's drop by another posterior of the same pictures, or as one from rest."""
    along = -(film.track.places_px[film.used] @ film.down_px)
    noise_px = film.drop.noise_m / film.drop.drop_height_m * film.projection.span
    view = posterior.fit.projection()
    free_s = film.drop.release_s if film.drop.launched and not from_rest else None
    return _drop(film.drop.seconds, along, view, noise_px, film.drop.first, free_s)


def _drop(
    seconds: Array,
    along: Array,
    fit: Projection,
    noise_px: float,
    first: int,
    free_s: float | None,
) -> Drop:
    """Build a drop of positions along the vertical; at rest where 6 samples or more lie still.

    A ball that flies freely from `free_s` on only is launched there; None for one let go at rest.
    """
    gravity = CALIBRATED.gravity_m_s2
    height_m = gravity * fit.fall_time_s**2 / 2
    heights = np.clip(fit.heights(along, seconds), -1.0, 2.0)
    last = float(fit.fall_times(seconds[-1:])[0])
    starts, speeds = fit.bounce.flights(last)
    lies_s = fit.impact_s + fit.fall_time_s * float(starts[-1])
    lying = seconds[(seconds > lies_s) & (speeds[-1] == 0)]
    release_s, release_m = fit.impact_s - fit.fall_time_s * fit.bounce.fall_time, height_m
    if free_s is not None:
        fallen = fit.bounce.heights(fit.fall_times(np.array([free_s])))
        release_s, release_m = free_s, height_m * float(fallen[0])
    return Drop(
        first=first,
        seconds=seconds,
        heights_m=heights * height_m,
        release_s=release_s,
        release_m=release_m,
        impact_s=fit.impact_s,
        contact_m=0.0,
        impact_speed_m_s=gravity * fit.fall_time_s,
        flight_restitution=fit.bounce.restitution,
        flight_restitution_sd=float("nan"),
        gravity_m_s2=gravity,
        fall_s=(fit.impact_s, fit.impact_s),
        flight_s=(fit.impact_s, fit.impact_s),
        noise_m=noise_px / fit.span * height_m,
        rest_m=0.0 if len(lying) > 5 else float("nan"),
        rest_tolerance_m=height_m,
        launched=free_s is not None,
    )


def _find_fit(whole: BounceSamples) -> tuple[FilmFit, list[int]]:
    """Fit from the first impact that may be the first one; return the impacts from there on.

    A way to the side explains much, so a straight way to the same impact is preferred.
    """
    impacts = film_impacts(whole.seconds, whole.positions, whole.noise)
    span = float(np.ptp(whole.positions))

    def is_plausible(fit: BounceFit) -> bool:
        """Return whether it is a drop of the track's size, with 0.3 fall times after the impact."""
        view = fit.projection()
        seen = view.fall_times(fit.samples.seconds[-1:])[0] > 0.3
        size = abs(np.log(view.span / span)) < 1.2
        bounces = view.residual_rms / view.span < 0.05
        return bool(seen and size and bounces and view.bounce.restitution <= 0.995)

    good: tuple[FilmFit, list[int]] | None = None  # by more than a straight way, from there on
    plausible: list[tuple[FilmFit, list[int]]] = []
    fitted = False
    for at in range(min(len(impacts), 6)):  # more of what moves before a drop is a hand's
        those = impacts[at:]
        if good is not None and whole.seconds[those[0]] > _first_known_s(good[0].fit):
            break
        fit = fit_from(whole, those)
        fitted |= fit is not None
        if fit is not None and is_good(fit) and is_plausible(fit):
            return FilmFit(fit), those
        moved = _fit_sideways(whole, those, fit) if good is None else None
        if moved is not None and is_plausible(moved):
            good = FilmFit(moved), those
        elif fit is not None:
            found = _of_first_flights(whole, those, fit)
            if is_plausible(found.fit):
                plausible.append((found, those))
                good = plausible[-1] if good is None and is_good(found.fit) else good
    if good is not None:
        return good
    if not plausible:
        raise _NoDropError(impacts, fitted)
    return min(plausible, key=lambda one: misfit(one[0].fit))


# Speed from which on a ball moves [spans a fall time]: where it lies, its places agree too well.
_MOVES = 0.1
_SHADED = 1.25  # by which light and blur widen a track's own noise: alike where the ball is near


def _through_lens(fit: BounceFit) -> BounceFit:
    """Refit with the lens's distortion as an unknown: what is left is the track's own noise.

    That is of the pictures in which the ball moves, and of as many as its unknowns leave free. A
    contact that lasts is known too roughly for it, and more noise than a lens distorts hides it.
    """
    samples = fit.samples
    allowed = samples.distortion_variance_fraction * samples.noise**2
    noise_px = float(np.sqrt(samples.noise**2 - allowed))
    speeds = np.gradient(samples.positions + fit.residuals, samples.times(fit.unknowns))
    moves = np.abs(speeds) > _MOVES * float(fit.unknowns[SPAN])
    count = int(np.count_nonzero(moves))
    if count < MIN_SAMPLES or samples.is_soft or not allowed:
        return fit
    for _ in range(2):
        left = max(count - len(fit.free), 0.25 * count)
        # What hangs together is no noise: a contact, light, or a way that no unknown is of.
        together = correlation_time(fit.residuals, len(fit.free))
        own_px = scale_of(fit.residuals[moves], noise_px) * float(np.sqrt(together * count / left))
        shaded = min((_SHADED**2 - 1) * own_px**2, allowed)
        sharp = replace(
            samples,
            noise=min(float(np.sqrt(own_px**2 + shaded)), samples.noise),
            distortion_variance_fraction=shaded / (own_px**2 + shaded),
            through_lens=True,
        )
        fit = fit_bounce(sharp, fit.unknowns, sharp.unknowns, most=60, gain=1e-8)
    return fit


def _first_known_s(fit: BounceFit) -> float:
    """Return a quarter of a fall after the first impact [s]: a later one is another bounce."""
    view = fit.projection()
    return view.impact_s + view.fall_time_s / 4


def _trusted_fit(
    whole: BounceSamples, first: tuple[FilmFit, list[int]]
) -> tuple[FilmFit, list[int], float | None]:
    """Fit the track before its `late_fault`; return its impacts, when a clock is at fault [s]."""
    (found, impacts), uneven_s = first, None
    for _ in range(3):
        fault = late_fault(found.fit)
        if fault is None:
            break
        fault_s, flights = fault
        try:
            shorter, _ = _find_fit(whole.part(0, int(whole.seconds.searchsorted(fault_s))))
        except _NoDropError:
            break
        apart_s = shorter.fit.unknowns[IMPACT] - found.fit.unknowns[IMPACT]
        if abs(apart_s) > shorter.fit.projection().fall_time_s / 4:
            break  # of another drop
        found = FilmFit(shorter.fit, shorter.flights or flights or found.flights)
        uneven_s = fault_s if flights is None else uneven_s
    return found, impacts, uneven_s


def _deep_falls_s(samples: BounceSamples, least_px: float) -> list[float]:
    """Return when falls of at least `least_px` end in an impact [s]."""
    seconds, positions = samples.seconds, samples.positions
    if len(seconds) < MIN_SAMPLES:
        return []
    impacts = film_impacts(seconds, positions, samples.noise)
    begins = [0, *impacts]
    return [
        float(seconds[at])
        for begin, at in zip(begins, impacts, strict=False)
        if positions[begin : at + 1].max() - positions[at] > least_px
    ]


# ---- Pictures placed by the ball's motion where their arrival leaves a stamp in doubt
# Where pictures are lost on their way, those around the loss may be a tick earlier or later. A ball
# that falls is elsewhere a tick later, so its flight in the other pictures shows which.


def placed_by_motion(
    track: Track, arrivals: CorrectedStamps, start_ns: int, ball: Ball | None
) -> tuple[Track, CorrectedStamps]:
    """Place unsure pictures of a track, and its stamps, where the ball's flight wants them.

    Both are unchanged where no picture is unsure, or no drop is found. `track` is at the corrected
    stamps of `arrivals`, which are of all pictures.
    """
    numbers = np.searchsorted(arrivals.stamps_ns, track.stamps_ns)
    for _ in range(2):
        clock = arrivals.clock
        if clock is None or not clock.unsure.any():
            break
        # The drop in the sure pictures, or in all where those are too few.
        unsure, film = clock.unsure[numbers], None
        sure = replace(track, places_px=np.where(unsure[:, None], np.nan, track.places_px))
        for tried in (sure, track):
            with suppress(NotFoundError):
                film = film or find_filmed_drop(tried, start_ns, ball)
        if film is None:
            break
        along = np.full(len(clock.ticks), np.nan)
        along[numbers] = -(track.places_px @ film.down_px)
        since_s = float(clock.arrivals_ns[0] - start_ns) * 1e-9
        placed = clock.placed_by(partial(_misfit, film, along, since_s))
        arrivals = replace(arrivals, clock=placed, stamps_ns=placed.stamps_ns)
        track = replace(track, stamps_ns=arrivals.stamps_ns[numbers])
    return track, arrivals


def _misfit(
    film: FilmedDrop, along: Array, since_s: float, asked: NDArray[np.intp], times_ms: Array
) -> Array:
    """Return the negative log likelihood of `asked` pictures (N,) of places `along` (T,) at times.

    These are (N, S) [ms], and 0 at `since_s` on the drop's clock; 0 where nothing flies.
    """
    flat, fit = (since_s + 1e-3 * times_ms).ravel(), film.projection
    times, flies_from = fit.fall_times(flat), -0.95  # fall times: for sure
    positions = fit.positions(fit.bounce.heights(np.maximum(times, flies_from)), flat)
    off = positions.reshape(times_ms.shape) - along[asked][:, None]
    off /= max(fit.residual_rms, 0.3)
    cost = np.minimum(0.5 * off**2, 12.0)  # a single wrong place is not the ball's
    flies = (times >= flies_from) & (flat <= film.end_s)
    return np.where(flies.reshape(times_ms.shape) & np.isfinite(off), cost, 0.0)
