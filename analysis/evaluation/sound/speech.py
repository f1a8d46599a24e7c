"""Synthesise speech without words: a pulsed throat through resonances, hisses, pauses."""

from __future__ import annotations

import numpy as np

from tunenet_logs.arrays import Array

# First three formants of vowels (Peterson and Barney 1952, men).
_VOWELS_HZ = (
    *((730, 1090, 2440), (270, 2290, 3010), (300, 870, 2240), (530, 1840, 2480)),
    *((570, 840, 2410), (660, 1720, 2410), (440, 1020, 2240), (490, 1350, 1690)),
)

_WIDTHS_HZ = (70.0, 100.0, 150.0)


def speech(seconds: float, rate_hz: float, rng: np.random.Generator) -> Array:
    """Synthesise somebody who talks, about as loud as 1 at the loudest."""
    count = int(seconds * rate_hz)
    sound = np.zeros(count)
    pitch_hz, size = rng.uniform(90, 230), rng.uniform(0.95, 1.2)
    at_s = rng.uniform(0.0, 0.4)
    while at_s < seconds:
        for _ in range(int(rng.integers(2, 9))):  # a phrase
            for part in _syllable(pitch_hz * np.exp(rng.normal(0, 0.12)), size, rate_hz, rng):
                start = int(at_s * rate_hz)
                end = min(count, start + len(part))
                if start < end:
                    sound[start:end] += part[: end - start]
                at_s += len(part) / rate_hz
            at_s += rng.choice([0.0, 0.0, rng.uniform(0.02, 0.1)])
        at_s += rng.uniform(0.15, 0.8)
    return sound / max(float(np.max(np.abs(sound), initial=0.0)), 1e-9)


def _syllable(
    pitch_hz: float, size: float, rate_hz: float, rng: np.random.Generator
) -> list[Array]:
    """Synthesise a consonant, mostly, and a vowel."""
    parts: list[Array] = []
    kind = rng.choice(["hiss", "burst", "none"], p=[0.35, 0.4, 0.25])
    if kind == "hiss":
        parts.append(_hiss(rng.uniform(0.05, 0.14), rate_hz, rng))
    elif kind == "burst":
        parts.append(np.zeros(int(rng.uniform(0.02, 0.08) * rate_hz)))
        parts.append(_burst(rate_hz, rng))
    parts.append(_vowel(rng.uniform(0.08, 0.26), pitch_hz, size, rate_hz, rng))
    return parts


def _vowel(
    seconds: float, pitch_hz: float, size: float, rate_hz: float, rng: np.random.Generator
) -> Array:
    from scipy.signal import lfilter

    count = int(seconds * rate_hz)
    glide = np.linspace(1.0, np.exp(rng.normal(-0.05, 0.08)), count)
    phase = np.cumsum(pitch_hz * glide * (1 + 0.01 * rng.standard_normal(count))) / rate_hz
    pulses = np.zeros(count)
    pulses[1:] = np.diff(np.floor(phase)) > 0
    pulses = lfilter([1.0], [1.0, -0.96], pulses)  # a throat's closing, 6 dB an octave
    pulses = pulses + 0.02 * rng.standard_normal(count)
    formants = _VOWELS_HZ[int(rng.integers(len(_VOWELS_HZ)))]
    for hz, width in zip(formants, _WIDTHS_HZ, strict=True):
        radius = np.exp(-np.pi * width / rate_hz)
        turn = 2 * np.pi * hz * size / rate_hz
        shape = [1.0, -2 * radius * np.cos(turn), radius**2]
        pulses = lfilter([sum(shape)], shape, pulses)
    sound = np.diff(pulses, prepend=0.0)  # the lips
    rise, fall = int(rng.uniform(0.008, 0.04) * rate_hz), int(0.04 * rate_hz)
    envelope = np.minimum(np.arange(count) / rise, 1) * np.minimum(np.arange(count)[::-1] / fall, 1)
    sound = sound * envelope
    return rng.uniform(0.4, 1.0) * sound / max(float(np.max(np.abs(sound))), 1e-9)


def _hiss(seconds: float, rate_hz: float, rng: np.random.Generator) -> Array:
    from scipy.signal import butter, sosfilt

    low = rng.uniform(1500, 4500)
    ends = [low, min(low + rng.uniform(2000, 5000), 0.45 * rate_hz)]
    band = butter(2, ends, "bandpass", fs=rate_hz, output="sos")
    count = int(seconds * rate_hz)
    noise = np.asarray(sosfilt(band, rng.standard_normal(count)))
    noise *= np.sin(np.pi * (np.arange(count) + 0.5) / count) ** rng.uniform(0.3, 1.0)
    return rng.uniform(0.1, 0.4) * noise / max(float(np.max(np.abs(noise))), 1e-9)


def _burst(rate_hz: float, rng: np.random.Generator) -> Array:
    """Synthesise p, t or k, which start at once."""
    from scipy.signal import butter, sosfilt

    count = int(rng.uniform(0.012, 0.04) * rate_hz)
    low = rng.uniform(500, 3000)
    band = butter(1, [low, low * rng.uniform(1.5, 3.0)], "bandpass", fs=rate_hz, output="sos")
    noise = np.asarray(sosfilt(band, rng.standard_normal(count)))
    noise *= np.exp(-np.arange(count) / rate_hz / rng.uniform(0.003, 0.01))
    return rng.uniform(0.2, 0.7) * noise / max(float(np.max(np.abs(noise))), 1e-9)
