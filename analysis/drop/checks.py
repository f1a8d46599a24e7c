"""Checks of a drop, each with figure, limit and what to do about it.

First those of any recorded drop, then its cross-check, then what only a film shows, then the checks
and the cross-check of a drop that was only heard.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.checks import Check, CrossCheck, figures
from tunenet_logs.analysis.drop.audio import FusedEstimate
from tunenet_logs.analysis.drop.bounce_fit import BounceFit
from tunenet_logs.analysis.drop.bounce_model import TOUCH, Projection
from tunenet_logs.analysis.drop.bounce_posterior import flight_ratio
from tunenet_logs.analysis.drop.detection import DISAGREEMENT, AnyDetection, FilmDetection
from tunenet_logs.analysis.drop.film import (
    MAX_CLOCK_GAIN,
    MIN_FREE,
    FilmedDrop,
    clock_test,
    free_flight,
    is_whole,
    long_steps,
)
from tunenet_logs.analysis.drop.free_flight import Drop, Indices, meet
from tunenet_logs.analysis.drop.times.detection import TimesDetection
from tunenet_logs.analysis.drop.times.model import HeardBall, Whitening
from tunenet_logs.analysis.drop.times.search import BallAmong
from tunenet_logs.analysis.estimators.base import FitResult, Observation, Step
from tunenet_logs.analysis.record import SimulationFit, Units
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.base import CALIBRATED

# Rms in drop heights: a simulation that is farther off is of something else than the recording.
_REJECT_FIT = 0.1

_CLEAR_FLIGHT = 10  # samples of a first flight in which a parabola can be found, if there is one
# A first rebound lower than this many standard deviations of the noise has no value of its own.
_CLEAR_HOP = 8

_MAX_GAP = 4.0  # sample periods without a sample: a longer gap may hide an impact
_SURE = 0.02  # half width of an interval that still tells one ball from another
# Fall times after the impact: less than that may miss the top of the first bounce, and of a ball
# that a hand catches, what is free.
MIN_SEEN, _MIN_SEEN_THROWN = 0.9, 0.2

# Of the drop height, and of the noise's standard deviations, that a sample may lie under the
# contact: a ball that sinks in less is still on the table.
_MAX_BELOW, _BELOW_SDS = 0.03, 6

# Of the drop height: a ball that is let go stays nearer; one that is thrown does not.
_MAX_DRIFT = 0.5

# Of the drop height [%], beyond the noise: what cannot be seen in a review, and what a fit to the
# first part of a recording may be off in the rest.
MAX_EXCESS_PERCENT, _MAX_HELD_OUT = 0.5, 1.0

# Of the drop height [%]: a simulation that is farther off is of something else.
_REJECT_EXCESS = 15.0

_MAX_LEFT_OUT = 0.05  # fraction of the samples that may be something else than the ball
# Relative: a fall may be this far from g, as the air and a short fall make it.
_WITHIN_GRAVITY = 0.05


def recording_checks(
    drop: Drop,
    sideways_m: Array,
    most_gap_falls: float = 0.0,
    excused_s: Sequence[float] | Array = (),
    most_sideways: float = 0.0,
    sunk_m: float = 0.0,
) -> list[Check]:
    """Check the recording itself: its length, gaps, table and sideways motion.

    Args:
        drop: the drop in it.
        sideways_m: the ball's horizontal positions in the drop's window [m], shape (T, 2).
        most_gap_falls: a gap of so many fall times may be, even where it is many periods.
        excused_s: when a sample is missing that tells nothing of an impact [s].
        sunk_m: how far below the contact the ball is elsewhere in the recording [m].
        most_sideways: fraction of the impact's speed at which the ball may go sideways.
    """
    height = drop.drop_height_m
    after = drop.seconds > drop.impact_s
    below = max(drop.contact_m - float(drop.heights_m[after].min(initial=drop.contact_m)), sunk_m)
    seen = (drop.seconds[-1] - drop.impact_s) / drop.fall_time_s
    drift = float(np.linalg.norm(np.ptp(sideways_m, axis=0)))
    periods = np.diff(drop.seconds)
    known_s = np.union1d(drop.seconds, np.asarray(excused_s))
    longest_s = float(np.diff(known_s).max())
    gap = longest_s / float(np.median(periods))
    most_gap = max(_MAX_GAP, most_gap_falls * drop.fall_time_s / float(np.median(periods)))
    floor = _MAX_BELOW * height + _BELOW_SDS * drop.noise_m
    least_seen = _MIN_SEEN_THROWN if drop.launched else MIN_SEEN
    flown, wanted = figures(seen, least_seen, 1)
    size, unit = _length(drop)
    under, most_under = figures(size * max(below, 0.0), size * floor, 1)
    lasts_s = float(drop.seconds[-1] - drop.seconds[0])
    most_m = max(_MAX_DRIFT * height, most_sideways * drop.impact_speed_m_s * lasts_s)
    aside, most_aside = figures(size * drift, size * most_m, 0)
    longest, too_long = figures(gap, most_gap, 1)
    return [
        Check(
            "first flight seen",
            seen > least_seen,
            f"{flown} fall times (wanted: {wanted} or more)",
            advice="record until the ball lies still",
            invalidates_interval=False,
        ),
        Check(
            "stays on the table",
            below < floor,
            f"{under} {unit} below contact (at most {most_under})",
            advice="drop onto the middle of a large, level surface",
        ),
        Check(
            "falls straight",
            drift < most_m,
            f"{aside} {unit} sideways (at most {most_aside})",
            advice="let go without a push, over a level surface",
        ),
        Check(
            "no samples missing",
            gap < most_gap,
            f"longest gap {longest} periods (less than {too_long})",
            advice="keep the ball in sight all the way, and the rate steady",
            invalidates_interval=False,
        ),
    ]


def _length(drop: Drop) -> tuple[float, str]:
    """Return the factor and unit that show a drop's lengths: mm, or % of an unscaled height."""
    if drop.scale_known:
        return 1000.0, "mm"
    return 100 / drop.drop_height_m, "% of the drop height"


