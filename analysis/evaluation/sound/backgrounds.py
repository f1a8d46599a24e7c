"""Synthesise background sound: a quiet room, a fan, speech, music."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from analysis.evaluation.sound.music import music
from analysis.evaluation.sound.speech import speech
from tunenet_logs.arrays import Array

Background = Literal["quiet", "noise", "speech", "music"]
BACKGROUNDS: tuple[Background, ...] = get_args(Background)


def background_sound(
    kind: Background, seconds: float, rate_hz: float, rng: np.random.Generator
) -> Array:
    """Synthesise a background of any loudness, shape (N,).

    Args:
        kind: "quiet" has noise that falls with frequency, and hum; "noise" is white, pink or of a
            fan with its blades; "speech" and "music" have a little of the first below them.
        seconds: how long.
        rate_hz: of its samples.
        rng: draws it.
    """
    count = int(seconds * rate_hz)
    if kind == "noise":
        noise = coloured_noise(count, rate_hz, rng.choice([0.0, 0.5, 1.0]), rng)
        if rng.random() < 0.4:
            time = np.arange(count) / rate_hz
            blades = 1 + 0.5 * np.sin(2 * np.pi * rng.uniform(20, 90) * time)
            noise = noise * blades
        return noise
    room = coloured_noise(count, rate_hz, rng.uniform(0.5, 1.0), rng)
    room += rng.uniform(0.0, 1.0) * hum(count, rate_hz, rng)
    if kind == "quiet":
        return room
    made = (speech if kind == "speech" else music)(seconds, rate_hz, rng)[:count]
    loud = np.sqrt(np.mean(made**2))
    return made + loud * 10 ** (-rng.uniform(20, 35) / 20) * room / np.sqrt(np.mean(room**2))


def coloured_noise(count: int, rate_hz: float, fall: float, rng: np.random.Generator) -> Array:
    """Synthesise noise with amplitude f^-`fall`: 0 is white, .5 pink, 1 brown."""
    spectrum = np.fft.rfft(rng.standard_normal(count))
    hz = np.fft.rfftfreq(count, 1 / rate_hz)
    return np.fft.irfft(spectrum * np.maximum(hz, 30.0) ** -fall, count) * 30.0**fall


def hum(count: int, rate_hz: float, rng: np.random.Generator) -> Array:
    """Synthesise mains hum with harmonics, about as strong as 1."""
    time = np.arange(count) / rate_hz
    mains_hz = rng.choice([50.0, 60.0])
    turns = rng.uniform(0, 2 * np.pi, 6)
    return sum(
        (
            np.sin(2 * np.pi * mains_hz * number * time + turn) / number
            for number, turn in enumerate(turns, 1)
        ),
        start=np.zeros(count),
    )
