"""What a network sees of a payload: one reading a joint for any motion, or all as they are."""

from __future__ import annotations

import numpy as np

from analysis.estimators.base import Observation
from recorders.simulators.arm.path import CIRCLE_RAD_S, JointPath, circle_at
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError

READINGS = 7
"""Joints that a reading is taken of, those that feel a payload most: a Jaco has as many."""

PAPER_RATE_HZ = 60.0
PAPER_SAMPLES = 300
PAPER_JOINTS = 7
"""What the paper's network sees: 5 s of a Jaco's torques (Allevato et al. 2019)."""

CIRCLE_S = 2 * np.pi / CIRCLE_RAD_S
"""A turn."""

_NEAR_S = 0.05
"""To the nearest torque: between samples further apart nothing is interpolated."""

_COARSE, _HALVINGS = 64, 16
"""Phases that the search for the circle begins with, some degrees apart; then it halves its step,
down to microseconds."""


def payload_readings(effort_nm: Array, empty_nm: Array, per_kg_nm: Array) -> Observation:
    """Each joint's part of the payload's mass, so that one network serves every arm and motion.

    A joint's torques beyond those of the empty arm are projected on what a kilogram adds to them;
    the sum over all joints is the mass by least squares. Constant torques are left out of both: a
    sensor's offset is one. Joints are in the order of how much of a payload they feel.

    Args:
        effort_nm: along a motion [N·m], shape (T, J).
        empty_nm: with nothing in the gripper, along the same motion [N·m], shape (T, J).
        per_kg_nm: what a kilogram adds to that [N·m], shape (T, J).

    Returns:
        Values in kg, shape (7, 1); 0 for joints that the arm has not.
    """
    felt = per_kg_nm - per_kg_nm.mean(axis=0)
    beyond = effort_nm - empty_nm
    parts = (beyond * felt).sum(axis=0) / (felt**2).sum()
    order = np.argsort((felt**2).sum(axis=0))[::-1][:READINGS]
    values = np.zeros((READINGS, 1))
    values[: len(order), 0] = parts[order]
    axis = np.arange(1.0, READINGS + 1)
    return Observation(values, axis, "joint, by how much of a payload it feels", ("[kg]",))


def paper_torques(seconds: Array, effort_nm: Array, phase_s: float = 0.0) -> Observation:
    """Seven torques at 60 Hz for the first 5 s of the paper's circle, as its network sees them.

    Args:
        seconds: times of the torques [s], shape (T,), increasing.
        effort_nm: [N·m], shape (T, 7).
        phase_s: how far along the circle the arm is at 0 s [s].

    Returns:
        Values in N·m, shape (300, 7); NaN where there are no torques.
    """
    axis = np.arange(PAPER_SAMPLES) / PAPER_RATE_HZ
    along = (seconds + phase_s) % CIRCLE_S
    order = np.argsort(along)
    along, effort_nm = along[order], effort_nm[order]
    after = np.clip(np.searchsorted(along, axis), 1, len(along) - 1)
    nearest = np.minimum(np.abs(along[after] - axis), np.abs(along[after - 1] - axis))
    values = np.column_stack([np.interp(axis, along, column) for column in effort_nm.T])
    values[nearest > _NEAR_S] = np.nan
    names = tuple(f"joint {number} [N·m]" for number in range(1, PAPER_JOINTS + 1))
    return Observation(values, axis, "time [s]", names)


def circle_phase_s(path: JointPath) -> tuple[float, float]:
    """How far along the paper's circle a motion is at 0 s, and its worst distance from it [rad].

    Raises:
        NotFoundError: it is the motion of another arm.
    """
    if path.position_rad.shape[1] != PAPER_JOINTS:
        raise NotFoundError("the paper's network knows the Jaco alone; use --preset default")

    def off_rad(phase_s: float) -> Array:
        ideal = circle_at(path.seconds + phase_s).position_rad
        return np.angle(np.exp(1j * (path.position_rad - ideal)))

    def cost(phase_s: float) -> float:
        return float(np.sum(off_rad(phase_s) ** 2))

    step_s = CIRCLE_S / _COARSE
    phase_s = min((step_s * np.arange(_COARSE)).tolist(), key=cost)
    for _ in range(_HALVINGS):
        step_s /= 2
        phase_s = min((phase_s - step_s, phase_s, phase_s + step_s), key=cost)
    return phase_s % CIRCLE_S, float(np.abs(off_rad(phase_s)).max())
