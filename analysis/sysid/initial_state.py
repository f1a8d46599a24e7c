"""Estimate the initial state of a log's motion: positions and speeds, with uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from analysis.sysid.beginning import Samples, beginning, stays
from analysis.sysid.initial_turn import InitialTurn, initial_turn
from recorders.simulators.base import Parameter
from recorders.simulators.mujoco.library import mujoco
from recorders.simulators.mujoco.model_frames import free_joint, seen_in_world
from recorders.simulators.mujoco.model_sensors import SensedSignal
from recorders.simulators.mujoco.model_simulator import InitialState

_MIN_SD = 1e-4
_FAR = 50.0  # standard deviations from its estimate that an initial value is looked for


def initial_state(model: Any, sensed: Sequence[SensedSignal], stamp_ns: int) -> InitialState:
    """Estimate the state of a compiled model at a stamp, by what the log shows right after.

    Unobserved coordinates are as the model has them, at rest.
    """
    qpos, qvel = model.qpos0.copy(), np.zeros(model.nv)
    if model.nkey:
        qpos = model.key_qpos[0].copy()
    unsure: list[Parameter] = []
    places: list[tuple[bool, int]] = []
    sensed = seen_in_world(model, sensed)
    shown = _shown(model, sensed)
    for (label, unit, place_q, place_v), (positions, speeds) in shown.items():
        found = beginning(positions, speeds, stamp_ns)
        if found is None:
            continue
        (position, speed), (position_sd, speed_sd), knows_position = found
        is_near = abs(position - qpos[place_q]) < position_sd and abs(speed) < speed_sd
        if is_near and stays(positions, stamp_ns) and stays(speeds, stamp_ns):
            continue  # as the model has it, such as a body that lies on the ground
        if knows_position:
            qpos[place_q] = position
            unsure.append(_unsure(f"initial/{label}.position", unit, position, position_sd))
            places.append((False, place_q))
        qvel[place_v] = speed
        unsure.append(_unsure(f"initial/{label}.velocity", f"{unit}/s", speed, speed_sd))
        places.append((True, place_v))
    for joint, turn in _turns(model, sensed, stamp_ns).items():
        place_q, place_v = int(model.jnt_qposadr[joint]) + 3, int(model.jnt_dofadr[joint]) + 3
        if turn.is_still(qpos[place_q : place_q + 4]):
            continue
        qpos[place_q : place_q + 4] = turn.quaternion
        qvel[place_v : place_v + 3] = turn.spin
        found = _unsure_turn(model.body(int(model.jnt_bodyid[joint])).name, turn)
        unsure += [one for one, _, _ in found]
        places += [(is_spin, (place_v if is_spin else place_q) + at) for _, is_spin, at in found]
    return InitialState(stamp_ns, qpos, qvel, tuple(unsure), tuple(places))


def _turns(model: Any, sensed: Sequence[SensedSignal], stamp_ns: int) -> dict[int, InitialTurn]:
    """Estimate the orientation of bodies with a free joint, by that joint."""
    found: dict[int, InitialTurn] = {}
    for one in sensed:
        if one.sensors[0].kind != "framexaxis":
            continue
        joint = free_joint(model, one.sensors[0].name)
        if joint is not None and joint not in found and (turn := initial_turn(one, stamp_ns)):
            found[joint] = turn
    return found


def _unsure_turn(body: str, turn: InitialTurn) -> list[tuple[Parameter, bool, int]]:
    """List parameters of a body's orientation and spin: each, whether it is of the spin, its index.

    Three numbers of a quaternion suffice: they and its length determine the largest.
    """
    largest = int(np.argmax(np.abs(turn.quaternion)))
    found: list[tuple[Parameter, bool, int]] = []
    for number, axis in enumerate("wxyz"):
        if number != largest:
            value, name = float(turn.quaternion[number]), f"initial/{body}.orientation.{axis}"
            found.append((_unsure(name, "1", value, turn.quaternion_sd), False, number))
    for number, axis in enumerate("xyz"):
        value, sd = float(turn.spin[number]), float(turn.spin_sd[number])
        found.append((_unsure(f"initial/{body}.spin.{axis}", "rad/s", value, sd), True, number))
    return found


def _shown(
    model: Any, sensed: Sequence[SensedSignal]
) -> dict[tuple[str, str, int, int], tuple[Samples | None, Samples | None]]:
    """Collect each coordinate's samples: name, unit and addresses -> positions and speeds."""
    shown: dict[tuple[str, str, int, int], tuple[Samples | None, Samples | None]] = {}
    kinds = mujoco().mjtJoint
    for one in sensed:
        for column, sensor in zip(one.columns, one.sensors, strict=True):
            samples = _samples(one, column)
            if sensor.kind == "framepos":
                joint = free_joint(model, sensor.name)
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


def _samples(sensed: SensedSignal, column: str) -> Samples:
    values = sensed.signal.values[:, sensed.signal.columns.index(column)]
    good = np.isfinite(values)
    return sensed.signal.stamps_ns[good], values[good]


def _unsure(name: str, unit: str, value: float, sd: float) -> Parameter:
    sd = max(sd, _MIN_SD)
    far = (value - _FAR * sd, value + _FAR * sd)
    return Parameter(name, unit, far, (value - sd, value + sd), value, prior_sd=sd)
