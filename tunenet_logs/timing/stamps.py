"""Stamps of samples: the clock of live ones, jumps of a clock, gaps, rates, and their order.

Clocks are set while a log is recorded, and the time across such a jump is unknown: the longest part
that one clock gave is kept. A pause is a jump only if no experiment waits so long (half a day), or
if it leaves a few samples many minutes from all others. Samples that overtook each other are mere
disorder: once sorted they lie as far apart as ever, as each fills a hole. Where a clock was set
back, time occurs twice, so they are too many; or all that came later lies far before the rest.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import BY_CLOCK, SAME_STAMP, Episode, added, median_step
from tunenet_logs.terminal import listed


@cache
def _anchor_ns() -> int:
    return time.time_ns() - time.monotonic_ns()


def wall_ns(monotonic_ns: int) -> int:
    """Convert monotonic time to wall time [ns]: a clock that is set must not bend the stamps."""
    return _anchor_ns() + monotonic_ns


def now_ns() -> int:
    """Return the current time on that clock [ns since 1970]."""
    return _anchor_ns() + time.monotonic_ns()


# ---- Clock jumps: the longest part of the stamps that one clock gave

_MAX_PAUSE_S = 43_200.0  # between two samples of one recording: half a day
_ALONE_S = 600.0  # a few samples so far from all others are no part of a recording
# Samples before and after a step back: where their medians step back too, the clock was set. Where
# they do not, a few samples overtook each other, or one stamp is off.
_AROUND = 5
_BURST = 3  # samples in a row that may be far off without being a stretch of a clock
_NEARBY = 128  # samples within which they overtake each other


class ContiguousSegment(NamedTuple):
    """Contiguous samples of one clock."""

    keep: NDArray[np.intp]  # their indices, increasing, shape (K,)
    # what is wrong with the others, one reason each; empty where all are kept
    words: tuple[str, ...] = ()


def sound_part(stamps_ns: NDArray[np.int64]) -> ContiguousSegment:
    """Return the longest part of sorted stamps, shape (T,) [ns], without a clock jump."""
    times_ns = stamps_ns.astype(np.float64)  # as int64, the longest step would not fit
    stretch = _stretches(np.diff(times_ns) * 1e-9 > _ALONE_S)
    if not stretch[-1]:
        return ContiguousSegment(np.arange(len(stamps_ns)))
    # One or two samples far from all others: their stamps are off.
    sizes = np.bincount(stretch)
    is_alone = sizes[stretch] <= min(2, int(sizes.max()) // 2)
    kept, words = np.flatnonzero(~is_alone), []
    if is_alone.any():
        count = f"{np.count_nonzero(is_alone)} of {len(stamps_ns)} samples"
        words = [f"{count} without a stamp: not used"]
        if np.any(stamps_ns[is_alone]):
            off_s = np.abs(times_ns[kept] - times_ns[is_alone][0]).min() * 1e-9
            words = [f"the clock jumps by {off_s:.1f} s for {count}: not used"]
    # The longest part without a pause in which no experiment waits.
    steps_s = np.diff(times_ns[kept]) * 1e-9
    jumps = np.flatnonzero(steps_s > _MAX_PAUSE_S)
    if len(jumps):
        rows = _longest(_stretches(steps_s > _MAX_PAUSE_S))
        what = f"jumps by {steps_s[jumps[0]]:.1f} s"
        words.append(_jump_words(what, jumps + 1, len(kept), rows))
        kept = kept[rows]
    return ContiguousSegment(kept, tuple(words))


def written_part(stamps_ns: NDArray[np.int64]) -> ContiguousSegment:
    """Return the longest part of stamps in file order in which the clock is not set back.

    All are kept where what was written later fills holes, or goes before what was written first
    without a pause: then sorting mends it.
    """
    backs = _set_back(stamps_ns)
    if len(backs):
        backs = backs[_repeats_time(stamps_ns, backs)]
    return _longest_between(stamps_ns, backs)


def is_disorder(stamps_ns: NDArray[np.int64], others_ns: NDArray[np.int64]) -> bool:
    """Check whether stamps that run back and forth are those of a uniform clock, reordered.

    `others_ns` are the same samples' stamps by another clock; both are in file order, shape (T,).
    """
    ordered = np.sort(stamps_ns)
    if _usual_ns(stamps_ns) <= 0:
        return False
    short, other = (
        float(np.mean(_short(one, _usual_ns(one)))) for one in (ordered, np.sort(others_ns))
    )
    return short <= max(0.1, other / 2)  # of a period, by which sorted steps are too short


def fill_holes(stamps_ns: NDArray[np.int64], at: int) -> bool:
    """Check whether stamps from index `at` on, in file order [ns], fill holes of those before."""
    uneven: list[float] = []  # mean deviation of steps from their median, relative and at most 1
    for one in (stamps_ns, stamps_ns[:at]):
        steps = np.diff(np.sort(one).astype(np.float64))
        usual = float(np.median(steps)) if len(steps) else 0.0
        off = np.mean(np.minimum(np.abs(steps / usual - 1), 1)) if usual else 1.0
        uneven.append(float(off))
    return uneven[0] < uneven[1] / 2


def filmed_part(stamps_ns: NDArray[np.int64]) -> ContiguousSegment:
    """Return the longest part of pictures, stamped in file order [ns], without a clock jump.

    Pictures are not sorted: what follows a step back is another part, wherever it lies.
    """
    order = np.argsort(stamps_ns, kind="stable")
    in_time = sound_part(stamps_ns[order])
    keep = np.sort(order[in_time.keep])
    part = _longest_between(stamps_ns[keep], _set_back(stamps_ns[keep]))
    return ContiguousSegment(keep[part.keep], (*in_time.words, *part.words))


def part_on_grid(seconds: NDArray[np.float64], longest_s: float) -> ContiguousSegment:
    """Cut sorted times [s] at their longest steps until a grid of `longest_s` may span them."""
    keep = np.arange(len(seconds))
    words = ""
    for cuts in range(33):
        if not len(keep) or seconds[keep[-1]] - seconds[keep[0]] <= longest_s:
            break
        steps_s = np.diff(seconds[keep])
        is_end = steps_s == steps_s.max()
        if cuts == 32:  # no part without such a step is longer than the grid
            is_end = steps_s > longest_s / len(keep)
        at = int(steps_s.argmax()) + 1
        rows = _longest(_stretches(is_end))
        side = "before" if rows[0] < at else "after"
        words = words or (
            f"a pause of {steps_s[at - 1]:.1f} s after sample {at} of {len(keep)} is too long: the "
            f"longer part, {side} it, is used"
        )
        keep = keep[rows]
    return ContiguousSegment(keep, (f"{words} ({len(keep)} samples)",) if words else ())


def _stretches(is_end: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Number the stretch of each sample, shape (T,); one ends where `is_end`, shape (T - 1,)."""
    stretch = np.zeros(len(is_end) + 1, np.int64)
    stretch[1:] = np.cumsum(is_end)
    return stretch


