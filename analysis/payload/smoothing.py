"""A smooth curve through noisy samples, as stiff as cross-validation wants it.

A penalised spline of degree 5 on even knots, with third differences as its penalty (Eilers and
Marx 1996), so that second derivatives are smooth too; its stiffness by generalised cross-validation
(Craven and Wahba 1979), for each column.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tunenet_logs.arrays import Array

if TYPE_CHECKING:
    from scipy.interpolate import BSpline


_DEGREE = 5
_LEAST_KNOT_S = 0.04
_STIFFNESSES = np.logspace(-9, 7, 65)
_CAUTION = 1.4
"""What a degree of freedom costs: 1 follows noise too often (Gu 2002)."""
_WINDOW = 300
"""Knots over which the stiffness is chosen; a long recording is as stiff throughout."""
_FREE = 1e-10
"""Share of the penalty that keeps gaps without a sample determined."""


def smoothing_spline(seconds: Array, values: Array, late_s: float = 0.0) -> BSpline:
    """Fit each column of samples.

    Args:
        seconds: when they were taken [s], increasing, shape (T,).
        values: shape (T, C).
        late_s: by how much each may have been taken earlier. Such errors have a memory, which
            cross-validation takes for the curve; so no curve comes nearer than they allow.
    """
    from scipy.interpolate import BSpline
    from scipy.sparse import dia_array
    from scipy.sparse.linalg import splu

    step = max(float(np.median(np.diff(seconds))), _LEAST_KNOT_S)
    cells = max(int(np.ceil((seconds[-1] - seconds[0]) / step)), _DEGREE)
    step = (seconds[-1] - seconds[0]) / cells
    knots = seconds[0] + step * np.arange(-_DEGREE, cells + _DEGREE + 1)
    design = BSpline.design_matrix(seconds, knots, _DEGREE, extrapolate=True).tocsc()
    count = cells + _DEGREE
    weights = np.tile([[-1.0], [3.0], [-3.0], [1.0]], count)
    third = dia_array((weights, np.arange(4)), shape=(count - 3, count))
    normal, penalty = (design.T @ design).tocsc(), (third.T @ third).tocsc()
    speeds = np.diff(values, axis=0) / np.diff(seconds)[:, None]
    floor = late_s**2 / 12 * np.mean(speeds**2, axis=0)
    some = seconds <= knots[_DEGREE + min(cells, _WINDOW)]
    window = slice(0, min(cells, _WINDOW) + _DEGREE)
    stiffnesses = _stiffnesses(
        design[some][:, window].toarray(), penalty[window, window].toarray(), values[some], floor
    )
    pull = design.T @ values
    coefficients = [
        splu(normal + (stiffness + _FREE) * penalty).solve(column)
        for stiffness, column in zip(stiffnesses, pull.T, strict=True)
    ]
    return BSpline(knots, np.column_stack(coefficients), _DEGREE, extrapolate=True)


def _stiffnesses(design: Array, penalty: Array, values: Array, floor: Array) -> Array:
    """For each column of `values`, shape (C,), such that the variance left is over a floor's."""
    from scipy.linalg import eigh

    normal = design.T @ design
    powers, ways = eigh(penalty, normal + _FREE * penalty)
    powers = np.maximum(powers, 0.0)
    curves = design @ ways
    amounts = curves.T @ values
    kept = 1 / (1 + _STIFFNESSES[:, None] * powers)
    squares = np.sum(values**2, axis=0) - 2 * kept @ amounts**2 + kept**2 @ amounts**2
    freedom = len(values) - _CAUTION * kept.sum(axis=1)
    scores = np.maximum(squares, 0.0) / np.maximum(freedom, 1e-3)[:, None] ** 2
    scores[freedom <= 0] = np.inf
    left = squares / np.maximum(len(values) - kept.sum(axis=1), 1.0)[:, None]
    scores[(left < floor) & (left < left[-1])] = np.inf
    return _STIFFNESSES[np.argmin(scores, axis=0)]
