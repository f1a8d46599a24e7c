"""Reconstruct the acquisition times of a video file's frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import FRAME_NS

# What Android's cameras call the rate at which they filmed.
_SLOW_MOTION_TAG = "com.android.capture.fps"

_RATES_HZ = (1.0, 100_000.0)  # what a camera can film at; a tag beyond it is wrong
_SAME_RATE = 1.05  # a slow-motion tag below so many times the file's own rate says nothing new


@dataclass(frozen=True)
class StoredTimes:
    """Times stored in a video file.

    Attributes:
        ticks: of the frames shown, increasing; None where they have no times, and are in
            display order.
        count: number of frames shown.
        base_s: one tick [s].
        rate_hz: stated by the file, for frames without times; None where it is unstated.
        tags: of the file.
    """

    ticks: Sequence[int] | None
    count: int
    base_s: Fraction
    rate_hz: float | None
    tags: dict[str, str]


@dataclass(frozen=True, eq=False)
class VideoClock:
    """Acquisition stamps of a video file's frames.

    Attributes:
        stamps_ns: of all frames shown, int64, shape (T,), strictly increasing; from the file's
            creation tag on, else from 0.
        stored_hz: playback rate; 0 where it is unstated.
        filmed_hz: the user's, else that of a slow-motion tag, else the playback rate.
        is_timed: whether the stamps are times; else they count frames, `FRAME_NS` each.
        warnings: what was repaired or is doubtful, in words.
    """

    stamps_ns: NDArray[np.int64]
    stored_hz: float
    filmed_hz: float
    is_timed: bool
    warnings: tuple[str, ...]


def clock_of(times: StoredTimes, said_hz: float | None) -> VideoClock:
    """Build the clock from the user's frame rate, else from the file.

    Args:
        times: of the file.
        said_hz: true frame rate, where the user knows better: frames are then counted,
            regardless of their times.
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
    """Return the playback rate [Hz]; 0 for a single frame, and where it is unstated."""
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
    """Return the rate of a slow-motion tag; None without one, or if it is no faster."""
    try:
        rate = float(text)
    except ValueError:
        return None
    low, high = _RATES_HZ
    if not (math.isfinite(rate) and low <= rate <= high) or rate < stored_hz * _SAME_RATE:
        return None
    return rate


def creation_ns(text: str) -> int:
    """Parse a file's creation tag [ns]; 0 where it is not a date."""
    try:
        stamp = datetime.fromisoformat(text)
    except ValueError:
        return 0
    return max(0, round(stamp.timestamp()) * 10**9)
