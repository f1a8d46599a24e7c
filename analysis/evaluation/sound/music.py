"""Synthesise music that nobody wrote: chords, a melody and drums on a beat."""

from __future__ import annotations

import numpy as np

from tunenet_logs.arrays import Array

_SCALE = (0, 2, 4, 5, 7, 9, 11)  # Semitones of a major scale


def music(seconds: float, rate_hz: float, rng: np.random.Generator) -> Array:
    """Synthesise a band, about as loud as 1 at the loudest."""
    count = int(seconds * rate_hz)
    sound = np.zeros(count)
    beat_s = 60 / rng.uniform(70, 160)
    root_hz = 110 * 2 ** (rng.integers(12) / 12)
    pluck_s, has_drums = rng.uniform(0.002, 0.02), rng.random() < 0.75
    starts_s = -rng.uniform(0.0, beat_s)
    for beat in range(int(seconds / beat_s) + 2):
        at_s = starts_s + beat * beat_s
        if beat % 4 == 0:
            degree = int(rng.integers(6))
            for step in (0, 2, 4):
                hz = root_hz * _ratio(degree + step)
                _add(sound, at_s, _note(4 * beat_s, hz, 0.04, 1.5, rate_hz, rng), 0.25, rate_hz)
        for half in range(2):
            if rng.random() < 0.6:
                hz = 2 * root_hz * _ratio(int(rng.integers(10)))
                long_s = beat_s * rng.choice([0.5, 1.0])
                tone = _note(long_s, hz, pluck_s, rng.uniform(0.1, 0.5), rate_hz, rng)
                _add(sound, at_s + half * beat_s / 2, tone, 0.4, rate_hz)
            if has_drums and rng.random() < 0.8:
                _add(sound, at_s + half * beat_s / 2, _drum("hat", rate_hz, rng), 0.25, rate_hz)
        if has_drums:
            kind = "kick" if beat % 2 == 0 else "snare"
            _add(sound, at_s, _drum(kind, rate_hz, rng), 0.8, rate_hz)
    return sound / max(float(np.max(np.abs(sound), initial=0.0)), 1e-9)


def _ratio(degree: int) -> float:
    octave, step = divmod(degree, len(_SCALE))
    return 2 ** (octave + _SCALE[step] / 12)


def _add(sound: Array, at_s: float, part: Array, gain: float, rate_hz: float) -> None:
    start = int(at_s * rate_hz)
    if start < 0:
        part, start = part[-start:], 0
    end = min(len(sound), start + len(part))
    if start < end:
        sound[start:end] += gain * part[: end - start]


def _note(
    seconds: float,
    hz: float,
    rise_s: float,
    fall_s: float,
    rate_hz: float,
    rng: np.random.Generator,
) -> Array:
    time = np.arange(int(seconds * rate_hz)) / rate_hz
    sound = np.zeros(len(time))
    steep = rng.uniform(0.8, 1.8)
    for number in range(1, 9):
        if number * hz < 0.4 * rate_hz:
            turn = rng.uniform(0, 2 * np.pi)
            sound += number**-steep * np.sin(2 * np.pi * number * hz * time + turn)
    end = np.clip((seconds - time) / 0.02, 0, 1)
    return sound / 2 * np.minimum(time / rise_s, 1) * np.exp(-time / fall_s) * end


def _drum(kind: str, rate_hz: float, rng: np.random.Generator) -> Array:
    time = np.arange(int(0.25 * rate_hz)) / rate_hz
    noise = rng.standard_normal(len(time))
    if kind == "kick":
        sweep = 50 * time + 4.0 * (1 - np.exp(-time / 0.03))
        return np.sin(2 * np.pi * sweep) * np.exp(-time / 0.09) * np.minimum(time / 0.001, 1)
    if kind == "hat":
        return 0.5 * np.diff(noise, prepend=0.0) * np.exp(-time / rng.uniform(0.01, 0.05))
    ring = np.sin(2 * np.pi * 190 * time) * np.exp(-time / 0.05)
    return 0.5 * ring + 0.4 * noise * np.exp(-time / rng.uniform(0.04, 0.1))
