"""Checks of a filmed drop: what an uncalibrated picture can tell of itself."""

from __future__ import annotations

from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from analysis.observe.film import FilmedDrop
from analysis.observe.quality import Check

Array = NDArray[np.float64]

_LEAST_SPAN_PX = 40
_CLEAR_HOP = 6
_SEEN = 0.8
_REJECT_SEEN = 0.6
_LOOKED_AT = 4.0
_RESIDUAL = 0.02
_REJECT_RESIDUAL = 0.04
_PERSPECTIVE = 1.4
_REPEATED = 0.05


def film_checks(film: FilmedDrop, restitution: float) -> list[Check]:
    """What speaks for and against a track as a drop's.

    Args:
        film: the drop.
        restitution: that was found.
    """
    fit = film.projection
    span, residual = fit.span_px, fit.residual_px / fit.span_px
    noise_px = film.drop.noise_m / film.drop.drop_height_m * span
    hop_px = restitution**2 * span
    seen, repeated = _seen(film), _repeated(film)
    return [
        Check(
            "large enough",
            span > _LEAST_SPAN_PX,
            f"falls {span:.0f} px (wanted: {_LEAST_SPAN_PX} or more)",
        ),
        Check(
            "stays in view",
            seen > _SEEN,
            f"found in {100 * seen:.0f} % of the pictures of the drop "
            f"(wanted: {100 * _SEEN:.0f} or more)",
            fatal=seen < _REJECT_SEEN,
        ),
        Check(
            "pictures differ",
            repeated < _REPEATED,
            f"{100 * repeated:.0f} % show the flying ball where it was (at most "
            f"{100 * _REPEATED:.0f})",
        ),
        Check(
            "bounces along parabolas",
            residual < _RESIDUAL,
            f"{100 * residual:.2f} % of the drop height off, rms (at most {100 * _RESIDUAL:.0f})",
            fatal=residual > _REJECT_RESIDUAL,
        ),
        Check(
            "seen from a distance",
            abs(fit.perspective) < _PERSPECTIVE,
            f"perspective {fit.perspective:+.2f} (at most {_PERSPECTIVE} either way)",
        ),
        Check(
            "rebound stands out",
            hop_px > max(_CLEAR_HOP * noise_px, 1.0),
            f"{hop_px:.1f} px high (wanted: over {max(_CLEAR_HOP * noise_px, 1.0):.1f})",
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
            f"within a factor {within}; --fps sets a recording's true rate)",
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
    """Share of the pictures in which a fast ball has not moved at all."""
    seconds, heights = film.drop.seconds, film.drop.heights_m
    fit = film.projection
    falling = (seconds > fit.impact_s - 0.7 * fit.fall_time_s) & (seconds < fit.impact_s)
    steps = np.abs(np.diff(heights[falling])) / film.drop.drop_height_m * fit.span_px
    return float(np.mean(steps < 0.02)) if len(steps) > 3 else 0.0
