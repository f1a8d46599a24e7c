"""Simulate a log of a machine without an engine, with its owner's MuJoCo model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, EpisodeInfo, Signal

START_NS = 1_700_000_000_123_456_789  # of all logs, by their own clock
NOISE = 0.02  # white noise of a sensor, over the standard deviation of what it measures
GRAVITY_M_S2 = 9.81  # that MuJoCo assumes, and the machines feel
STATES_HZ, COMMANDS_HZ = 100.0, 50.0

# Standard deviation of the times of samples about an even clock. Stamps say when samples were
# taken.
_JITTER_S = 2e-4

_STANDS_STILL = 1e-9  # standard deviation up to which a column does


@dataclass(frozen=True, eq=False)
class ModelLog:
    """A user's log and model, and the truth.

    Attributes:
        episode: the log, as it is read.
        truth: by the addresses of what is tuned.
        model: the text of the MJCF file, whose values are wrong where they are to be tuned.
        tune: what stands after `--tune`, with ranges.
        untold: addresses of what is unidentifiable from this log.
        clean: the signals without noise, by name, each of shape (T, C).
        noise: standard deviation of the noise of each column, by signal, each of shape (C,).
    """

    episode: Episode
    truth: Mapping[str, float]
    model: str
    tune: tuple[str, ...]
    untold: tuple[str, ...] = ()
    clean: Mapping[str, Array] = field(default_factory=dict)
    noise: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Sensed:
    """Quantity before its sensor.

    Attributes:
        seconds: when it is sampled, after the log's start, shape (T,).
        values: shape (T, C).
        columns: the C names.
        noise: standard deviation of its sensor, in the values' unit; None for `NOISE` of the
            values' own; 0 of what is known.
    """

    seconds: Array
    values: Array
    columns: tuple[str, ...]
    unit: str
    noise: float | None = None


def sample_times(length_s: float, rate_hz: float, rng: np.random.Generator) -> Array:
    """Draw times of samples from 0 on, with jitter, shape (T,) [s]; whole nanoseconds."""
    seconds = np.arange(0.0, length_s, 1 / rate_hz)
    most_s = 0.4 / rate_hz
    seconds[1:] += np.clip(rng.normal(0.0, _JITTER_S, len(seconds) - 1), -most_s, most_s)
    return np.round(seconds * 1e9) * 1e-9


def recorded(
    sensed: Mapping[str, Sensed], noise: float, rng: np.random.Generator
) -> tuple[Episode, dict[str, Array], dict[str, Array]]:
    """Record quantities at so many times the usual noise; return log, clean values, noise std."""
    signals: dict[str, Signal] = {}
    clean: dict[str, Array] = {}
    sizes: dict[str, Array] = {}
    for name, one in sensed.items():
        size = noise * _usual_noise(one)
        values = one.values + size * rng.standard_normal(one.values.shape)
        stamps_ns = START_NS + np.round(1e9 * one.seconds).astype(np.int64)
        signals[name] = Signal(name, stamps_ns, values, one.columns, one.unit)
        clean[name], sizes[name] = one.values, size
    return Episode(EpisodeInfo(), signals), clean, sizes


def _usual_noise(sensed: Sensed) -> Array:
    """Return each column's noise std, shape (C,); a joint held still has the other's sensor."""
    if sensed.noise is not None:
        return np.full(len(sensed.columns), sensed.noise)
    moved = np.std(sensed.values, axis=0)
    return NOISE * np.where(moved > _STANDS_STILL, moved, np.max(moved))
