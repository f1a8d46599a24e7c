"""Detect a change of the sampling rate, such as a camera's in the dark."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# A rate that changes is sought in so many parts of equal length, with so many samples each.
_PARTS, _MIN_OF_PART = 8, 10

_OTHER_RATE = 0.1  # of a rate: parts differ by more where it changes
# Of a usual step, and of the steps of a part that is left out because its samples had waited.
_AT_ONCE, _OFTEN_AT_ONCE = 0.1, 0.2

_SURELY = 8.0  # usual deviations of a part's rate that are no change


def changing_rate(stamps_ns: NDArray[np.int64], lag: int = 1) -> str:
    """Describe a change of sampling rate, as "goes from 60.0 to 30.0 Hz"; "" if there is none.

    Compares the median step of up to eight parts: neither pauses nor missing samples are a change,
    nor is what the scatter of the steps makes likely.

    Args:
        stamps_ns: not decreasing, shape (T,) [ns].
        lag: samples that a step goes over; many where each is late by its own time.
    """
    steps = 1e-6 * (stamps_ns[lag:] - stamps_ns[:-lag]) / lag
    parts = min(_PARTS, len(steps) // max(_MIN_OF_PART, 2 * lag))
    if parts < 2:
        return ""
    # What waited on its way comes at once: no rate of a sensor.
    at_once = 1e-6 * np.diff(stamps_ns)[: len(steps)] < _AT_ONCE * float(np.median(steps))
    pieces = [
        piece
        for piece, waited in zip(
            np.array_split(steps, parts), np.array_split(at_once, parts), strict=True
        )
        if np.mean(waited) < _OFTEN_AT_ONCE
    ]
    if len(pieces) < 2:
        return ""
    medians = np.array([np.median(piece) for piece in pieces])
    # Between one step and the next, neither a slow change nor a sudden one counts.
    changes = np.diff(steps[::lag])
    scatter = float(np.median(np.abs(changes - np.median(changes)))) / np.sqrt(2)
    doubt = _SURELY * scatter / np.sqrt(len(pieces[0]) / lag)
    low, high = float(medians.min()), float(medians.max())
    if low <= 0 or high - low <= _OTHER_RATE * high + doubt:
        return ""
    first, last = 1e3 / medians[[0, -1]]
    if abs(first - last) > _OTHER_RATE * max(first, last):
        return f"goes from {first:.1f} to {last:.1f} Hz"
    return f"changes between {1e3 / high:.1f} and {1e3 / low:.1f} Hz"
