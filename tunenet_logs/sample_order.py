"""Which of a log's clocks to believe, and its samples in order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.clock_jumps import sound_part, written_part

_MAX_REVERSED_FRACTION = 0.1
"""Of a channel's samples: a few that overtake each other on a network are sorted; from a tenth on
the header's clock is set back again and again."""

_MIN_DISTINCT_FRACTION = 0.1
"""Of a channel's stamps; below it, its sender hardly ever sets the header's stamp."""

_MOST_SOUND = 0.9
"""Of a channel's stamps before or after a jump: with more of them the others are left out."""


def trusts_header(header_ns: NDArray[np.int64]) -> tuple[bool, list[str]]:
    """Whether a channel's header stamps tell the time; if not for a reason to hear of, that too.

    Args:
        header_ns: acquisition stamps of T messages in file order [ns], shape (T,); 0 where not set.
    """
    if not len(header_ns):
        return True, []
    if np.count_nonzero(header_ns == 0) > 1:
        return False, []
    if len(np.unique(header_ns)) <= _MIN_DISTINCT_FRACTION * len(header_ns):
        return False, ["header stamps hardly change, so the log's own times are used"]
    if np.count_nonzero(np.diff(header_ns) < 0) > _MAX_REVERSED_FRACTION * len(header_ns):
        return False, ["header stamps run backwards, so the log's own times are used"]
    return True, []


def jumps_alone(header_ns: NDArray[np.int64], log_ns: NDArray[np.int64]) -> str:
    """Why the log's own times tell more than a header whose clock jumps; "" where they do not.

    A single stamp that is off is no reason: it is left out.

    Args:
        header_ns: acquisition stamps of T messages in file order [ns], shape (T,).
        log_ns: receipt stamps of the same messages [ns], shape (T,).
    """
    jumps = _jumps(header_ns)
    if not jumps or _jumps(log_ns):
        return ""
    return f"{jumps.partition(':')[0]} in header stamps, so the log's own times are used"


def _jumps(stamps_ns: NDArray[np.int64]) -> str:
    """How a clock jumps, in words, where much is lost by it; "" where it does not."""
    for part in (written_part(stamps_ns), sound_part(np.sort(stamps_ns))):
        if len(part.keep) < _MOST_SOUND * len(stamps_ns):
            return part.words[-1]
    return ""


def order_samples(
    header_ns: NDArray[np.int64], log_ns: NDArray[np.int64]
) -> tuple[NDArray[np.intp], NDArray[np.int64], list[str]]:
    """Choose stamps and sort.

    `header.stamp` is used where it is set and, but for a few samples, monotonic; else `log_time`.

    Args:
        header_ns: acquisition stamps of T messages in file order [ns], shape (T,); 0 where not set.
        log_ns: receipt stamps of the same messages [ns], shape (T,).

    Returns:
        Indices of the K samples to keep, shape (K,), their stamps [ns], shape (K,), strictly
        increasing, and what was repaired.
    """
    is_header, notes = trusts_header(header_ns)
    if is_header and (reason := jumps_alone(header_ns, log_ns)):
        is_header, notes = False, [reason]
    order, ordered, repairs = sorted_stamps(header_ns if is_header else log_ns)
    return order, ordered, notes + repairs


def sorted_stamps(
    stamps: NDArray[np.int64],
) -> tuple[NDArray[np.intp], NDArray[np.int64], list[str]]:
    """Sort; of samples with one stamp the first is kept, and of a clock that is set back one part.

    Args:
        stamps: of T samples in file order [ns], shape (T,).

    Returns:
        Indices of the K samples to keep, shape (K,), their stamps [ns], shape (K,), strictly
        increasing, and what was repaired.
    """
    written, words = written_part(stamps)
    notes = list(words)
    stamps = stamps[written]
    order = np.argsort(stamps, kind="stable")
    reversals = int(np.count_nonzero(np.diff(stamps) < 0))
    ordered = stamps[order]
    fresh = np.diff(ordered, prepend=ordered[:1] - 1) > 0
    duplicates = int(np.count_nonzero(~fresh))
    if reversals:
        notes.append(f"{reversals} samples out of order were sorted")
    if duplicates:
        notes.append(f"{duplicates} samples with a stamp already seen were left out")
    return written[order[fresh]], ordered[fresh], notes