def fall_checks(drop: Drop, restitution: float, units: Units) -> list[Check]:
    """Check that the ball falls and flies freely, so that the restitution is its own."""
    checks: list[Check] = []
    if units.doubt:
        checks.append(
            Check("gravity", False, units.doubt, advice=units.remedy, invalidates_interval=False)
        )
    elif units.tell_speed:
        checks.append(
            Check(
                "gravity",
                abs(drop.gravity_m_s2 / CALIBRATED.gravity_m_s2 - 1) < _WITHIN_GRAVITY,
                f"falls with {drop.gravity_m_s2:.2f} m/s² (wanted: {CALIBRATED.gravity_m_s2:.2f} "
                f"within {100 * _WITHIN_GRAVITY:.0f} %)",
                advice="record lengths in m and the true times",
            )
        )
    if not np.isnan(drop.rest_m):
        off = abs(drop.rest_m - drop.contact_m)
        size, unit = _length(drop)
        apart, most_apart = figures(size * off, size * drop.rest_tolerance_m, 1)
        checks.append(
            Check(
                "rests where it hit",
                off < drop.rest_tolerance_m,
                f"{apart} {unit} between impact and rest (at most {most_apart})",
                advice="let it come to rest by itself, on a hard and level surface",
            )
        )
    flight_samples = 2 * restitution * drop.fall_time_s / float(np.median(np.diff(drop.seconds)))
    if np.isnan(drop.flight_restitution) and flight_samples >= _CLEAR_FLIGHT:
        detail = (
            f"none found in the {flight_samples:.0f} samples of the first flight "
            "(a filtered track?)"
        )
        advice = "record unfiltered positions, and let go without spin"
        checks.append(Check("flies a parabola", False, detail, advice=advice))
    return checks


def rebound_check(drop: Drop, restitution: float) -> Check:
    """Check that the first rebound stands out of the noise, where there is no interval."""
    hop_m = restitution**2 * drop.drop_height_m
    high, least = figures(1000 * hop_m, 1000 * _CLEAR_HOP * drop.noise_m, 1)
    return Check(
        "rebound stands out",
        hop_m > _CLEAR_HOP * drop.noise_m,
        f"{high} mm high (wanted: over {least}, {_CLEAR_HOP} times the noise)",
        advice="drop from higher, or record with less noise",
        secondary=True,
    )


def sure_check(low: float, high: float, reject: float = np.inf) -> Check:
    """Check that a 95 % interval is narrow enough; half a width above `reject` is fatal."""
    half = (high - low) / 2
    shown, most = figures(half, _SURE, 2, "g")
    return Check(
        "sure enough",
        half < _SURE,
        f"95 % interval of ±{shown} (at most {most})",
        fatal=half > reject,
        advice="drop from higher, or record larger or at a higher rate",
        secondary=True,
        invalidates_interval=False,
    )


def motion_checks(fit: SimulationFit | None) -> list[Check]:
    """Check that the tuned simulator moves as the ball does, and predicts the hold-out.

    A simulator that leaves the observation is not tuned, however narrow the fit's interval is.
    """
    if fit is None:
        return []
    seen, most = figures(fit.excess_percent, MAX_EXCESS_PERCENT, 2)
    share = fit.left_out / max(fit.samples + fit.left_out, 1)
    found = [
        Check(
            "simulation fits",
            fit.excess_percent < MAX_EXCESS_PERCENT,
            f"{seen} % of the drop height apart beyond the noise, rms of {fit.samples} samples (at "
            f"most {most}); {fit.worst_percent:.2f} % at worst",
            fatal=fit.excess_percent > _REJECT_EXCESS,
            advice="drop it again without spin, onto a hard and level surface",
        ),
        Check(
            "samples are the ball's",
            share <= _MAX_LEFT_OUT,
            f"{fit.left_out} of {fit.samples + fit.left_out} are elsewhere (at most "
            f"{100 * _MAX_LEFT_OUT:.0f} %)",
            advice="keep other things that move, or are marked, away from the ball",
        ),
    ]
    if fit.held_out_percent is not None:
        off, most = figures(fit.held_out_percent, _MAX_HELD_OUT, 2)
        found.append(
            Check(
                "hold-out prediction",
                fit.held_out_percent < _MAX_HELD_OUT,
                f"by the first 60 % of the time the rest is {off} % of the drop height off (at "
                f"most {most})",
                advice="drop from higher, or record more bounces at a higher rate",
                invalidates_interval=False,
            )
        )
    return found


