"""Samples that a fitted bounce adds and leaves out: the ball in the hand, and at impacts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.drop.bounce_fit import BounceFit
from analysis.drop.bounce_model import FALL, IMPACT, SPAN, BounceSamples
from analysis.statistics import correlation_time
from tunenet_logs.arrays import Array

# Of a film's fit, and with a restitution of their own: later bounces are too low to say more.
MAX_IMPACTS = 6

MIN_SAMPLES = 12  # for eight unknowns, of which three have priors, and a noise
# Fall times before the impact from which on a held ball counts; standard deviations from where it
# is let go that it may be off.
_HELD_BACK, _OFF = 3.0, 4.0

_SHORTLY = 0.35  # fall times: a ball that moved before, and was still for less, was in no hand
_AT_IMPACT = 1.5  # samples to either side of an impact that a filter rounds
_NARROW = 0.15  # fraction of a flight, at most, that is left out at either end


def with_held(whole: BounceSamples, fit: BounceFit) -> BounceSamples:
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


def sharp(fit: BounceFit) -> BounceSamples:
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
