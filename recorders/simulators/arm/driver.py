"""Simulate an arm's run as its driver publishes it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recorders.simulators.arm.description import Arm, Payload
from recorders.simulators.arm.disturbances import Disturbances
from recorders.simulators.arm.dynamics import joint_efforts_nm
from recorders.simulators.arm.path import JointPath
from recorders.simulators.arm.payload import joint_signals, payload_info
from recorders.simulators.engines import engine
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.errors import UsageError

STICKING_RAD_S = 0.01  # Coulomb friction changes its sign over about this speed, by a tanh


def perturbed(arm: Arm, disturbances: Disturbances) -> Arm:
    """Apply the link mass and centre-of-mass errors to an arm's description."""
    joints = list(arm.joints)
    for index, error in enumerate(_per_joint(arm, disturbances, "link_mass_error").tolist()):
        link = joints[index].link
        x, y, z, *more = (moment * (1 + error) for moment in link.inertia_kg_m2)
        heavier = replace(link, mass_kg=link.mass_kg * (1 + error), inertia_kg_m2=(x, y, z, *more))
        joints[index] = replace(joints[index], link=heavier)
    _per_joint(arm, disturbances, "link_com_error_m")
    for index, off_m in enumerate(disturbances.link_com_error_m):
        link = joints[index].link
        x, y, z = (at + off for at, off in zip(link.com_m, off_m, strict=True))
        joints[index] = replace(joints[index], link=replace(link, com_m=(x, y, z)))
    return replace(arm, joints=tuple(joints))


def driver_episode(
    arm: Arm, path: JointPath, payload: Payload | None, disturbances: Disturbances
) -> Episode:
    """Simulate a run along a path as the driver publishes it, deterministically.

    Args:
        arm: as its description says; the one that moves is `perturbed`.
        path: the true motion; at 100 Hz or more where messages have times of their own.
        payload: None for an empty gripper.
        disturbances: errors of sensors, model and timing.

    Returns:
        `/joint_states` signals; it begins a little after the path where torques lag or are stale.

    Raises:
        UsageError: the path does not fit the arm, or is shorter than what the driver needs.
    """
    rng = np.random.default_rng([disturbances.noise_seed, 0x4015])
    true_arm = perturbed(arm, disturbances)
    effort_nm = _with_errors(arm, path, joint_efforts_nm(true_arm, path, payload), disturbances)
    times = _message_times(path, disturbances, rng)
    clock = disturbances.clock
    position_at = _fresh_times(times, clock.position_hz, rng)
    velocity_at = _fresh_times(times, clock.velocity_hz, rng)
    effort_at = _fresh_times(times, clock.effort_hz, rng)
    position = _at(path.seconds, path.position_rad, position_at.fresh)
    velocity = _at(path.seconds, path.velocity_rad_s, velocity_at.fresh)
    effort = _at(path.seconds, effort_nm, effort_at.fresh - disturbances.lag_s)
    position = position + disturbances.position_noise_rad * rng.normal(0, 1, position.shape)
    velocity = velocity + disturbances.velocity_noise_rad_s * rng.normal(0, 1, velocity.shape)
    effort = effort + disturbances.torque_noise_nm * rng.normal(0, 1, effort.shape)
    if disturbances.position_step_rad:
        step = disturbances.position_step_rad
        position = np.round(position / step) * step
    shown = JointPath(
        times,
        position[position_at.shown],
        velocity[velocity_at.shown],
        np.zeros((len(times), len(arm.joints))),
    )
    held = payload or Payload(0.0)
    source = f"{engine().name}, inverse dynamics"
    info = payload_info(held, source, "default", disturbances.in_words())
    return Episode(info, joint_signals(arm, shown, effort[effort_at.shown]))


def _with_errors(arm: Arm, path: JointPath, ideal_nm: Array, disturbances: Disturbances) -> Array:
    """Add friction, sensor gain and offset to ideal torques, shape (T, J) [N·m]."""
    speed = path.velocity_rad_s
    friction = _per_joint(arm, disturbances, "viscous_nm_s") * speed
    friction += _per_joint(arm, disturbances, "coulomb_nm") * np.tanh(speed / STICKING_RAD_S)
    gain = 1 + _per_joint(arm, disturbances, "gain_error")
    return gain * (ideal_nm + friction) + _per_joint(arm, disturbances, "offset_nm")


def _per_joint(arm: Arm, disturbances: Disturbances, name: str) -> Array:
    """Return a disturbance of all joints, shape (J,); zeros where there is none."""
    values = getattr(disturbances, name)
    if len(values) not in (0, len(arm.joints)):
        raise UsageError(f"{name} has {len(values)} values for {len(arm.joints)} joints")
    return np.array(values or [0.0] * len(arm.joints))


def _message_times(path: JointPath, disturbances: Disturbances, rng: np.random.Generator) -> Array:
    """Draw the message stamps [s], shape (T,)."""
    start_s, end_s = float(path.seconds[0]) + disturbances.lead_s, float(path.seconds[-1])
    if disturbances.rate_hz is None:
        times = path.seconds[path.seconds >= start_s - 1e-12]
    else:
        count = math.floor((end_s - 4 * disturbances.jitter_s - start_s) * disturbances.rate_hz)
        times = start_s + np.arange(max(count + 1, 0)) / disturbances.rate_hz
    if len(times) < 2:
        raise UsageError(f"a path of {end_s - path.seconds[0]:.3g} s is too short for this driver")
    jitter = np.clip(rng.normal(0.0, 1.0, len(times)), -4, 4) * disturbances.jitter_s
    closest = 0.4 * float(np.diff(times).min())
    return times + np.clip(jitter, -closest, closest)


@dataclass(frozen=True, eq=False)
class _Fresh:
    """Update times of a field [s], shape (F,), and the one each message shows, shape (T,)."""

    fresh: Array
    shown: NDArray[np.int64]


def _fresh_times(times: Array, rate_hz: float, rng: np.random.Generator) -> _Fresh:
    if math.isinf(rate_hz):
        return _Fresh(times, np.arange(len(times)))
    first = times[0] - rng.uniform() / rate_hz
    count = math.floor((times[-1] - first) * rate_hz) + 1
    fresh = first + np.arange(count) / rate_hz
    return _Fresh(fresh, np.searchsorted(fresh, times, side="right") - 1)


def _at(seconds: Array, values: Array, wanted: Array) -> Array:
    """Interpolate samples by a cubic spline, shape (len(wanted), J)."""
    if np.array_equal(seconds, wanted):
        return np.array(values)
    from scipy.interpolate import CubicSpline

    return CubicSpline(seconds, values)(np.clip(wanted, seconds[0], seconds[-1]))
