"""How an arm moved while its torques were measured: smoothed, with its derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.payload.arm_log import ArmLog
from analysis.payload.smoothing import smoothing_spline
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError

if TYPE_CHECKING:
    from scipy.interpolate import BSpline


_ENDS_S = 0.25
_MOST_GAP = 5.0
"""Periods of the positions between which nothing is known of the motion."""
_LEAST_GAP_S = 0.25
_FEWEST = 20
_STRAY, _USUAL = 0.05, 20.0
"""Least that a stray sample is off [rad], and by how many times what is usual."""
_MOST = 1500
_SPAN_S = 0.05
"""Over which the torques of an arm hardly change."""


@dataclass(frozen=True, eq=False)
class ArmMotion:
    """Torques, and the motion at any time between.

    Attributes:
        seconds: of the torques [s], shape (T,).
        effort: as the driver gives them [N·m], shape (T, J).
        used: joints whose torque says something, shape (J,).
    """

    seconds: Array
    effort: Array
    used: NDArray[np.bool_]
    spline: BSpline

    def at(self, seconds: Array) -> tuple[Array, Array, Array]:
        """Positions [rad], velocities [rad/s] and accelerations [rad/s^2], each (T, J)."""
        position, velocity, acceleration = (self.spline(seconds, order) for order in range(3))
        return position, velocity, acceleration


def arm_motion(log: ArmLog) -> ArmMotion:
    """Smooth the positions by splines whose stiffness is cross-validated.

    The first and last quarter of a second are left out, and torques in gaps of the positions.

    Raises:
        NotFoundError: too little is left.
    """
    usual = ~_strays(log.position.values)
    seconds, values = log.position.seconds[usual], log.position.values[usual]
    spline = smoothing_spline(seconds, values, log.position.late_s)
    keep = _known(log)
    if np.count_nonzero(keep) < _FEWEST:
        raise NotFoundError(
            f"{np.count_nonzero(keep)} torques have positions about them (wanted: {_FEWEST} or "
            "more): record both at once, for 5 s"
        )
    at, effort = _thinned(log.effort.seconds[keep], log.effort.values[keep])
    return ArmMotion(at, effort, ~log.constant, spline)


def _strays(values: Array) -> NDArray[np.bool_]:
    """Single samples at which no arm can have been between the two beside them."""
    off = np.zeros(len(values))
    aside = np.abs(values[1:-1] - (values[2:] + values[:-2]) / 2)
    off[1:-1] = np.max(aside / np.maximum(_USUAL * np.median(aside, axis=0), _STRAY), axis=1)
    most = np.maximum(off, np.maximum(np.roll(off, 1), np.roll(off, -1)))
    return (off > 1) & (off == most)


def _thinned(seconds: Array, effort: Array) -> tuple[Array, Array]:
    """Means over short spans of time where there are more samples than a fit needs."""
    if len(seconds) <= _MOST:
        return seconds, effort
    since = seconds - seconds[0]
    width = float(since[-1]) / (_MOST - 1)
    spans = (since / width).astype(np.int64)
    near = since - spans * width < _SPAN_S
    _, spans, counts = np.unique(spans[near], return_inverse=True, return_counts=True)
    rows = np.column_stack([seconds[near], effort[near]])
    sums = np.zeros((len(counts), rows.shape[1]))
    np.add.at(sums, spans, rows)
    means = sums / counts[:, None]
    return means[:, 0], means[:, 1:]


def _known(log: ArmLog) -> NDArray[np.bool_]:
    """Which torques were measured where the motion is known."""
    positions, efforts = log.position.seconds, log.effort.seconds
    after = np.clip(np.searchsorted(positions, efforts), 1, len(positions) - 1)
    gaps = np.diff(positions)
    most = max(_MOST_GAP * float(np.median(gaps)), _LEAST_GAP_S)
    inside = (efforts > positions[0] + _ENDS_S) & (efforts < positions[-1] - _ENDS_S)
    return inside & (gaps[after - 1] < most)
