"""Where a log's motion begins: positions and speeds at its first stamp, and how sure they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from analysis.sysid.compared import noise_of
from recorders.simulators.base import Parameter
from recorders.simulators.mujoco.library import mujoco
from recorders.simulators.mujoco.model_simulator import InitialState, SensedSignal
from tunenet_logs.arrays import Array

_SECONDS, _MOST_SAMPLES, _LEAST_SAMPLES = 0.12, 40, 4
_CAUTION = 3.0
"""What the priors are wider by than the noise alone says: speeds change in the first samples."""

_LEAST_SD = 1e-4
_FAR = 50.0
"""Standard deviations from its estimate that an initial value is looked for."""


def initial_state(model: Any, sensed: Sequence[SensedSignal], stamp_ns: int) -> InitialState:
    """The state of a compiled model at a stamp, by what the log shows of it right after.

    What the log does not show is as the model has it, at rest.

    Args:
        model: compiled.
        sensed: what the log shows.
        stamp_ns: where a rollout is to begin.
    """
    qpos, qvel = model.qpos0.copy(), np.zeros(model.nv)
    if model.nkey:
        qpos = model.key_qpos[0].copy()
    unsure: list[Parameter] = []
    places: list[tuple[bool, int]] = []
    shown = _shown(model, sensed)
    for (label, unit, place_q, place_v), (positions, speeds) in shown.items():
        found = _beginning(positions, speeds, stamp_ns)
        if found is None:
            continue
        (position, speed), (position_sd, speed_sd), knows_position = found
        if abs(position - qpos[place_q]) < position_sd and abs(speed) < speed_sd:
            continue  # as the model has it, such as a body that lies on the ground
        if knows_position:
            qpos[place_q] = position
            unsure.append(_unsure(f"initial/{label}.position", unit, position, position_sd))
            places.append((False, place_q))
        qvel[place_v] = speed
        unsure.append(_unsure(f"initial/{label}.velocity", f"{unit}/s", speed, speed_sd))
        places.append((True, place_v))
    return InitialState(stamp_ns, qpos, qvel, tuple(unsure), tuple(places))


_Samples = tuple[Array, Array]
"""Stamps [ns] and values."""


def _shown(
    model: Any, sensed: Sequence[SensedSignal]
) -> dict[tuple[str, str, int, int], tuple[_Samples | None, _Samples | None]]:
    """What is shown of each coordinate: its name, unit and places -> positions and speeds."""
    shown: dict[tuple[str, str, int, int], tuple[_Samples | None, _Samples | None]] = {}
    kinds = mujoco().mjtJoint
    for one in sensed:
        for column, sensor in zip(one.columns, one.sensors, strict=True):
            samples = _samples(one, column)
            if sensor.kind == "framepos":
                joint = _free_joint(model, sensor.name)
                if joint is None:
                    continue
                axis = "xyz"[sensor.axis]
                key = (
                    f"{sensor.name}.{axis}",
                    "m",
                    int(model.jnt_qposadr[joint]) + sensor.axis,
                    int(model.jnt_dofadr[joint]) + sensor.axis,
                )
                shown[key] = (samples, None)
            elif sensor.kind in ("jointpos", "jointvel"):
                joint = model.joint(sensor.name).id
                unit = "m" if model.jnt_type[joint] == kinds.mjJNT_SLIDE else "rad"
                key = (
                    sensor.name,
                    unit,
                    int(model.jnt_qposadr[joint]),
                    int(model.jnt_dofadr[joint]),
                )
                positions, speeds = shown.get(key, (None, None))
                if sensor.kind == "jointpos":
                    shown[key] = (samples, speeds)
                else:
                    shown[key] = (positions, samples)
    return shown


def _free_joint(model: Any, body: str) -> int | None:
    """The joint that lets a body move freely; None where it hangs on another."""
    number = model.body(body).id
    first = int(model.body_jntadr[number])
    free = mujoco().mjtJoint.mjJNT_FREE
    return first if first >= 0 and model.jnt_type[first] == free else None


def _samples(sensed: SensedSignal, column: str) -> _Samples:
    values = sensed.signal.values[:, sensed.signal.columns.index(column)]
    good = np.isfinite(values)
    return sensed.signal.stamps_ns[good].astype(np.float64), values[good]


def _beginning(
    positions: _Samples | None, speeds: _Samples | None, stamp_ns: int
) -> tuple[tuple[float, float], tuple[float, float], bool] | None:
    """Position and speed at a stamp, their standard deviations, and whether a position was seen.

    One parabola goes through the first positions and, as its slope, through the first speeds.
    """
    rows: list[Array] = []
    values: list[Array] = []
    for samples, row_of in (
        (positions, lambda t: np.column_stack([np.ones_like(t), t, t**2 / 2])),
        (speeds, lambda t: np.column_stack([np.zeros_like(t), np.ones_like(t), t])),
    ):
        if samples is None or len(samples[0]) < _LEAST_SAMPLES:
            continue
        at_s = (samples[0] - stamp_ns) * 1e-9
        count = int(np.clip(np.sum(at_s <= _SECONDS), _LEAST_SAMPLES, _MOST_SAMPLES))
        noise = max(noise_of(samples[1]), 1e-9)
        rows.append(row_of(at_s[:count]) / noise)
        values.append(samples[1][:count] / noise)
    if not rows:
        return None
    matrix, wanted = np.concatenate(rows), np.concatenate(values)
    inverse = np.linalg.pinv(matrix.T @ matrix)
    found = inverse @ (matrix.T @ wanted)
    sds = _CAUTION * np.sqrt(np.maximum(np.diag(inverse), 0.0))
    return (float(found[0]), float(found[1])), (float(sds[0]), float(sds[1])), positions is not None


def _unsure(name: str, unit: str, value: float, sd: float) -> Parameter:
    sd = max(sd, _LEAST_SD)
    far = (value - _FAR * sd, value + _FAR * sd)
    return Parameter(name, unit, far, (value - sd, value + sd), value, prior_sd=sd)