def fit_check(
    simulated: Observation,
    target: Observation,
    scale: float,
    most: float,
    reject: float = _REJECT_FIT,
) -> Check:
    """Check that the tuned simulator is within `most` drop heights of the recording (rms).

    `scale` is the drop height in the observations' unit; more than `reject` is fatal.
    """
    off = (simulated.values - target.values) / scale
    rms = float(np.sqrt(np.nanmean(off**2)))
    apart, most_apart = figures(100 * rms, 100 * most, 2)
    return Check(
        "simulation fits",
        rms < most,
        f"{apart} % of the drop height apart, rms (at most {most_apart})",
        fatal=rms > reject,
        advice="drop it again without spin, onto a hard and level surface",
        secondary=True,
    )


# ---- Cross-check of a drop: a second estimate by sound, flight durations or impact speeds

# Of the restitution: what systematic errors take off the cross-check of a good recording.
_AGREEMENT, _AGREEMENT_IN_PICTURE = 0.02, 0.03


def flight_cross_check(detection: AnyDetection, estimate: Array) -> CrossCheck | None:
    """Cross-check the restitution by the ratio of two flights, else by the impact's speeds.

    Both are compared with what the fitted ball would show in the same way, so the air's drag, and
    what a smooth curve makes of it, take nothing from them. The first changes with no projection.
    """
    if not detection.physical or detection.posterior is None:
        return None
    fit, value = detection.posterior.fit, float(estimate[0])
    by_ear = None if detection.ear is None else _by_ear(detection.ear, value)
    if by_ear is not None:
        return by_ear
    ratio = flight_ratio(fit)
    if ratio is not None:
        margin = _AGREEMENT if detection.film is None else _AGREEMENT_IN_PICTURE
        # What they tell is the second impact's; the first one's is as much off, at any slope.
        scale = value / ratio.fitted
        return CrossCheck.judged(
            "durations of the first two flights",
            scale * ratio.value,
            value,
            scale * (margin + 3 * ratio.sd),
            sd=scale * ratio.sd,
            advice=DISAGREEMENT,
        )
    if isinstance(detection, FilmDetection):
        return None
    return _by_speeds(detection.found, fit, value)


def _by_ear(ear: FusedEstimate, value: float) -> CrossCheck | None:
    """Cross-check two flights as they are heard against those of the pictures alone.

    None where no three impacts in a row were seen and heard. The contact's duration is the joint
    fit's.
    """
    if ear.touches is None or ear.impacts is None:
        return None
    numbers = ear.touches.numbers
    are_seen = numbers[2:] < len(ear.impacts.times_s)
    in_a_row = np.flatnonzero(are_seen & (numbers[2:] - numbers[:-2] == 2))
    if not len(in_a_row):
        return None
    three = slice(int(in_a_row[0]), int(in_a_row[0]) + 3)
    which = numbers[three]
    heard_s = np.diff(ear.touches.times_s[three])
    seen_s = np.diff(ear.impacts.times_s[which]) + ear.posterior.fit.unknowns[TOUCH]
    off = float(np.log(heard_s[1] / heard_s[0]) - np.log(seen_s[1] / seen_s[0]))
    slopes = np.array([1 / seen_s[0], -1 / seen_s[0] - 1 / seen_s[1], 1 / seen_s[1]])
    covariance = ear.impacts.covariance[np.ix_(which, which)]
    sd = float(np.sqrt(slopes @ (covariance + ear.touches.covariance[three, three]) @ slopes))
    return CrossCheck.judged(
        "two flights by ear, beside the pictures",
        value * float(np.exp(off)),
        value,
        value * (_AGREEMENT + 3 * sd),
        sd=value * sd,
        advice=DISAGREEMENT,
    )


