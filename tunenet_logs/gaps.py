"""Gaps in a recording: times in which its source was away, marked in the log.

The note `gaps` of the info record lists them, each by the stamps [ns] of the picture before it and
of the one after it: `1700000000000000000-1700000001200000000,...`. Nobody knows what happened in
between, and a camera that was connected anew may count its time anew: what one part shows is not
continued in the next.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.terminal import listed

_NOTE = "gaps"  # the note's name in the info record
_GAP = re.compile(r"(\d{1,19})-(\d{1,19})", re.ASCII)

_LAST_NS = 2**63 - 1  # the last stamp that fits int64
# Of a gap's length: where no step between samples is so long any more, late samples fill it.
_STILL_OPEN = 0.5


class Gap(NamedTuple):
    """Interval in which the source delivered nothing.

    Attributes:
        last_ns: stamp of the last picture before it.
        next_ns: stamp of the first picture after it.
    """

    last_ns: int
    next_ns: int

    @property
    def seconds(self) -> float:
        """Length [s]."""
        return (self.next_ns - self.last_ns) * 1e-9


def noted_gaps(notes: Mapping[str, str]) -> tuple[Gap, ...]:
    """Parse the gaps listed in an info record's notes; what is no gap is left out."""
    found = (Gap(int(last), int(after)) for last, after in _GAP.findall(notes.get(_NOTE, "")))
    return tuple(gap for gap in found if gap.last_ns < gap.next_ns <= _LAST_NS)


def gap_note(gaps: Iterable[Gap]) -> tuple[str, str]:
    """Return name and text of the note that lists the gaps."""
    return _NOTE, ",".join(f"{gap.last_ns}-{gap.next_ns}" for gap in gaps)


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
        if len(touched) and touched.max() >= _STILL_OPEN * gap.seconds:
            cuts_ns.add(int(ordered[first + int(touched.argmax()) + 1]))
    return np.searchsorted(np.array(sorted(cuts_ns), np.int64), stamps_ns, side="right")
