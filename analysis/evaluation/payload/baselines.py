"""Baselines for the payload: least squares, tare subtraction, and the Cramér-Rao bound.

The Cramér-Rao bound is what no unbiased estimate beats where nothing but the sensors' noise, the
payload's centre and, without a tare, their zeros are unknown.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from analysis.evaluation.payload.stranger_arm import StrangerRun
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode

_SMOOTH_S = 0.35  # of the parabolas whose derivatives are a joint's speed and acceleration
_SLOW_RAD_S = 0.01  # dry friction turns over with a joint's speed, over this


def least_squares(model: Any, frame: int, held: Episode) -> float:
    """Estimate the mass [kg] by least squares, beside offset, viscous and dry friction a joint."""
    seconds, where, effort = _read(held)
    speed, pull, empty = _moved(model, seconds, where)
    per_kg = _rigid(_holding(model, frame, 1.0, np.zeros(3)), where, speed, pull) - empty
    own = (np.ones_like(speed), speed, np.tanh(speed / _SLOW_RAD_S))
    slopes = np.hstack([per_kg.T.reshape(-1, 1), *map(_diagonal, own)])
    return float(_solve(slopes, (effort - empty).T.ravel())[0])


def tare_subtracted(model: Any, frame: int, held: Episode, empty: Episode) -> float:
    """Estimate the mass [kg] and first moments from two runs along one motion."""
    seconds, where, effort = _read(held)
    tare_seconds, tare_where, tare_effort = _read(empty)
    inside = (seconds > tare_seconds[0]) & (seconds < tare_seconds[-1])
    speed, pull, own = _moved(model, seconds, where)
    _, _, tare_own = _moved(model, tare_seconds, tare_where)
    left = tare_effort - tare_own
    there = np.column_stack([np.interp(seconds, tare_seconds, column) for column in left.T])
    base = _rigid(_holding(model, frame, 1.0, np.zeros(3)), where, speed, pull) - own
    columns = [base]
    for axis in np.eye(3):
        moved = _rigid(_holding(model, frame, 1.0, 0.01 * axis), where, speed, pull) - own
        columns.append((moved - base) / 0.01)
    slopes = np.stack([column[inside].T.ravel() for column in columns], axis=1)
    return float(_solve(slopes, (effort - own - there)[inside].T.ravel())[0])


def bound_kg(held: StrangerRun, empty: StrangerRun | None) -> float:
    """Return the Cramér-Rao bound on the mass's standard deviation [kg]; no tare if None."""
    count = held.feels.shape[1]
    precision = np.zeros((4 + count, 4 + count))
    for joint in range(count):
        noise = held.noise_nm[joint]
        zero = np.zeros((len(held.feels), count))
        zero[:, joint] = 1.0
        slopes = np.hstack([held.feels[:, joint], zero]) / noise
        precision += slopes.T @ slopes
        if empty is not None:
            precision[4 + joint, 4 + joint] += len(empty.seconds) / noise**2
    return float(np.sqrt(np.linalg.pinv(precision)[0, 0]))


def _read(episode: Episode) -> tuple[Array, Array, Array]:
    """Return times [s], shape (T,), positions [rad] and torques [N·m], both of shape (T, J)."""
    position = episode.signals["/joint_states.position"]
    effort = episode.signals["/joint_states.effort"]
    seconds = np.asarray(position.stamps_ns * 1e-9, np.float64)
    return seconds, np.array(position.values), np.array(effort.values)


def _moved(model: Any, seconds: Array, where: Array) -> tuple[Array, Array, Array]:
    """Return speeds and accelerations by Savitzky-Golay, and the model's torques, all (T, J)."""
    from scipy.signal import savgol_filter

    step = float(np.median(np.diff(seconds)))
    window = max(2 * int(_SMOOTH_S / step / 2) + 1, 7)
    speed = np.asarray(savgol_filter(where, window, 3, 1, step, axis=0), np.float64)
    pull = np.asarray(savgol_filter(where, window, 3, 2, step, axis=0), np.float64)
    return speed, pull, _rigid(model, where, speed, pull)


def _rigid(model: Any, where: Array, speed: Array, pull: Array) -> Array:
    """Return inverse dynamics torques [N·m] along a motion, all of shape (T, J)."""
    library, data = import_module("pinocchio"), model.createData()
    rows = zip(where, speed, pull, strict=True)
    return np.array([library.rnea(model, data, *row).copy() for row in rows])


def _holding(model: Any, frame: int, mass_kg: float, centre_m: Array) -> Any:
    """Attach a point mass to the model's hand, at a place of the tool frame, shape (3,)."""
    library, model = import_module("pinocchio"), model.copy()
    mount = model.frames[frame]
    body = library.Inertia(mass_kg, centre_m, np.zeros((3, 3)))
    at = mount.parentJoint
    model.inertias[at] = model.inertias[at] + mount.placement.act(body)
    return model


def _diagonal(column: Array) -> Array:
    """Return a column a joint, over the samples of all joints in turn: (J T, J)."""
    samples, count = column.shape
    block = np.zeros((count * samples, count))
    for joint in range(count):
        block[joint * samples : (joint + 1) * samples, joint] = column[:, joint]
    return block


def _solve(slopes: Array, target: Array) -> Array:
    return np.asarray(np.linalg.lstsq(slopes, target, rcond=None)[0], np.float64)
