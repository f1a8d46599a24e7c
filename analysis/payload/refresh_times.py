"""When a driver measured what it then publishes, where it publishes faster than it measures.

A value that is new in a message was measured some time since the message before. Where all that
fits one even clock, that clock tells the times far better than the messages do: their beat with it
would look like a tremor of the arm.
"""

from __future__ import annotations

import numpy as np

from tunenet_logs.arrays import Array

_ROUNDS = 5
_MOST_OFF = 0.05
"""Share of the samples that may lie outside of their messages, by which messages are late."""
_SLACK = 0.15
"""Of the time between two messages, likewise."""
_FEWEST = 20


def even_clock(before: Array, seconds: Array) -> Array | None:
    """Times of an even clock at which samples were measured; None where none fits.

    Args:
        before: time of the message before each new sample's [s], shape (T,); the first has none.
        seconds: time of the message that shows it first [s], shape (T,).
    """
    if len(seconds) < _FEWEST:
        return None
    begins, ends = before[1:], seconds[1:]
    middles = (begins + ends) / 2
    ticks = np.arange(1.0, len(seconds))
    period = start = 0.0
    for _ in range(_ROUNDS):
        period, start = np.polyfit(ticks, middles, 1)
        ticks = np.round((middles - start) / period)
    times = start + period * ticks
    slack = _SLACK * float(np.median(ends - begins))
    off = (times < begins - slack) | (times > ends + slack)
    if np.any(np.diff(ticks) < 1) or float(np.mean(off)) > _MOST_OFF:
        return None
    return np.concatenate([times[:1] - period, times])
