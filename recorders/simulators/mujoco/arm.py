"""Simulate an arm in MuJoCo: inverse dynamics along a path, and position control."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from recorders.simulators.arm.description import PAYLOAD_RADIUS_M
from recorders.simulators.arm.rigid_bodies import Inertial, rotation_from_rpy, solid_sphere
from recorders.simulators.mujoco.library import mujoco
from tunenet_logs.arrays import Array
from tunenet_logs.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recorders.simulators.arm.description import Arm, Payload
    from recorders.simulators.arm.path import JointPath
    from recorders.simulators.arm.rollout import RolloutSettings

# MuJoCo takes no body without inertia; this one moves no torque by 1e-9 N·m.
_MIN_MOMENT_KG_M2 = 1e-12


def inverse_dynamics(
    arm: Arm,
    path: JointPath,
    payload: Payload | None,
    gravity_m_s2: tuple[float, float, float],
) -> Array:
    """Compute the torques along a path, shape (T, J) [N·m]; see `Engine`."""
    model, data = _model(arm, payload, gravity_m_s2)
    solve = mujoco().mj_inverse
    efforts_nm = np.empty_like(path.position_rad)
    samples = zip(path.position_rad, path.velocity_rad_s, path.acceleration_rad_s2, strict=True)
    for row, (position, velocity, acceleration) in enumerate(samples):
        data.qpos[:], data.qvel[:], data.qacc[:] = position, velocity, acceleration
        solve(model, data)
        efforts_nm[row] = data.qfrc_inverse
    return efforts_nm


def position_control(
    arm: Arm, path: JointPath, payload: Payload | None, settings: RolloutSettings
) -> Array:
    """Simulate the states after each step, shape (steps, J, 3); see `Engine`.

    A motor gives the torque with which the step ends at the speed that PyBullet's position control
    aims at: the joint's own, with a share of the errors of speed and position taken away.

    Raises:
        UsageError: settings that only another engine can reproduce.
    """
    if settings.is_damped:
        raise UsageError(
            f"the preset {settings.name} is PyBullet's own behaviour, not MuJoCo's; take "
            "--engine pybullet, or --preset default"
        )
    model, data = _model(arm, payload, settings.gravity_m_s2)
    solve, step = mujoco().mj_inverse, mujoco().mj_step
    model.opt.timestep = period_s = 1.0 / settings.step_hz
    targets, speeds = path.position_rad, path.velocity_rad_s
    data.qpos[:], data.qvel[:] = targets[0], speeds[0]
    states = np.empty((len(targets) - 1, len(arm.joints), 3))
    for row, (target, speed) in enumerate(zip(targets[:-1], speeds[1:], strict=True)):
        gain = settings.position_gain / period_s
        change = gain * (target - data.qpos) + settings.velocity_gain * (speed - data.qvel)
        data.qacc[:] = change / period_s
        solve(model, data)
        effort_nm = np.clip(data.qfrc_inverse, -settings.force_nm, settings.force_nm)
        data.qfrc_applied[:] = effort_nm
        step(model, data)
        states[row] = np.column_stack([data.qpos, data.qvel, effort_nm])
    return states


def _model(arm: Arm, payload: Payload | None, gravity_m_s2: Sequence[float]) -> tuple[Any, Any]:
    """Compile the arm on a fixed base, without limits, contacts or damping; with its data."""
    spec = mujoco().MjSpec()
    spec.option.gravity = gravity_m_s2
    spec.option.disableflags = int(mujoco().mjtDisableBit.mjDSBL_CONSTRAINT)
    body = spec.worldbody
    for joint in arm.joints:
        body = _body(body, joint.origin_m, joint.origin_rpy, joint.link)
        kind = "mjJNT_SLIDE" if joint.is_prismatic else "mjJNT_HINGE"
        body.add_joint(type=getattr(mujoco().mjtJoint, kind), axis=joint.axis)
    if payload is not None and payload.mass_kg > 0:
        held = solid_sphere(payload.mass_kg, PAYLOAD_RADIUS_M)
        frame = _body(body, arm.tool_from_last_m, arm.tool_from_last_rpy, held)
        frame.ipos = payload.com_m
    model = spec.compile()
    return model, mujoco().MjData(model)


def _body(parent: Any, origin_m: Sequence[float], rpy: Sequence[float], weight: Inertial) -> Any:
    moments, axes = weight.principal()
    return parent.add_body(
        pos=origin_m,
        quat=_quaternion(rotation_from_rpy(rpy)),
        explicitinertial=True,
        mass=weight.mass_kg,
        ipos=weight.com_m,
        iquat=_quaternion(axes),
        inertia=np.maximum(moments, _MIN_MOMENT_KG_M2),
    )


def _quaternion(rotation: Array) -> Array:
    """Convert a rotation, shape (3, 3), to w, x, y, z."""
    quaternion = np.zeros(4)
    mujoco().mju_mat2Quat(quaternion, rotation.ravel())
    return quaternion
