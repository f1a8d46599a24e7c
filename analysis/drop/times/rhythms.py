"""Rhythms that are no ball's: the evidence of each for the same times, against a ball's.

A ball's flights shorten by a ratio that grows from flight to flight, if it changes at all. A hand
keeps its beat, or quickens it: each beat shorter by the same time, or by the same tempo, or by a
ratio that falls. The first beat has any duration, as a ball's first flight; times are jittered one
by one as a ball's, or each beat runs from the one before, as a hand's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from analysis.drop.times import impact_prior as priors
from tunenet_logs.arrays import Array

_RANGE = float(np.log(100.0))  # of the log duration of a first beat, before it is heard
# Standard deviations of a beat that are tried, in mean beats.
_STEADY_SDS = np.geomspace(0.002, 0.5, 25)

_TYPICAL_STEADY, _LOG_STEADY_SD = 0.03, 1.0  # of a hand: log normal
# By which the last beat is shorter than the first; below 0 it is longer.
_SHARES = np.linspace(-1.0, 0.98, 1001)

_TEMPOS = np.geomspace(0.02, 20.0, 400)  # by how much the last beat's tempo is over the first's
# Logarithm of the first ratio of beats, and what is added to it from beat to beat.
_RATIOS, _BENDS = np.linspace(-1.5, 0.0, 61), -np.geomspace(0.002, 0.3, 40)


@dataclass(frozen=True)
class Rhythm:
    """Rhythm that explains the times best.

    Attributes:
        name: in words.
        log_evidence: against noises, as a ball's.
    """

    name: str
    log_evidence: float


def best_rhythm(
    times_s: Array,
    numbers: NDArray[np.int64],
    log_rate: float,
    jitter_s: float = priors.TRIGGER_JITTER_S,
) -> Rhythm:
    """Find the rhythm with the highest evidence.

    Args:
        times_s: of the beats, shape (N,), N at least 3 [s].
        numbers: of the beats, the first 0, shape (N,).
        log_rate: logarithm of the density of noises' times [1/s], by which the evidence is divided.
        jitter_s: usual standard deviation of a time.
    """
    found = []
    for name, beats in _families(int(numbers.max())):
        sums = np.cumsum(np.column_stack([np.zeros(len(beats)), beats]), axis=1)[:, numbers]
        each = np.logaddexp(
            _jittered(times_s, sums, jitter_s), _running(times_s, sums, np.diff(numbers))
        )
        most = float(each.max())
        evidence = most + float(np.log(np.exp(each - most).mean())) - float(np.log(2.0))
        found.append(Rhythm(name, evidence - _RANGE - (len(times_s) - 1) * log_rate))
    return max(found, key=lambda one: one.log_evidence)


@lru_cache(maxsize=4)
def _bent(count: int) -> Array:
    steps = np.arange(count)
    first, bend = (one.ravel()[:, None] for one in np.meshgrid(_RATIOS, _BENDS))
    return np.exp(np.maximum(first * steps + bend * steps * (steps - 1) / 2, -20.0))


def _families(count: int) -> Iterator[tuple[str, Array]]:
    """Yield the beats' durations over the first, shape (M, count), of each kind of rhythm."""
    steps = np.arange(count) / max(count - 1, 1)
    yield "an even beat", np.ones((1, count))
    yield "beats that shorten by one time each", 1 - _SHARES[:, None] * steps
    yield "a tempo that grows evenly", 1 / (1 + _TEMPOS[:, None] * steps)
    yield "beats whose ratio falls", _bent(count)


def _jittered(times_s: Array, sums: Array, jitter_s: float) -> Array:
    """Return the log evidence where each time has its own jitter, shape (M,)."""
    middle = sums.mean(axis=1)
    about = sums - middle[:, None]
    length = (about**2).sum(axis=1)
    first_s = about @ times_s / length
    off = times_s - times_s.mean() - first_s[:, None] * about
    jitters, free = priors.JITTERS_S, len(times_s) - 2
    log = priors.log_jitter_prior(jitter_s) - free * np.log(jitters * np.sqrt(2 * np.pi))
    log = log - (off**2).sum(axis=1)[:, None] / (2 * jitters**2)
    return _summed(log) - 0.5 * np.log(len(times_s) * length) - _log_duration(first_s)


def _running(times_s: Array, sums: Array, apart: NDArray[np.int64]) -> Array:
    """Return the log evidence where each beat runs from the one before, shape (M,)."""
    scale = np.sqrt(apart)
    heard, shape = np.diff(times_s) / scale, np.diff(sums, axis=1) / scale
    length = (shape**2).sum(axis=1)
    first_s = shape @ heard / length
    off = heard - first_s[:, None] * shape
    sds = _STEADY_SDS * float(np.ptp(times_s)) / int(apart.sum())
    prior = np.exp(-0.5 * (np.log(_STEADY_SDS / _TYPICAL_STEADY) / _LOG_STEADY_SD) ** 2)
    log = np.log(prior / prior.sum()) - (len(heard) - 1) * np.log(sds * np.sqrt(2 * np.pi))
    log = log - (off**2).sum(axis=1)[:, None] / (2 * sds**2)
    return _summed(log) - 0.5 * np.log(length) - np.log(scale).sum() - _log_duration(first_s)


def _log_duration(first_s: Array) -> Array:
    """Return the log duration of the first beat; infinite where there is none."""
    return np.where(first_s > 0, np.log(np.maximum(first_s, 1e-9)), np.inf)


def _summed(log: Array) -> Array:
    most = log.max(axis=1)
    return most + np.log(np.exp(log - most[:, None]).sum(axis=1))