def _by_speeds(drop: Drop, fit: BounceFit, value: float) -> CrossCheck | None:
    """Cross-check by the speeds just before and after the impact, from parabolas on either side.

    The same parabolas are fitted to the fitted ball: what they are off there, they are off here.
    """
    fall = _between(drop.seconds, drop.fall_s)
    flight = _between(drop.seconds, drop.flight_s)
    if np.isnan(drop.flight_restitution_sd) or len(fall) < 3 or len(flight) < 3:
        return None
    view = fit.projection()
    heights = view.bounce.heights(view.fall_times(drop.seconds))
    ball_m = view.positions(heights, drop.seconds)
    clock = drop.seconds - view.impact_s
    usual = meet(clock, ball_m, fall, flight, drop.noise_m).flight_restitution
    own = drop.flight_restitution, drop.flight_restitution_sd
    if drop.launched:  # its flights were cut where a hand may be
        again = meet(clock, drop.heights_m, fall, flight, drop.noise_m)
        own = again.flight_restitution, again.flight_restitution_sd
    seen = value + own[0] - usual
    return CrossCheck.judged(
        "speeds at the first impact",
        seen,
        value,
        _AGREEMENT + 3 * own[1],
        sd=own[1],
        advice=DISAGREEMENT,
    )


def _between(seconds: Array, ends: tuple[float, float]) -> Indices:
    """Return the indices of the samples between two times, both included."""
    return np.flatnonzero((seconds >= ends[0]) & (seconds <= ends[1]))


# ---- Checks of a filmed drop: what an uncalibrated picture shows of its own faults
# A fit takes up much of what is wrong with a film. So these also look at what it cannot take up: a
# clock that lags from some moment on, and a ball that grows or shrinks as no fitted camera has it.

_MIN_SPAN_PX = 40  # of a fall: in a smaller one the first hop of restitution .2 is under 2 px high
_CLEAR_FILMED_HOP = 6  # standard deviations of the noise that a first hop has to be high
# Fractions of the pictures in which the ball has to be found, and fall times of them.
_SEEN, _REJECT_SEEN, _LOOKED_AT = 0.8, 0.6, 4.0

_AWAY = 0.25  # fall times from an impact, beyond which none hides where the ball is out of view
# Of the drop height: rms that passes, and from which on, or a worst one, nothing is a drop.
_RESIDUAL, _REJECT_RESIDUAL, _REJECT_WORST = 0.02, 0.03, 0.10

_LONG_STEPS = 2  # pictures lost one here, one there; the clock's test is for one moment alone
_PERSPECTIVE = 1.4  # two standard deviations of its prior
# Fraction of repeated pictures that passes: the ball should move by the step, and did not move.
_REPEATED, _STEP_PX, _SAME_PX = 0.05, 1.5, 0.02

# Fraction of a size, and difference of k, that pass: light changes a ball's outline.
_GROWS, _PERSPECTIVES_APART = 0.2, 0.2

_SDS = 4.0  # standard errors that are allowed on top of a threshold
_MIN_FLIGHTS = 2  # the first alone has no other to be compared with
_MIN_COUNT = 12  # samples for a test of size
_AT_REST = 1.0  # fall times of a rest whose sizes count


def film_checks(film: FilmedDrop) -> list[Check]:
    """Check whether a track is a drop's, in view, along parabolas and on an even clock."""
    span = film.projection.span
    residual = film.projection.residual_rms / span
    worst = float(np.quantile(np.abs(film.fit.residuals) / span, 0.98))
    seen, repeated = _seen_and_repeated(film)
    gain, moment_s = clock_test(film.fit)
    uneven_s = film.uneven_s
    left_out = "" if uneven_s is None else f"; what comes after {uneven_s:.2f} s is left out"
    flight = free_flight(film.track, film.used)
    long = long_steps(film.fit) if residual < _REJECT_RESIDUAL else 0  # else nothing is expected
    return [
        Check(
            "flies freely",
            not flight.is_carried,
            f"free flight in {100 * flight.share:.0f} % of its way (wanted: "
            f"{100 * MIN_FREE:.0f} or more)",
            advice="let go above the table and touch nothing, the camera still",
        ),
        Check(
            "large enough",
            span > _MIN_SPAN_PX,
            f"falls {span:.0f} px (wanted: {_MIN_SPAN_PX} or more)",
            advice="film from closer, the fall over half of the picture's height",
            invalidates_interval=False,
        ),
        Check(
            "first impact",
            not film.left_out,
            f"{film.left_out} deeper falls before it fit no drop (wanted: none)",
            advice="let the ball bounce in the middle of a flat table, with nothing in its way",
        ),
        Check(
            "stays in view",
            seen > _SEEN,
            f"found in {100 * seen:.0f} % of the pictures of the drop "
            f"(wanted: {100 * _SEEN:.0f} or more)",
            fatal=seen < _REJECT_SEEN,
            advice="leave room at the sides, a plain background; mark the ball with --preview",
            invalidates_interval=False,
        ),
        Check(
            "pictures differ",
            repeated < _REPEATED,
            f"{100 * repeated:.0f} % show the moving ball unmoved (at most {100 * _REPEATED:.0f})",
            advice="record at a rate that the camera keeps",
        ),
        Check(
            "no pictures missing",
            long < _LONG_STEPS,
            f"{long} steps of the ball are far too long for the stamps (at most {_LONG_STEPS - 1})",
            advice="use the camera's own file, not a copy at another rate",
        ),
        Check(
            "bounces along parabolas",
            residual < _RESIDUAL,
            f"{100 * residual:.2f} % of the drop height off, rms (at most {100 * _RESIDUAL:.0f})",
            fatal=residual > _REJECT_RESIDUAL or worst > _REJECT_WORST,
            advice="let the ball bounce in the middle of a flat table, with nothing in its way",
            secondary=True,
        ),
        Check(
            "bounces alike",
            film.flights is None or film.flights >= _MIN_FLIGHTS,
            "all that are seen"
            if film.flights is None
            else f"only until the {film.flights + 1}. impact, what comes later is left out "
            f"(wanted: {_MIN_FLIGHTS} flights or more)",
            advice="a round ball, a flat and level table",
            invalidates_interval=False,  # what comes later touches no flight that counts
            secondary=True,
        ),
        Check(
            "even clock",
            gain < MAX_CLOCK_GAIN,
            f"log likelihood ratio {gain:.1f} for missing pictures or another rate, at "
            f"{moment_s:.2f} s (at most {MAX_CLOCK_GAIN:.0f}){left_out}",
            advice="use the camera's own file, not a copy at another rate; name another ball or "
            "none, if one was named; a lens that bends less",
        ),
        *_distance_checks(film),
    ]


