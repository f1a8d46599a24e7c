"""Bounce fit to recorded heights: more and more flights, as long as one law explains them.

The first flight fixes the restitution to a few thousandths, which is near enough for the second,
and so on: far ahead the cost has dozens of minima.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from analysis.drop.bounce_fit import BounceFit, best_of, fit_bounce
from analysis.drop.bounce_model import (
    CONTACT,
    DRAG,
    FALL,
    IMPACT,
    LOW,
    RESTITUTION,
    SLOPE,
    SPAN,
    BounceSamples,
)
from analysis.drop.bounce_samples import MIN_SAMPLES, sharp, with_held
from analysis.drop.free_fall import Drop
from tunenet_logs.arrays import Array

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
        flies_in=drop.launched,
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
    samples = fit.samples if whole.flies_in else with_held(whole, fit)
    if samples is not fit.samples:
        held = fit_bounce(samples, fit.unknowns, fit.free)
        if held.tail_sd < 1.5 * max(fit.tail_sd, whole.noise):
            fit = held
    return fit_bounce(sharp(fit), fit.unknowns, fit.free, most=60, gain=1e-8)


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
    return (whole.flies_in | (times > -_FALL_SEEN * ball.fall_time)) & (times < end)


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
