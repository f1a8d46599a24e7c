"""Correct regular stamps of which some are held up and then arrive in a burst."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# A longer step is a pause: half-way between the usual step and that over one missing sample.
_PAUSE_PERIODS = 1.5

# A shorter step belongs to a burst that catches up; an even clock's own jitter is smaller.
_CLOSE_PERIODS = 0.9

_PUNCTUAL_PERIODS = 0.3  # a sample is no later than that where the burst has made up for the pause
# Samples in a row that are not close, after which what follows a pause is no burst.
_PATIENCE_SAMPLES = 3

# Of the steps: at least so many go to the very next point of a grid that has points left out.
_SINGLE_FRACTION = 0.1

# Of the median step on a grid: with more, what looks like its frames is how stamps are rounded.
_MAX_MEDIAN_FRAMES = 3

_NEAR_PERIODS = 8  # longer steps tell nothing of a grid: the error of its period adds up
_ROUNDING_NS = 1_100  # of a step between two stamps of whole microseconds, or of ..
_ROUNDING_FRACTION = 1e-3  # ... a frame.


def without_bursts(
    stamps_ns: NDArray[np.int64], steps: NDArray[np.float64], period: float
) -> NDArray[np.int64]:
    """Respace the stamps of a burst after a pause at the usual period.

    Args:
        stamps_ns: not decreasing, shape (T,) [ns].
        steps: between them, shape (T - 1,) [ns].
        period: the usual step [ns].
    """
    corrected, after = stamps_ns.copy(), 0
    for pause in np.flatnonzero(steps > _PAUSE_PERIODS * period):
        end = _caught_up(steps, int(pause), period)
        if end is None or pause < after:
            continue
        inside = slice(pause + 1, end)
        even = stamps_ns[pause] + np.round(period * np.arange(1, end - pause)).astype(np.int64)
        corrected[inside] = np.minimum(even, stamps_ns[inside])
        after = end
    return corrected


def is_grid(steps: NDArray[np.float64], period: float) -> bool:
    """Check whether stamps with these steps [ns] lie on one regular grid, up to rounding."""
    frame = float(np.quantile(steps, _SINGLE_FRACTION, method="lower"))
    if frame <= 0 or period > (_MAX_MEDIAN_FRAMES + 0.5) * frame:
        return False
    near = steps[steps < _NEAR_PERIODS * period]
    counts = np.round(near / frame)
    if counts.min() < 1:
        return False
    frame = float(near.sum() / counts.sum())
    error = float(np.abs(near - counts * frame).max())
    return error <= max(_ROUNDING_NS, _ROUNDING_FRACTION * frame)


def _caught_up(steps: NDArray[np.float64], pause: int, period: float) -> int | None:
    """Return the index after the first step at which a burst is back on the clock, or None."""
    lateness, slow = steps[pause] - period, 0
    for at in range(pause + 1, len(steps)):
        slow = 0 if steps[at] < _CLOSE_PERIODS * period else slow + 1
        lateness += steps[at] - period
        if lateness <= _PUNCTUAL_PERIODS * period:
            return at + 1
        if slow == _PATIENCE_SAMPLES:
            return None
    return None
