"""Baseline of today: phyphox's "(In)elastic collision", written as plainly as it is.

An event is the first sample over a threshold (.1 of full scale, unless a user sets another) at
least a minimum delay (.1 s) after the last one. The first six events give five flights; the energy
that an impact keeps is the squared ratio of the flights after and before it. There is no air in it
and no doubt. (phyphox-experiments, inelastic_collision.phyphox, version 1.4.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.evaluation.sound.clip import SoundClip
from tunenet_logs.arrays import Array

TYPICAL_THRESHOLD = 0.1
DELAY_S = 0.1
MAX_EVENTS = 6

_THRESHOLDS = 60
# Thresholds that are tried: so many, evenly in the logarithm, from this fraction of the loudest
# sample on.
_LOWEST = 0.003

_LATE_S = 0.02
# An event is an impact's if it is so much after or before the beginning of its sound.
_EARLY_S = 0.001


@dataclass(frozen=True, eq=False)
class PhyphoxReading:
    """Reading of the app at one threshold.

    Attributes:
        threshold: of full scale.
        events_s: at most six, after the first sample, shape (N,).
        right: how many of them, from the first on, are the ball's first impacts, one after another.
    """

    threshold: float
    events_s: Array
    right: int

    @property
    def restitutions(self) -> Array:
        """Root of the kept energy at the second event, the third, ..., shape (N - 2,)."""
        flights = np.diff(self.events_s)
        return flights[1:] / flights[:-1]


def events_over(
    samples: NDArray[np.float32], rate_hz: float, threshold: float, delay_s: float = DELAY_S
) -> Array:
    """Return when samples first exceed a threshold [s], shape (N,), six at most."""
    over = np.flatnonzero(np.abs(samples) > threshold) / rate_hz
    events: list[float] = []
    at = 0
    while at < len(over) and len(events) < MAX_EVENTS:
        events.append(float(over[at]))
        at = int(np.searchsorted(over, over[at] + delay_s))
    return np.array(events)


def reading(clip: SoundClip, threshold: float) -> PhyphoxReading:
    """Read a clip as the app does."""
    events = events_over(clip.samples, clip.rate_hz, threshold)
    right = 0
    for event, impact in zip(events, clip.impacts_s, strict=False):
        if not -_EARLY_S <= event - impact <= _LATE_S:
            break
        right += 1
    return PhyphoxReading(threshold, events, right)


def best_reading(clip: SoundClip, fewest_events: int = 3) -> PhyphoxReading | None:
    """Read a clip at the threshold nearest to the true restitution; None without any.

    Only thresholds count at which the first events are the ball's first impacts: a user who hears
    and sees the ball could know that.

    Args:
        clip: with its truth.
        fewest_events: that must be the first impacts; 3 give one restitution.
    """
    loudest = float(np.max(np.abs(clip.samples)))
    thresholds = loudest * np.geomspace(_LOWEST, 0.99, _THRESHOLDS)
    tried = [reading(clip, threshold) for threshold in (*thresholds.tolist(), TYPICAL_THRESHOLD)]
    good = [one for one in tried if one.right >= fewest_events]
    truth = clip.restitutions[1]
    return min(good, key=lambda one: abs(one.restitutions[0] - truth), default=None)
