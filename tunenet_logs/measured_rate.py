"""Measure the rate of pictures or messages: their number over time, pauses left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

# No film and no sensor is faster: what seems so came in one piece, and tells no rate.
MAX_SPEED_HZ = 100_000.0

MAX_SPEED_CAMERA_HZ = 2000.0  # no camera that is plugged in or in a network is faster
_LAG = 30  # messages over which the usual rate is looked at: few bursts are longer
# A longer step, in usual ones and in seconds, is a pause; a burst's own steps are shorter.
_PAUSE_PERIODS, _PAUSE_S = 10.0, 0.5

# Messages at the beginning that are closer had waited until somebody asked for them.
_WAITED_PERIODS = 0.1

# Of the time, where there are several pauses: with more they are how the messages come.
_MAX_PAUSED = 0.9


def measured_hz(
    stamps_ns: Sequence[int] | NDArray[np.int64], fastest_hz: float = MAX_SPEED_HZ
) -> float:
    """Return the mean message rate [Hz]; 0 where the stamps determine none.

    A pause is left out, but for what of it the messages behind it make up for: what a stopped
    recorder or a stalled network only delayed is not lost, and its time counts.

    Args:
        stamps_ns: in any order, shape (T,) [ns].
        fastest_hz: what no such messages exceed.
    """
    stamps = np.sort(np.array(stamps_ns, np.int64))
    seconds = (stamps - stamps[:1]).astype(np.float64) * 1e-9
    period_s = _usual_s(seconds)
    if period_s > 0:
        seconds = _without_those_that_waited(seconds, period_s)
    count = len(seconds) - 1
    if count < 1:
        return 0.0
    whole_s = float(seconds[-1] - seconds[0])
    counted_s = whole_s - _lost_s(seconds, period_s)
    return count / counted_s if counted_s * fastest_hz >= count else 0.0


def _usual_s(seconds: NDArray[np.float64]) -> float:
    """Return the median period over many messages [s], so that bursts level out."""
    lag = max(1, min(_LAG, (len(seconds) - 1) // 4))
    return float(np.median(seconds[lag:] - seconds[:-lag])) / lag if len(seconds) > lag else 0.0


def _without_those_that_waited(
    seconds: NDArray[np.float64], period_s: float
) -> NDArray[np.float64]:
    late = np.diff(seconds) >= _WAITED_PERIODS * period_s
    return seconds[int(late.argmax()) :] if late.any() else seconds


def _lost_s(seconds: NDArray[np.float64], period_s: float) -> float:
    """Return the time [s] of pauses that no later message makes up for."""
    steps_s = np.diff(seconds)
    pauses = np.flatnonzero(steps_s > max(_PAUSE_PERIODS * period_s, _PAUSE_S))
    if not len(pauses) or period_s <= 0:
        return 0.0
    lengths_s = steps_s[pauses]
    # As many as usual come in as long a time behind a pause; more of them had waited.
    ends_s = seconds[pauses + 1]
    watched_s = np.minimum(lengths_s, seconds[-1] - ends_s)
    came = np.searchsorted(seconds, ends_s + watched_s, "right") - (pauses + 2)
    waited_s = np.clip(came * period_s - watched_s, 0.0, lengths_s)
    lost_s = float((lengths_s - waited_s - period_s).clip(0.0).sum())
    is_how_they_come = len(pauses) > 2 and lost_s > _MAX_PAUSED * (seconds[-1] - seconds[0])
    return 0.0 if is_how_they_come else lost_s
