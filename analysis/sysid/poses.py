"""Match positions and orientations in a log with a model's bodies and frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from analysis.sysid.names import named_as, topic_of, words_of
from recorders.simulators.mujoco.model_sensors import Kind, SensedSignal, Sensor
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import short_name

# Frames that are taken for the model's world without a word.
_WORLDS = ("world", "map", "odom", "mocap")

_AXES: tuple[Kind, Kind] = ("framexaxis", "framezaxis")


def is_orientation(signal: Signal) -> bool:
    """Return whether a signal is one of quaternions."""
    return signal.columns == ("x", "y", "z", "w") and signal.unit == "1"


def sensed_pose(
    signal: Signal, told: str, bodies: Sequence[str]
) -> tuple[SensedSignal | None, str]:
    """Match a position or an orientation with a model.

    Args:
        signal: Of the log.
        told: Body that the user names; "" if none.
        bodies: The model's, the world first.

    Returns:
        The matched signal (of an orientation the body's x and z axes), and its use in words; or
        None, and why.

    Raises:
        UsageError: The user names a body for a signal that is neither.
    """
    is_turn = is_orientation(signal)
    if not is_turn and (signal.columns != ("x", "y", "z") or signal.unit != "m"):
        raise UsageError(
            f"--map {short_name(signal.name)}=body/{short_name(told)}: is no position in m",
            "map the topic of a pose, a point or a transform",
        )
    found = (named_as(word, bodies[1:]) for word in words_of(topic_of(signal.name)))
    body = told or next((one for one in found if one is not None), None)
    if body is None:
        return None, "no body of the model is called so"
    if np.isfinite(signal.values).all(axis=1).sum() < 2:
        return None, "fewer than two samples"
    reference = named_as(signal.frame, bodies[1:]) or ""
    if reference == body:
        return None, f"is in {short_name(body)}'s own frame"
    words = f" from {short_name(reference)}" if reference else _taken_for_world(signal.frame)
    if is_turn:
        return _axes(signal, body, reference), f"orientation of {short_name(body)}{words}"
    sensors = tuple(Sensor("framepos", body, axis, reference) for axis in range(3))
    return SensedSignal(signal, signal.columns, sensors), f"position of {short_name(body)}{words}"


def _taken_for_world(frame: str) -> str:
    """Describe a frame that the model does not know; "" if there is none."""
    plain = frame.rpartition("/")[2].lower()
    return "" if plain in ("", *_WORLDS) else f", frame {short_name(frame)} taken for the world"


def _axes(signal: Signal, body: str, reference: str) -> SensedSignal:
    """Convert quaternions to a body's x and z axes, which have no sign ambiguity."""
    columns = tuple(f"{one} axis {each}" for one in "xz" for each in "xyz")
    sensors = tuple(Sensor(kind, body, axis, reference) for kind in _AXES for axis in range(3))
    axes = _axes_of(signal.values)
    return SensedSignal(replace(signal, values=axes, columns=columns), columns, sensors)


def _axes_of(quaternions: Array) -> Array:
    """Return the x and z axes, shape (T, 6), of quaternions x, y, z, w, shape (T, 4)."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    return np.column_stack(
        [
            1 - 2 * (y * y + z * z),
            2 * (x * y + z * w),
            2 * (x * z - y * w),
            2 * (x * z + y * w),
            2 * (y * z - x * w),
            1 - 2 * (x * x + y * y),
        ]
    )
