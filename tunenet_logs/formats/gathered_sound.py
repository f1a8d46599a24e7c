"""Assemble audio from packets: mono, gapless, of bounded length and rate."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_S = 600.0  # of sound that is used [s]
_MAX_VALUES = 240_000_000  # of all channels that are gone through: ten minutes of eight at 48 kHz
# A sound of more samples a second is reduced by a whole number, to no more than that.
_KEPT_HZ = 48_000

# Least and greatest rate of samples; speech by telephone has 8,000, bats' 500,000.
RATES_HZ = (1_000.0, 2_000_000.0)

# Between where a piece should begin and where it says: files round it to ms, or to a piece.
_SAME_S = 0.03

_MAX_SIZE = 8.0  # of a sample; decoders give a little more than 1 where a sound was clipped
_SILENT = 2e-5  # a sound is silent that is nowhere louder: less than the last of 16 bits
_MAX_PIECES = 1_000_000  # that are put together
# Of whole numbers, by their type.
_FULL_SCALE = {"u1": 2.0**7, "i2": 2.0**15, "i4": 2.0**31, "i8": 2.0**63}


@dataclass(frozen=True, eq=False)
class GatheredSound:
    """Assembled audio.

    Attributes:
        samples: mean of all channels, full scale 1, shape (N,).
        start_s: time of the first sample, on the clock of the packets [s].
        rate_hz: samples in a second of that clock.
        warnings: what was repaired, left out or is doubtful, in words.
    """

    samples: NDArray[np.float32]
    start_s: float
    rate_hz: float
    warnings: tuple[str, ...]


class SoundGatherer:
    """Assembler of audio packets.

    A gap between two is filled with silence of its length, so that what follows keeps its time.

    Args:
        rate_hz: of the packets' samples.
        heard_hz: the same as a microphone heard it, where the clock is that of a slow-motion video.

    Raises:
        ValueError: no sound has such a rate.
    """

    def __init__(self, rate_hz: float, heard_hz: float = 0.0) -> None:
        low, high = RATES_HZ
        if not low <= rate_hz <= high:
            raise ValueError(f"claims {rate_hz:.6g} samples a second")
        self._file_hz = float(rate_hz)
        heard_hz = heard_hz if low <= heard_hz <= high else self._file_hz
        self._every = max(1, ceil(heard_hz / _KEPT_HZ))
        self._most = int(MAX_S * heard_hz)  # samples, before they are reduced
        self._pieces: list[NDArray[np.float32]] = []
        self._rest = np.empty(0, np.float32)  # what is not yet a sample that is kept
        self._offsets_s: list[float] = []  # of the pieces before the first hole
        self._base_s, self._base_count = 0.0, 0  # from where pieces are counted
        self._count = self._values = self._calls = 0
        self._bad = self._holes = self._backwards = 0
        self._hole_s = 0.0
        self._why_full = ""

    @property
    def is_full(self) -> bool:
        """Whether further packets are ignored."""
        return bool(self._why_full)

    def add(self, piece: NDArray[Any], at_s: float | None) -> None:
        """Append a packet.

        Args:
            piece: whole numbers or floats as a file has them, shape (N, channels).
            at_s: time of its first sample [s]; None where it follows upon the last.
        """
        self._calls += 1
        self._values += piece.size
        if self._values > _MAX_VALUES or self._calls > _MAX_PIECES:
            self._why_full = self._why_full or "the rest is too much"
        if self.is_full or not piece.size:
            return
        if at_s is not None:
            self._place(at_s)
        mono = _mono(piece)
        is_bad = ~np.isfinite(mono) | (np.abs(mono) > _MAX_SIZE)
        if is_bad.any():
            self._bad += int(is_bad.sum())
            mono[is_bad] = 0.0
        self._append(mono)

    def result(self) -> GatheredSound:
        """Return the audio assembled so far."""
        samples = np.concatenate(self._pieces) if self._pieces else np.empty(0, np.float32)
        samples.flags.writeable = False
        start_s = float(np.median(self._offsets_s)) if self._offsets_s else 0.0
        middle_s = (self._every - 1) / 2 / self._file_hz  # of the samples that became one
        rate_hz = self._file_hz / self._every
        return GatheredSound(samples, start_s + middle_s, rate_hz, tuple(self._said(samples)))

    def _said(self, samples: NDArray[np.float32]) -> list[str]:
        said: list[str] = []
        if not len(samples):
            said.append("the sound track holds no sound")
        elif float(np.abs(samples).max()) < _SILENT:
            said.append("the sound track is silent")
        if self._why_full:
            used_s = len(samples) * self._every / self._file_hz
            said.append(f"only the first {used_s:.1f} s of the sound are used: {self._why_full}")
        if self._every > 1:
            kept_hz = self._file_hz / self._every
            said.append(f"the sound was reduced from {self._file_hz:g} to {kept_hz:g} Hz")
        if self._bad:
            said.append(f"{self._bad} samples that are no numbers, or far too loud, became silence")
        if self._holes:
            holes = "1 hole" if self._holes == 1 else f"{self._holes} holes"
            said.append(f"{holes} in the sound, {self._hole_s:.2f} s in all")
        if self._backwards:
            said.append(f"the times of the sound run backwards {self._backwards} times")
        return said

    def _place(self, at_s: float) -> None:
        """Fill a gap before a packet with silence, or count a step backwards."""
        if not np.isfinite(at_s):
            return
        if not self._offsets_s:
            self._base_s, self._base_count = at_s, self._count
        late_s = at_s - self._base_s - (self._count - self._base_count) / self._file_hz
        if abs(late_s) <= _SAME_S:
            if not self._holes and not self._backwards:
                self._offsets_s.append(at_s - self._count / self._file_hz)
            return
        if late_s < 0:
            self._backwards += 1
            self._base_s, self._base_count = at_s, self._count
            return
        self._holes += 1
        self._hole_s += late_s
        count = round(min(late_s * self._file_hz, self._most - self._count))
        begun = min(count, -len(self._rest) % self._every)  # to end a sample that was begun
        self._append(np.zeros(begun, np.float32))
        kept, rest = divmod(count - begun, self._every)
        self._count += kept * self._every
        self._pieces.append(np.zeros(kept, np.float32))
        self._append(np.zeros(rest, np.float32))

    def _append(self, mono: NDArray[np.float32]) -> None:
        most = self._most - self._count
        if len(mono) > most:
            mono = mono[:most]
            self._why_full = f"{MAX_S / 60:g} minutes are enough"
        self._count += len(mono)
        if self._every == 1:
            self._pieces.append(mono)
            return
        mono = np.concatenate((self._rest, mono))
        whole = len(mono) // self._every * self._every
        self._rest = mono[whole:]
        self._pieces.append(mono[:whole].reshape(-1, self._every).mean(axis=1, dtype=np.float32))


def reduced_hz(rate_hz: float) -> float:
    """Return the sample rate kept of a sound, after decimation by an integer."""
    return rate_hz / max(1, ceil(rate_hz / _KEPT_HZ))


def _mono(piece: NDArray[Any]) -> NDArray[np.float32]:
    """Return the mean of the channels, full scale 1, shape (N,)."""
    kind = piece.dtype.str[1:]
    if kind not in _FULL_SCALE:
        with np.errstate(all="ignore"):  # what is no number is dealt with by the caller
            return np.asarray(piece.mean(axis=1, dtype=np.float64), np.float32)
    middle = 128.0 if kind == "u1" else 0.0
    return np.asarray(
        (piece.mean(axis=1, dtype=np.float64) - middle) / _FULL_SCALE[kind], np.float32
    )
