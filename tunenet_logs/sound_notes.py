"""Split sound into short blocks for a log, with notes on what their messages cannot say."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.formats.gathered_sound import RATES_HZ
from tunenet_logs.sound import Sound

_RATE, _FILE_RATE, _ABOUT = "sound_rate_hz", "sound_file_rate_hz", "sound"

WARNINGS_NOTE = "sound_warnings"  # under which a log says what is doubtful of its sound
BLOCK_S = 0.1  # of the log's clock, in each message
_FULL_SCALE = 32768.0  # of 16 bits


def sound_notes_of(sound: Sound) -> dict[str, str]:
    """Return the notes on a sound that is written to a log."""
    channels = {1: "mono", 2: "stereo"}.get(sound.channels, f"{sound.channels} channels")
    about = f"{sound.codec}, {sound.file_rate_hz:g} Hz, {channels}"
    notes = rate_notes(about, sound.rate_hz, sound.file_rate_hz)
    return notes | ({WARNINGS_NOTE: "; ".join(sound.warnings)} if sound.warnings else {})


def rate_notes(about: str, rate_hz: float, told_hz: float) -> dict[str, str]:
    """Return the notes on what a sound is, and its rate on the log's clock and as it says."""
    return {_ABOUT: about, _RATE: repr(float(rate_hz)), _FILE_RATE: repr(float(told_hz))}


def why_not_kept(sound: Sound) -> str:
    """Return why a sound cannot be written to a log; "" where it can."""
    low_hz, high_hz = RATES_HZ
    if not len(sound.samples):
        return "; ".join(sound.warnings) or "it holds no sound"
    if not low_hz <= sound.rate_hz <= high_hz:
        return f"{sound.rate_hz:.6g} samples a second on the log's clock are no sound's"
    return ""


def noted_rates(notes: Mapping[str, str]) -> tuple[float, float]:
    """Return the noted rates of a log's sound, on its clock and in its file; 0 if unknown."""
    return _positive(notes.get(_RATE, "")), _positive(notes.get(_FILE_RATE, ""))


def _positive(text: str) -> float:
    try:
        rate_hz = float(text)
    except ValueError:
        return 0.0
    return rate_hz if math.isfinite(rate_hz) and rate_hz > 0 else 0.0


def sound_blocks(sound: Sound) -> Iterator[tuple[int, NDArray[np.int16]]]:
    """Yield the blocks of a sound, shape (N, 1), with stamps [ns]; none before the epoch."""
    step = max(1, round(BLOCK_S * sound.rate_hz))
    begin = max(0, int(np.ceil(-sound.start_ns * 1e-9 * sound.rate_hz)))
    for first in range(begin, len(sound.samples), step):
        stamp_ns = sound.start_ns + round(first / sound.rate_hz * 1e9)
        yield max(stamp_ns, 0), as_pcm(sound.samples[first : first + step])[:, None]


def as_pcm(samples: NDArray[np.float32]) -> NDArray[np.int16]:
    """Convert samples of full scale 1 to 16-bit PCM of the same shape."""
    return np.clip(np.round(samples * _FULL_SCALE), -_FULL_SCALE, _FULL_SCALE - 1).astype(np.int16)
