"""Where a clock jumps: the part of some stamps that one clock gave, and why not the rest.

Clocks are set while a log is recorded: a computer that starts in 1970 hears of today, a network's
time steps by seconds, a single message is stamped by nobody. What was recorded before such a jump
and what came after it have no known distance, and a grid over both has no bound.

A pause is no jump: an arm rests, a recorder waits for the next ball. It differs from a jump by its
length, and by what is on both sides. Half a day is longer than any experiment waits; a few samples
many minutes from all others are no recording. A step back is told by the order in which samples
were written: two stretches of samples that lie in the same time, one of which came after the other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_LONGEST_PAUSE_S = 43_200.0
"""Between two samples of one recording: half a day."""

_ALONE_S, _ALONE_SAMPLES = 600.0, 2
"""So many samples, so far from all others, are no part of a recording: their stamps are off."""

_AROUND = 5
"""Samples before and after a step back: where their medians step back too, the clock was set. Where
they do not, a few samples overtook each other, or one stamp is off."""

_FEW_CHANGES = 10
"""Changes from one stretch to another, in order of their stamps, that are no overlap."""

_MOST_CUTS = 32
"""At one longest pause after the other."""

_S = 1e-9
"""A nanosecond."""


class SoundPart(NamedTuple):
    """The samples of one clock.

    Attributes:
        keep: their indices, increasing, shape (K,).
        words: what is wrong with the others, one reason each; empty where all are kept.
    """

    keep: NDArray[np.intp]
    words: tuple[str, ...] = ()


def sound_part(stamps_ns: NDArray[np.int64]) -> SoundPart:
    """The longest part of sorted stamps in which the clock does not jump.

    Args:
        stamps_ns: not decreasing, shape (T,) [ns].
    """
    steps_s = _steps_s(stamps_ns)
    if not np.any(steps_s > _ALONE_S):
        return SoundPart(np.arange(len(stamps_ns)))
    stretch = _stretches(steps_s > _ALONE_S)
    sizes = np.bincount(stretch)
    is_alone = sizes[stretch] <= min(_ALONE_SAMPLES, int(sizes.max()) // 2)
    alone, kept = np.flatnonzero(is_alone), np.flatnonzero(~is_alone)
    words = [_alone_words(stamps_ns, alone, kept)] if len(alone) else []
    steps_s = _steps_s(stamps_ns[kept])
    jumps = np.flatnonzero(steps_s > _LONGEST_PAUSE_S)
    if len(jumps):
        rows = _longest(_stretches(steps_s > _LONGEST_PAUSE_S))
        what = f"jumps by {steps_s[jumps[0]]:.1f} s"
        words.append(_jump_words(what, jumps + 1, len(kept), rows))
        kept = kept[rows]
    return SoundPart(kept, tuple(words))


def written_part(stamps_ns: NDArray[np.int64]) -> SoundPart:
    """The longest part of stamps in the order of their file in which the clock is not set back.

    All are kept where what was written later lies in a time of its own: then sorting mends it.

    Args:
        stamps_ns: shape (T,) [ns], in the order in which they were written.
    """
    backs = _set_back(stamps_ns)
    if len(backs):
        stretch = _stretches(_ends_before(backs, len(stamps_ns)))
        in_time = stretch[np.argsort(stamps_ns, kind="stable")]
        if np.count_nonzero(np.diff(in_time)) > 2 * len(backs) + _FEW_CHANGES:
            return _longest_between(stamps_ns, backs)
    return SoundPart(np.arange(len(stamps_ns)))


def filmed_part(stamps_ns: NDArray[np.int64]) -> SoundPart:
    """The longest part of pictures, in the order of their file, in which the clock does not jump.

    Pictures are not sorted: what follows a step back is another part, wherever it lies.

    Args:
        stamps_ns: shape (T,) [ns], in the order of the file.
    """
    order = np.argsort(stamps_ns, kind="stable")
    in_time = sound_part(stamps_ns[order])
    keep, words = np.sort(order[in_time.keep]), in_time.words
    backs = _set_back(stamps_ns[keep])
    if len(backs):
        part = _longest_between(stamps_ns[keep], backs)
        keep, words = keep[part.keep], (*words, *part.words)
    return SoundPart(keep, words)


def part_on_grid(seconds: NDArray[np.float64], longest_s: float) -> SoundPart:
    """The part of sorted times that an even grid may span: what is left, cut at its longest steps.

    Args:
        seconds: not decreasing, shape (T,) [s].
        longest_s: what the grid may span.
    """
    keep = np.arange(len(seconds))
    words = ""
    for cuts in range(_MOST_CUTS + 1):
        if not len(keep) or seconds[keep[-1]] - seconds[keep[0]] <= longest_s:
            break
        steps_s = np.diff(seconds[keep])
        is_end = steps_s == steps_s.max()
        if cuts == _MOST_CUTS:  # no part without such a step is longer than the grid
            is_end = steps_s > longest_s / len(keep)
        at = int(steps_s.argmax()) + 1
        rows = _longest(_stretches(is_end))
        side = "before" if rows[0] < at else "after"
        words = words or (
            f"a pause of {steps_s[at - 1]:.1f} s after sample {at} of {len(keep)} is too long: the "
            f"longer part, {side} it, is used"
        )
        keep = keep[rows]
    return SoundPart(keep, (f"{words} ({len(keep)} samples)",) if words else ())


def _steps_s(stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Steps between stamps [s], shape (T - 1,): as int64, the longest would not fit."""
    return np.diff(stamps_ns.astype(np.float64)) * _S


