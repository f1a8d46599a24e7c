"""Checks of a filmed drop: what an uncalibrated picture shows of its own faults.

A fit takes up much of what is wrong with a film. So beside its residuals these look at what it
cannot take up: positions that lag behind the fitted ball from some moment on, and a ball that grows
or shrinks as no fitted camera has it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.checks import Check
from analysis.drop.detection import FilmDetection
from analysis.drop.film import FilmedDrop, is_whole
from analysis.drop.film_faults import MAX_CLOCK_GAIN, clock_test, long_steps
from analysis.drop.film_reasons import MIN_FREE, free_flight
from analysis.drop.projection import Projection
from tunenet_logs.arrays import Array

_MIN_SPAN_PX = 40  # of a fall: in a smaller one the first hop of restitution .2 is under 2 px high
_CLEAR_HOP = 6  # standard deviations of the noise that a first hop has to be high
# Fractions of the pictures in which the ball has to be found, and fall times of them.
_SEEN, _REJECT_SEEN, _LOOKED_AT = 0.8, 0.6, 4.0

_AWAY = 0.25  # fall times from an impact, beyond which none hides where the ball is out of view
# Of the drop height: rms that passes, and from which on, or a worst one, nothing is a drop.
_RESIDUAL, _REJECT_RESIDUAL, _REJECT_WORST = 0.02, 0.03, 0.10

_LONG_STEPS = 2  # of pictures that were lost one here, one there; the clock's test is for one alone
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
            doubts_model=False,
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
            doubts_model=False,
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
            symptom=True,
        ),
        Check(
            "bounces alike",
            film.flights is None or film.flights >= _MIN_FLIGHTS,
            "all that are seen"
            if film.flights is None
            else f"only until the {film.flights + 1}. impact, what comes later is left out "
            f"(wanted: {_MIN_FLIGHTS} flights or more)",
            advice="a round ball, a flat and level table",
            doubts_model=False,  # what comes later touches no flight that counts
            symptom=True,
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
    hop_px, least = restitution**2 * span, max(_CLEAR_HOP * noise_px, 1.0)
    return Check(
        "rebound stands out",
        hop_px > least,
        f"{hop_px:.1f} px high (wanted: over {least:.1f})",
        advice="film from closer",
        symptom=True,
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