def hop_check(film: FilmedDrop, restitution: float) -> Check:
    """Check that the first bounce can be seen at all, where there is no interval."""
    span = film.projection.span
    noise_px = film.drop.noise_m / film.drop.drop_height_m * span
    hop_px, least = restitution**2 * span, max(_CLEAR_FILMED_HOP * noise_px, 1.0)
    return Check(
        "rebound stands out",
        hop_px > least,
        f"{hop_px:.1f} px high (wanted: over {least:.1f})",
        advice="film from closer",
        secondary=True,
    )


def _distance_checks(film: FilmedDrop) -> list[Check]:
    """Check the perspective, and the ball's size where that is seen."""
    fit, track = film.projection, film.track
    too_near = abs(fit.perspective) >= _PERSPECTIVE
    side = (", from below" if fit.perspective > 0 else ", from above") if too_near else ""
    checks = [
        Check(
            "seen from a distance",
            not too_near,
            f"perspective {fit.perspective:+.2f}{side} (at most {_PERSPECTIVE} either way)",
            advice="film from farther away, the camera at the height of the bounces",
        )
    ]
    along = -(track.places_px[film.used] @ film.down_px)
    trend = size_trend(film.drop.seconds, along, track.radius_px[film.used], fit)
    if trend is None:
        return checks
    most = _GROWS + _SDS * trend.grows_sd
    apart = _PERSPECTIVES_APART + _SDS * trend.perspective_sd
    return [
        *checks,
        Check(
            "keeps its distance",
            abs(trend.grows) < most,
            f"grows by {100 * trend.grows:+.0f} % (at most {100 * most:.0f} either way)",
            advice="let go without pushing or spinning the ball",
        ),
        Check(
            "size fits perspective",
            abs(trend.perspective) < apart,
            f"perspective {trend.perspective:+.2f} apart by the ball's size (at most {apart:.2f} "
            "either way)",
            advice="keep the camera still and the ball in one piece of light",
        ),
    ]


def scale_checks(detection: FilmDetection) -> list[Check]:
    """Check that the film's frame rate is its true one, where a length is known.

    A film that plays at another rate than it was filmed shows another gravity. The restitution is
    the same, the drop height, speeds and drag are not.
    """
    if not detection.is_timed or detection.known_height is None:
        return []
    known_m, within = detection.known_height
    return [
        Check(
            "frame rate",
            not detection.contradicted_scale,
            f"falls {detection.film.drop.drop_height_m:.2f} m by the clock, {known_m:.2f} m by the "
            f"known size (wanted: within a factor {within}; or it is not that size)",
            advice="record slow motion with its true rate: tunenet-record --camera FILE --fps RATE",
        )
    ]


def _seen_and_repeated(film: FilmedDrop) -> tuple[float, float]:
    """Return the fractions of pictures with the ball found, and with it unmoved.

    The first is of those from mid-fall for four fall times, without those that it flies out of; the
    second of those with a moving ball.
    """
    fit, best, track = film.projection, film.fit, film.track
    end_s = min(float(film.drop.seconds[-1]), fit.impact_s + _LOOKED_AT * fit.fall_time_s)
    seconds = _track_seconds(film)
    wanted = (seconds > fit.impact_s - fit.fall_time_s / 2) & (seconds <= end_s)
    wanted &= ~_out_of_view(film)
    seen = float(np.mean(track.found[wanted])) if wanted.any() else 0.0
    positions = best.samples.positions
    expected = np.abs(np.diff(positions + best.residuals))
    whole = is_whole(track.places_px[film.used])  # then noise may hide a step
    moving = expected > (max(_STEP_PX, _SDS * best.samples.noise) if whole else _STEP_PX)
    moving &= fit.fall_times(best.samples.seconds[1:]) > -1
    same = np.abs(np.diff(positions)) < _SAME_PX
    return seen, float(np.mean(same[moving])) if np.count_nonzero(moving) > 3 else 0.0


