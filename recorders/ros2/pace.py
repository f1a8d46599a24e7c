"""Measure a topic's sample rate and gaps by its own stamps."""

from __future__ import annotations

from collections import deque

import numpy as np

# Intervals that are judged in one go: a median for each message would cost more than the rest.
_SETTLED_AT = 100

# Intervals whose median is the usual one: 0.2 s at 1 kHz, so a rate that changes is followed.
_REMEMBERED = 200

_MIN_COUNT = 5  # intervals without which there is no usual one
# Usual intervals: at least one sample is missing in a longer one, whatever its jitter.
_GAP_PERIODS = 2.5

# An arm does not get far in less, and computers without a real-time kernel are late by that.
_MIN_GAP_NS = 10_000_000

_MIN_NS = 10_000  # between samples: those that are closer came in one piece, and tell no rate


class Pace:
    """Sample rate and gaps, in constant memory.

    DDS counts the samples it knows to be lost, but not those that overflowed its own buffer. So the
    stamps are checked: a gap is an interval of more than 2.5 median ones, and of 10 ms.
    """

    def __init__(self) -> None:
        self.samples = 0
        self._gaps = 0
        self._longest_gap_ns = 0
        self._last_ns: int | None = None
        self._recent: deque[int] = deque(maxlen=_REMEMBERED)
        self._fresh: list[int] = []

    def add(self, stamp_ns: int) -> None:
        """Add the next sample, taken at `stamp_ns`."""
        self.samples += 1
        if self._last_ns is not None and stamp_ns > self._last_ns:
            self._fresh.append(stamp_ns - self._last_ns)
            if len(self._fresh) >= _SETTLED_AT:
                self._settle()
        self._last_ns = stamp_ns

    @property
    def rate_hz(self) -> float:
        """Rate of the last 200 samples, by their median interval [Hz]; 0 if unknown."""
        self._settle()
        if len(self._recent) < _MIN_COUNT or self._usual_ns() < _MIN_NS:
            return 0.0
        return 1e9 / self._usual_ns()

    @property
    def gaps(self) -> int:
        """Number of gaps so far."""
        self._settle()
        return self._gaps

    @property
    def longest_gap_s(self) -> float:
        """Longest interval with a gap, from sample to sample [s]; 0 without a gap."""
        self._settle()
        return self._longest_gap_ns * 1e-9

    def in_words(self) -> str:
        """Describe rate and gaps, such as "999.8 Hz, 2 gaps (0.50 s at most)"."""
        if not self.gaps:
            return f"{self.rate_hz:.1f} Hz, no gap"
        plural = "" if self.gaps == 1 else "s"
        return (
            f"{self.rate_hz:.1f} Hz, {self.gaps} gap{plural} ({self.longest_gap_s:.2f} s at most)"
        )

    def _settle(self) -> None:
        """Judge the intervals since the last time."""
        if len(self._recent) + len(self._fresh) < _MIN_COUNT:
            return
        fresh, self._fresh = self._fresh, []
        self._recent.extend(fresh)
        longest_ns = max(_GAP_PERIODS * self._usual_ns(), _MIN_GAP_NS)
        gaps = [interval_ns for interval_ns in fresh if interval_ns > longest_ns]
        self._gaps += len(gaps)
        self._longest_gap_ns = max(self._longest_gap_ns, *gaps, 0)

    def _usual_ns(self) -> float:
        return float(np.median(np.array(self._recent)))
