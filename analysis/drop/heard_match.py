"""Which of the onsets in a sound track are the impacts that the pictures foretell.

The fit to the pictures says when each impact was, with a covariance: two impacts that are told
apart well may both be late together. One offset is common to all that is heard. From each pair of
an impact and an onset on, the others are looked for in turn, the surest first, and each that is
heard narrows the rest (a Kalman filter's update). What a match is worth is by how much likelier its
onsets are as impacts than as so many onsets at any time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.bounce_fit import BounceFit
from analysis.drop.bounce_model import HIGH, IMPACT
from analysis.drop.bounce_samples import MOST_IMPACTS
from analysis.drop.heard import HeardImpacts
from analysis.drop.heard_touches import OFFSET_SD_S, HeardTouches
from analysis.statistics import correlation_time
from tunenet_logs.arrays import Array

FARTHEST_OFFSET_S = 0.1
"""That sound and pictures may be apart."""

FEWEST_HEARD = 3
"""Impacts: two whole flights."""

LEAST_LOG_ODDS = 7.0
"""Of impacts against onsets at any time, from which on a match is one."""

_HEARD = 0.8
"""Probability that an impact is heard."""

_FARTHEST_SDS = 4.0
"""An onset that is farther from where an impact is foretold is none of it."""

_UNEVEN = 0.003
"""Fraction of a flight's duration by which real ones leave any law."""

_LEAST_SD_S = 1e-4
"""Of an onset: no microphone's distance and no table is better."""

_LEAST_RATE_HZ = 1.0
"""Of onsets: in a silent room as many could be heard by chance."""

_MOST_ONSETS = 400
"""Near a drop; a track with more of them has no silence to hear a bounce in."""

_SHORT = 1e-6
"""By which an unknown is moved for a derivative."""


@dataclass(frozen=True, eq=False)
class HeardMatch:
    """Onsets that are a drop's impacts.

    Attributes:
        touches: them.
        offset_s: by how much they are later than the pictures have them.
        log_odds: see above.
        onsets: how many there are in all, while the ball bounces.
    """

    touches: HeardTouches
    offset_s: float
    log_odds: float
    onsets: int


@dataclass(frozen=True, eq=False)
class ForetoldImpacts:
    """Impacts by the pictures.

    Attributes:
        times_s: shape (K,).
        covariance: of them [s^2], shape (K, K).
    """

    times_s: Array
    covariance: Array


def foretold(fit: BounceFit) -> ForetoldImpacts:
    """The impacts that are within what was fitted, K of them."""
    samples, unknowns = fit.samples, fit.unknowns
    until_s = float(samples.seconds[-1])
    count = min(len(fit.projection().impacts(until_s)), MOST_IMPACTS + 1)
    numbers = np.arange(count)
    times_s = samples.touches_s(unknowns, numbers)
    rows = np.zeros((count, len(fit.free)))
    for at, index in enumerate(fit.free):
        moved = unknowns.copy()
        moved[index] += _SHORT if unknowns[index] < HIGH[index] - _SHORT else -_SHORT
        rows[:, at] = samples.touches_s(moved, numbers) - times_s
        rows[:, at] /= moved[index] - unknowns[index]
    factor = max(correlation_time(fit.residuals, len(fit.free)), fit.effective_sample_factor)
    normal, _ = fit.normal_equations()
    covariance = rows @ np.linalg.pinv(normal) @ rows.T * factor
    uneven = np.cumsum((_UNEVEN * np.diff(times_s, prepend=unknowns[IMPACT])) ** 2)
    covariance += np.minimum(uneven[:, None], uneven)
    return ForetoldImpacts(times_s, covariance)


def match_onsets(impacts: ForetoldImpacts, heard: HeardImpacts) -> HeardMatch | None:
    """The likeliest of all matches; None where too few onsets fit.

    Args:
        impacts: by the pictures, three or more.
        heard: on their clock.
    """
    first_s, last_s = impacts.times_s[[0, -1]]
    near = heard.times_s > first_s - FARTHEST_OFFSET_S
    near &= heard.times_s < last_s + FARTHEST_OFFSET_S
    heard = heard.only(near)
    count = len(heard.times_s)
    if not FEWEST_HEARD <= count <= _MOST_ONSETS:
        return None
    rate_hz = max(count / float(last_s - first_s + 2 * FARTHEST_OFFSET_S), _LEAST_RATE_HZ)
    offsets_s = heard.times_s - impacts.times_s[:, None]
    best: HeardMatch | None = None
    tried: set[tuple[int, int]] = set()
    for number, onset in np.argwhere(np.abs(offsets_s) < FARTHEST_OFFSET_S).tolist():
        if (number, onset) in tried:
            continue
        found, pairs = _from_pair(impacts, heard, (number, onset), rate_hz)
        tried.update(pairs)  # from any of its pairs it would be found again
        if len(pairs) >= FEWEST_HEARD and (best is None or found.log_odds > best.log_odds):
            best = found
    return None if best is None else replace(best, onsets=count)


def _from_pair(
    impacts: ForetoldImpacts, heard: HeardImpacts, pair: tuple[int, int], rate_hz: float
) -> tuple[HeardMatch, list[tuple[int, int]]]:
    """The match that one impact and one onset begin."""
    times_s = impacts.times_s.copy()
    covariance = impacts.covariance + OFFSET_SD_S**2
    sds_s = np.maximum(heard.sds_s, _LEAST_SD_S)
    open_numbers = set(range(len(times_s)))
    number, onset = pair
    pairs: list[tuple[int, int]] = []
    log_odds = 0.0
    while True:
        variance = float(covariance[number, number] + sds_s[onset] ** 2)
        off_s = float(heard.times_s[onset] - times_s[number])
        gained = np.log(_HEARD / rate_hz) - 0.5 * off_s**2 / variance
        gained += -0.5 * np.log(2 * np.pi * variance) + _own_log_odds(heard, onset)
        is_near = abs(off_s) < _FARTHEST_SDS * np.sqrt(variance)
        if not pairs or (is_near and gained > np.log(1 - _HEARD)):
            log_odds += gained
            pairs.append((number, onset))
            gain = covariance[:, number] / variance
            times_s = times_s + gain * off_s
            covariance = covariance - np.outer(gain, covariance[number])
        else:
            log_odds += np.log(1 - _HEARD)
        open_numbers.discard(number)
        if not open_numbers:
            break
        number = min(open_numbers, key=lambda one: float(covariance[one, one]))
        onset = int(np.abs(heard.times_s - times_s[number]).argmin())
    pairs.sort()
    numbers, onsets = np.array(pairs).T
    offset_s = float(np.median(heard.times_s[onsets] - impacts.times_s[numbers]))
    touches = HeardTouches(numbers, heard.times_s[onsets], sds_s[onsets])
    return HeardMatch(touches, offset_s, float(log_odds), len(heard.times_s)), pairs


def _own_log_odds(heard: HeardImpacts, onset: int) -> float:
    """What an onset's own sound takes from a match: it adds nothing."""
    probability = float(np.clip(heard.probabilities[onset], 1e-3, 0.5))
    return float(np.log(probability / (1 - probability)))
