"""Where frames are in other frames: rotations, and roll, pitch and yaw as URDF means them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, cos, hypot, sin

import numpy as np

from tunenet_logs.arrays import Array


def rotation_from_rpy(rpy: Sequence[float]) -> Array:
    """R = Rz(yaw) Ry(pitch) Rx(roll), shape (3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = zip(*((cos(one), sin(one)) for one in rpy), strict=True)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_from_rotation(rotation: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw [rad] of a rotation, shape (3, 3); where two are one, yaw is 0."""
    level = hypot(rotation[0, 0], rotation[1, 0])
    pitch = atan2(-rotation[2, 0], level)
    if level < 1e-9:
        return atan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0
    return (
        atan2(rotation[2, 1], rotation[2, 2]),
        pitch,
        atan2(rotation[1, 0], rotation[0, 0]),
    )


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame in another one: its origin [m], shape (3,), and its axes as columns, (3, 3)."""

    origin_m: Array
    rotation: Array

    @classmethod
    def at(cls, origin_m: Sequence[float], rpy: Sequence[float]) -> Frame:
        """A frame by its origin [m], and its roll, pitch and yaw [rad]."""
        return cls(np.array(origin_m, np.float64), rotation_from_rpy(rpy))

    def __matmul__(self, inner: Frame) -> Frame:
        """A frame that is given in this one, in the frame that this one is given in."""
        return Frame(self.origin_m + self.rotation @ inner.origin_m, self.rotation @ inner.rotation)


HERE = Frame.at((0, 0, 0), (0, 0, 0))
"""A frame in itself."""
