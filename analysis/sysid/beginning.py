"""Estimate value and slope of sampled curves at a stamp, by their first samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.sysid.compared import noise_of
from tunenet_logs.arrays import Array

_SECONDS, _MAX_SAMPLES, _MIN_SAMPLES = 0.12, 40, 4
_SHRINKS = 0.7  # to this share, a window that a parabola misses
_MISSES = 2.0  # standard deviations of noise, from which on it does
# What the priors are wider by than the noise alone says: speeds change in the first samples.
_CAUTION = 3.0

# For how long what begins at rest is looked at, and how much it may scatter, in its noise.
_STAYS_S, _SCATTERS = 0.5, 2.0

Samples = tuple[NDArray[np.int64], Array]  # stamps [ns] and values


def beginning(
    positions: Samples | None,
    speeds: Samples | None,
    stamp_ns: int,
    noise: float | None = None,
) -> tuple[tuple[float, float], tuple[float, float], bool] | None:
    """Estimate position and speed at a stamp, with sds, and whether a position was seen.

    One parabola is fitted to the first positions and, by its slope, to the first speeds. The window
    shrinks until it fits; the standard deviations include the misfit of the shortest one, and
    disagreement of speeds and positions.

    Args:
        positions: None if none were seen.
        speeds: Likewise.
        stamp_ns: The stamp.
        noise: Standard deviation of the samples' noise; None to estimate it by differences.
    """
    at_s: list[Array] = []
    rows: list[Array] = []
    values: list[Array] = []
    for order, samples in enumerate((positions, speeds)):
        if samples is None or len(samples[0]) < _MIN_SAMPLES:
            continue
        seconds = 1e-9 * (samples[0][:_MAX_SAMPLES] - stamp_ns).astype(np.float64)
        count = max(int(np.sum(seconds <= _SECONDS)), _MIN_SAMPLES)
        scatter = max(noise_of(samples[1]) if noise is None else noise, 1e-9)
        at_s.append(seconds[:count])
        rows.append(_terms(seconds[:count], order) / scatter)
        values.append(samples[1][:count] / scatter)
    if not rows:
        return None
    window_s = max(float(seconds[-1]) for seconds in at_s)
    counts = [len(seconds) for seconds in at_s]
    while True:
        found, sds, misfit = _parabola(
            np.concatenate([row[:count] for row, count in zip(rows, counts, strict=True)]),
            np.concatenate([value[:count] for value, count in zip(values, counts, strict=True)]),
        )
        window_s *= _SHRINKS
        fewer = [max(int(np.sum(seconds <= window_s)), 1) for seconds in at_s]
        if misfit <= 1 or max(fewer) < _MIN_SAMPLES:
            break
        counts = fewer
    sds = sds * max(misfit, 1.0)
    if len(at_s) == 2 and (alone := beginning(positions, None, stamp_ns, noise)):
        (_, slope), (_, slope_sd), _ = alone
        if abs(slope - found[1]) > _MISSES * slope_sd:  # such as speeds that a driver filters
            sds[1] = max(sds[1], abs(slope - found[1]))
    knows_position = positions is not None and len(positions[0]) >= _MIN_SAMPLES
    return (float(found[0]), float(found[1])), (float(sds[0]), float(sds[1])), knows_position


def _terms(at_s: Array, order: int) -> Array:
    """Return rows of 1, t, t²/2, t³/6 and t⁴/24, or of their slopes (order 1), shape (T, 5)."""
    terms = [np.ones_like(at_s), at_s, at_s**2 / 2, at_s**3 / 6, at_s**4 / 24]
    return np.column_stack([np.zeros_like(at_s), *terms[:4]] if order else terms)


def _parabola(rows: Array, values: Array) -> tuple[Array, Array, float]:
    """Fit a parabola by least squares, to rows of terms, shape (T, 5), in units of noise.

    Returns:
        Its value and slope at 0; their standard deviations; and the misfit beyond noise, as a
        share: by the residuals, or by what either of the next two terms would add, which moves the
        slope most.
    """
    scales = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    first = int(not rows[:, 0].any())  # speeds alone tell no position
    axes, triangle = np.linalg.qr((rows / scales)[:, first:])
    told, own = axes.T @ values, slice(3 - first)
    inverse = np.linalg.pinv(triangle[own, own])
    off = values - axes[:, own] @ told[own]
    left = float(np.linalg.norm(off)) / np.sqrt(max(len(off) - 3, 1))
    misfit = max(left, float(np.abs(told[3 - first : 5 - first]).max())) / _MISSES
    by_next = triangle[3 - first, 3 - first]
    follows = inverse @ triangle[own, 3 - first] / np.where(by_next, by_next, np.inf)
    plain = np.linalg.norm(inverse, axis=1)
    sds = np.maximum(_CAUTION * plain, np.hypot(plain, follows))
    both = np.zeros((2, 3))
    both[:, first:] = inverse @ told[own], sds
    found, sds = both[:, :2] / scales[:2]
    return found, sds, misfit


def stays(samples: Samples | None, stamp_ns: int) -> bool:
    """Return whether a signal only scatters for a while after a stamp."""
    if samples is None:
        return True
    first = samples[1][samples[0] <= stamp_ns + 1e9 * _STAYS_S]
    return not len(first) or float(np.std(first)) <= _SCATTERS * noise_of(samples[1])
