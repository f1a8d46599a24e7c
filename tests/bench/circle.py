"""Make `recorders/simulators/arm/circle.csv`: one turn of the paper's circle by the Jaco.

`python -m tests.bench.circle FILE.csv`. Seven joints leave four ways to hold the tool at a point.
Of these each sample takes the one nearest to a posture, so that the turn closes and is smooth.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.arm.description import Arm, jaco
from tunenet_logs.recorders.simulators.arm.path import CIRCLE_RAD_S, link_poses, write_path_file

POSTURE_RAD = (0.323, 3.394, 0.688, 1.365, 2.32, 1.916, 0.672)
SAMPLES = 256
ROUNDS = 400


def main() -> None:
    turn = np.arange(SAMPLES + 1) / SAMPLES
    position_rad = nearest_to_posture(jaco(), circle_m(2 * math.pi * turn[:-1]))
    closed = np.concatenate([position_rad, position_rad[:1]])
    seconds = 2 * math.pi / CIRCLE_RAD_S * turn
    write_path_file(Path(sys.argv[1]), jaco().joint_names, seconds, closed, overwrite=False)


def circle_m(angle_rad: Array) -> Array:
    """Return the paper's circle, 0.3 m over the base, shape (T, 3)."""
    return np.column_stack(
        [np.full(len(angle_rad), -0.4), 0.2 * np.cos(angle_rad), 0.3 + 0.2 * np.sin(angle_rad)]
    )


def nearest_to_posture(arm: Arm, tool_m: Array) -> Array:
    """Solve inverse kinematics at these points near a posture [rad], shape (T, 7)."""
    posture = np.array([POSTURE_RAD])
    position_rad = np.repeat(posture, len(tool_m), axis=0)
    for _ in range(ROUNDS):
        reached_m, jacobian = tool(arm, position_rad)
        inverse = np.linalg.pinv(jacobian)
        to_point = np.einsum("tji,ti->tj", inverse, tool_m - reached_m)
        home = posture - position_rad
        along_null = home - np.einsum("tji,tik,tk->tj", inverse, jacobian, home)
        step = np.clip(0.3 / np.abs(to_point + along_null).max(axis=1, keepdims=True), 0, 1)
        position_rad = position_rad + step * (to_point + along_null / 2)
    return position_rad


def tool(arm: Arm, position_rad: Array) -> tuple[Array, Array]:
    """Return tool positions [m], shape (T, 3), and Jacobians [m/rad], shape (T, 3, J)."""
    poses = link_poses(arm, position_rad)
    reached_m = poses.position_m[:, -1]
    columns = [
        np.cross(poses.rotation[:, index] @ joint.axis, reached_m - poses.position_m[:, index])
        for index, joint in enumerate(arm.joints, start=1)
    ]
    return reached_m, np.stack(columns, axis=-1)


if __name__ == "__main__":
    main()
