"""Restamp frames of a camera that reports no time by the uniform clock behind their arrivals.

The clock is fitted to all of them, so the log is restamped once it has ended. While it is written,
and where no clock is found, its stamps are the arrivals; those stay in it as the log times.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.even_clock import EvenClock
from tunenet_logs.gaps import noted_gaps, parts_between
from tunenet_logs.late_stamps import BY_ARRIVALS, MAX_SAMPLES, clock_behind, clock_in_words
from tunenet_logs.messages import CAMERA_TOPIC, VIDEO_TOPIC
from tunenet_logs.restamping import header_stamps_ns, restamp

_MIN_COUNT = 50  # pictures of which a clock is worth the name


def stamp_evenly(path: Path, notes: Mapping[str, str], spare_bytes: int) -> str:
    """Restamp the frames of a finished log by the uniform clock fitted to their arrivals.

    Each contiguous segment has a clock of its own: a new connection may count anew.

    Args:
        path: the log; the header stamps of its pictures are their arrivals.
        notes: the log's, which say where its gaps are.
        spare_bytes: space to leave free on the disk beside a copy of the log.

    Returns:
        Which clock the stamps come from now, in words.

    Raises:
        LogError: the log cannot be copied; it is as it was.
    """
    topic, arrivals_ns = _pictures(path)
    if len(arrivals_ns) < _MIN_COUNT:
        return "arrival"
    if len(arrivals_ns) > MAX_SAMPLES:
        return f"arrival: no clock is sought behind more than {MAX_SAMPLES} pictures"
    parts = parts_between(arrivals_ns, noted_gaps(notes))
    stamps_ns = arrivals_ns.copy()
    found: list[EvenClock] = []
    for part in np.unique(parts):
        chosen = parts == part
        clock, rates = clock_behind(arrivals_ns[chosen], are_arrivals=True)
        if rates:
            return f"arrival: the rate of the pictures {rates}, so no even clock is behind them"
        if clock is not None:
            stamps_ns[chosen] = clock.stamps_ns
            found.append(clock)
        elif np.count_nonzero(chosen) >= _MIN_COUNT:
            found.clear()
            break
    if not found or np.any(np.diff(stamps_ns) <= 0):
        return "arrival: no even clock is behind them"
    if shutil.disk_usage(path.parent).free < path.stat().st_size + spare_bytes:
        return "arrival: the disk has no room for a copy of the log"
    said = f"{BY_ARRIVALS} ({'; '.join(clock_in_words(clock) for clock in found)})"
    restamp(path, topic, dict(zip(arrivals_ns.tolist(), stamps_ns.tolist(), strict=True)), said)
    return said


def _pictures(path: Path) -> tuple[str, NDArray[np.int64]]:
    """Return the topic of a log's pictures and their header stamps [ns]."""
    of = {topic: header_stamps_ns(path, topic) for topic in (CAMERA_TOPIC, VIDEO_TOPIC)}
    topic = max(of, key=lambda one: len(of[one]))
    return topic, np.array(of[topic], np.int64)
