"""Gravity in a recording of any units: the acceleration that free flights share.

A body that nothing touches moves on a parabola, and all parabolas of one recording have the same
acceleration. So the acceleration that most windows share is gravity in the recording's own units of
length and time, and its direction says what is down. A hand, a rest or a slope shares it with
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.statistics import noise_of
from tunenet_logs.arrays import Array

# Samples in which an acceleration is looked for: a tenth of a second at 60 Hz, and at 1 kHz.
_WINDOWS = (7, 11, 17, 27, 43, 69, 109)

_BLOCK = 2000  # Windows that are fitted at a time: a log of an hour has tens of thousands
_MAX_SHARED = 1500  # Windows that are compared, each with each
_ALIKE = 0.1  # fraction by which the air, and noise, move an acceleration of free flight
_SURE_SDS = 8.0  # standard errors that an acceleration is away from none
# Residual of a window's parabola, in standard deviations of the noise and in its own size.
_SMOOTH_SDS, _SMOOTH = 3.0, 2e-3

_STILL = 1e-3  # of the noisiest axis: one with less noise is made up
# Windows that share an acceleration, and the same of one that was expected.
_MIN_FREE, _MIN_EXPECTED = 20, 6

_EXPECTED = 0.2  # fraction that an acceleration may be off the expected one
# An axis of the recording that is so near to the vertical is the vertical.
_SNAP = np.cos(np.radians(3.0))


@dataclass(frozen=True, eq=False)
class Gravity:
    """Acceleration that the free flights of a recording share.

    Attributes:
        size: in the recording's units.
        up: unit vector against it, shape (3,).
        noise: standard deviation of a position, by the flights' own residuals.
    """

    size: float
    up: Array
    noise: float

    @property
    def tilt_deg(self) -> float:
        """Angle between up and the nearest axis [degrees]."""
        return float(np.degrees(np.arccos(np.clip(np.abs(self.up).max(), 0.0, 1.0))))

    @property
    def up_name(self) -> str:
        """Axis nearest to up, by name: "+y"."""
        axis = int(np.abs(self.up).argmax())
        return ("+" if self.up[axis] > 0 else "-") + "xyz"[axis]


def gravity_in(seconds: Array, positions: Array, expected: float | None = None) -> Gravity | None:
    """Estimate the acceleration that free flights share; None where there are none.

    Args:
        seconds: on any clock, shape (T,), increasing.
        positions: in any unit, shape (T, 3), finite.
        expected: where the units are known: only what is near it counts.
    """
    noises = np.array([noise_of(axis) if len(axis) > 4 else 0.0 for axis in positions.T])
    sure = _SURE_SDS if expected is None else _SURE_SDS / 2
    found = [_accelerations(seconds, positions, noises, width, sure) for width in _WINDOWS]
    vectors, offs, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    if expected is not None:
        near = np.abs(np.linalg.norm(vectors, axis=1) / expected - 1) < _EXPECTED
        vectors, offs, weights = vectors[near], offs[near], weights[near]
    if len(vectors) > _MAX_SHARED:
        best = np.argsort(weights, kind="stable")[-_MAX_SHARED:]
        vectors, offs, weights = vectors[best], offs[best], weights[best]
    if not len(vectors):
        return None
    sizes = np.linalg.norm(vectors, axis=1)
    apart = np.linalg.norm(vectors[:, None] - vectors, axis=2)
    alike = apart < _ALIKE * np.minimum(sizes[:, None], sizes)
    most = int((alike @ weights).argmax())
    members = alike[most]
    if weights[members].sum() < (_MIN_FREE if expected is None else _MIN_EXPECTED):
        return None
    mean = np.average(vectors[members], axis=0, weights=weights[members])
    up = -mean / np.linalg.norm(mean)
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) > _SNAP:
        up = np.sign(up[axis]) * np.eye(3)[axis]
    moving = np.count_nonzero(noises > _STILL * noises.max())
    noise = float(np.median(offs[members]) / np.sqrt(max(moving, 1)))
    return Gravity(float(-mean @ up), up, noise)


def _accelerations(
    seconds: Array, positions: Array, noises: Array, width: int, sure: float
) -> tuple[Array, Array, Array]:
    """Return accelerations, residuals and weights of a width's parabolic windows, (W, ...)."""
    none = np.empty((0, 3)), np.empty(0), np.empty(0)
    if len(seconds) < width:
        return none
    every = max(1, width // 6, len(seconds) // 20_000)
    begins = np.arange(0, len(seconds) - width + 1, every)
    usual = float(np.median(np.diff(seconds)))
    parts = [none]
    for at in range(0, len(begins), _BLOCK):
        rows = begins[at : at + _BLOCK, None] + np.arange(width)
        whole = np.ptp(seconds[rows], axis=1) < 2.0 * usual * width
        if whole.any():
            rows = rows[whole]
            vectors, off, kept = _parabolas(seconds[rows], positions[rows], noises, sure)
            parts.append((vectors[kept], off[kept], np.full(np.count_nonzero(kept), float(every))))
    vectors, off, weights = (np.concatenate(column) for column in zip(*parts, strict=True))
    return vectors, off, weights


def _parabolas(
    clock: Array, values: Array, noises: Array, sure: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Fit W windows of times, shape (W, T), and positions, shape (W, T, 3).

    Returns:
        Accelerations, shape (W, 3), residuals, shape (W,), and which of them are sure, shape (W,).
    """
    lasts, width = np.ptp(clock, axis=1), clock.shape[1]
    clock = 2 * (clock - clock.mean(axis=1, keepdims=True)) / lasts[:, None]
    design = np.stack([np.ones_like(clock), clock, clock**2], axis=2)
    normal = np.einsum("wti,wtj->wij", design, design)
    solution = np.linalg.solve(normal, np.einsum("wti,wtk->wik", design, values))
    off = values - np.einsum("wti,wik->wtk", design, solution)
    rms = np.sqrt(np.mean(off**2, axis=1) * width / (width - 3))
    curve = solution[:, 2]
    size = np.linalg.norm(curve, axis=1)
    noise = float(np.linalg.norm(noises))
    error = np.sqrt(np.linalg.inv(normal)[:, 2, 2]) * np.maximum(
        np.linalg.norm(rms, axis=1), 0.5 * noise
    )
    off = np.linalg.norm(rms, axis=1)
    kept = (size > sure * error) & (off < _SMOOTH_SDS * noise + _SMOOTH * size)
    return 8 * curve / lasts[:, None] ** 2, off, kept
