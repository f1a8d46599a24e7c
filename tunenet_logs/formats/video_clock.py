"""When the pictures of a video file were taken."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import FRAME_NS

_SLOW_MOTION_TAG = "com.android.capture.fps"
"""What Android's cameras call the rate at which they filmed."""

_RATES_HZ = (1.0, 100_000.0)
"""What a camera can film at; a tag beyond it is wrong."""

_SAME_RATE = 1.05
"""A slow-motion tag below so many times the file's own rate says nothing new."""


@dataclass(frozen=True)
class StoredTimes:
    """What a file says of its times.

    Attributes:
        ticks: of the pictures that are shown, increasing; None where they have no times, and are in
            the order in which they are shown.
        count: how many are shown.
        base_s: one tick [s].
        rate_hz: as the file states it, for pictures without times; None where it does not.
        tags: of the file.
    """

    ticks: Sequence[int] | None
    count: int
    base_s: Fraction
    rate_hz: float | None
    tags: dict[str, str]


@dataclass(frozen=True, eq=False)
class VideoClock:
    """When the pictures of a video file were taken.

    Attributes:
        stamps_ns: of all that are shown, int64, shape (T,), strictly increasing; from the file's
            creation tag on, else from 0.
        stored_hz: rate at which the file plays; 0 where it does not say it.
        filmed_hz: as the user says, else as a slow-motion tag says, else as it plays.
        is_timed: whether the stamps are times; else they count frames, `FRAME_NS` each.
        warnings: what was repaired or is doubtful, in words.
    """

    stamps_ns: NDArray[np.int64]
    stored_hz: float
    filmed_hz: float
    is_timed: bool
    warnings: tuple[str, ...]


def clock_of(times: StoredTimes, said_hz: float | None) -> VideoClock:
    """The clock by what the user says, else by the file.

    Args:
        times: of the file.
        said_hz: rate at which it was filmed, where the user knows better: pictures are then
            counted, whatever times they have.
    """
    start_ns = creation_ns(times.tags.get("creation_time", ""))
    stored_hz = _stored_rate(times)
    counts = np.arange(times.count)
    if said_hz is not None:
        stamps_ns = start_ns + np.round(counts * (1e9 / said_hz)).astype(np.int64)
        plays = f"it plays at {stored_hz:.4g}" if stored_hz else "it states none"
        said = f"{said_hz:g} pictures a second were said; {plays}"
        return VideoClock(stamps_ns, stored_hz, said_hz, is_timed=True, warnings=(said,))
    if times.ticks is None:
        rate_hz = times.rate_hz or 1e9 / FRAME_NS
        stamps_ns = start_ns + np.round(counts * (1e9 / rate_hz)).astype(np.int64)
        said = "nothing says how many pictures a second there are; say it with --fps"
        return VideoClock(
            stamps_ns,
            stored_hz,
            stored_hz,
            is_timed=times.rate_hz is not None,
            warnings=() if times.rate_hz else (said,),
        )
    doubled = times.count - len(set(times.ticks))
    warnings = (f"{doubled} frames have a stamp of another",) if doubled else ()
    rate_hz = _tagged_rate(times.tags.get(_SLOW_MOTION_TAG, ""), stored_hz) or stored_hz
    slow = Fraction(stored_hz / rate_hz) if stored_hz else Fraction(1)
    origin = times.ticks[0]
    step_ns = times.base_s * slow * 10**9
    stamps_ns = np.array(
        [start_ns + round((tick - origin) * step_ns) for tick in times.ticks], np.int64
    )
    if doubled:  # keep one stamp a frame, in order
        stamps_ns = np.maximum.accumulate(stamps_ns) + counts
    return VideoClock(stamps_ns, stored_hz, rate_hz, is_timed=True, warnings=warnings)


def _stored_rate(times: StoredTimes) -> float:
    """Frames a second at which a file plays; 0 for a single frame, and where it does not say it."""
    if times.ticks is None:
        return times.rate_hz or 0.0
    fresh = sorted(set(times.ticks))
    if len(fresh) < 2:
        return 0.0
    periods = np.diff(np.array(fresh, np.int64))
    median = np.median(periods)
    usual = periods[np.abs(periods - median) <= 0.2 * median]  # none of two that are far apart
    return float(1 / ((np.mean(usual) if len(usual) else median) * float(times.base_s)))


def _tagged_rate(text: str, stored_hz: float) -> float | None:
    """The rate that a slow-motion tag states; None where there is none, or nothing to change."""
    try:
        rate = float(text)
    except ValueError:
        return None
    low, high = _RATES_HZ
    if not (math.isfinite(rate) and low <= rate <= high) or rate < stored_hz * _SAME_RATE:
        return None
    return rate


def creation_ns(text: str) -> int:
    """When a file was made, by its tag [ns]; 0 where that says nothing."""
    try:
        stamp = datetime.fromisoformat(text)
    except ValueError:
        return 0
    return max(0, round(stamp.timestamp()) * 10**9)
