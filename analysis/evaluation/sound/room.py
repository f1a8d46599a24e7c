"""Simulate a room, a microphone and a phone's electronics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tunenet_logs.arrays import Array

_BLOCK = 64  # samples that automatic gain is the same for, before it is smoothed


@dataclass(frozen=True)
class SoundRoom:
    """Room and where the microphone stands in it.

    Attributes:
        echo_s: time in which echoes fall by 60 dB.
        direct_db: power of the direct sound over that of the echo's tail.
        reflections: how many come one by one.
        seed: of them.
    """

    echo_s: float
    direct_db: float
    reflections: int
    seed: int

    def response(self, rate_hz: float) -> Array:
        """Return the impulse response; the direct sound is its first sample, of 1."""
        rng = np.random.default_rng(self.seed)
        count = int(min(self.echo_s, 0.9) * rate_hz)
        seconds = np.arange(count) / rate_hz
        tail = rng.standard_normal(count) * 10 ** (-3 * seconds / self.echo_s)
        tail *= np.clip((seconds - 0.004) / 0.012, 0.0, 1.0)
        smooth = rng.uniform(0.1, 0.6)  # walls take more of high notes
        tail[1:] = (1 - smooth) * tail[1:] + smooth * tail[:-1]
        tail *= np.sqrt(10 ** (-self.direct_db / 10) / np.sum(tail**2))
        tail[0] = 1.0
        for _ in range(self.reflections):
            at_s = rng.uniform(0.0015, 0.03)
            gain = rng.uniform(0.1, 0.5) * rng.choice([-1.0, 1.0], p=[0.2, 0.8])
            exact = at_s * rate_hz
            whole, part = int(exact), exact - int(exact)
            tail[whole] += gain * (1 - part)
            tail[whole + 1] += gain * part
        return tail

    def heard(self, samples: Array, rate_hz: float) -> Array:
        """Convolve a sound with this room, as long as before."""
        from scipy.signal import fftconvolve

        return fftconvolve(samples, self.response(rate_hz))[: len(samples)]


def draw_room(rng: np.random.Generator) -> SoundRoom:
    """Draw any room, the phone up to a few steps from the ball."""
    return SoundRoom(
        echo_s=float(rng.uniform(0.2, 0.8)),
        direct_db=float(rng.uniform(0.0, 15.0)),
        reflections=int(rng.integers(2, 8)),
        seed=int(rng.integers(2**31)),
    )


@dataclass(frozen=True)
class SoundPhone:
    """Microphone and electronics of a phone.

    Attributes:
        low_hz: lower end of its band.
        high_hz: upper end.
        peak: loudest sample of what it records, of full scale; over 1 is clipped.
        gain_ratio: compression of its automatic gain; 1 for none.
        release_s: in which that gain comes back.
    """

    low_hz: float
    high_hz: float
    peak: float
    gain_ratio: float = 1.0
    release_s: float = 0.5

    def band(self, samples: Array, rate_hz: float) -> Array:
        """Apply the microphone's band-pass filter; causal, as every microphone."""
        from scipy.signal import butter, sosfilt

        high = min(self.high_hz, 0.46 * rate_hz)
        sections = butter(2, [self.low_hz, high], "bandpass", fs=rate_hz, output="sos")
        return np.asarray(sosfilt(sections, samples))

    def recorded(self, samples: Array, rate_hz: float) -> Array:
        """Apply gain, full scale and 16 bits."""
        if self.gain_ratio > 1:
            samples = samples * _automatic_gain(samples, rate_hz, self.gain_ratio, self.release_s)
        loudest = float(np.max(np.abs(samples), initial=1e-9))
        clipped = np.clip(self.peak / loudest * samples, -1.0, 32767 / 32768)
        return np.round(clipped * 32768) / 32768


def _automatic_gain(samples: Array, rate_hz: float, ratio: float, release_s: float) -> Array:
    """Return a gain for each sample that falls within 5 ms and comes back slowly."""
    count = -(-len(samples) // _BLOCK)
    padded = np.pad(np.abs(samples), (0, count * _BLOCK - len(samples)))
    peaks = padded.reshape(count, _BLOCK).max(axis=1)
    up = np.exp(-_BLOCK / rate_hz / 0.005)
    down = np.exp(-_BLOCK / rate_hz / release_s)
    floor = 0.02 * float(peaks.max(initial=1e-9))
    level, levels = floor, np.empty(count)
    for at, peak in enumerate(np.maximum(peaks, floor).tolist()):
        keep = up if peak > level else down
        level = keep * level + (1 - keep) * peak
        levels[at] = level
    gains = (levels / floor) ** (1 / ratio - 1)
    middles = (np.arange(count) + 1.0) * _BLOCK  # what a block's gain is known from lies before it
    return np.interp(np.arange(len(samples)), middles, gains)


def draw_phone(rng: np.random.Generator) -> SoundPhone:
    """Draw any phone: a fourth with automatic gain, a sixth of them overdriven."""
    clips = rng.random() < 1 / 6
    return SoundPhone(
        low_hz=float(rng.uniform(60.0, 200.0)),
        high_hz=float(rng.uniform(10000.0, 18000.0)),
        peak=float(rng.uniform(1.2, 3.0) if clips else rng.uniform(0.1, 0.95)),
        gain_ratio=float(rng.uniform(1.5, 4.0)) if rng.random() < 0.25 else 1.0,
        release_s=float(rng.uniform(0.2, 1.5)),
    )