def _stretches(is_end: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The number of each sample's stretch, shape (T,); one ends where `is_end`, shape (T - 1,)."""
    stretch = np.zeros(len(is_end) + 1, np.int64)
    stretch[1:] = np.cumsum(is_end)
    return stretch


def _longest(stretch: NDArray[np.int64]) -> NDArray[np.intp]:
    """Indices of the stretch with the most samples, the first of equals."""
    return np.flatnonzero(stretch == np.bincount(stretch).argmax())


def _ends_before(firsts: NDArray[np.intp], count: int) -> NDArray[np.bool_]:
    """Whether a stretch ends with a sample, shape (count - 1,), by the first of the others."""
    is_end = np.zeros(count - 1, np.bool_)
    is_end[firsts - 1] = True
    return is_end


def _set_back(stamps_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Indices of the first samples after the clock was set back, shape (J,)."""
    reversals = np.flatnonzero(stamps_ns[1:] < stamps_ns[:-1]) + 1
    if not len(reversals):
        return reversals
    around = reversals[:, None] + np.arange(_AROUND)
    after = stamps_ns[np.minimum(around, len(stamps_ns) - 1)]
    before = stamps_ns[np.maximum(around - _AROUND, 0)]
    middle = _AROUND // 2
    return reversals[np.sort(after, axis=1)[:, middle] < np.sort(before, axis=1)[:, middle]]


def _longest_between(stamps_ns: NDArray[np.int64], backs: NDArray[np.intp]) -> SoundPart:
    """The longest stretch between steps back, and words on the first of them."""
    count, at = len(stamps_ns), int(backs[0])
    by_s = (float(stamps_ns[at - 1]) - float(stamps_ns[at])) * _S
    rows = _longest(_stretches(_ends_before(backs, count)))
    return SoundPart(rows, (_jump_words(f"is set back by {by_s:.3f} s", backs, count, rows),))


def _jump_words(what: str, jumps: NDArray[np.intp], count: int, rows: NDArray[np.intp]) -> str:
    """That the clock jumps, and which part is used.

    Args:
        what: the clock does at its first jump.
        jumps: indices of the first samples after each, shape (J,).
        count: of all samples.
        rows: indices of those that are used.
    """
    where = f"the clock {what} after sample {jumps[0]} of {count}"
    used = f"is used ({len(rows)} samples)"
    if len(jumps) > 1:
        return f"{where}, and {len(jumps) - 1} times more: the longest part {used}"
    return f"{where}: the longer part, {'after' if rows[0] else 'before'} it, {used}"


def _alone_words(
    stamps_ns: NDArray[np.int64], alone: NDArray[np.intp], kept: NDArray[np.intp]
) -> str:
    """That samples lie far from all others, and how far the first of them."""
    count = f"{len(alone)} of {len(stamps_ns)} samples"
    if not np.any(stamps_ns[alone]):
        return f"{count} without a stamp: not used"
    off_ns = np.abs(stamps_ns[kept].astype(np.float64) - float(stamps_ns[alone[0]])).min()
    return f"the clock jumps by {off_ns * _S:.1f} s for {count}: not used"
