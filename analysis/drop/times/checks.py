"""Checks of a drop that was heard, and its cross-check."""

from __future__ import annotations

import numpy as np

from analysis.checks import Check, CrossCheck, figures
from analysis.drop.checks import sure_check
from analysis.drop.detection import DISAGREEMENT
from analysis.drop.times.ball_among import BallAmong
from analysis.drop.times.detection import TimesDetection
from analysis.drop.times.least_squares import Whitening
from analysis.drop.times.posterior import HeardBall
from analysis.estimators.base import FitResult, Step
from tunenet_logs.arrays import Array

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
# Of plain ratios with the fit; and half width of an interval from which on nothing is known.
_AGREEMENT, _UNSURE = 0.02, 0.1


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
            symptom=not is_ball or is_beat,
        ),
        Check(
            "times are the ball's",
            share <= _MAX_WRONG and is_ball,
            f"{_heard_how(heard)}{odds:.3g} to 1 against noises at random times "
            f"(wanted: {np.exp(_SURE_ODDS):.0f} to 1); {heard.reading.missed} impacts missed, "
            f"{heard.reading.false} noises between {count} impacts: {of_wrong} % wrong (at most "
            f"{most})",
            advice="record five bounces or more in a quiet room",
            doubts_model=share > _MAX_WRONG,
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
        checks += _sound_checks(detection.among, start_s, symptom=not is_ball or is_beat)
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


def _sound_checks(among: BallAmong, first_s: float, *, symptom: bool) -> tuple[Check, Check]:
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
        doubts_model=False,
        symptom=symptom,
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
        doubts_model=softening_odds is not None,
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
