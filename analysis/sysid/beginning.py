"""The value and slope of sampled curves at a stamp, by their first samples."""

from __future__ import annotations

import numpy as np

from analysis.sysid.compared import noise_of
from tunenet_logs.arrays import Array

_SECONDS, _MOST_SAMPLES, _LEAST_SAMPLES = 0.12, 40, 4
_CAUTION = 3.0
"""What the priors are wider by than the noise alone says: speeds change in the first samples."""

_STAYS_S, _SCATTERS = 0.5, 2.0
"""For how long what begins at rest is looked at, and how much it may scatter, in its noise."""

Samples = tuple[Array, Array]
"""Stamps [ns] and values."""


def beginning(
    positions: Samples | None, speeds: Samples | None, stamp_ns: int
) -> tuple[tuple[float, float], tuple[float, float], bool] | None:
    """Position and speed at a stamp, their standard deviations, and whether a position was seen.

    One parabola goes through the first positions and, as its slope, through the first speeds.
    """
    rows: list[Array] = []
    values: list[Array] = []
    for samples, row_of in (
        (positions, lambda t: np.column_stack([np.ones_like(t), t, t**2 / 2])),
        (speeds, lambda t: np.column_stack([np.zeros_like(t), np.ones_like(t), t])),
    ):
        if samples is None or len(samples[0]) < _LEAST_SAMPLES:
            continue
        at_s = (samples[0] - stamp_ns) * 1e-9
        count = int(np.clip(np.sum(at_s <= _SECONDS), _LEAST_SAMPLES, _MOST_SAMPLES))
        noise = max(noise_of(samples[1]), 1e-9)
        rows.append(row_of(at_s[:count]) / noise)
        values.append(samples[1][:count] / noise)
    if not rows:
        return None
    matrix, wanted = np.concatenate(rows), np.concatenate(values)
    inverse = np.linalg.pinv(matrix.T @ matrix)
    found = inverse @ (matrix.T @ wanted)
    sds = _CAUTION * np.sqrt(np.maximum(np.diag(inverse), 0.0))
    return (float(found[0]), float(found[1])), (float(sds[0]), float(sds[1])), positions is not None


def stays(samples: Samples | None, stamp_ns: int) -> bool:
    """Whether what is sampled only scatters for a while after a stamp."""
    if samples is None:
        return True
    first = samples[1][samples[0] <= stamp_ns + 1e9 * _STAYS_S]
    return not len(first) or float(np.std(first)) <= _SCATTERS * noise_of(samples[1])