def seconds_out_of_view(film: FilmedDrop) -> Array:
    """Return the times at which the ball is out of the picture, shape (N,) [s]."""
    return _track_seconds(film)[_out_of_view(film) & ~film.track.found]


def _track_seconds(film: FilmedDrop) -> Array:
    """Return the times of all pictures, on the drop's clock [s], shape (T,)."""
    seconds = film.track.stamps_ns * 1e-9
    return seconds + film.drop.seconds[0] - seconds[film.used][0]


def _out_of_view(film: FilmedDrop) -> NDArray[np.bool_]:
    """Return which pictures cut the ball in flight, well away from an impact, shape (T,)."""
    fit, track = film.projection, film.track
    seconds = _track_seconds(film)
    times = fit.fall_times(seconds)
    starts, _ = fit.bounce.flights(float(times[-1]))
    apart = np.abs(times[:, None] - starts).min(axis=1)
    along = fit.positions(fit.bounce.heights(times), seconds)
    across_px = np.array([film.down_px[1], -film.down_px[0]])
    known = np.flatnonzero(track.found)
    across = np.interp(seconds, seconds[known], track.places_px[known] @ across_px)
    places = across[:, None] * across_px - along[:, None] * film.down_px
    radius = float(np.nanmedian(track.radius_px[film.used]))
    far = np.array(track.size_px) - 1 - radius
    cut = np.any((places < radius) | (places > far), axis=1)
    return cut & (apart > _AWAY)


@dataclass(frozen=True)
class SizeTrend:
    """Change of the ball's size in the picture, beyond what the fitted camera predicts.

    Attributes:
        grows: by what fraction from the first used picture to the last, at one height.
        grows_sd: its standard error.
        perspective: k by the ball's size less that by the fit.
        perspective_sd: its standard error.
    """

    grows: float
    grows_sd: float
    perspective: float
    perspective_sd: float


def size_trend(
    seconds: Array, along_px: Array, radius_px: Array, projection: Projection
) -> SizeTrend | None:
    """Regress log radius on height, time and speed, reweighted; None for too few samples.

    A ball at height u is 1 / (1 + (e^k - 1) u) as large as at contact; a long exposure draws it out
    by its speed, which is therefore fitted too.

    Args:
        seconds: shape (T,).
        along_px: positions along the image's vertical, shape (T,).
        radius_px: shape (T,); NaN where it is not known.
        projection: of the drop.
    """
    heights = np.clip(projection.heights(along_px, seconds), 0.0, 1.2)
    times = projection.fall_times(seconds)
    last = float(projection.impacts(float(seconds[-1]))[-1])
    good = np.isfinite(radius_px) & (radius_px > 0) & (times > -1) & (times < last + _AT_REST)
    if np.count_nonzero(good) < _MIN_COUNT:
        return None
    nearly = projection.perspective or 1e-6
    depth = np.log1p(np.expm1(nearly) * heights) / nearly
    speed = np.abs(np.gradient(along_px, seconds))
    speed = speed / max(float(speed.max()), 1e-9)
    length = float(np.ptp(times[good]))
    columns = np.column_stack([np.ones(len(times)), depth, times / length, speed])[good]
    sizes = np.log(radius_px[good])
    weights = np.ones(len(sizes))
    found, spread = np.zeros(columns.shape[1]), 0.0
    for _ in range(5):
        found = np.linalg.lstsq(columns * weights[:, None], sizes * weights, rcond=None)[0]
        residuals = sizes - columns @ found
        spread = 1.4826 * float(np.median(np.abs(residuals))) + 1e-6
        weights = 1 / np.sqrt(1 + (residuals / spread / 2) ** 2)
    sds = spread * np.sqrt(np.diag(np.linalg.pinv(columns.T @ columns)))
    return SizeTrend(
        grows=float(found[2]),
        grows_sd=float(sds[2]),
        perspective=float(-found[1] - projection.perspective),
        perspective_sd=float(sds[1]),
    )


# ---- Checks of a drop that was heard, and its cross-check

_MAX_WRONG = 0.4  # share of impacts that were missed and of times that are none
_SURE_ODDS = float(np.log(100.0))  # logarithm of the odds against noises at random times
# Odds for knocks that soften, against such as stay as loud: claps have a hundredth.
_MIN_SOFTENING = 0.2

_MAX_AS_LOUD = 2  # knocks of others while a ball bounces, as loud as its own
# Standard deviation of a time [s], and in mean flights: a hand's clapping has more.
_MAX_JITTER_S, _MAX_JITTER = 0.006, 0.03

