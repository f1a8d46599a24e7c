"""How regularly the samples of a topic were taken: rate and gaps, by their own stamps."""

from __future__ import annotations

from collections import deque

import numpy as np

_SETTLED_AT = 100
"""Intervals that are judged in one go: a median for each message would cost more than the rest."""

_REMEMBERED = 200
"""Intervals whose median is the usual one: 0.2 s at 1 kHz, so a rate that changes is followed."""

_FEWEST = 5
"""Intervals without which there is no usual one."""

_GAP_PERIODS = 2.5
"""Usual intervals: at least one sample is missing in a longer one, whatever its jitter."""

_SHORTEST_GAP_NS = 10_000_000
"""An arm does not get far in less, and computers without a real-time kernel are late by that."""

_SHORTEST_NS = 10_000
"""Between samples: those that are closer came in one piece, and tell no rate."""


class Pace:
    """Rate and gaps of samples, in little memory however many there are.

    DDS counts what it knows to be lost; what a full buffer of its own pushed out it does not count.
    So the stamps are looked at: a gap is an interval of more than 2.5 usual ones, and of 10 ms.
    """

    def __init__(self) -> None:
        self.samples = 0
        self._gaps = 0
        self._longest_gap_ns = 0
        self._last_ns: int | None = None
        self._recent: deque[int] = deque(maxlen=_REMEMBERED)
        self._fresh: list[int] = []

    def add(self, stamp_ns: int) -> None:
        """The next sample, taken at `stamp_ns`."""
        self.samples += 1
        if self._last_ns is not None and stamp_ns > self._last_ns:
            self._fresh.append(stamp_ns - self._last_ns)
            if len(self._fresh) >= _SETTLED_AT:
                self._settle()
        self._last_ns = stamp_ns

    @property
    def rate_hz(self) -> float:
        """Of the last 200 samples, by their median interval [Hz]; 0 where they tell none."""
        self._settle()
        if len(self._recent) < _FEWEST or self._usual_ns() < _SHORTEST_NS:
            return 0.0
        return 1e9 / self._usual_ns()

    @property
    def gaps(self) -> int:
        """How many there were so far."""
        self._settle()
        return self._gaps

    @property
    def longest_gap_s(self) -> float:
        """From the sample before it to the one behind [s]; 0 without a gap."""
        self._settle()
        return self._longest_gap_ns * 1e-9

    def in_words(self) -> str:
        """Such as "999.8 Hz, 2 gaps (0.50 s at most)"."""
        if not self.gaps:
            return f"{self.rate_hz:.1f} Hz, no gap"
        plural = "" if self.gaps == 1 else "s"
        return (
            f"{self.rate_hz:.1f} Hz, {self.gaps} gap{plural} ({self.longest_gap_s:.2f} s at most)"
        )

    def _settle(self) -> None:
        """Judge the intervals that came since the last time."""
        if len(self._recent) + len(self._fresh) < _FEWEST:
            return
        fresh, self._fresh = self._fresh, []
        self._recent.extend(fresh)
        longest_ns = max(_GAP_PERIODS * self._usual_ns(), _SHORTEST_GAP_NS)
        gaps = [interval_ns for interval_ns in fresh if interval_ns > longest_ns]
        self._gaps += len(gaps)
        self._longest_gap_ns = max(self._longest_gap_ns, *gaps, 0)

    def _usual_ns(self) -> float:
        return float(np.median(np.array(self._recent)))
