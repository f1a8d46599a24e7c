"""Detect clock jumps, and keep the longest part of the stamps that one clock gave.

Clocks are set while a log is recorded: a computer that starts in 1970 hears of today, a network's
time steps by seconds, a single message is stamped by nobody. The time between what was recorded
before such a jump and after it is unknown, and a grid over both has no bound.

A pause is no jump: an arm rests, a recorder waits for the next ball. It differs from a jump by its
length, and by what is on both sides. Half a day is longer than any experiment waits; a few samples
many minutes from all others are no recording.

A step back differs from mere disorder by time that occurs twice. Samples that overtook each other
on their way lie, once they are sorted, as far apart as ever: each fills a hole. Where a clock was
set back, the stretches before and after it lie in the same time, and sorted there are too many.
Nor is it disorder where all that was written later lies in a time before, far from the rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_MAX_PAUSE_S = 43_200.0  # between two samples of one recording: half a day
# So many samples, so far from all others, are no part of a recording: their stamps are off.
_ALONE_S, _ALONE_SAMPLES = 600.0, 2

# Samples before and after a step back: where their medians step back too, the clock was set. Where
# they do not, a few samples overtook each other, or one stamp is off.
_AROUND = 5

_BURST = 3  # samples in a row that may be far off without being a stretch of a clock
# Samples over which a period is looked at, and within which samples overtake each other; sorted
# steps of less than so much of the period of such neighbours are those of two stretches.
_LAG, _NEARBY, _HALVED = 32, 128, 0.75

# Samples too many where a clock was set back: at least, of those that lie in the time of others,
# and in standard deviations of what uneven steps make.
_MIN_TOO_MANY, _TOO_MANY, _UNLIKELY = 2.5, 0.3, 5.0

# Samples too many, for each that is between, by which a step back is worth less than another.
_EXPLAINED = 0.5

# Periods between what was written later and what was written before, all of it later in time:
# nearer ones are one recording in another order.
_APART = 10.0

_EVEN = 0.1  # of a period, by which sorted steps of an even clock are too short on average
_MAX_CUTS = 32  # at one longest pause after the other
_S = 1e-9  # a nanosecond


class SoundPart(NamedTuple):
    """Contiguous samples of one clock.

    Attributes:
        keep: their indices, increasing, shape (K,).
        words: what is wrong with the others, one reason each; empty where all are kept.
    """

    keep: NDArray[np.intp]
    words: tuple[str, ...] = ()


def sound_part(stamps_ns: NDArray[np.int64]) -> SoundPart:
    """Return the longest part of sorted stamps, shape (T,) [ns], without a clock jump."""
    steps_s = _steps_s(stamps_ns)
    if not np.any(steps_s > _ALONE_S):
        return SoundPart(np.arange(len(stamps_ns)))
    stretch = _stretches(steps_s > _ALONE_S)
    sizes = np.bincount(stretch)
    is_alone = sizes[stretch] <= min(_ALONE_SAMPLES, int(sizes.max()) // 2)
    alone, kept = np.flatnonzero(is_alone), np.flatnonzero(~is_alone)
    words = [_alone_words(stamps_ns, alone, kept)] if len(alone) else []
    steps_s = _steps_s(stamps_ns[kept])
    jumps = np.flatnonzero(steps_s > _MAX_PAUSE_S)
    if len(jumps):
        rows = _longest(_stretches(steps_s > _MAX_PAUSE_S))
        what = f"jumps by {steps_s[jumps[0]]:.1f} s"
        words.append(_jump_words(what, jumps + 1, len(kept), rows))
        kept = kept[rows]
    return SoundPart(kept, tuple(words))


def written_part(stamps_ns: NDArray[np.int64]) -> SoundPart:
    """Return the longest part of stamps in file order in which the clock is not set back.

    All are kept where what was written later fills holes, or goes before what was written first
    without a pause: then sorting mends it.

    Args:
        stamps_ns: shape (T,) [ns], in the order in which they were written.
    """
    backs = _set_back(stamps_ns)
    if len(backs):
        backs = backs[_repeats_time(stamps_ns, backs)]
    if len(backs):
        return _longest_between(stamps_ns, backs)
    return SoundPart(np.arange(len(stamps_ns)))


def is_disorder(stamps_ns: NDArray[np.int64], others_ns: NDArray[np.int64]) -> bool:
    """Check whether stamps that run back and forth are those of a uniform clock, reordered.

    Args:
        stamps_ns: shape (T,) [ns], in the order in which they were written.
        others_ns: of another clock, of the same samples [ns], shape (T,).
    """
    ordered = np.sort(stamps_ns)
    if _usual_ns(stamps_ns[None]) <= 0:
        return False
    short, other = (
        float(np.mean(_short(one, _usual_ns(one[None])))) for one in (ordered, np.sort(others_ns))
    )
    return short <= max(_EVEN, other / 2)


def fill_holes(stamps_ns: NDArray[np.int64], at: int) -> bool:
    """Check whether stamps from index `at` on, in file order [ns], fill holes of those before."""
    both, before = (_unevenness(np.sort(one)) for one in (stamps_ns, stamps_ns[:at]))
    return both < before / 2


def _unevenness(ordered: NDArray[np.int64]) -> float:
    """Return the mean deviation of steps from their median, relative to it and clipped at 1."""
    steps = np.diff(ordered.astype(np.float64))
    usual = float(np.median(steps)) if len(steps) else 0.0
    return float(np.mean(np.minimum(np.abs(steps / usual - 1), 1))) if usual else 1.0


def filmed_part(stamps_ns: NDArray[np.int64]) -> SoundPart:
    """Return the longest part of pictures, stamped in file order [ns], without a clock jump.

    Pictures are not sorted: what follows a step back is another part, wherever it lies.
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
    """Cut sorted times [s] at their longest steps until a grid of `longest_s` may span them."""
    keep = np.arange(len(seconds))
    words = ""
    for cuts in range(_MAX_CUTS + 1):
        if not len(keep) or seconds[keep[-1]] - seconds[keep[0]] <= longest_s:
            break
        steps_s = np.diff(seconds[keep])
        is_end = steps_s == steps_s.max()
        if cuts == _MAX_CUTS:  # no part without such a step is longer than the grid
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
    """Return the steps between stamps [s], shape (T - 1,); as int64, the longest would not fit."""
    return np.diff(stamps_ns.astype(np.float64)) * _S


