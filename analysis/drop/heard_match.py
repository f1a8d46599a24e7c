"""Match the onsets in a sound track to the impacts that the pictures predict.

The fit to the pictures predicts when each impact was, with a covariance: two impacts that are
resolved well may both be late together. One offset is common to all that is heard. From each pair
of an impact and an onset on, the others are looked for in turn, the surest first, and each that is
heard narrows the rest (a Kalman filter's update). What a match is worth is by how much likelier its
onsets are as impacts than as so many onsets at any time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.drop.bounce_fit import BounceFit
from analysis.drop.bounce_model import HIGH, IMPACT, OFFSET
from analysis.drop.bounce_samples import MAX_IMPACTS
from analysis.drop.heard import HeardImpacts
from analysis.drop.heard_touches import OFFSET_SD_S, HeardTouches
from analysis.statistics import correlation_time
from tunenet_logs.arrays import Array

FARTHEST_OFFSET_S = 0.1  # that sound and pictures may be apart
MIN_HEARD = 3  # impacts: two whole flights
MIN_LOG_ODDS = 7.0  # of impacts against onsets at any time, from which on a match is one
_HEARD = 0.8  # probability that an impact is heard
_FARTHEST_SDS = 4.0  # an onset that is farther from where an impact is foretold is none of it
_UNEVEN = 0.003  # fraction of a flight's duration by which real ones leave any law
_MIN_SD_S = 1e-4  # of an onset: no microphone's distance and no table is better
_MIN_RATE_HZ = 1.0  # of onsets: in a silent room as many could be heard by chance
_MAX_ONSETS = 400  # near a drop; a track with more of them has no silence to hear a bounce in
# Impacts of a drop that are listened for, and the shortest flight between two.
_MAX_HEARD, _MIN_S = 25, 0.03

# Later impacts that are not heard, one after the other, and how unsure the next may be.
_MAX_PASSED_OVER, _MAX_UNSURE_S = 1, 0.004

_SHORT = 1e-6  # by which an unknown is moved for a derivative


@dataclass(frozen=True, eq=False)
class HeardMatch:
    """Onsets matched to a drop's impacts.

    Attributes:
        touches: the matched onsets.
        offset_s: by how much they are later than the pictures have them.
        log_odds: of the match against onsets at any time.
        onsets: how many there are in all, while the ball bounces.
    """

    touches: HeardTouches
    offset_s: float
    log_odds: float
    onsets: int


@dataclass(frozen=True, eq=False)
class ForetoldImpacts:
    """Impact times predicted by a fit.

    Attributes:
        times_s: shape (K,).
        covariance: of them [s^2], shape (K, K).
    """

    times_s: Array
    covariance: Array

    def told(self, at: int, off_s: float, variance: float) -> ForetoldImpacts:
        """Apply a Kalman update: impact `at` is `off_s` late, with this variance [s^2]."""
        gain = self.covariance[:, at] / variance
        covariance = self.covariance - np.outer(gain, self.covariance[at])
        return replace(self, times_s=self.times_s + gain * off_s, covariance=covariance)


def foretold(fit: BounceFit) -> ForetoldImpacts:
    """Predict the impacts that are within what was fitted."""
    count = len(fit.projection().impacts(float(fit.samples.seconds[-1])))
    return _foretold(fit, np.arange(min(count, MAX_IMPACTS + 1)))


def _foretold(fit: BounceFit, numbers: NDArray[np.intp]) -> ForetoldImpacts:
    """Predict impacts of consecutive numbers, late by the sound's offset where the fit has one."""
    samples, unknowns = fit.samples, fit.unknowns
    times_s = samples.touches_s(unknowns, numbers)
    rows = np.zeros((len(numbers), len(fit.free)))
    for at, index in enumerate(fit.free):
        if index == OFFSET:
            rows[:, at] = 1.0
            continue
        moved = unknowns.copy()
        moved[index] += _SHORT if unknowns[index] < HIGH[index] - _SHORT else -_SHORT
        rows[:, at] = samples.touches_s(moved, numbers) - times_s
        rows[:, at] /= moved[index] - unknowns[index]
    factor = max(correlation_time(fit.residuals, len(fit.free)), fit.effective_sample_factor)
    normal, _ = fit.normal_equations()
    covariance = rows @ np.linalg.pinv(normal) @ rows.T * factor
    before_s = samples.touches_s(unknowns, numbers[:1] - 1) if numbers[0] else unknowns[IMPACT]
    uneven = np.cumsum((_UNEVEN * np.diff(times_s, prepend=before_s)) ** 2)
    covariance += np.minimum(uneven[:, None], uneven)
    late_s = float(unknowns[OFFSET]) if OFFSET in fit.free else 0.0
    return ForetoldImpacts(times_s + late_s, covariance)


