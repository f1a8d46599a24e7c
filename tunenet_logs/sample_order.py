"""Choose which of a log's clocks to trust, and sort its samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.clock_jumps import is_disorder, sound_part, written_part
from tunenet_logs.left_out import BY_CLOCK, SAME_STAMP

# Of a channel's samples: a few that overtake each other on a network are sorted; from a tenth on
# the header's clock is set back again and again, unless its stamps are even once they are sorted.
_MAX_REVERSED_FRACTION = 0.1

# Of a channel's stamps; below it, its sender hardly ever sets the header's stamp.
_MIN_DISTINCT_FRACTION = 0.1

# Of a channel's stamps before or after a jump: with more of them the others are left out.
_MAX_SOUND = 0.9


_MAX_AHEAD = 16  # pictures that wait until their turn comes: what memory holds of large ones


class SampleOrder(NamedTuple):
    """Samples of one clock, in order.

    Attributes:
        keep: indices of the K samples to keep, shape (K,).
        stamps_ns: theirs [ns], shape (K,), strictly increasing.
        notes: what was repaired.
        left_out: samples that are not kept, by the reason; not those that repeat one that is.
    """

    keep: NDArray[np.intp]
    stamps_ns: NDArray[np.int64]
    notes: list[str]
    left_out: dict[str, int]


def trusts_header(
    header_ns: NDArray[np.int64], log_ns: NDArray[np.int64]
) -> tuple[bool, list[str]]:
    """Check whether a channel's header stamps can be trusted, and give the reason if not.

    They cannot where the log's own times say more: where they are not set or hardly change, run
    backwards, or jump while the log's do not. A single stamp that is off is no reason: it is left
    out.

    Args:
        header_ns: acquisition stamps of T messages in file order [ns], shape (T,); 0 where not set.
        log_ns: receipt stamps of the same messages [ns], shape (T,).
    """
    if not len(header_ns):
        return True, []
    if np.count_nonzero(header_ns == 0) > 1:
        return False, []
    if len(distinct(header_ns)) <= _MIN_DISTINCT_FRACTION * len(header_ns):
        return False, ["header stamps hardly change, so the log's own times are used"]
    if jumps := _jumps(header_ns):
        what = f"{jumps.partition(':')[0]} in header stamps, so the log's own times are used"
        return (True, []) if _jumps(log_ns) else (False, [what])
    reversed_fraction = np.count_nonzero(np.diff(header_ns) < 0) / len(header_ns)
    if reversed_fraction > _MAX_REVERSED_FRACTION and not is_disorder(header_ns, log_ns):
        return False, ["header stamps run backwards, so the log's own times are used"]
    return True, []


def distinct(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the unique stamps, sorted: much faster than by hashing, as most are sorted."""
    ordered = np.sort(stamps_ns)
    return ordered[np.diff(ordered, prepend=ordered[:1] - 1) > 0]


def _jumps(stamps_ns: NDArray[np.int64]) -> str:
    """Describe how a clock jumps, where much is lost by it; "" where it does not."""
    for part in (written_part(stamps_ns), sound_part(np.sort(stamps_ns))):
        if len(part.keep) < _MAX_SOUND * len(stamps_ns):
            return part.words[-1]
    return ""


def places_ahead(stamps_ns: NDArray[np.int64]) -> int:
    """Return how far ahead in a file the next sample in order lies; 0 if sorting mends nothing."""
    is_sorted = not np.any(stamps_ns[1:] < stamps_ns[:-1])
    if is_sorted or len(written_part(stamps_ns).keep) < len(stamps_ns):
        return 0
    order = np.argsort(stamps_ns, kind="stable")
    ahead = int((np.maximum.accumulate(order) - np.arange(len(order))).max())
    return ahead if ahead <= _MAX_AHEAD else 0


def order_samples(
    header_ns: NDArray[np.int64],
    log_ns: NDArray[np.int64],
    values: Sequence[NDArray[np.float64]] = (),
) -> SampleOrder:
    """Sort samples by header stamps where these can be trusted, else by the log's own.

    Args:
        header_ns: acquisition stamps of T messages in file order [ns], shape (T,); 0 where not set.
        log_ns: receipt stamps of the same messages [ns], shape (T,).
        values: see `sorted_stamps`.
    """
    is_header, notes = trusts_header(header_ns, log_ns)
    found = sorted_stamps(header_ns if is_header else log_ns, values)
    return found._replace(notes=notes + found.notes)


def sorted_stamps(
    stamps: NDArray[np.int64], values: Sequence[NDArray[np.float64]] = ()
) -> SampleOrder:
    """Sort; keep the first sample of each stamp, and the longest part of a clock set back.

    Args:
        stamps: of T samples in file order [ns], shape (T,).
        values: what the samples are, each of shape (T, ...): one that repeats all values of another
            with its stamp is not missed.
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
        if others := _others(written[order[duplicates]], written[order[known]], values):
            left_out[SAME_STAMP] = others
    return SampleOrder(written[order[fresh]], ordered[fresh], notes, left_out)


def _others(
    rows: NDArray[np.intp], known: NDArray[np.intp], values: Sequence[NDArray[np.float64]]
) -> int:
    """Count the rows with a value other than that of the row known at their time."""
    differs = np.full(len(rows), not values)
    for one in values:
        new, old = (one[at].reshape(len(rows), -1) for at in (rows, known))
        differs |= np.any((new != old) & ~(np.isnan(new) & np.isnan(old)), axis=1)
    return int(np.count_nonzero(differs))
