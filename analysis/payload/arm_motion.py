"""Smooth an arm's joint positions, and differentiate them twice.

A penalised spline of degree 5 on even knots, with third differences as its penalty (P-spline,
Eilers and Marx 1996), so that second derivatives are smooth too; its smoothing parameter by
generalised cross-validation (Craven and Wahba 1979), for each joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.payload.arm_log import MIN_KNOT_S, ArmLog, most_knots
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

# Left out at both ends: a spline's second derivative is poor where samples are on one side.
_ENDS_S = 0.25

# A gap of the positions within which the motion is unknown: longer than both.
_MAX_GAP_PERIODS, _MIN_GAP_S = 5.0, 0.25

_MIN_TORQUES = 20  # samples; fewer do not determine the terms of a fit
# A single sample is an outlier where it is off the middle of its neighbours by more than this angle
# and this multiple of the median.
_OUTLIER_RAD, _OUTLIER_FACTOR = 0.05, 20.0

_MAX_TORQUES = 700  # samples of a fit: more cost time and add nothing, as an arm's motion is slow
# Over which the torques of an arm hardly change: spans of samples that are averaged.
_MEAN_SPAN_S = 0.05

_DEGREE = 5  # of the spline: its second derivative is a cubic, smooth itself
# Penalty weights that are compared: from interpolation to a parabola, four a decade.
_STIFFNESSES = np.logspace(-9, 7, 65)

# Of a degree of freedom in the score: with 1, cross-validation follows noise too often (Gu 2002).
_DOF_COST = 1.4

_WINDOW_KNOTS = 300  # over which the stiffness is chosen; a long recording has the same throughout
_RIDGE = 1e-10  # fraction of the penalty that keeps knots without a sample determined


@dataclass(frozen=True, eq=False)
class ArmMotion:
    """Torques, and the motion at any time between.

    Attributes:
        seconds: Of the torques [s], shape (T,).
        effort: As reported by the driver [N·m], shape (T, J).
        used: Joints whose torque is informative, shape (J,).
        spline: Positions of all joints [rad] over time [s].
    """

    seconds: Array
    effort: Array
    used: NDArray[np.bool_]
    spline: BSpline

    def at(self, seconds: Array) -> tuple[Array, Array, Array]:
        """Return positions [rad], velocities [rad/s] and accelerations [rad/s^2], each (T, J)."""
        position, velocity, acceleration = (self.spline(seconds, order) for order in range(3))
        return position, velocity, acceleration


def arm_motion(log: ArmLog) -> ArmMotion:
    """Smooth the positions by P-splines, with generalised cross-validation.

    The first and last quarter of a second are left out, and torques in gaps of the positions.

    Raises:
        NotFoundError: Too few torques remain.
    """
    positions, efforts = log.position.seconds, log.effort.seconds
    angles = log.position.values
    # Single samples at which no arm can have been between the two beside them.
    off = np.zeros(len(angles))
    aside = np.abs(angles[1:-1] - (angles[2:] + angles[:-2]) / 2)
    usual = np.maximum(_OUTLIER_FACTOR * np.median(aside, axis=0), _OUTLIER_RAD)
    off[1:-1] = np.max(aside / usual, axis=1)
    most = np.maximum(off, np.maximum(np.roll(off, 1), np.roll(off, -1)))
    inliers = ~((off > 1) & (off == most))
    spline = smoothing_spline(positions[inliers], angles[inliers], log.position.late_s)
    after = np.clip(np.searchsorted(positions, efforts), 1, len(positions) - 1)
    gaps = np.diff(positions)
    most_s = max(_MAX_GAP_PERIODS * float(np.median(gaps)), _MIN_GAP_S)
    inside = (efforts > positions[0] + _ENDS_S) & (efforts < positions[-1] - _ENDS_S)
    keep = inside & (gaps[after - 1] < most_s)
    if np.count_nonzero(keep) < _MIN_TORQUES:
        raise NotFoundError(
            f"{np.count_nonzero(keep)} torques have positions about them (wanted: "
            f"{_MIN_TORQUES} or more): record both at once, for 5 s"
        )
    seconds, effort = efforts[keep], log.effort.values[keep]
    if len(seconds) > _MAX_TORQUES:  # means over short spans
        since = seconds - seconds[0]
        width = float(since[-1]) / (_MAX_TORQUES - 1)
        spans = (since / width).astype(np.int64)
        near = since - spans * width < _MEAN_SPAN_S
        _, spans, counts = np.unique(spans[near], return_inverse=True, return_counts=True)
        rows = np.column_stack([seconds[near], effort[near]])
        sums = np.zeros((len(counts), rows.shape[1]))
        np.add.at(sums, spans, rows)
        means = sums / counts[:, None]
        seconds, effort = means[:, 0], means[:, 1:]
    return ArmMotion(seconds, effort, ~log.constant, spline)


def smoothing_spline(seconds: Array, values: Array, late_s: float = 0.0) -> BSpline:
    """Fit a P-spline to each column of samples.

    Args:
        seconds: Of the samples [s], increasing, shape (T,).
        values: Shape (T, C).
        late_s: Maximum delay from measurement to stamp [s]. Such errors are correlated, which
            cross-validation takes for the curve; so residuals stay at least as large as they make.
    """
    from scipy.interpolate import BSpline
    from scipy.sparse import dia_array
    from scipy.sparse.linalg import splu

    step = max(float(np.median(np.diff(seconds))), MIN_KNOT_S)
    cells = int(np.ceil((seconds[-1] - seconds[0]) / step))
    cells = min(max(cells, _DEGREE), most_knots(len(seconds)))
    step = (seconds[-1] - seconds[0]) / cells
    knots = seconds[0] + step * np.arange(-_DEGREE, cells + _DEGREE + 1)
    design = BSpline.design_matrix(seconds, knots, _DEGREE, extrapolate=True).tocsc()
    count = cells + _DEGREE
    weights = np.tile([[-1.0], [3.0], [-3.0], [1.0]], count)
    third = dia_array((weights, np.arange(4)), shape=(count - 3, count))
    normal, penalty = (design.T @ design).tocsc(), (third.T @ third).tocsc()
    speeds = np.diff(values, axis=0) / np.diff(seconds)[:, None]
    floor = late_s**2 / 12 * np.mean(speeds**2, axis=0)  # variance of a uniform delay, times speed
    early = seconds <= knots[_DEGREE + min(cells, _WINDOW_KNOTS)]
    size = min(cells, _WINDOW_KNOTS) + _DEGREE
    inner = third.tocsr()[: size - 3, :size].toarray()  # a difference cut off would pull to 0
    stiffnesses = _stiffnesses(
        design[early][:, :size].toarray(), inner.T @ inner, values[early], floor
    )
    right_sides = design.T @ values
    coefficients = [
        splu(normal + (stiffness + _RIDGE) * penalty).solve(column)
        for stiffness, column in zip(stiffnesses, right_sides.T, strict=True)
    ]
    return BSpline(knots, np.column_stack(coefficients), _DEGREE, extrapolate=True)


def _stiffnesses(design: Array, penalty: Array, values: Array, floor: Array) -> Array:
    """Choose each column's penalty weight, shape (C,), by generalised cross-validation.

    In the basis that makes both matrices diagonal (Demmler and Reinsch 1975) a stiffness only
    shrinks each coordinate, so that all of them are compared at the cost of one.

    Args:
        design: Spline basis at each sample, shape (T, K).
        penalty: Squared third differences, shape (K, K).
        values: Shape (T, C).
        floor: Least variance of the residuals, shape (C,).
    """
    from scipy.linalg import eigh

    normal = design.T @ design
    powers, basis = eigh(penalty, normal + _RIDGE * penalty)
    powers = np.maximum(powers, 0.0)
    curves = design @ basis
    amounts = curves.T @ values
    shrinkage = 1 / (1 + _STIFFNESSES[:, None] * powers)
    squares = np.sum(values**2, axis=0) - 2 * shrinkage @ amounts**2 + shrinkage**2 @ amounts**2
    freedom = len(values) - _DOF_COST * shrinkage.sum(axis=1)
    scores = np.maximum(squares, 0.0) / np.maximum(freedom, 1e-3)[:, None] ** 2
    scores[freedom <= 0] = np.inf
    variance = squares / np.maximum(len(values) - shrinkage.sum(axis=1), 1.0)[:, None]
    scores[(variance < floor) & (variance < variance[-1])] = np.inf
    return _STIFFNESSES[np.argmin(scores, axis=0)]
