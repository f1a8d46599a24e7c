"""Outliers of a track: jumps to another thing, repeated pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array
from tunenet_logs.episode import Signal

_MIN_COUNT = 15  # samples of a track in which something may be left out
_MAX_LENGTH = 8  # samples that a tracker stays with another thing
# Least size of a jump: in median steps of the samples around it, and in spans of the track.
_JUMP, _JUMP_SPAN = 3.0, 0.1

_BACK = 0.6  # of a jump: how near to its beginning the way back ends
_MAX = 0.2  # of all samples, that are left out as jumps
_AROUND = 9  # samples before and behind, whose steps a step is compared with
_MOVING = 0.02  # of the track's span, that it moves before and behind a repeated picture
# Between repeated pictures: how many must be seen, and which part of them be multiples of one.
_MIN_GAPS, _REGULAR = 3, 0.6

_MAX_CYCLE = 12  # stamps from one repeated picture to the next
_MAX_MISSING = 4  # stamps of a film for each that was tracked
# Of the smaller step beside it: how far a tracker sees the same picture's ball from itself.
_NEAR = 0.1


@dataclass(frozen=True, eq=False)
class BallAlone:
    """Track without samples that are no places of the ball.

    Attributes:
        signal: what is left.
        jumps_ns: stamps of the jumps left out, shape (J,).
        words: what was left out, for the user.
    """

    signal: Signal
    jumps_ns: NDArray[np.int64]
    words: tuple[str, ...]


def ball_alone(signal: Signal) -> BallAlone | None:
    """Remove jumps and, where no metres are named, repeats; None where nothing is left out."""
    steady = without_jumps(signal) or signal
    once = (None if signal.unit == "m" else without_repeats(steady)) or steady
    jumps_ns = np.setdiff1d(signal.stamps_ns, steady.stamps_ns)
    jumps, repeats = len(jumps_ns), len(steady.values) - len(once.values)
    words: list[str] = []
    if jumps:
        words.append(f"{jumps} samples of {signal.name} jump away and back: they were left out")
    if repeats:
        words.append(f"{repeats} pictures are there twice in {signal.name}: one was left out")
    return BallAlone(once, jumps_ns, tuple(words)) if words else None


def without_jumps(signal: Signal) -> Signal | None:
    """Remove samples that are far from both neighbours; None where none are, or too many.

    A tracker that takes another thing for the ball jumps there, stays for a few samples, and jumps
    back to near where the ball was.
    """
    values, count = signal.values, len(signal.values)
    if count < _MIN_COUNT:
        return None
    low, high = np.quantile(values, (0.02, 0.98), axis=0)
    least = _JUMP_SPAN * float(np.linalg.norm(high - low))
    steps = np.diff(values, axis=0)
    sizes = np.linalg.norm(steps, axis=1)
    far = np.flatnonzero((sizes > least) & (sizes > _JUMP * _medians(sizes)))
    left = np.zeros(count, bool)
    at = 0
    while at < len(far) - 1:
        away = far[at]
        for back in far[at + 1 : at + 1 + _MAX_LENGTH]:
            if back - away > _MAX_LENGTH:
                break
            missed = float(np.linalg.norm(values[back + 1] - values[away]))
            if missed < _BACK * min(sizes[away], sizes[back]):
                left[away + 1 : back + 1] = True
                at = int(np.searchsorted(far, back))
                break
        at += 1
    return _kept(signal, ~left) if 0 < left.sum() <= _MAX * count else None


def without_repeats(signal: Signal) -> Signal | None:
    """Remove samples that are exactly where the one before is while the track moves.

    A film that is played at another rate holds pictures twice. None where no sample is like that.
    """
    if len(signal.values) < _MIN_COUNT:
        return None
    low, high = np.quantile(signal.values, (0.02, 0.98), axis=0)
    sizes = np.linalg.norm(np.diff(signal.values, axis=0), axis=1)
    moving = sizes > _MOVING * float(np.linalg.norm(high - low))
    left = np.zeros((2, len(signal.values)), bool)
    beside = moving[:-2] & moving[2:]
    left[0, 2:-1] = (sizes[1:-1] == 0) & beside
    left[1, 2:-1] = (sizes[1:-1] <= _NEAR * np.minimum(sizes[:-2], sizes[2:])) & beside
    if not left[0].any():
        return None
    return _even(signal, left[1]) or _kept(signal, ~left[0])


def _even(signal: Signal, repeated: NDArray[np.bool_]) -> Signal | None:
    """Retime a film that holds every so many pictures twice; None if it does not.

    What holds 4 pictures in 5 stamps has taken them in 5/4 of a stamp's distance. That also finds
    the other repeated pictures, which a tracker saw at two places or at rest.
    """
    stamps = signal.stamps_ns - signal.stamps_ns[0]
    step_ns = float(np.median(np.diff(stamps)))
    numbers = np.round(stamps / step_ns).astype(np.int64)
    seen = numbers[repeated]
    gaps = np.diff(seen)
    is_film = np.abs(stamps - numbers * step_ns).max() < 0.1 * step_ns
    is_film &= bool(np.diff(numbers).min() > 0 and numbers[-1] < _MAX_MISSING * len(numbers))
    if len(gaps) < _MIN_GAPS or not is_film:
        return None
    fits = [np.count_nonzero(gaps % every == 0) for every in range(_MAX_CYCLE + 1) if every]
    every = max(range(3, _MAX_CYCLE + 1), key=lambda one: (fits[one - 1], one))
    if fits[every - 1] < _REGULAR * len(gaps):
        return None
    regular = np.concatenate([[False], gaps % every == 0, [False]])
    seen = seen[regular[1:] | regular[:-1]]
    gaps = np.diff(seen)
    parts = [np.arange(seen[0], -every, -every)[::-1]]
    for first, gap in zip(seen[:-1], gaps, strict=True):
        count = max(1, round(gap / every))
        parts.append(np.round(first + gap * np.arange(1, count + 1) / count).astype(np.int64))
    parts.append(np.arange(seen[-1] + every, numbers[-1] + 2 * every, every))
    twice = np.concatenate(parts)
    keep = ~np.isin(numbers, twice)
    pictures = numbers - np.searchsorted(twice, numbers, side="right")
    of_twice = twice - 1 - np.arange(len(twice))
    even = np.interp(pictures[keep], of_twice, twice - 1.0) * step_ns
    evenly_ns = signal.stamps_ns[0] + np.round(even).astype(np.int64)
    if np.any(np.diff(evenly_ns) <= 0):
        return None
    return replace(signal, stamps_ns=evenly_ns, values=signal.values[keep])


def _medians(sizes: Array) -> Array:
    """Return the median of the steps around each, itself among them; shape (T - 1,)."""
    padded = np.pad(sizes, _AROUND, mode="reflect")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * _AROUND + 1), axis=1)


def _kept(signal: Signal, keep: NDArray[np.bool_]) -> Signal:
    return replace(signal, stamps_ns=signal.stamps_ns[keep], values=signal.values[keep])