def _stretches(is_end: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Number the stretch of each sample, shape (T,); one ends where `is_end`, shape (T - 1,)."""
    stretch = np.zeros(len(is_end) + 1, np.int64)
    stretch[1:] = np.cumsum(is_end)
    return stretch


def _longest(stretch: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the indices of the stretch with the most samples, the first of equals."""
    return np.flatnonzero(stretch == np.bincount(stretch).argmax())


def _ends_before(firsts: NDArray[np.intp], count: int) -> NDArray[np.bool_]:
    """Mark the samples that end a stretch, shape (count - 1,), given the firsts of the others."""
    is_end = np.zeros(count - 1, np.bool_)
    is_end[firsts - 1] = True
    return is_end


def _set_back(stamps_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the first samples after stamps step back, stragglers aside, shape (J,)."""
    reversals = np.flatnonzero(stamps_ns[1:] < stamps_ns[:-1]) + 1
    if not len(reversals) or len(stamps_ns) < 2 * _AROUND:
        return reversals[:0]
    around = reversals[:, None] + np.arange(_AROUND)
    after = stamps_ns[np.minimum(around, len(stamps_ns) - 1)]
    before = stamps_ns[np.maximum(around - _AROUND, 0)]
    middle = _AROUND // 2
    return reversals[np.sort(after, axis=1)[:, middle] < np.sort(before, axis=1)[:, middle]]


def _repeats_time(stamps_ns: NDArray[np.int64], backs: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Check after each step back whether the same or an earlier time follows, shape (J,)."""
    ordered, near = np.sort(stamps_ns), _sorted_nearby(stamps_ns)
    usual_ns, nearby_ns = _usual_ns(ordered[None]), _usual_ns(near)
    period_ns = nearby_ns if usual_ns < _HALVED * nearby_ns else usual_ns
    if period_ns <= 0:
        return np.zeros(len(backs), np.bool_)
    # From where on, and up to where, samples from both sides of each step back lie.
    low, high = _without_strays(stamps_ns)
    at_end, at_start = np.minimum(backs, len(low) - 1), np.maximum(backs - _BURST, 0)
    begins = np.minimum.accumulate(high)[at_start]
    reached = np.maximum.accumulate(low)[at_start]
    ahead = np.minimum.accumulate(high[::-1])[::-1][at_end]
    ends = np.maximum.accumulate(low[::-1])[::-1][at_end]
    entangled = np.minimum(
        backs - np.searchsorted(ordered, ahead, "left"),
        np.searchsorted(ordered, reached, "right") - backs,
    )
    first = np.searchsorted(ordered, np.maximum(ahead, begins), "left")
    last = np.searchsorted(ordered, np.minimum(reached, ends), "right")
    entangled = np.minimum(entangled, (last - first) / 2)
    first = np.maximum(first - _BURST, 0)
    last = np.maximum(np.minimum(last + _BURST, len(ordered) - 1), first)
    # How many samples there are too many: a step that is short by a period is one.
    short = _short(ordered, period_ns)
    mean, spread = min((float(x.mean()), float(x.std())) for x in (short, _short(near, period_ns)))
    steps = last - first
    too_many = np.diff(np.append(0.0, np.cumsum(short))[[first, last]], axis=0)[0] - mean * steps
    enough = np.maximum(_MIN_TOO_MANY, _TOO_MANY * entangled)
    is_set = too_many >= np.maximum(enough, _UNLIKELY * spread * np.sqrt(steps))
    # Or all that comes later lies before all that came first, and far from it.
    apart_ns = begins.astype(np.float64) - ends
    is_apart = (apart_ns > _APART * period_ns) & (_usual_ns(stamps_ns[None]) > 0)
    is_apart &= (backs >= _AROUND) & (backs <= len(ordered) - _AROUND)  # not for a stray at an end
    if np.count_nonzero(stamps_ns[1:] < stamps_ns[:-1]) == len(backs):  # no other disorder
        return is_set | is_apart
    return _strongest(backs, np.where(is_set | is_apart, np.maximum(too_many, is_apart), -np.inf))


def _strongest(backs: NDArray[np.intp], too_many: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Select the steps back that are no mere disorder around a set clock, shape (J,).

    Such have fewer samples too many, the farther from it they are; near it one is as good as
    another.
    """
    far = _EXPLAINED * backs
    is_set = too_many > -np.inf
    is_set[1:] &= too_many[1:] > np.maximum.accumulate(too_many + far)[:-1] - far[1:]
    least = np.maximum.accumulate((too_many - far)[::-1])[::-1]
    is_set[:-1] &= too_many[:-1] >= least[1:] + far[:-1]
    peaks = np.flatnonzero(is_set)
    if len(peaks):
        group = _stretches(np.diff(backs[peaks]) >= _NEARBY)
        best = np.lexsort((-too_many[peaks], group))
        is_set[:] = False
        is_set[peaks[best[np.append(True, np.diff(group) > 0)]]] = True
    return is_set


def _without_strays(stamps_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the minimum and maximum of each `_BURST` stamps in a row, shape (T - 2,) each."""
    one, two, three = stamps_ns[:-2], stamps_ns[1:-1], stamps_ns[2:]
    return np.minimum(np.minimum(one, two), three), np.maximum(np.maximum(one, two), three)


def _sorted_nearby(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sort stamps in blocks of those written together, shape (blocks, `_NEARBY` or fewer)."""
    size = max(2 * _AROUND, min(_NEARBY, len(stamps_ns) // 4))
    blocks = stamps_ns[: len(stamps_ns) // size * size].reshape(-1, size)
    return np.sort(blocks, axis=1)


def _short(stamps_ns: NDArray[np.int64], period_ns: float) -> NDArray[np.float64]:
    """Return by how much of a period each step is too short, 1 at most, shape (..., T - 1)."""
    steps_ns = np.diff(stamps_ns.astype(np.float64))
    return np.clip(1.0 - steps_ns / period_ns, 0.0, 1.0) if period_ns > 0 else 1.0 + 0.0 * steps_ns


def _usual_ns(rows_ns: NDArray[np.int64]) -> float:
    """Return the median step over many samples [ns], of rows of stamps, shape (rows, T)."""
    far = rows_ns.astype(np.float64)
    lag = max(1, min(_LAG, far.shape[1] // 4))
    return float(np.median(far[:, lag:] - far[:, :-lag])) / lag if far.shape[1] > lag else 0.0


def _longest_between(stamps_ns: NDArray[np.int64], backs: NDArray[np.intp]) -> SoundPart:
    """Return the longest stretch between steps back, with a reason that names the first."""
    count, at = len(stamps_ns), int(backs[0])
    before, after = stamps_ns[max(at - _AROUND, 0) : at], stamps_ns[at : at + _AROUND]
    by_s = (float(before.max()) - float(after.min())) * _S
    rows = _longest(_stretches(_ends_before(backs, count)))
    return SoundPart(rows, (_jump_words(f"is set back by {by_s:.3f} s", backs, count, rows),))


def _jump_words(what: str, jumps: NDArray[np.intp], count: int, rows: NDArray[np.intp]) -> str:
    """Say that the clock jumps (J firsts after a jump), and which rows of `count` are used."""
    where = f"the clock {what} after sample {jumps[0]} of {count}"
    used = f"is used ({len(rows)} samples)"
    if len(jumps) > 1:
        return f"{where}, and {len(jumps) - 1} times more: the longest part {used}"
    return f"{where}: the longer part, {'after' if rows[0] else 'before'} it, {used}"


def _alone_words(
    stamps_ns: NDArray[np.int64], alone: NDArray[np.intp], kept: NDArray[np.intp]
) -> str:
    """Say that samples lie far from all others, and how far the first of them does."""
    count = f"{len(alone)} of {len(stamps_ns)} samples"
    if not np.any(stamps_ns[alone]):
        return f"{count} without a stamp: not used"
    off_ns = np.abs(stamps_ns[kept].astype(np.float64) - float(stamps_ns[alone[0]])).min()
    return f"the clock jumps by {off_ns * _S:.1f} s for {count}: not used"
