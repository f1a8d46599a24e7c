"""Impacts with free flight on both sides, anywhere in a recording.

What is free on both sides of an impact measures the restitution, however the ball came to fly:
let go, thrown, rolled off an edge, or bouncing before the recording began. A hand is no impact:
it holds on, and its motion is no parabola.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.drop.film_search import film_impacts
from tunenet_logs.arrays import Array

_MIN_RUN = 4  # samples of a free flight beside an impact
# A sample is on a flight within so much noise and this part of the fall that the impact ends.
_RUN_SDS, _RUN_OFF = 5.0, 4e-3

# Samples from which on a flight's own curvature is fitted, and how much of gravity it may be: the
# air takes from a fall and adds to a rise.
_OWN_CURVE, _BENT = 8, (0.7, 1.35)

# Standard error of a flight's acceleration, of gravity's, from which on it may be anything.
_UNSURE = 0.15

# The same where a flight may end in a hand.
_SURE_RUN_SDS, _SURE_RUN_OFF, _SURELY_BENT = 3.0, 1e-3, (0.85, 1.15)

_UNSEEN_SDS = 2.0  # standard deviations of the noise within which a hand's beginning is not seen
_MISSES = 3  # samples in a row off a flight, after which it is over
# Sample periods, and fall times, that an impact may last: a hand holds on longer.
_TOUCH_PERIODS, _TOUCH_FALLS = 3.5, 0.12

_SHORT_TOUCH = 0.03  # of the flights on both sides: what is shorter may all be a touch
_BOUNCIEST = 1.0  # restitution from which on something pushes


@dataclass(frozen=True, eq=False)
class Chain:
    """Impacts with free flight before, between and after them.

    Attributes:
        first: index of the first sample of the free flight before the first impact.
        last: index of the last sample of the free flight after the last one.
        impacts: samples at which falls end.
        falls: index of the first sample of each fall that is free.
        flights: index of the last sample of each flight that is free.
    """

    first: int
    last: int
    impacts: tuple[int, ...]
    falls: tuple[int, ...]
    flights: tuple[int, ...]


def chains_in(seconds: Array, heights: Array, gravity: float, noise: float) -> list[Chain]:
    """Find impacts with free flight on both sides, those with nothing else between as one chain.

    Args:
        seconds: shape (T,), increasing.
        heights: along what is up, shape (T,).
        gravity: in their units.
        noise: standard deviation of a height.
    """
    chains: list[Chain] = []
    end = 0
    for index in film_impacts(seconds, heights, noise) if len(seconds) > 2 * _MIN_RUN else []:
        found = _impact_at(seconds, heights, index, end, gravity, noise)
        if found is None:
            continue
        first, at, last = found
        if chains and first <= chains[-1].last + 1:
            before = chains[-1]
            chains[-1] = Chain(
                before.first,
                last,
                (*before.impacts, at),
                (*before.falls, first),
                (*before.flights, last),
            )
        else:
            chains.append(Chain(first, last, (at,), (first,), (last,)))
        end = at
    return chains


def _impact_at(
    seconds: Array, heights: Array, index: int, start: int, gravity: float, noise: float
) -> tuple[int, int, int] | None:
    """Return the fall's first sample and last, and the flight's last; None where none meet."""
    low = index - 1 + int(np.argmin(heights[max(index - 1, 0) : index + 2]))
    best: tuple[tuple[float, int], tuple[int, int, int]] | None = None
    for before in range(low - 2, low + 2):
        for after in range(before + 1, min(before + 4, len(heights) - _MIN_RUN)):
            if before - start < _MIN_RUN:
                continue
            found = _meets(seconds, heights, (before, after), gravity, noise, start)
            if found is None:
                continue
            first, _, last = found[1]
            between_s = float(seconds[after] - seconds[before])
            is_short = between_s < _SHORT_TOUCH * float(seconds[last] - seconds[first])
            # Of flights as long: without what a soft ball does on the ground.
            score = found[0], after - before if is_short else before - after
            if best is None or score > best[0]:
                best = score, found[1]
    return None if best is None else best[1]


def _meets(
    seconds: Array,
    heights: Array,
    around: tuple[int, int],
    gravity: float,
    noise: float,
    start: int,
) -> tuple[float, tuple[int, int, int]] | None:
    """Return how long both flights are, and their ends, where they meet between two samples."""
    before, after = around
    fall = _line(seconds, heights, np.arange(max(start, before - 5), before + 1), gravity)
    rise = _line(seconds, heights, np.arange(after, min(after + 6, len(heights))), gravity)
    at_s = (seconds[before] + seconds[after]) / 2
    falling, rising = -_slope(fall, at_s), _slope(rise, at_s)
    if not 0.02 * falling < rising < (_BOUNCIEST + 0.1) * falling:
        return None
    depth = falling**2 / (2 * gravity)
    near = _RUN_SDS * noise + _RUN_OFF * depth
    first = _run(seconds, heights, before, -1, start, gravity, near)
    last = _run(seconds, heights, after, 1, len(heights) - 1, gravity, near)
    if first is None or last is None:
        return None
    sides = np.arange(first, before + 1), np.arange(after, last + 1)
    down, up = (_parabola(seconds, heights, rows, gravity) for rows in sides)
    falling, rising = -_slope(down, at_s), _slope(up, at_s)
    if not 0.02 * falling < rising < _BOUNCIEST * falling:
        return None
    gap = _value(up, at_s) - _value(down, at_s)
    meets_s = at_s - gap / (rising + falling)
    period_s = float(np.median(np.diff(seconds[first : last + 1])))
    slack_s = 0.5 * period_s + 4 * noise / (rising + falling)
    if not seconds[before] - slack_s < meets_s < seconds[after] + slack_s:
        return None
    touch_s = max(_TOUCH_PERIODS * period_s, _TOUCH_FALLS * falling / gravity)
    is_brief = seconds[after] - seconds[before] <= touch_s
    if is_brief and all(_is_free(seconds[rows], heights[rows], gravity, noise) for rows in sides):
        return float(last - first), (first, before, last)
    return None


def surely_free(
    seconds: Array, heights: Array, chain: Chain, gravity: float, noise: float
) -> tuple[int, int]:
    """Return the first and last sample of a chain that no hand touches, or is about to."""
    speed = np.ptp(heights[chain.first : chain.last + 1])
    near = _SURE_RUN_SDS * noise + _SURE_RUN_OFF * float(speed)
    before, after = chain.impacts[0], chain.impacts[-1] + 1
    first = _run(seconds, heights, before, -1, chain.first, gravity, near, _SURELY_BENT)
    last = _run(seconds, heights, after, 1, chain.last, gravity, near, _SURELY_BENT)
    unseen_s = float(np.sqrt(2 * _UNSEEN_SDS * noise / gravity))
    first = chain.first if first is None else first
    last = chain.last if last is None else last
    if first > 0:
        first = int(np.searchsorted(seconds, seconds[first] + unseen_s))
    if last < len(seconds) - 2:
        last = int(np.searchsorted(seconds, seconds[last] - unseen_s, side="right")) - 1
    return first, last


def _run(
    seconds: Array,
    heights: Array,
    at: int,
    step: int,
    end: int,
    gravity: float,
    near: float,
    bent: tuple[float, float] = _BENT,
) -> int | None:
    """Extend a free flight from a sample in a direction, to its last; None if too short."""
    count = min(6, abs(end - at) + 1)
    if count < _MIN_RUN:
        return None
    last = at + step * (count - 1)
    while True:
        rows = np.arange(min(at, last), max(at, last) + 1)
        curve = _parabola(seconds, heights, rows, gravity, bent)
        off = np.abs(heights[rows] - np.polyval(curve[:3], seconds[rows] - curve[3]))
        if np.count_nonzero(off > near) > 0.1 * len(rows):
            return None
        ahead = last + step * np.arange(1, max(2, len(rows) // 2) + 1)
        ahead = ahead[(ahead >= min(at, end)) & (ahead <= max(at, end))]
        if not len(ahead):
            return last
        on = np.abs(heights[ahead] - np.polyval(curve[:3], seconds[ahead] - curve[3])) < near
        misses = np.convolve(~on, np.ones(_MISSES), "full")[: len(on)] >= _MISSES
        if misses.any():
            ahead = ahead[: int(misses.argmax())]
            on = on[: len(ahead)]
        if not on.any():
            return last
        reached = int(ahead[np.flatnonzero(on)[-1]])
        if reached == last:
            return last
        last = reached
        if misses.any():
            return last


def _is_free(seconds: Array, heights: Array, gravity: float, noise: float) -> bool:
    """Return whether a flight shows gravity, long enough to: a hand pulls otherwise."""
    if len(seconds) < _MIN_RUN:
        return False
    inverse = np.linalg.pinv(np.vander(seconds - seconds.mean(), 3))
    shown = -2 * float(inverse[0] @ heights) / gravity
    error = 2 * noise * float(np.linalg.norm(inverse[0])) / gravity
    low, high = _BENT
    return error < _UNSURE and low - 2 * error < shown < high + 2 * error


def _line(seconds: Array, heights: Array, rows: NDArray[np.intp], gravity: float) -> Array:
    """Fit a parabola of gravity's curvature: half of it, slope, height and time at the middle."""
    middle = float(seconds[rows].mean())
    since = seconds[rows] - middle
    straight = heights[rows] + gravity / 2 * since**2
    slope, height = np.polyfit(since, straight, 1) if len(rows) > 1 else (0.0, straight[0])
    return np.array([-gravity / 2, slope, height, middle])


def _parabola(
    seconds: Array,
    heights: Array,
    rows: NDArray[np.intp],
    gravity: float,
    bent: tuple[float, float] = _BENT,
) -> Array:
    """Fit the same with its own curvature near gravity's, where the samples are many."""
    if len(rows) < _OWN_CURVE:
        return _line(seconds, heights, rows, gravity)
    middle = float(seconds[rows].mean())
    since = seconds[rows] - middle
    curve = float(np.polyfit(since, heights[rows], 2)[0])
    low, high = bent
    return _line(seconds, heights, rows, float(np.clip(-2 * curve, low * gravity, high * gravity)))


def _slope(curve: Array, at_s: float) -> float:
    return float(curve[1] + 2 * curve[0] * (at_s - curve[3]))


def _value(curve: Array, at_s: float) -> float:
    return float(np.polyval(curve[:3], at_s - curve[3]))
