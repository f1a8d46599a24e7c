"""Measure how loud impacts are beside the background."""

from __future__ import annotations

import numpy as np

from tunenet_logs.arrays import Array

OCTAVES_HZ = (250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)  # middles of bands an octave wide
WINDOW_S = 0.02


def impact_ratio(foreground: Array, background: Array, rate_hz: float, impacts_s: Array) -> float:
    """Return the signal-to-noise ratio of a bounce [dB].

    Of the impacts, the one of median power in its first 20 ms is taken, and the octave in which it
    has most power in that time. The ratio is that power over the background's mean power in the
    same octave. An ear that listens there hears that impact at this ratio, louder ones better.

    Args:
        foreground: the ball alone, as recorded, shape (N,).
        background: the rest, shape (N,).
        rate_hz: of both.
        impacts_s: when the sound of each impact begins, after the first sample.
    """
    count = int(WINDOW_S * rate_hz)
    windows = [foreground[(at := int(time * rate_hz)) : at + count] for time in impacts_s]
    powers = np.array([float(np.mean(window**2)) for window in windows])
    middle = windows[int(np.argsort(powers)[(len(powers) - 1) // 2])]
    bands = np.array([_power(middle, rate_hz, hz) for hz in OCTAVES_HZ])
    loudest = int(np.argmax(bands))
    below = max(_power(background, rate_hz, OCTAVES_HZ[loudest]), 1e-30)
    return float(10 * np.log10(bands[loudest] / below))


def _power(samples: Array, rate_hz: float, middle_hz: float) -> float:
    """Return the mean power in an octave (by Parseval's theorem)."""
    power = np.abs(np.fft.rfft(samples)) ** 2
    hz = np.fft.rfftfreq(len(samples), 1 / rate_hz)
    inside = (hz >= middle_hz / np.sqrt(2)) & (hz < middle_hz * np.sqrt(2))
    return float(2 * power[inside].sum() / len(samples) ** 2)
