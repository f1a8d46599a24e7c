"""Synthesise impact sounds: damped modes and the noise of a touch."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from analysis.evaluation.sound.sounding_balls import ImpactVoice
from tunenet_logs.arrays import Array

# A strike gets to its full strength in a time that goes as the speed to this power: fast impacts
# are brighter.
_BRIGHTER = -0.3

_MAX_S = 1.2
_RINGS = 7.0  # a mode is followed for so many of its times, but no longer


def add_impacts(
    samples: Array,
    rate_hz: float,
    voice: ImpactVoice,
    impacts: Iterable[tuple[float, float]],
    rng: np.random.Generator,
) -> None:
    """Add impacts, each (onset [s], speed [m/s]), to a sound in place, shape (N,)."""
    for begins_s, speed_m_s in impacts:
        first = int(np.ceil(begins_s * rate_hz))
        last = min(len(samples), first + int(_MAX_S * rate_hz))
        uneven = np.exp(rng.normal(0.0, voice.uneven, len(voice.gains)))
        overall = np.exp(rng.normal(0.0, 0.1))
        slap_seed = int(rng.integers(2**31))
        if first >= last or first < 0:
            continue
        seconds = np.arange(first, last) / rate_hz - begins_s
        sound = _one(voice, seconds, rate_hz, speed_m_s, uneven, slap_seed)
        samples[first:last] += overall * speed_m_s**voice.loudness * sound


def _one(
    voice: ImpactVoice,
    seconds: Array,
    rate_hz: float,
    speed_m_s: float,
    uneven: Array,
    slap_seed: int,
) -> Array:
    """Synthesise one impact at times after its touch, shape (T,), without its loudness."""
    strike_s = voice.strike_s * speed_m_s**_BRIGHTER
    part = np.clip(seconds / strike_s, 0.0, 1.0)
    strength = part * part * (3 - 2 * part)
    sound = np.zeros(len(seconds))
    for hz, ring_s, gain in zip(voice.modes_hz, voice.rings_s, voice.gains * uneven, strict=True):
        if hz > 0.47 * rate_hz:
            continue
        heard = seconds[: int(_RINGS * ring_s * rate_hz) + 1]
        dulled = gain / (1 + (hz * strike_s) ** 2)
        sound[: len(heard)] += dulled * np.exp(-heard / ring_s) * np.sin(2 * np.pi * hz * heard)
    noise = _slap(voice, seconds[: int(8 * voice.slap_s * rate_hz) + 1], rate_hz, slap_seed)
    sound[: len(noise)] += noise
    return strength * sound


def _slap(voice: ImpactVoice, seconds: Array, rate_hz: float, seed: int) -> Array:
    from scipy.signal import butter, sosfilt

    low, high = voice.slap_hz
    band = butter(1, [low, min(high, 0.45 * rate_hz)], "bandpass", fs=rate_hz, output="sos")
    white = np.random.default_rng(seed).standard_normal(len(seconds) + 200)
    noise = np.asarray(sosfilt(band, white))[200:]
    return voice.slap_gain * noise * np.exp(-seconds / voice.slap_s)
