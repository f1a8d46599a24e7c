"""Checks of a filmed drop: what an uncalibrated picture can tell of itself."""

from __future__ import annotations

from typing import TypeGuard

import numpy as np

from analysis.drop.checks import Check
from analysis.drop.film import FilmedDrop, is_whole
from analysis.drop.film_doubts import clock_doubt, size_doubt

_LEAST_SPAN_PX = 40
_CLEAR_HOP = 6
_SEEN, _REJECT_SEEN = 0.8, 0.6
_LOOKED_AT = 4.0
_RESIDUAL, _REJECT_RESIDUAL, _REJECT_WORST = 0.02, 0.03, 0.10
_PERSPECTIVE = 1.4
_REPEATED = 0.05
_STEP_PX, _SAME_PX = 1.5, 0.02
_CLOCK = 12.0
_GROWS, _PERSPECTIVES_APART = 0.2, 0.2
_SDS = 4.0
_FEWEST_FLIGHTS = 2


def film_checks(film: FilmedDrop) -> list[Check]:
    """What speaks for and against a track as a drop's."""
    fit = film.projection
    span = fit.span_px
    left = np.abs(film.best.left_px) / span
    residual, worst = fit.residual_px / span, float(np.quantile(left, 0.98))
    seen, repeated = _seen(film), _repeated(film)
    gain, moment_s = clock_doubt(film.best)
    return [
        Check(
            "large enough",
            span > _LEAST_SPAN_PX,
            f"falls {span:.0f} px (wanted: {_LEAST_SPAN_PX} or more)",
            advice="film from closer, the fall over half of the picture's height",
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
        ),
        Check(
            "pictures differ",
            repeated < _REPEATED,
            f"{100 * repeated:.0f} % show the moving ball where it was (at most "
            f"{100 * _REPEATED:.0f})",
            advice="record at a rate that the camera keeps",
        ),
        Check(
            "bounces along parabolas",
            residual < _RESIDUAL,
            f"{100 * residual:.2f} % of the drop height off, rms (at most {100 * _RESIDUAL:.0f})",
            fatal=residual > _REJECT_RESIDUAL or worst > _REJECT_WORST,
            advice="let the ball bounce in the middle of a flat table, with nothing in its way",
        ),
        Check(
            "bounces alike",
            film.flights is None or film.flights >= _FEWEST_FLIGHTS,
            "all that are seen"
            if film.flights is None
            else f"only until the {film.flights + 1}. impact, what comes later is left out "
            f"(wanted: {_FEWEST_FLIGHTS} flights or more)",
            advice="a round ball, a flat and level table",
        ),
        Check(
            "even clock",
            gain < _CLOCK,
            f"log likelihood ratio {gain:.1f} for a jump or another rate, at {moment_s:.2f} s "
            f"(at most {_CLOCK:.0f})",
            advice="use the camera's own file, not a copy at another rate; name another ball or "
            "none, if one was named; a lens that bends less",
        ),
        *_distance_checks(film),
    ]


def hop_check(film: FilmedDrop, restitution: float) -> Check:
    """Whether the first bounce can be seen at all, where no interval tells."""
    span = film.projection.span_px
    noise_px = film.drop.noise_m / film.drop.drop_height_m * span
    hop_px, least = restitution**2 * span, max(_CLEAR_HOP * noise_px, 1.0)
    return Check(
        "rebound stands out",
        hop_px > least,
        f"{hop_px:.1f} px high (wanted: over {least:.1f})",
        advice="film from closer",
    )


def _distance_checks(film: FilmedDrop) -> list[Check]:
    fit, track = film.projection, film.track
    checks = [
        Check(
            "seen from a distance",
            abs(fit.perspective) < _PERSPECTIVE,
            f"perspective {fit.perspective:+.2f} (at most {_PERSPECTIVE} either way)",
            advice="film from farther away, the camera at the height of the bounces",
        )
    ]
    along = -(track.places_px[film.used] @ film.down_px)
    doubt = size_doubt(film.drop.seconds, along, track.radius_px[film.used], fit)
    if doubt is None:
        return checks
    most = _GROWS + _SDS * doubt.grows_sd
    apart = _PERSPECTIVES_APART + _SDS * doubt.perspective_sd
    return [
        *checks,
        Check(
            "keeps its distance",
            abs(doubt.grows) < most,
            f"grows by {100 * doubt.grows:+.0f} % (at most {100 * most:.0f} either way)",
            advice="let go without pushing or spinning the ball",
        ),
        Check(
            "size fits perspective",
            abs(doubt.perspective) < apart,
            f"perspective {doubt.perspective:+.2f} apart by the ball's size (at most {apart:.2f} "
            "either way)",
            advice="keep the camera still and the ball in one piece of light",
        ),
    ]


def scale_checks(
    film: FilmedDrop, ball_diameter_m: float | None, drop_height_m: float | None
) -> list[Check]:
    """Whether the film's frame rate is its true one, where a length is known.

    A film that plays at another rate than it was filmed shows another gravity. The restitution is
    the same, the drop height and speeds are not. A length that nothing has (0, say, where somebody
    did not measure) is not known.

    Args:
        film: the drop.
        ball_diameter_m: as the log says.
        drop_height_m: as the log says; the more exact of the two.
    """
    if _is_length(drop_height_m):
        told_m, within = drop_height_m, 1.3
    elif _is_length(ball_diameter_m):
        diameter_px = 2 * float(np.nanmedian(film.track.radius_px[film.used]))
        told_m, within = film.projection.span_px / diameter_px * ball_diameter_m, 1.8
    else:
        return []
    by_time_m = film.drop.drop_height_m
    return [
        Check(
            "frame rate",
            told_m / within < by_time_m < told_m * within,
            f"falls {by_time_m:.2f} m by the clock, {told_m:.2f} m by the known size (wanted: "
            f"within a factor {within}; or it is not that size)",
            advice="record slow motion with its true rate: tunenet-record --camera FILE --fps RATE",
        )
    ]


def _is_length(meters: float | None) -> TypeGuard[float]:
    return meters is not None and 0 < meters < np.inf


def _seen(film: FilmedDrop) -> float:
    """Share of the pictures, from mid-fall on for four fall times, in which the ball is found."""
    fit = film.projection
    end_s = min(float(film.drop.seconds[-1]), fit.impact_s + _LOOKED_AT * fit.fall_time_s)
    origin_s = film.drop.seconds[0] - film.track.stamps_ns[film.used][0] * 1e-9
    seconds = film.track.stamps_ns * 1e-9 + origin_s
    wanted = (seconds > fit.impact_s - fit.fall_time_s / 2) & (seconds <= end_s)
    return float(np.mean(film.track.found[wanted])) if wanted.any() else 0.0


def _repeated(film: FilmedDrop) -> float:
    """Share of the pictures with a moving ball in which it has not moved at all."""
    fit, best = film.projection, film.best
    places = best.samples.places_px
    expected = np.abs(np.diff(places + best.left_px))
    whole = is_whole(film.track.places_px[film.used])  # then noise may hide a step
    moving = expected > (max(_STEP_PX, _SDS * best.samples.noise_px) if whole else _STEP_PX)
    moving &= fit.fall_times(best.samples.seconds[1:]) > -1
    same = np.abs(np.diff(places)) < _SAME_PX
    return float(np.mean(same[moving])) if np.count_nonzero(moving) > 3 else 0.0