_NO_RHYTHM = float(np.log(20.0))  # logarithm of the odds against every rhythm that is no ball's
_MAX_RESTITUTION = 0.95  # of any ball that is heard; a beat that hardly quickens has more
# Of the slope at its interval's upper end: no ball bounces better the faster it is, but flights
# that shorten by one time each look so.
_MIN_SLOPE = -0.01

_ENOUGH = 5  # impacts from which on other rhythms than a ball's can be told from it
_FITS, _MIN_FIT_S = 2.0, 0.0005  # rms between rollout and times: so many jitters and so much more
_MAX_HEIGHT_SDS = 3.5  # by which the height may contradict the times
_UNSURE = 0.1  # half width of an interval from which on nothing is known


def times_checks(detection: TimesDetection, last: Step, fit: FitResult | None) -> tuple[Check, ...]:
    """Check the times themselves, and whether the tuned simulator keeps them."""
    heard = detection.heard
    count, wrong = len(heard.times_s), heard.reading.missed + heard.reading.false
    share = wrong / (count + wrong)
    of_wrong, most = figures(100 * share, 100 * _MAX_WRONG, 0)
    jitter, most_jitter = figures(1000 * heard.jitter_s, 1000 * _most_jitter_s(heard), 1)
    odds = float(np.exp(min(heard.log_odds, 20.0)))
    is_ball = heard.log_odds > _SURE_ODDS
    softening_odds = None if detection.among is None else detection.among.softening_odds
    rhythm = _no_rhythm(heard, softening_odds or 0.0)
    is_beat = not any(check.passed for check in rhythm)
    checks = [
        Check(
            "enough impacts",
            count >= _ENOUGH,
            f"{count} impacts heard (wanted: {_ENOUGH} or more)",
            advice="let it bounce longer",
            secondary=not is_ball or is_beat,
        ),
        Check(
            "times are the ball's",
            share <= _MAX_WRONG and is_ball,
            f"{_heard_how(heard)}{odds:.3g} to 1 against noises at random times "
            f"(wanted: {np.exp(_SURE_ODDS):.0f} to 1); {heard.reading.missed} impacts missed, "
            f"{heard.reading.false} noises between {count} impacts: {of_wrong} % wrong (at most "
            f"{most})",
            advice="record five bounces or more in a quiet room",
            invalidates_interval=share > _MAX_WRONG,
            fatal=share > _MAX_WRONG or heard.log_odds < 0,
        ),
        Check(
            "times are sharp",
            heard.jitter_s < _most_jitter_s(heard),
            f"they scatter by {jitter} ms about a ball's (at most {most_jitter})",
            advice="put the microphone near the impact, and set its threshold low",
        ),
    ]
    if detection.among is not None:
        start_s = float(heard.times_s[0])
        checks += _sound_checks(detection.among, start_s, secondary=not is_ball or is_beat)
    checks += rhythm
    slope = float(heard.interval95[1, 1])
    checks.append(
        Check(
            "slows as balls do",
            slope > _MIN_SLOPE,
            f"its restitution {'may fall' if slope > 0 else 'grows'} with speed, by a power of "
            f"{'up to' if slope > 0 else 'at least'} {abs(slope):.3f} (it may grow by "
            f"{-_MIN_SLOPE:g} at most)",
            advice="record one ball that bounces freely",
        )
    )
    if heard.rig.height_m is not None:
        off, most_off = figures(heard.height_sds, _MAX_HEIGHT_SDS, 1)
        checks.append(
            Check(
                "height fits the times",
                heard.height_sds < _MAX_HEIGHT_SDS,
                f"{off} standard deviations off (at most {most_off})",
                advice="measure from the ball's underside, and record its first impact",
            )
        )
    if fit is not None:
        checks.append(sure_check(*fit.interval95[0], reject=_UNSURE))
    return (*checks, _simulation_check(heard, off_s(detection, last)))


def _heard_how(heard: HeardBall) -> str:
    if heard.log_odds > _SURE_ODDS:
        return ""
    return "a ball is hardly heard: " if heard.log_odds > 0 else "no bouncing ball is heard: "


def _sound_checks(among: BallAmong, first_s: float, *, secondary: bool) -> tuple[Check, Check]:
    odds = float(np.exp(np.clip(among.second_odds, -20.0, 20.0)))
    earlier_s = among.earlier_s
    second = "for a second ball at the same time"
    if len(earlier_s) and among.second_odds > 0:
        second = (
            f"that the {len(earlier_s)} knocks from {earlier_s[0]:.2f} to {earlier_s[-1]:.2f} s, "
            f"just before its first at {first_s:.2f} s, are the same ball's, or of one like it"
        )
    alone = Check(
        "one ball alone",
        among.second_odds < _SURE_ODDS and among.as_loud <= _MAX_AS_LOUD,
        f"{odds:.3g} to 1 {second} (at most {np.exp(_SURE_ODDS):.0f}), {among.as_loud} other "
        f"knocks as loud as its own (at most {_MAX_AS_LOUD})",
        advice="let one ball bounce alone, or choose one drop with --start and --end",
        invalidates_interval=False,
        secondary=secondary,
    )
    return alone, _softens(among)


