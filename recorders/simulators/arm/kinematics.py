"""Where an arm's links are: forward kinematics of many samples at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from recorders.simulators.arm.description import Arm
from recorders.simulators.arm.rigid_bodies import Transform
from tunenet_logs.arrays import Array


@dataclass(frozen=True, eq=False)
class LinkPoses:
    """Frames of an arm's base, of each joint's link and of its tool, in that order.

    Attributes:
        position_m: origins in the base's frame, shape (T, J + 2, 3).
        rotation: axes as columns, shape (T, J + 2, 3, 3).
    """

    position_m: Array
    rotation: Array


def link_poses(arm: Arm, position_rad: ArrayLike) -> LinkPoses:
    """Forward kinematics; `position_rad` has shape (T, J)."""
    angles = np.asarray(position_rad, np.float64)
    samples = len(angles)
    origin = np.zeros((samples, 3))
    rotation = np.broadcast_to(np.eye(3), (samples, 3, 3))
    origins, rotations = [origin], [rotation]
    for index, joint in enumerate(arm.joints):
        at = Transform.at(joint.origin_m, joint.origin_rpy)
        axis, moved = np.array(joint.axis), angles[:, index]
        origin = origin + rotation @ at.origin_m
        rotation = rotation @ at.rotation
        if joint.is_prismatic:
            origin = origin + (rotation @ axis) * moved[:, None]
        else:
            rotation = rotation @ _turned(axis, moved)
        origins.append(origin)
        rotations.append(rotation)
    tool = Transform.at(arm.tool_from_last_m, arm.tool_from_last_rpy)
    origins.append(origin + rotation @ tool.origin_m)
    rotations.append(rotation @ tool.rotation)
    return LinkPoses(np.stack(origins, axis=1), np.stack(rotations, axis=1))


def link_positions_m(arm: Arm, position_rad: ArrayLike) -> Array:
    """Origins of base, joints' links and tool in the base's frame, shape (T, J + 2, 3)."""
    return link_poses(arm, position_rad).position_m


def _turned(axis: Array, angle_rad: Array) -> Array:
    """Rotations about one axis (Rodrigues), shape (T, 3, 3)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, rest = np.sin(angle_rad)[:, None, None], (1 - np.cos(angle_rad))[:, None, None]
    return np.eye(3) + sine * cross + rest * (cross @ cross)
