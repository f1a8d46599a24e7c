"""Choose which orientations of a log to compare: those that the model begins with, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from recorders.simulators.mujoco.model_frames import free_joint, rotation_in
from recorders.simulators.mujoco.model_sensors import SensedSignal
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import short_name

# Between a body's orientation in the log and in the model, at the start: a tracker has axes of its
# own, which nobody may have turned as the model's.
_NEAR_DEG = 20.0


@dataclass(frozen=True, eq=False)
class Turned:
    """Orientation in a log.

    Attributes:
        sensed: The body's x and z axes.
        words: Description of its use.
        is_sure: Whether the user states that its axes are the body's.
    """

    sensed: SensedSignal
    words: str
    is_sure: bool

    @property
    def body(self) -> str:
        """Body that it is of."""
        return self.sensed.sensors[0].name

    @property
    def reference(self) -> str:
        """Body that it is relative to; "" for the world."""
        return self.sensed.sensors[0].reference


def orients_start(model: Any, turned: Sequence[Turned]) -> list[SensedSignal]:
    """List orientations of freely moving bodies, from which a rollout starts."""
    return [one.sensed for one in turned if free_joint(model, one.body) is not None]


def why_not(model: Any, qpos: Array, turned: Turned) -> str:
    """Say why an orientation is not compared; "" if it is.

    Args:
        model: Compiled.
        qpos: Its coordinates at the start, shape (nq,).
        turned: The log's.
    """
    values = turned.sensed.signal.values
    first = rotations(values[np.isfinite(values).all(axis=1)][:1])[0]
    own = rotation_in(model, qpos, turned.body, turned.reference)
    cosine = (np.trace(first.T @ own) - 1) / 2
    degrees = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    if turned.is_sure or degrees <= _NEAR_DEG:
        return ""
    name, body = turned.sensed.signal.name, short_name(turned.body)
    return (
        f"turned by {degrees:.0f} degrees from body/{body} at the start; where its axes are that "
        f"body's, say --map {short_name(name)}=body/{body}"
    )


def rotations(axes: Array) -> Array:
    """Build rotation matrices, shape (T, 3, 3), from their x and z axes, shape (T, 6)."""
    x, z = axes[:, :3], axes[:, 3:]
    return np.stack([x, np.cross(z, x), z], axis=2)
