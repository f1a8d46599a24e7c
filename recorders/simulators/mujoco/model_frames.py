"""Transform a log's body poses to a model's world frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from recorders.simulators.mujoco.library import mujoco
from recorders.simulators.mujoco.model_sensors import SensedSignal
from tunenet_logs.arrays import Array


def free_joint(model: Any, body: str) -> int | None:
    """Find a body's free joint; None where it has none."""
    number = model.body(body).id
    first = int(model.body_jntadr[number])
    free = mujoco().mjtJoint.mjJNT_FREE
    return first if first >= 0 and model.jnt_type[first] == free else None


def rotation_in(model: Any, qpos: Array, body: str, reference: str) -> Array:
    """Compute a body's rotation in another's frame ("": the world) at `qpos`, shape (3, 3).

    Args:
        model: compiled.
        qpos: its coordinates, shape (nq,).
        body: its name.
        reference: name of the other; "" for the world.
    """
    data = mujoco().MjData(model)
    data.qpos[:] = qpos
    mujoco().mj_kinematics(model, data)
    own = data.body(body).xmat.reshape(3, 3)
    return data.body(reference).xmat.reshape(3, 3).T @ own if reference else own.copy()


def seen_in_world(model: Any, sensed: Sequence[SensedSignal]) -> list[SensedSignal]:
    """Transform signals in frames of static bodies to the world; omit moving frames.

    Those that are seen from a body that moves are left out.
    """
    found: list[SensedSignal] = []
    for one in sensed:
        reference = one.sensors[0].reference
        if not reference:
            found.append(one)
        elif model.body_weldid[model.body(reference).id] == 0:
            found.append(_in_world(model, one, reference))
    return found


def _in_world(model: Any, sensed: SensedSignal, reference: str) -> SensedSignal:
    """Transform a signal of 3-vectors to the world frame."""
    data = mujoco().MjData(model)
    mujoco().mj_kinematics(model, data)
    frame = data.body(reference)
    values = sensed.signal.values.reshape(len(sensed.signal.values), -1, 3)
    values = values @ frame.xmat.reshape(3, 3).T
    if sensed.sensors[0].kind == "framepos":
        values = values + frame.xpos
    flat = np.asarray(values).reshape(sensed.signal.values.shape)
    sensors = tuple(sensor._replace(reference="") for sensor in sensed.sensors)
    return replace(sensed, signal=replace(sensed.signal, values=flat), sensors=sensors)
