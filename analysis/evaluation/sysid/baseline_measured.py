"""Convert a log to the input of `mujoco.sysid`: model sensors, samples, and a first state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.evaluation.sysid.held_commands import HeldCommands
from recorders.simulators.mujoco.library import mujoco
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, Signal

STATES, COMMANDS = "/joint_states", "/joint_commands.position"

_START_S = 0.1  # the first samples, by which the first state is told
# Of the largest standard deviation of a signal's columns, what each counts as having at least.
_MIN_SHARE = 0.05

_QUANTITIES = {
    "position": "mjSENS_JOINTPOS",
    "velocity": "mjSENS_JOINTVEL",
    "effort": "mjSENS_JOINTACTFRC",
}


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements of a log.

    Attributes:
        seconds: of the samples, after the first of all that are simulated, shape (T,).
        values: in the order of the model's sensors, shape (T, C).
        weights: by sensor; None where all columns have one noise.
        start: positions, then velocities, of the joints or in the plane, shape (S,).
        start_reach: how far that can be off, shape (S,).
        commands: of the model's actuators; None without any.
    """

    seconds: Array
    values: Array
    weights: dict[str, float] | None
    start: Array
    start_reach: Array
    commands: HeldCommands | None

    def count(self, step_s: float) -> int:
        """Return the number of steps until the last sample, and one more."""
        return int(np.ceil(self.seconds[-1] / step_s)) + 2


def measured(episode: Episode, spec: Any, *, with_efforts: bool) -> Measured:
    """Convert the log's samples; `spec` gets a sensor for each quantity of the joints."""
    pose = next((one for one in episode.signals.values() if one.is_position), None)
    if pose is not None:
        return _posed(pose, spec)
    joints = [joint.name for joint in spec.joints]
    columns: list[Array] = []
    weights: dict[str, float] = {}
    for quantity, kind in _QUANTITIES.items():
        signal = episode.signals.get(f"{STATES}.{quantity}")
        if signal is None or (quantity == "effort" and not with_efforts):
            continue
        spread = np.std(signal.values, axis=0)
        spread = np.maximum(spread, _MIN_SHARE * np.max(spread))
        for joint in joints:
            at = signal.columns.index(joint)
            name = f"{quantity} of {joint}"
            sensor_type = getattr(mujoco().mjtSensor, kind)
            joint_type = mujoco().mjtObj.mjOBJ_JOINT
            spec.add_sensor(name=name, type=sensor_type, objtype=joint_type, objname=joint)
            columns.append(signal.values[:, at])
            weights[name] = 1.0 / float(spread[at])
    positions, velocities = (episode.signals[f"{STATES}.{one}"] for one in ("position", "velocity"))
    start = [_state(positions, velocities, joint) for joint in joints]
    reach = [_reach(positions, velocities, joint) for joint in joints]
    begin_ns = int(positions.stamps_ns[0])
    return Measured(
        positions.seconds,
        np.column_stack(columns),
        weights,
        np.array(start).T.ravel(),
        np.array(reach).T.ravel(),
        _commands(episode, joints, begin_ns),
    )


def _commands(episode: Episode, joints: list[str], begin_ns: int) -> HeldCommands | None:
    signal = episode.signals.get(COMMANDS)
    if signal is None:
        return None
    order = [signal.columns.index(joint) for joint in joints]
    seconds = (signal.stamps_ns - begin_ns).astype(np.float64) * 1e-9
    return HeldCommands(seconds, signal.values[:, order])


def _state(positions: Signal, velocities: Signal, joint: str) -> tuple[float, float]:
    """Fit position and velocity at the first sample by a parabola through the first of both."""
    at = positions.columns.index(joint)
    first = positions.seconds <= _START_S
    seconds = positions.seconds[first]
    spreads = np.std(positions.values[:, at]), np.std(velocities.values[:, at])
    one, none = np.ones_like(seconds), np.zeros_like(seconds)
    places = np.column_stack([one, seconds, seconds**2 / 2]) / spreads[0]
    speeds = np.column_stack([none, one, seconds]) / spreads[1]
    target = np.concatenate(
        [positions.values[first, at] / spreads[0], velocities.values[first, at] / spreads[1]]
    )
    found = np.linalg.lstsq(np.concatenate([places, speeds]), target, rcond=None)[0]
    return float(found[0]), float(found[1])


def _reach(positions: Signal, velocities: Signal, joint: str) -> tuple[float, float]:
    at = positions.columns.index(joint)
    widest = (np.std(one.values, axis=0) for one in (positions, velocities))
    place, speed = (max(float(one[at]), _MIN_SHARE * float(np.max(one))) for one in widest)
    return 0.3 * place, 0.5 * speed


def _posed(pose: Signal, spec: Any) -> Measured:
    """Convert a free body's positions; the height and the turn at the start are the model's."""
    body = pose.name.split("/")[1]
    frame, body_type = mujoco().mjtSensor.mjSENS_FRAMEPOS, mujoco().mjtObj.mjOBJ_BODY
    spec.add_sensor(name="place", type=frame, objtype=body_type, objname=body)
    first = pose.seconds <= _START_S
    curve = np.polynomial.polynomial.polyfit(pose.seconds[first], pose.values[first, :2], 2)
    reach = np.array([0.02, 0.02, 0.5, 0.5])
    return Measured(
        pose.seconds, pose.values, None, np.asarray(curve[:2].ravel(), np.float64), reach, None
    )