def _softens(among: BallAmong) -> Check:
    softening_odds, clipped = among.softening_odds, f"{among.clipped} of its knocks are clipped"
    if softening_odds is None:
        detail = f"too few whole knocks to tell how it softens; {clipped}"
    else:
        softer = float(np.exp(np.clip(softening_odds, -20.0, 20.0)))
        wanted = f"(wanted: {_MIN_SOFTENING} to 1)"
        detail = f"{softer:.3g} to 1 against knocks that stay as loud {wanted}; {clipped}"
    return Check(
        "softens as a ball does",
        softening_odds is not None and softening_odds > np.log(_MIN_SOFTENING),
        detail,
        advice="record one ball that bounces freely, the microphone farther away, without "
        "automatic gain",
        invalidates_interval=softening_odds is not None,
    )


def _no_rhythm(heard: HeardBall, softening_odds: float) -> tuple[Check, Check]:
    name, log_odds = heard.rhythm
    log_odds = log_odds + softening_odds  # a beat keeps its loudness
    odds = float(np.exp(min(log_odds, 20.0)))
    surely_softer = softening_odds > _SURE_ODDS
    least = float(heard.interval95[0, 0] if surely_softer else heard.values[0])
    value, most = figures(least, _MAX_RESTITUTION, 3)
    return (
        Check(
            "a ball rather than a rhythm",
            log_odds > _NO_RHYTHM,
            f"{odds:.3g} to 1 against {name} (wanted: {np.exp(_NO_RHYTHM):.0f} to 1)",
            fatal=log_odds < 0,
            advice="record more bounces of one ball, near the microphone",
        ),
        Check(
            "flights shorten as a ball's",
            least <= _MAX_RESTITUTION,
            f"each lasts {value} of the one before (at most {most}: no ball that is heard keeps "
            "more)",
            advice="record one ball that bounces freely",
        ),
    )


def _most_jitter_s(heard: HeardBall) -> float:
    return min(_MAX_JITTER_S, _MAX_JITTER * float(np.diff(heard.predicted_s).mean()))


def off_s(detection: TimesDetection, step: Step) -> Array:
    """Return an iterate's impacts less those heard, shape (I,) [s]; NaN where one is none."""
    assert step.evaluation is not None
    off = step.evaluation.observation.values - detection.target.values
    return off[:, 0] / detection.heard.seconds_s


def _simulation_check(heard: HeardBall, off: Array) -> Check:
    known = np.isfinite(off)
    rms_s, worst_s = np.inf, 0.0
    if known.any():
        numbers = np.flatnonzero(known) + heard.told
        times_s = heard.predicted_s[numbers]
        ratio = heard.scatter / heard.jitter_s
        own = Whitening.of(times_s, numbers - numbers[0], ratio).rows @ off[known]
        rms_s, worst_s = float(np.sqrt(np.mean(own**2))), float(np.abs(off[known]).max())
    most_s = _FITS * heard.jitter_s + _MIN_FIT_S
    rms, most = figures(1000 * rms_s, 1000 * most_s, 2)
    return Check(
        "simulation fits",
        rms_s < most_s,
        f"its impacts are {rms} ms from those heard, rms of {known.sum()} beside the "
        f"{100 * heard.scatter:.2g} % by which each bounce is its own (at most {most}, by their "
        f"jitter of {1000 * heard.jitter_s:.2f} ms); {1000 * worst_s:.2f} ms at worst",
        advice="drop it again without spin, onto a hard and level surface",
    )


def ratio_cross_check(heard: HeardBall, value: float) -> CrossCheck | None:
    """Cross-check by plain ratios of successive flights' durations; None without two whole ones.

    Each is compared with that of the fitted ball, so that the air takes nothing from it.
    """
    numbers, times_s, fitted_s = heard.numbers, heard.times_s, heard.predicted_s
    whole = np.flatnonzero((np.diff(numbers[:-1]) == 1) & (np.diff(numbers[1:]) == 1))
    if not len(whole):
        return None
    before, after = np.diff(times_s)[whole], np.diff(times_s)[whole + 1]
    at = numbers[whole]
    usual = np.diff(fitted_s)[at + 1] / np.diff(fitted_s)[at]
    each = after / before / usual
    sds = heard.jitter_s * np.sqrt(before**-2 + after**-2 + (1 / before + 1 / after) ** 2)
    sds = np.hypot(sds, heard.scatter)
    best = int(np.argmin(sds))
    weights = sds**-2 / np.sum(sds**-2)
    seen = value * float(weights @ each)
    sd = value * float(sds[best])
    return CrossCheck.judged(
        "ratios of the flights' durations",
        seen,
        value,
        _AGREEMENT + 3 * sd,
        sd=sd,
        advice=DISAGREEMENT,
    )
