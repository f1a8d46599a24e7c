"""Cross-check of a drop: a second estimate by sound, flight durations or impact speeds."""

from __future__ import annotations

import numpy as np

from analysis.checks import CrossCheck
from analysis.drop.bounce_fit import BounceFit
from analysis.drop.bounce_model import TOUCH
from analysis.drop.detection import DISAGREEMENT, AnyDetection, FilmDetection
from analysis.drop.ear_and_eye import EarAndEye
from analysis.drop.free_fall import Drop
from analysis.drop.impact import Indices, meet
from analysis.drop.rebounds import flight_ratio
from tunenet_logs.arrays import Array

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


def _by_ear(ear: EarAndEye, value: float) -> CrossCheck | None:
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
