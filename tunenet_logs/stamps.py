"""Which of a log's clocks to believe, and how to put its samples in order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_MAX_REVERSALS = 0.1
_MIN_DIFFERENT = 0.1


def trusts_header(header_ns: NDArray[np.int64]) -> tuple[bool, list[str]]:
    """Whether a channel's header stamps tell the time; if not for a reason to hear of, that too.

    Args:
        header_ns: acquisition stamps of T messages in file order [ns]; 0 where not set.
    """
    if not len(header_ns):
        return True, []
    if np.count_nonzero(header_ns == 0) > 1:
        return False, []
    if len(np.unique(header_ns)) <= _MIN_DIFFERENT * len(header_ns):
        return False, ["header stamps hardly change, so the log's own times are used"]
    if np.count_nonzero(np.diff(header_ns) < 0) > _MAX_REVERSALS * len(header_ns):
        return False, ["header stamps run backwards, so the log's own times are used"]
    return True, []


def choose_stamps(
    header_ns: NDArray[np.int64], log_ns: NDArray[np.int64]
) -> tuple[NDArray[np.int64], list[str]]:
    """The header's stamps where they tell the time, else the log's; and why, if that is of note."""
    is_header, notes = trusts_header(header_ns)
    return (header_ns if is_header else log_ns), notes


def order_samples(
    header_ns: NDArray[np.int64], log_ns: NDArray[np.int64]
) -> tuple[NDArray[np.intp], NDArray[np.int64], list[str]]:
    """Choose stamps and sort.

    `header.stamp` is used where it is set and, but for a few samples, monotonic; else `log_time`.

    Args:
        header_ns: acquisition stamps of T messages in file order [ns]; 0 where not set.
        log_ns: receipt stamps of the same messages [ns].

    Returns:
        Indices of the samples to keep, their stamps (strictly increasing), and what was repaired.
    """
    stamps, notes = choose_stamps(header_ns, log_ns)
    order, ordered, repairs = in_order(stamps)
    return order, ordered, notes + repairs


def in_order(
    stamps: NDArray[np.int64],
) -> tuple[NDArray[np.intp], NDArray[np.int64], list[str]]:
    """Sort; of samples with one stamp the first is kept.

    Returns:
        Indices of the samples to keep, their stamps (strictly increasing), and what was repaired.
    """
    notes: list[str] = []
    order = np.argsort(stamps, kind="stable")
    reversals = int(np.count_nonzero(np.diff(stamps) < 0))
    ordered = stamps[order]
    fresh = np.diff(ordered, prepend=ordered[:1] - 1) > 0
    duplicates = int(np.count_nonzero(~fresh))
    if reversals:
        notes.append(f"{reversals} samples out of order were sorted")
    if duplicates:
        notes.append(f"{duplicates} samples with a stamp already seen were left out")
    return order[fresh], ordered[fresh], notes
