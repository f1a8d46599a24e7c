"""Joint angles as a physical arm has them: in radians, without jumps of whole turns."""

from __future__ import annotations

import numpy as np

from recorders.simulators.arm.description import Arm
from tunenet_logs.arrays import Array

_TURN = 2 * np.pi
_SLACK_RAD = 0.3
_MOST_TURNS = 2.1
_FAST = 3.0
"""Times its limit that a joint never moves at."""
_FASTEST_RAD_S = 15.0


def in_radians(seconds: Array, values: Array, arm: Arm) -> tuple[Array, list[str]]:
    """Angles as the arm can have had them, and what was done to them in words.

    Degrees give themselves away: as radians they are outside of the joints' limits, turn many
    times, or faster than any arm does.

    Args:
        seconds: times [s], shape (T,).
        values: as the driver gives them, shape (T, J); of a joint that slides in m.
        arm: whose they are.
    """
    turns = np.array([not one.is_prismatic for one in arm.joints])
    notes: list[str] = []
    as_degrees = np.where(turns, np.radians(values), values)
    if turns.any() and _oddities(seconds, as_degrees, arm) < _oddities(seconds, values, arm):
        values = as_degrees
        notes.append("the joints' positions are in degrees: converted")
    whole = np.where(turns, np.unwrap(values, period=_TURN, axis=0), values)
    if not np.allclose(whole, values):
        notes.append("the joints' positions are cut to one turn: joined")
    for at, joint in enumerate(arm.joints):
        middle = sum(joint.limits_rad) / 2
        if turns[at] and np.isfinite(middle):
            whole[:, at] -= _TURN * np.round((float(np.mean(whole[:, at])) - middle) / _TURN)
    return whole, notes


def _oddities(seconds: Array, values: Array, arm: Arm) -> int:
    """How many joints are where, or as fast as, none can be."""
    steps = np.diff(values, axis=0)
    steps -= _TURN * np.round(steps / _TURN)
    speeds = np.quantile(np.abs(steps) / np.diff(seconds)[:, None], 0.9, axis=0)
    count = 0
    for joint, speed, column in zip(arm.joints, speeds, values.T, strict=True):
        if joint.is_prismatic:
            continue
        low, high = joint.limits_rad
        if np.isfinite(high - low) and high - low < _TURN:
            beyond = np.mod(column - low + _SLACK_RAD, _TURN) > high - low + 2 * _SLACK_RAD
            count += int(np.mean(beyond) > 0.1)
        fastest = min(_FAST * joint.max_velocity_rad_s, _FASTEST_RAD_S)
        count += int(speed > fastest)
        count += int(np.abs(column).max() > _MOST_TURNS * _TURN)
    return count
