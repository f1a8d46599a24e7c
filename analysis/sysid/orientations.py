"""Which orientations of a log are compared: those that a model begins with, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from recorders.simulators.mujoco.model_frames import free_joint, rotation_in
from recorders.simulators.mujoco.model_sensors import SensedSignal
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import short_name

_NEAR_DEG = 20.0
"""Between a body's orientation in the log and in the model, at the start: a tracker has axes of its
own, which nobody may have turned as the model's."""


@dataclass(frozen=True, eq=False)
class Turned:
    """An orientation in a log.

    Attributes:
        sensed: the body's x and z axes.
        words: as what it is used.
        is_sure: whether a user says that its axes are the body's.
    """

    sensed: SensedSignal
    words: str
    is_sure: bool

    @property
    def body(self) -> str:
        """Whose it is."""
        return self.sensed.sensors[0].name

    @property
    def reference(self) -> str:
        """The body that it is seen from; "" for the world."""
        return self.sensed.sensors[0].reference


def orients_start(model: Any, turned: Sequence[Turned]) -> list[SensedSignal]:
    """Those that a rollout's first orientations are taken from: of bodies that move freely."""
    return [one.sensed for one in turned if free_joint(model, one.body) is not None]


def why_not(model: Any, qpos: Array, turned: Turned) -> str:
    """Why an orientation is not compared; "" where it is.

    Args:
        model: compiled.
        qpos: its coordinates at the start, shape (nq,).
        turned: the log's.
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
    """Rotations, shape (T, 3, 3), by their x and z axes, shape (T, 6)."""
    x, z = axes[:, :3], axes[:, 3:]
    return np.stack([x, np.cross(z, x), z], axis=2)