def _longest(stretch: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the indices of the stretch with the most samples, the first of equals."""
    return np.flatnonzero(stretch == np.bincount(stretch).argmax())


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
    ordered = np.sort(stamps_ns)
    # And sorted in blocks of those written together, shape (blocks, `_NEARBY` or fewer).
    size = max(2 * _AROUND, min(_NEARBY, len(stamps_ns) // 4))
    near = np.sort(stamps_ns[: len(stamps_ns) // size * size].reshape(-1, size), axis=1)
    usual_ns, nearby_ns = _usual_ns(ordered), _usual_ns(near)
    # Much shorter steps than those of neighbours are those of two stretches.
    period_ns = nearby_ns if usual_ns < 0.75 * nearby_ns else usual_ns
    if period_ns <= 0:
        return np.zeros(len(backs), np.bool_)
    # From where on, and up to where, samples from both sides of each step back lie: strays aside,
    # by the minimum and maximum of each `_BURST` stamps in a row, shape (T - 2,) each.
    one, two, three = stamps_ns[:-2], stamps_ns[1:-1], stamps_ns[2:]
    low, high = np.minimum(np.minimum(one, two), three), np.maximum(np.maximum(one, two), three)
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
    # Of those in the time of others; and beyond 5 standard deviations of what uneven steps make.
    enough = np.maximum(2.5, 0.3 * entangled)
    is_set = too_many >= np.maximum(enough, 5.0 * spread * np.sqrt(steps))
    # Or all that comes later lies before all that came first, and far from it: what is nearer is
    # one recording in another order.
    apart_ns = begins.astype(np.float64) - ends
    is_apart = (apart_ns > 10.0 * period_ns) & (_usual_ns(stamps_ns) > 0)
    is_apart &= (backs >= _AROUND) & (backs <= len(ordered) - _AROUND)  # not for a stray at an end
    if np.count_nonzero(stamps_ns[1:] < stamps_ns[:-1]) == len(backs):  # no other disorder
        return is_set | is_apart
    return _strongest(backs, np.where(is_set | is_apart, np.maximum(too_many, is_apart), -np.inf))


def _strongest(backs: NDArray[np.intp], too_many: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Select the steps back that are no mere disorder around a set clock, shape (J,)."""
    far = 0.5 * backs  # samples too many by which it is worth less, for each that is between
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


def _short(stamps_ns: NDArray[np.int64], period_ns: float) -> NDArray[np.float64]:
    """Return by how much of a period each step is too short, 1 at most, shape (..., T - 1)."""
    steps_ns = np.diff(stamps_ns.astype(np.float64))
    return np.clip(1.0 - steps_ns / period_ns, 0.0, 1.0) if period_ns > 0 else 1.0 + 0.0 * steps_ns


def _usual_ns(rows_ns: NDArray[np.int64]) -> float:
    """Return the median step over many samples [ns], of stamps of shape (T,) or (rows, T)."""
    count = rows_ns.shape[-1]
    lag = max(1, min(32, count // 4))
    return median_step(rows_ns.astype(np.float64), lag) if count > lag else 0.0


def _longest_between(stamps_ns: NDArray[np.int64], backs: NDArray[np.intp]) -> ContiguousSegment:
    """Return the longest stretch between steps back, with a reason that names the first."""
    count = len(stamps_ns)
    if not len(backs):
        return ContiguousSegment(np.arange(count))
    at = int(backs[0])
    before, after = stamps_ns[max(at - _AROUND, 0) : at], stamps_ns[at : at + _AROUND]
    by_s = (float(before.max()) - float(after.min())) * 1e-9
    rows = _longest(_stretches(np.isin(np.arange(1, count), backs)))
    words = _jump_words(f"is set back by {by_s:.3f} s", backs, count, rows)
    return ContiguousSegment(rows, (words,))


def _jump_words(what: str, jumps: NDArray[np.intp], count: int, rows: NDArray[np.intp]) -> str:
    """Say that the clock jumps (J firsts after a jump), and which rows of `count` are used."""
    where = f"the clock {what} after sample {jumps[0]} of {count}"
    used = f"is used ({len(rows)} samples)"
    if len(jumps) > 1:
        return f"{where}, and {len(jumps) - 1} times more: the longest part {used}"
    return f"{where}: the longer part, {'after' if rows[0] else 'before'} it, {used}"


# ---- Gaps: times in which a recording's source was away, noted in the log
# Nobody knows what happened in between, and a camera that was connected anew may count its time
# anew: what one part shows is not continued in the next.

# Note of the info record: stamps [ns] of the pictures before and after each gap, such as
# `1700000000000000000-1700000001200000000,...`.
_GAPS_NOTE = "gaps"
LAST_NS = 2**63 - 1  # the last stamp that fits int64: in the year 2262


class Gap(NamedTuple):
    """Interval in which the source delivered nothing."""

    last_ns: int  # stamp of the last picture before it
    next_ns: int  # stamp of the first picture after it

    @property
    def seconds(self) -> float:
        """Length [s]."""
        return (self.next_ns - self.last_ns) * 1e-9


def noted_gaps(notes: Mapping[str, str]) -> tuple[Gap, ...]:
    """Parse the gaps listed in an info record's notes; what is no gap is left out."""
    pairs = re.findall(r"(\d{1,19})-(\d{1,19})", notes.get(_GAPS_NOTE, ""), re.ASCII)
    found = (Gap(int(last), int(after)) for last, after in pairs)
    return tuple(gap for gap in found if gap.last_ns < gap.next_ns <= LAST_NS)


def gap_note(gaps: Iterable[Gap]) -> tuple[str, str]:
    """Return name and text of the note that lists the gaps."""
    return _GAPS_NOTE, ",".join(f"{gap.last_ns}-{gap.next_ns}" for gap in gaps)


def gaps_in_words(gaps: Iterable[Gap], start_ns: int) -> str:
    """Describe the length and time of each gap: "1.20 s at 2.45 s", counted from `start_ns`."""
    return listed(f"{gap.seconds:.2f} s at {(gap.last_ns - start_ns) * 1e-9:.2f} s" for gap in gaps)


def parts_between(stamps_ns: NDArray[np.int64], gaps: Iterable[Gap]) -> NDArray[np.intp]:
    """Number the part between gaps in which each sample lies, shape (T,), from 0.

    Each gap parts the samples at the longest of their steps that it touches: a stamp may have been
    corrected since. A gap that such stamps fill, because what was late came after all, parts
    nothing.
    """
    ordered = np.sort(stamps_ns)
    steps_s = np.diff(ordered.view(np.uint64)).astype(np.float64) * 1e-9  # which cannot overflow
    cuts_ns: set[int] = set()
    for gap in gaps:
        first = max(int(np.searchsorted(ordered, gap.last_ns, side="right")) - 1, 0)
        last = int(np.searchsorted(ordered, gap.next_ns, side="left"))
        touched = steps_s[first:last]
        # Where no step is half as long any more, late samples filled it.
        if len(touched) and touched.max() >= 0.5 * gap.seconds:
            cuts_ns.add(int(ordered[first + int(touched.argmax()) + 1]))
    return np.searchsorted(np.array(sorted(cuts_ns), np.int64), stamps_ns, side="right")


# ---- Measured rate: number of messages over time, pauses left out

# No film and no sensor is faster: what seems so came in one piece, and tells no rate.
MAX_SPEED_HZ = 100_000.0
MAX_SPEED_CAMERA_HZ = 2000.0  # no camera that is plugged in or in a network is faster


def measured_hz(
    stamps_ns: Sequence[int] | NDArray[np.int64], fastest_hz: float = MAX_SPEED_HZ
) -> float:
    """Return the mean message rate [Hz], at most `fastest_hz`; 0 where the stamps determine none.

    A pause is left out, but for what of it the messages behind it make up for: what a stopped
    recorder or a stalled network only delayed is not lost, and its time counts.
    """
    stamps = np.sort(np.array(stamps_ns, np.int64))
    seconds = (stamps - stamps[:1]).astype(np.float64) * 1e-9
    # The median period over many messages [s], so that bursts level out: few are longer than 30.
    lag = max(1, min(30, (len(seconds) - 1) // 4))
    period_s = median_step(seconds, lag) if len(seconds) > lag else 0.0
    if period_s > 0:  # without closer ones at the beginning, which had waited to be asked for
        late = np.diff(seconds) >= 0.1 * period_s
        seconds = seconds[int(late.argmax()) :] if late.any() else seconds
    count = len(seconds) - 1
    if count < 1:
        return 0.0
    counted_s = whole_s = float(seconds[-1] - seconds[0])
    steps_s = np.diff(seconds)
    pauses = np.flatnonzero(steps_s > max(10.0 * period_s, 0.5))  # a burst's own steps are shorter
    if len(pauses) and period_s > 0:
        lengths_s = steps_s[pauses]
        # As many as usual come in as long a time behind a pause; more of them had waited.
        ends_s = seconds[pauses + 1]
        watched_s = np.minimum(lengths_s, seconds[-1] - ends_s)
        came = np.searchsorted(seconds, ends_s + watched_s, "right") - (pauses + 2)
        waited_s = np.clip(came * period_s - watched_s, 0.0, lengths_s)
        lost_s = float((lengths_s - waited_s - period_s).clip(0.0).sum())
        is_how_they_come = len(pauses) > 2 and lost_s > 0.9 * whole_s
        counted_s -= 0.0 if is_how_they_come else lost_s
    return count / counted_s if counted_s * fastest_hz >= count else 0.0


# ---- One clock for an episode: each signal without what lies across a jump


def trim_clock_jumps(episode: Episode) -> Episode:
    """Keep the longest part of each signal without a clock jump, and warn of each cut."""
    parts = {name: sound_part(signal.stamps_ns) for name, signal in episode.signals.items()}
    signals = dict(episode.signals)
    for name, part in parts.items():
        if part.words:
            one, keep = signals[name], part.keep
            left_out = added(one.left_out, {BY_CLOCK: len(one.stamps_ns) - len(keep)})
            signals[name] = replace(
                one, stamps_ns=one.stamps_ns[keep], values=one.values[keep], left_out=left_out
            )
    warnings = tuple(dict.fromkeys((*episode.warnings, *_said(parts))))
    return replace(episode, signals=signals, warnings=warnings)


def with_jumps_of_pictures(episode: Episode) -> Episode:
    """Mark the pictures of a video file beyond a jump of their clock as left out."""
    parts = {
        one.topic: filmed_part(one.log_ns)
        for one in episode.channels
        if one.topic in episode.picture_topics
    }
    channels = list(episode.channels)
    for at, one in enumerate(channels):
        if part := parts.get(one.topic):
            channels[at] = replace(one, left_out={BY_CLOCK: one.messages - len(part.keep)})
    return replace(episode, channels=tuple(channels), warnings=(*episode.warnings, *_said(parts)))


def jump_warnings(episode: Episode) -> list[str]:
    """Return warnings about clock jumps of an episode's signals; the same words only once."""
    return _said({name: sound_part(one.stamps_ns) for name, one in episode.signals.items()})


def _said(parts: Mapping[str, ContiguousSegment]) -> list[str]:
    """List what is wrong with the clocks, by the first name of those that share it."""
    found: dict[str, str] = {}
    for name, part in parts.items():
        for words in part.words:
            found.setdefault(words, name)
    return [f"{name}: {words}" for words, name in found.items()]


# ---- Order of samples: which of a log's clocks to trust, and sort by it


class SampleOrder(NamedTuple):
    """Samples of one clock, in order."""

    keep: NDArray[np.intp]  # indices of the K samples to keep, shape (K,)
    stamps_ns: NDArray[np.int64]  # theirs [ns], shape (K,), strictly increasing
    notes: list[str]  # what was repaired
    # samples that are not kept, by the reason; not those that repeat one that is
    left_out: dict[str, int]


def trusts_header(
    header_ns: NDArray[np.int64], log_ns: NDArray[np.int64]
) -> tuple[bool, list[str]]:
    """Check whether a channel's header stamps can be trusted, and give the reason if not.

    They cannot where the log's own times say more: where they are not set (0) or hardly change, run
    backwards, or jump while the log's do not. A single stamp that is off is no reason: it is left
    out. Both are in file order, shape (T,) [ns].
    """
    if not len(header_ns):
        return True, []
    if np.count_nonzero(header_ns == 0) > 1:
        return False, []
    if len(distinct(header_ns)) <= 0.1 * len(header_ns):
        return False, ["header stamps hardly change, so the log's own times are used"]
    if jumps := _jumps(header_ns):
        what = f"{jumps.partition(':')[0]} in header stamps, so the log's own times are used"
        return (True, []) if _jumps(log_ns) else (False, [what])
    # A few that overtake each other on a network are sorted; from a tenth on the clock is set back
    # again and again, unless its stamps are even once they are sorted.
    reversed_fraction = np.count_nonzero(np.diff(header_ns) < 0) / len(header_ns)
    if reversed_fraction > 0.1 and not is_disorder(header_ns, log_ns):
        return False, ["header stamps run backwards, so the log's own times are used"]
    return True, []


def distinct(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the unique stamps, sorted: much faster than by hashing, as most are sorted."""
    ordered = np.sort(stamps_ns)
    return ordered[np.diff(ordered, prepend=ordered[:1] - 1) > 0]


def _jumps(stamps_ns: NDArray[np.int64]) -> str:
    """Describe how a clock jumps, where much is lost by it; "" where it does not."""
    for part in (written_part(stamps_ns), sound_part(np.sort(stamps_ns))):
        if len(part.keep) < 0.9 * len(stamps_ns):
            return part.words[-1]
    return ""


def places_ahead(stamps_ns: NDArray[np.int64]) -> int:
    """Return how far ahead in a file the next sample in order lies; 0 if sorting mends nothing."""
    is_sorted = not np.any(stamps_ns[1:] < stamps_ns[:-1])
    if is_sorted or len(written_part(stamps_ns).keep) < len(stamps_ns):
        return 0
    order = np.argsort(stamps_ns, kind="stable")
    ahead = int((np.maximum.accumulate(order) - np.arange(len(order))).max())
    return ahead if ahead <= 16 else 0  # pictures that wait: what memory holds of large ones


def order_samples(
    header_ns: NDArray[np.int64],
    log_ns: NDArray[np.int64],
    values: Sequence[NDArray[np.float64]] = (),
) -> SampleOrder:
    """Sort samples by header stamps where these can be trusted, else by the log's own."""
    is_header, notes = trusts_header(header_ns, log_ns)
    found = sorted_stamps(header_ns if is_header else log_ns, values)
    return found._replace(notes=notes + found.notes)


def sorted_stamps(
    stamps: NDArray[np.int64], values: Sequence[NDArray[np.float64]] = ()
) -> SampleOrder:
    """Sort; keep the first sample of each stamp, and the longest part of a clock set back.

    A sample that repeats all `values`, each of shape (T, ...), of one with its stamp is not missed.
    """
    written, words = written_part(stamps)
    notes = list(words)
    left_out = {BY_CLOCK: len(stamps) - len(written)} if words else {}
    stamps = stamps[written]
    order = np.argsort(stamps, kind="stable")
    reversals = int(np.count_nonzero(np.diff(stamps) < 0))
    ordered = stamps[order]
    fresh = np.diff(ordered, prepend=ordered[:1] - 1) > 0
    duplicates = np.flatnonzero(~fresh)
    if reversals:
        notes.append(f"{reversals} samples out of order were sorted")
    if len(duplicates):
        notes.append(f"{len(duplicates)} samples with a stamp already seen were left out")
        firsts = np.flatnonzero(fresh)
        known = firsts[np.searchsorted(firsts, duplicates) - 1]
        # Missed are those with a value other than that of the sample known at their time.
        rows, known = written[order[duplicates]], written[order[known]]
        differs = np.full(len(rows), not values)
        for one in values:
            new, old = (one[at].reshape(len(rows), -1) for at in (rows, known))
            differs |= np.any((new != old) & ~(np.isnan(new) & np.isnan(old)), axis=1)
        if others := int(np.count_nonzero(differs)):
            left_out[SAME_STAMP] = others
    return SampleOrder(written[order[fresh]], ordered[fresh], notes, left_out)