def later_touches(fit: BounceFit, heard: HeardImpacts) -> HeardTouches | None:
    """Match the onsets after those of a joint fit, on its clock, to the impacts that follow.

    Too low to be seen, later bounces tell most of how the restitution falls with speed.
    """
    assert fit.samples.heard is not None
    begin = int(fit.samples.heard.numbers.max()) + 1
    numbers = np.arange(begin, _MAX_HEARD)
    times_s = fit.samples.touches_s(fit.unknowns, np.arange(begin - 1, _MAX_HEARD))
    numbers = numbers[np.cumprod(np.diff(times_s) > _MIN_S).astype(bool)]
    if not len(numbers) or not len(heard.times_s):
        return None
    impacts = _foretold(fit, numbers)
    span_s = float(np.ptp(heard.times_s))
    rate_hz = max(len(heard.times_s) / max(span_s, 1e-3), _MIN_RATE_HZ)
    pairs: list[tuple[int, int]] = []
    passed_over = 0
    for at in range(len(numbers)):
        onset = int(np.abs(heard.times_s - impacts.times_s[at]).argmin())
        off_s, variance, gained = _compared(impacts, heard, (at, onset), rate_hz)
        if passed_over > _MAX_PASSED_OVER or variance > _MAX_UNSURE_S**2:
            break
        if gained < np.log(1 - _HEARD):
            passed_over += 1
            continue
        pairs.append((int(numbers[at]), onset))
        impacts = impacts.told(at, off_s, variance)
        passed_over = 0
    return _touches(pairs, heard) if pairs else None


def match_onsets(impacts: ForetoldImpacts, heard: HeardImpacts) -> HeardMatch | None:
    """Match onsets to three impacts or more, on one clock; None where too few onsets fit."""
    first_s, last_s = impacts.times_s[[0, -1]]
    near = heard.times_s > first_s - FARTHEST_OFFSET_S
    near &= heard.times_s < last_s + FARTHEST_OFFSET_S
    heard = heard.only(near)
    count = len(heard.times_s)
    if not MIN_HEARD <= count <= _MAX_ONSETS:
        return None
    rate_hz = max(count / float(last_s - first_s + 2 * FARTHEST_OFFSET_S), _MIN_RATE_HZ)
    offsets_s = heard.times_s - impacts.times_s[:, None]
    best: HeardMatch | None = None
    tried: set[tuple[int, int]] = set()
    for number, onset in np.argwhere(np.abs(offsets_s) < FARTHEST_OFFSET_S).tolist():
        if (number, onset) in tried:
            continue
        found, pairs = _from_pair(impacts, heard, (number, onset), rate_hz)
        tried.update(pairs)  # from any of its pairs it would be found again
        if len(pairs) >= MIN_HEARD and (best is None or found.log_odds > best.log_odds):
            best = found
    return None if best is None else replace(best, onsets=count)


def _from_pair(
    impacts: ForetoldImpacts, heard: HeardImpacts, pair: tuple[int, int], rate_hz: float
) -> tuple[HeardMatch, list[tuple[int, int]]]:
    """Grow the match that one impact and one onset begin."""
    told = replace(impacts, covariance=impacts.covariance + OFFSET_SD_S**2)
    open_numbers = set(range(len(told.times_s)))
    number, onset = pair
    pairs: list[tuple[int, int]] = []
    log_odds = 0.0
    while True:
        off_s, variance, gained = _compared(told, heard, (number, onset), rate_hz)
        if not pairs or gained > np.log(1 - _HEARD):
            log_odds += gained
            pairs.append((number, onset))
            told = told.told(number, off_s, variance)
        else:
            log_odds += np.log(1 - _HEARD)
        open_numbers.discard(number)
        if not open_numbers:
            break
        number = min(open_numbers, key=lambda one: float(told.covariance[one, one]))
        onset = int(np.abs(heard.times_s - told.times_s[number]).argmin())
    pairs.sort()
    touches = _touches(pairs, heard)
    offset_s = float(np.median(touches.times_s - impacts.times_s[touches.numbers]))
    return HeardMatch(touches, offset_s, float(log_odds), len(heard.times_s)), pairs


def _compared(
    impacts: ForetoldImpacts, heard: HeardImpacts, pair: tuple[int, int], rate_hz: float
) -> tuple[float, float, float]:
    """Compare an onset with an impact: how late it is, the variance of that, and its log odds."""
    at, onset = pair
    variance = float(impacts.covariance[at, at]) + _sds_s(heard)[onset] ** 2
    off_s = float(heard.times_s[onset] - impacts.times_s[at])
    if abs(off_s) > _FARTHEST_SDS * np.sqrt(variance):
        return off_s, variance, -np.inf
    gained = np.log(_HEARD / rate_hz) - 0.5 * off_s**2 / variance
    gained += -0.5 * np.log(2 * np.pi * variance) + _own_log_odds(heard, onset)
    return off_s, variance, float(gained)


def _touches(pairs: list[tuple[int, int]], heard: HeardImpacts) -> HeardTouches:
    """Build the touches of pairs of an impact's number and an onset."""
    numbers, onsets = np.array(pairs).T
    return HeardTouches(numbers, heard.times_s[onsets], _sds_s(heard)[onsets])


def _sds_s(heard: HeardImpacts) -> Array:
    return np.maximum(heard.sds_s, _MIN_SD_S)


def _own_log_odds(heard: HeardImpacts, onset: int) -> float:
    """Return what an onset's own sound takes from a match: it adds nothing."""
    probability = float(np.clip(heard.probabilities[onset], 1e-3, 0.5))
    return float(np.log(probability / (1 - probability)))
