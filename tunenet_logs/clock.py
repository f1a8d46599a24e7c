"""The clock of live stamps: wall time that nothing can bend while it is being recorded."""

from __future__ import annotations

import time
from functools import cache


@cache
def _anchor_ns() -> int:
    return time.time_ns() - time.monotonic_ns()


def wall_ns(monotonic_ns: int) -> int:
    """A monotonic time [ns] on the wall clock [ns], as that stood when it was first asked for.

    Anchored once in a process: a wall clock that is set while recording must not bend the stamps.
    """
    return _anchor_ns() + monotonic_ns


def now_ns() -> int:
    """Now on that clock [ns since 1970]."""
    return _anchor_ns() + time.monotonic_ns()
