"""What a film's fit starts from: which samples of a track, and which unknowns.

The samples are cut at impacts, at the fall before the first and at the end of the flights after it.
The cost of a fit has dozens of local minima, so it is first looked at everywhere on a grid of
restitutions, fall times and perspectives; the contact's position and the span of the fall are in
closed form for each point of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.drop.free_fall import run_slopes, slope_corners
from analysis.drop.projection import projected
from tunenet_logs.arrays import Array

_SURE_SLOPE = 0.06
"""Noise of a slope, as a fraction of the steepest, at which runs of samples are long enough."""

_FAST, _SHARP = 0.25, 0.25
"""An impact, as fractions: of the fastest fall, before it; of the sharpest corner, at it. They are
higher than for recorded positions: a picture has perspective, and other things that move."""

_LIFTED, _LOW = 1.15, 0.05
"""Fractions of a fall: above the one the ball is lifted, below the other it lies."""

_GAP_S = 1.0
"""A longer time in which the ball is not found ends its bounces."""

_RESTITUTIONS = np.linspace(0.02, 0.995, 40)
_STRETCHES = np.exp(np.linspace(np.log(0.92), np.log(3.2), 22))
"""Fall times, in durations of the part of the fall that is seen."""

_PERSPECTIVES = np.array([-0.8, -0.25, 0.3, 0.9])
"""Within about one standard deviation of their prior."""

_MOST_SAMPLES = 96
"""Of a track that the grid is compared with: its 3520 points are worth no more time."""

_LATER = 5.0
"""Fall durations after the impact that are looked at."""


def film_impacts(seconds: Array, along_px: Array, noise_px: float) -> list[int]:
    """Samples at which a fast fall ends, in order.

    The slopes are taken over as many samples as the noise requires.

    Args:
        seconds: shape (T,).
        along_px: positions along the image's vertical, up positive, shape (T,).
        noise_px: standard deviation of a position.
    """
    period_s = float(np.median(np.diff(seconds)))
    width = 2
    while True:
        if len(along_px) <= 2 * width + 1:
            return []
        slopes = run_slopes(seconds, along_px, width)
        half = (width + 1) // 2
        noise = noise_px * np.sqrt(2 / half) / ((width + 1 - half) * period_s)
        if noise < -_SURE_SLOPE * slopes.min() or 8 * width > len(along_px):
            break
        width += max(1, width // 3)
    return slope_corners(slopes, width, _FAST * min(slopes.min(), 0.0), _SHARP)


def fall_start(along_px: Array, index: int, fraction: float, noise_px: float) -> int:
    """The first sample of the fall to `index`, its slow upper part left out.

    There a hand may still be.

    Args:
        along_px: positions, up positive, shape (T,).
        index: of the impact.
        fraction: of the fall that is kept, from below.
        noise_px: standard deviation of a position.
    """
    low = float(along_px[max(index - 1, 0) : index + 2].min())
    top, first = low, index
    while first > 0 and along_px[first - 1] > top - 4 * noise_px - 0.03 * (top - low):
        first -= 1
        top = max(top, float(along_px[first]))
    high = np.flatnonzero(along_px[first:index] > low + fraction * (top - low))
    return first + (int(high[-1]) + 1 if len(high) else 0)


def bounces_end(seconds: Array, along_px: Array, impacts: Sequence[int]) -> int:
    """Where the bounces after the first of these impacts end: lifted, or long not found.

    Args:
        seconds: shape (T,).
        along_px: positions, up positive, shape (T,).
        impacts: as `film_impacts` finds them, from the first one on.
    """
    index = impacts[0]
    low = float(along_px[max(index - 1, 0) : index + 2].min())
    top = float(along_px[max(0, index - 200) : index].max())
    last = len(along_px)
    limits = [(index, low + _LIFTED * (top - low))]
    if len(impacts) > 1 and impacts[1] > index + 2:  # no bounce is higher than the first
        apex = float(along_px[index : impacts[1]].max())
        limits.append((impacts[1], apex + (_LIFTED - 1) * (top - low)))
    for begin, most in limits:
        above = np.flatnonzero(along_px[begin:last] > most)
        if len(above):
            lying = np.flatnonzero(along_px[begin : begin + above[0]] < low + _LOW * (top - low))
            last = begin + int(lying[-1] if len(lying) else above[0])
    gaps = np.flatnonzero(np.diff(seconds[index:last]) > _GAP_S)
    return index + int(gaps[0]) + 1 if len(gaps) else last


def grid_starts(seconds: Array, along_px: Array, impact_s: float, count: int) -> list[Array]:
    """The best points of the grid, no two of them neighbours.

    Args:
        seconds: shape (T,): the fall, the bounces, nothing before or after.
        along_px: positions along the image's vertical, up positive, shape (T,).
        impact_s: the first impact, to half a sample.
        count: how many are wanted.

    Returns:
        The unknowns of a `FilmFit`, shape (8,) each, best first.
    """
    seen_s = impact_s - float(seconds[0])
    near = seconds < impact_s + _LATER * seen_s
    every = max(1, -(-int(near.sum()) // _MOST_SAMPLES))
    clock, positions = seconds[near][::every] - impact_s, along_px[near][::every]
    falls = seen_s * _STRETCHES
    heights = _ideal_heights(clock / falls[:, None], _RESTITUTIONS[:, None, None])
    shapes = projected(heights, _PERSPECTIVES[:, None, None, None])
    middle = shapes.mean(axis=-1, keepdims=True)
    off, about = shapes - middle, positions - positions.mean()
    spread = (off**2).sum(axis=-1)
    spans = (off @ about) / np.maximum(spread, 1e-12)
    squares = float(about @ about) - spans**2 * spread
    squares = np.where(spans > 0, squares, np.inf) + 1e-9
    starts: list[Array] = []
    taken = np.zeros(squares.shape, dtype=bool)
    while len(starts) < count and not taken.all():
        at = np.unravel_index(np.where(taken, np.inf, squares).argmin(), squares.shape)
        if not np.isfinite(squares[at]):
            break
        view, ball, fall = (int(index) for index in at)
        span = float(spans[at])
        contact = float(positions.mean() - span * middle[view, ball, fall, 0])
        law = [_RESTITUTIONS[ball], impact_s, np.log(falls[fall])]
        starts.append(np.array([*law, contact, span, _PERSPECTIVES[view], 0.0, 0.0]))
        taken[:, max(0, ball - 1) : ball + 2, max(0, fall - 2) : fall + 3] = True
    return starts


def _ideal_heights(times: Array, restitution: Array) -> Array:
    """Heights [drop heights] of a ball that keeps one restitution, without air.

    Args:
        times: [fall times after the first impact]; broadcast with `restitution`.
        restitution: below 1.
    """
    after = np.clip(times, 0.0, None)
    bouncing = 1 - after * (1 - restitution) / (2 * restitution)  # e^n when flight n begins
    flight = np.floor(np.log(np.maximum(bouncing, 1e-12)) / np.log(restitution))
    kept = restitution**flight
    since = after - 2 * restitution * (1 - kept) / (1 - restitution)
    flying = np.clip(since * (2 * restitution * kept - since), 0.0, None)
    falling = 1 - np.clip(times + 1, 0.0, None) ** 2
    return np.where(times < 0, falling, np.where(bouncing > 0, flying, 0.0))
