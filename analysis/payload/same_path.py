"""Difference and mean of a log and a tare along one path, which separate unmodelled effects.

Ripple, hoses and other unmodelled effects depend on the arm's configuration. Where two runs are in
the same places at the same times, such effects are in their mean alone, not in their difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.payload.arm_motion import ArmMotion
from analysis.payload.torque_model import Convention, Linearization, LoggedArm
from analysis.payload.torque_terms import OWN_TERMS
from tunenet_logs.arrays import Array

# Root mean square and greatest distance of two runs along one path: how a controller repeats.
_NEAR_RAD, _NEVER_BEYOND_RAD = 0.01, 0.05

_OVERLAP = 0.9  # of the log that a tare along its path covers at least
# Of the search for the time by which the one began later: positions a second, shifts that are
# tried, and how often the step between them is halved then.
_COARSE_HZ, _MAX_SHIFTS, _HALVINGS = 20.0, 400, 12

_DRIFTS, _LAG = slice(-2, None), -OWN_TERMS - 3  # columns of a run's own terms


@dataclass(frozen=True, eq=False)
class TorqueRows:
    """Least-squares rows of a series of torques.

    Attributes:
        seconds: [s], shape (T,).
        left_nm: Residual at the linearisation point, shape (T, J).
        columns: Terms that each joint's slopes are by, shape (J, C).
        slopes: Shape (T, J, C).
        own: Which of those columns belong to a joint alone.
        used: Joints that count, shape (J,).
    """

    seconds: Array
    left_nm: Array
    columns: NDArray[np.int64]
    slopes: Array
    own: NDArray[np.int64]
    used: NDArray[np.bool_]

    def after_nm(self, change: Array) -> Array:
        """Return the residual, (T, J), after the terms have changed by `change`, shape (N,)."""
        return self.left_nm - np.einsum("tjc,jc->tj", self.slopes, change[self.columns])


def rows_of(
    runs: Sequence[LoggedArm], lines: Sequence[Linearization], convention: Convention
) -> list[TorqueRows]:
    """Build the rows of each run; of a log and a tare along it, their difference and mean."""
    rows = [
        TorqueRows(
            run.motion.seconds,
            run.torques_nm(convention) - line.predicted_nm,
            line.columns,
            line.slopes,
            np.arange(line.columns.shape[1])[-OWN_TERMS - 2 :],
            run.motion.used,
        )
        for run, line in zip(runs, lines, strict=True)
    ]
    beside = next((run for run in runs if run.covered is not None), None)
    if beside is None:
        return rows
    log, tare, inside = rows[0], rows.pop(beside.run), beside.covered
    lags, drifts = tare.columns[:, _LAG, None], tare.columns[:, _DRIFTS]
    columns = np.hstack([log.columns, lags, drifts])
    alone = np.concatenate([tare.slopes[..., _LAG, None], tare.slopes[..., _DRIFTS]], axis=-1)
    shared = tare.slopes.copy()
    shared[..., _LAG] = 0.0
    shared[..., _DRIFTS] = 0.0
    own = np.append(log.own, len(columns[0]) + np.array([-2, -1]))
    used = log.used & tare.used
    pair = []
    for of_log, of_tare, counted in ((1.0, -1.0, own[-4:]), (0.5, 0.5, own)):
        slopes = of_log * log.slopes + of_tare * shared
        both = np.concatenate([slopes, of_tare * alone], axis=-1)
        left_nm = of_log * log.left_nm + of_tare * tare.left_nm
        seconds = log.seconds[inside]
        pair.append(TorqueRows(seconds, left_nm[inside], columns, both[inside], counted, used))
    rows[0] = pair[0]
    rows.insert(1, pair[1])
    return rows


def along(motion: ArmMotion, tare: ArmMotion) -> tuple[ArmMotion, NDArray[np.bool_]] | None:
    """Resample a tare at the log's own times, and say which it covers; None if elsewhere."""
    seconds = motion.seconds
    length_s = float(seconds[-1] - seconds[0])
    step_s = 1 / _COARSE_HZ
    grid = np.arange(seconds[0], seconds[-1], max(step_s, length_s / 500))
    where = motion.spline(grid)
    first, last = float(tare.seconds[0]), float(tare.seconds[-1])
    slack_s = (1 - _OVERLAP) * length_s
    low, high = first - seconds[0] - slack_s, last - seconds[-1] + slack_s
    if high < low:
        return None

    def off(shift: float) -> tuple[float, float]:
        at = grid + shift
        inside = (at >= first) & (at <= last)
        if np.mean(inside) < _OVERLAP:
            return np.inf, np.inf
        away = np.abs(where[inside] - tare.spline(at[inside]))
        return float(np.sqrt(np.mean(away**2))), float(away.max())

    count = int(min(np.ceil((high - low) / step_s) + 1, _MAX_SHIFTS))
    shifts = np.linspace(low, high, count)
    best = min(shifts.tolist(), key=off)
    step = float(shifts[1] - shifts[0]) if count > 1 else step_s
    for _ in range(_HALVINGS):
        step /= 2
        best = min((best - step, best, best + step), key=off)
    rms, worst = off(best)
    if rms > _NEAR_RAD or worst > _NEVER_BEYOND_RAD:
        return None
    at = seconds + best
    inside = (at >= first) & (at <= last)
    effort = np.column_stack([np.interp(at, tare.seconds, column) for column in tare.effort.T])
    return replace(tare, seconds=at, effort=effort), inside
