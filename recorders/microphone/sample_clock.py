"""Stamp sound samples by sample number and rate, aligned to our clock by the device's times."""

from __future__ import annotations

import math
from collections.abc import Iterator
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recorders.microphone.base import SoundPiece

# Of sound that is looked at before samples are placed on our clock, at first and after a leap.
_HOLD_S = 0.5

# Between a piece's told time and its place: what is further off is no jitter, if it lasts.
_LEAP_NS = 30_000_000

# A loss that the device reports and that is shorter is not to be told from its jitter.
_NONE_LOST_NS = 2_000_000

_OVERLAP_NS = 5_000_000  # that pieces may overlap, for the clock to follow a device that runs fast
_WINDOW_S = 1.0  # of sound whose median place is one measurement
# Of a measurement, that part is followed, and so much a window at most: 200 millionths.
_GAIN, _MAX_STEP_NS = 0.1, 200_000

# By which the rate on our clock is measured, and how well it has to be known to be of use.
_MIN_WINDOWS, _KNOWN_TO = 10, 10e-6

_MAX_OFF = 1e-3  # of its rate: no sound card's crystal is further off


class TimedPiece(NamedTuple):
    """A block of samples with its time.

    Attributes:
        stamp_ns: capture time of the first sample.
        pcm: shape (N,).
    """

    stamp_ns: int
    pcm: NDArray[np.int16]
    arrived_ns: int


class _Held(NamedTuple):
    piece: SoundPiece
    offset_ns: int
    arrived_ns: int


class SampleClock:
    """Maps sample numbers to our clock [ns].

    A block's time is its first sample's number divided by the rate, plus one offset: the median
    over the first half second of reported times. So no jitter of device, driver or machine enters.
    The offset then tracks the device's clock slowly, by at most 200 ppm.

    Where samples are lost, the offset jumps: at once where the device reports it, else where
    reported times are 30 ms off for half a second. Sound that would overlap earlier sound is left
    out, so that times never run backwards.

    Args:
        rate_hz: nominal sample rate.

    Attributes:
        losses: how often samples were lost.
        lost_s: total duration of the losses.
        left_out_s: total duration of sound left out.
    """

    def __init__(self, rate_hz: float) -> None:
        self.losses = 0
        self.lost_s = self.left_out_s = 0.0
        self._rate_hz = rate_hz
        self._held: list[_Held] = []
        self._held_samples = 0
        self._is_told_lost = False
        self._offset_ns: int | None = None
        self._end_ns: int | None = None
        self._window: list[int] = []
        self._window_samples = 0
        self._drift = _Line()
        self._longest = self._drift

    def timed(self, piece: SoundPiece, arrived_ns: int) -> Iterator[TimedPiece]:
        """Yield the blocks whose time is known by now, in order."""
        if piece.follows_loss and self._offset_ns is not None:
            yield from self.rest()
            self._is_told_lost = True
        offset_ns = piece.begin_ns - self._length_ns(piece.first)
        at_ns = self._offset_ns
        if at_ns is None or self._is_told_lost or abs(offset_ns - at_ns) > _LEAP_NS:
            self._held.append(_Held(piece, offset_ns, arrived_ns))
            self._held_samples += len(piece.pcm)
            if self._held_samples >= _HOLD_S * self._rate_hz:
                yield from self.rest()
            return
        yield from self._released()  # what was held came merely at an odd time
        yield from self._placed(piece, arrived_ns)
        self._follow(piece, offset_ns)

    def rest(self) -> Iterator[TimedPiece]:
        """Yield all blocks still held back, aligning the clock to them where needed."""
        is_enough = self._held_samples >= _HOLD_S * self._rate_hz
        if self._held and (self._offset_ns is None or self._is_told_lost or is_enough):
            self._place(round(median(one.offset_ns for one in self._held)))
        yield from self._released()

    def measured_hz(self) -> float | None:
        """Return the sample rate on our clock; None where it is not yet known."""
        line = max(self._longest, self._drift, key=lambda one: one.count)
        if line.count < _MIN_WINDOWS:
            return None
        slope, known_to = line.slope()
        if known_to > _KNOWN_TO or abs(slope) > _MAX_OFF:
            return None
        return self._rate_hz / (1 + slope)

    def _length_ns(self, samples: int) -> int:
        return round(samples * 1_000_000_000 / self._rate_hz)

    def _place(self, offset_ns: int) -> None:
        before_ns, is_told, self._is_told_lost = self._offset_ns, self._is_told_lost, False
        if before_ns is not None:
            step_ns = offset_ns - before_ns
            if is_told and step_ns < _NONE_LOST_NS:
                return
            if step_ns > 0:
                self.losses += 1
                self.lost_s += step_ns * 1e-9
        self._offset_ns = offset_ns
        self._window, self._window_samples = [], 0
        self._longest = max(self._longest, self._drift, key=lambda one: one.count)
        self._drift = _Line()

    def _released(self) -> Iterator[TimedPiece]:
        held, self._held, self._held_samples = self._held, [], 0
        for one in held:
            yield from self._placed(one.piece, one.arrived_ns)

    def _placed(self, piece: SoundPiece, arrived_ns: int) -> Iterator[TimedPiece]:
        assert self._offset_ns is not None
        stamp_ns = self._offset_ns + self._length_ns(piece.first)
        if self._end_ns is not None and stamp_ns < self._end_ns - _OVERLAP_NS:
            self.left_out_s += len(piece.pcm) / self._rate_hz
            return
        self._end_ns = stamp_ns + self._length_ns(len(piece.pcm))
        yield TimedPiece(stamp_ns, piece.pcm, arrived_ns)

    def _follow(self, piece: SoundPiece, offset_ns: int) -> None:
        self._window.append(offset_ns)
        self._window_samples += len(piece.pcm)
        if self._window_samples < _WINDOW_S * self._rate_hz or self._offset_ns is None:
            return
        measured_ns = round(median(self._window))
        self._drift.add(piece.first / self._rate_hz, measured_ns)
        step_ns = round(_GAIN * (measured_ns - self._offset_ns))
        self._offset_ns += max(-_MAX_STEP_NS, min(step_ns, _MAX_STEP_NS))
        self._window, self._window_samples = [], 0


class _Line:
    """Online least-squares line, in constant memory."""

    def __init__(self) -> None:
        self.count = 0
        self._begin = (0.0, 0)
        self._mean_x = self._mean_y = 0.0
        self._xx = self._xy = self._yy = 0.0

    def add(self, x_s: float, y_ns: int) -> None:
        if not self.count:
            self._begin = x_s, y_ns
        x, y = x_s - self._begin[0], (y_ns - self._begin[1]) * 1e-9
        self.count += 1
        dx, dy = x - self._mean_x, y - self._mean_y
        self._mean_x += dx / self.count
        self._mean_y += dy / self.count
        self._xx += dx * (x - self._mean_x)
        self._xy += dx * (y - self._mean_y)
        self._yy += dy * (y - self._mean_y)

    def slope(self) -> tuple[float, float]:
        """Return the slope and its standard error [s/s]; of three points or more."""
        if self._xx <= 0 or self.count < 3:
            return 0.0, math.inf
        slope = self._xy / self._xx
        rest = max(0.0, self._yy - slope * self._xy)
        return slope, math.sqrt(rest / (self.count - 2) / self._xx)
