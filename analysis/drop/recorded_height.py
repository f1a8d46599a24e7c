"""Height in which a drop was sought and none was found, and what in it looks like an impact."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from analysis.drop.film_search import film_impacts
from analysis.drop.gravity import gravity_in
from analysis.statistics import noise_of
from recorders.simulators.drop import TOPIC
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, Signal

_MIN_COUNT = 12  # samples in which impacts are looked for
_FARTHEST = 1e6  # a coordinate beyond it is a marker for "none"
_MAX_SAMPLES = 20_000  # that are looked through: of more every second, third, ..
_MIN_NOISE = 1e-4  # of what the heights span: a simulator's have none


@dataclass(frozen=True, eq=False)
class RecordedHeight:
    """Height of a position signal.

    Attributes:
        signal: that it is of.
        seconds: since the signal's first sample, rising, shape (T,).
        heights: over the lowest one, in the signal's unit, shape (T,).
        impacts: samples at which a fast fall ends.
        is_free: whether something falls freely in it, which tells what is up; else the axis along
            which it moves most is drawn.
    """

    signal: Signal
    seconds: Array
    heights: Array
    impacts: tuple[int, ...]
    is_free: bool


def position_signals(signals: Iterable[Signal]) -> list[Signal]:
    """Select the signals of positions, in the order in which a drop is sought in them."""
    positions = [one for one in signals if one.is_position]
    return sorted(positions, key=lambda one: (one.name != TOPIC, "ball" not in one.name, one.name))


def recorded_heights(episode: Episode, most: int) -> list[RecordedHeight]:
    """Return the heights of the first `most` signals that hold positions."""
    found = (recorded_height(one) for one in position_signals(episode.signals.values())[:most])
    return [one for one in found if one is not None]


def recorded_height(signal: Signal) -> RecordedHeight | None:
    """Return the height of a signal of positions; None where it has no two samples."""
    seconds, values = signal.seconds, signal.values
    keep = np.all(np.abs(values) < _FARTHEST, axis=1)  # NaN is not
    seconds, values = seconds[keep], values[keep]
    if len(seconds) < 2:
        return None
    rising = np.concatenate([[True], seconds[1:] > np.maximum.accumulate(seconds)[:-1]])
    every = max(1, -(-np.count_nonzero(rising) // _MAX_SAMPLES))
    seconds, values = seconds[rising][::every], values[rising][::every]
    gravity = gravity_in(seconds, values) if len(seconds) >= _MIN_COUNT else None
    spans = np.ptp(values, axis=0) * np.array([0.5, 0.75, 1.0])  # z, if in doubt
    up = np.eye(3)[int(spans.argmax())] if gravity is None else gravity.up
    heights = values @ up
    heights = heights - heights.min()
    impacts: list[int] = []
    if len(seconds) >= _MIN_COUNT and heights.max() > 0:
        noise = max(noise_of(heights), _MIN_NOISE * float(heights.max()))
        impacts = film_impacts(seconds, heights, noise)
    return RecordedHeight(signal, seconds, heights, tuple(impacts), gravity is not None)
