"""Clock of live stamps: wall time that no adjustment can bend during a recording."""

from __future__ import annotations

import time
from functools import cache


@cache
def _anchor_ns() -> int:
    return time.time_ns() - time.monotonic_ns()


def wall_ns(monotonic_ns: int) -> int:
    """Convert monotonic time to wall time [ns].

    Anchored once in a process: a wall clock that is set while recording must not bend the stamps.
    """
    return _anchor_ns() + monotonic_ns


def now_ns() -> int:
    """Return the current time on that clock [ns since 1970]."""
    return _anchor_ns() + time.monotonic_ns()
