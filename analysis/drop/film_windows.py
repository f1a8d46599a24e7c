"""Which samples of a track a bounce is fitted to: impacts, the fall before, the flights after."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.drop.free_fall import run_slopes
from tunenet_logs.arrays import Array

_SURE_SLOPE = 0.06
"""Noise of a slope, as a share of the steepest."""

_FAST = 0.25
_CORNER = 0.25
_LIFTED, _LOW = 1.15, 0.05
_GAP_S = 1.0


def film_impacts(seconds: Array, along: Array, noise_px: float) -> list[int]:
    """Samples at which a fast fall ends, in order.

    The slopes are taken over as many samples as the noise asks for.

    Args:
        seconds: shape (T,).
        along: places along the image's vertical, up positive [px], shape (T,).
        noise_px: standard deviation of a place.
    """
    period_s = float(np.median(np.diff(seconds)))
    width = 2
    while True:
        if len(along) <= 2 * width + 1:
            return []
        slopes = run_slopes(seconds, along, width)
        half = (width + 1) // 2
        noise = noise_px * np.sqrt(2 / half) / ((width + 1 - half) * period_s)
        if noise < -_SURE_SLOPE * slopes.min() or 8 * width > len(along):
            break
        width += max(1, width // 3)
    before, after = slopes[:-width], slopes[width:]
    falling = (before < _FAST * min(slopes.min(), 0.0)) & (after > 0.5 * before)
    corner = np.where(falling, after - before, 0.0)
    peaks: list[int] = []
    for index in np.flatnonzero(corner > _CORNER * max(corner.max(), 1e-9)):
        if peaks and index - peaks[-1] <= width:
            peaks[-1] = max(peaks[-1], int(index), key=lambda at: corner[at])
        else:
            peaks.append(int(index))
    return [peak + width for peak in peaks]


def fall_start(along: Array, index: int, share: float, noise_px: float) -> int:
    """The first sample of the fall to `index`, its slow upper part left out.

    There a hand may still be.

    Args:
        along: places, up positive [px].
        index: of the impact.
        share: of the fall that is kept, from below.
        noise_px: standard deviation of a place.
    """
    low = float(along[max(index - 1, 0) : index + 2].min())
    top, first = low, index
    while first > 0 and along[first - 1] > top - 4 * noise_px - 0.03 * (top - low):
        first -= 1
        top = max(top, float(along[first]))
    high = np.flatnonzero(along[first:index] > low + share * (top - low))
    return first + (int(high[-1]) + 1 if len(high) else 0)


def bounces_end(seconds: Array, along: Array, impacts: Sequence[int]) -> int:
    """Where the bounces after the first of these impacts end: lifted, or long not found.

    Args:
        seconds: shape (T,).
        along: places, up positive [px], shape (T,).
        impacts: as `film_impacts` finds them, from the first one on.
    """
    index = impacts[0]
    low = float(along[max(index - 1, 0) : index + 2].min())
    top = float(along[max(0, index - 200) : index].max())
    last = len(along)
    limits = [(index, low + _LIFTED * (top - low))]
    if len(impacts) > 1 and impacts[1] > index + 2:  # no bounce is higher than the first
        apex = float(along[index : impacts[1]].max())
        limits.append((impacts[1], apex + (_LIFTED - 1) * (top - low)))
    for begin, most in limits:
        above = np.flatnonzero(along[begin:last] > most)
        if len(above):
            lying = np.flatnonzero(along[begin : begin + above[0]] < low + _LOW * (top - low))
            last = begin + int(lying[-1] if len(lying) else above[0])
    gaps = np.flatnonzero(np.diff(seconds[index:last]) > _GAP_S)
    return index + int(gaps[0]) + 1 if len(gaps) else last


def held_start(left_px: Array, allowed_px: float) -> int:
    """The first of the samples before a fall in which the ball is where it is let go.

    Args:
        left_px: distance of all samples before the fall from there, in order.
        allowed_px: that is still there.
    """
    first = len(left_px)
    misses = 0
    while first > 0 and misses < 3:
        first -= 1
        misses = misses + 1 if abs(left_px[first]) > allowed_px else 0
    return min(first + misses, len(left_px)) if misses else first
