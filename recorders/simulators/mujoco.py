"""Simulate arms and a ball over a plane in MuJoCo; the module is an `Engine`.

An impact gets its restitution by contact stiffness and damping. The contact's reference
acceleration is -b v, with b the damping and v the speed of the surfaces towards each other. With no
stiffness, an impedance near 1 and b = (1 + e) / h, one step of length h turns v into -e v: the
restitution that is set is the one that is got. What moves across the surface is damped likewise;
there, friction in the cone takes at most its coefficient times the normal impulse.
"""

from __future__ import annotations

import warnings
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from tunenet_logs.episode import Array
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.arm.description import (
    PAYLOAD_RADIUS_M,
    Inertial,
    rotation_from_rpy,
    solid_sphere,
)
from tunenet_logs.recorders.simulators.base import CALIBRATED, IMPACT_S, OVERLAP_M, ContactSettings
from tunenet_logs.recorders.simulators.known import named_version

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tunenet_logs.recorders.simulators.arm.description import Arm, Payload
    from tunenet_logs.recorders.simulators.arm.path import JointPath
    from tunenet_logs.recorders.simulators.base import RolloutSettings


_NOT_OURS = (
    "the preset {} is PyBullet's own behaviour, not MuJoCo's; take --engine pybullet, or "
    "--preset default"
)


@cache
def mujoco() -> ModuleType:
    """Import the library when first needed: most of a second. Its stubs leave names out."""
    import mujoco as module

    # what a stranger's model says in an old way, MuJoCo says at each compilation
    warnings.filterwarnings("ignore", "compiler attribute .* is deprecated", UserWarning)
    return module


def inverse_dynamics(
    arm: Arm, path: JointPath, payload: Payload | None, gravity_m_s2: tuple[float, float, float]
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
    """
    if settings.is_damped:
        raise UsageError(_NOT_OURS.format(settings.name))
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
    turns = np.zeros((2, 4))  # w, x, y, z: of the body, and of its principal axes
    for turn, rotation in zip(turns, (rotation_from_rpy(rpy), axes), strict=True):
        mujoco().mju_mat2Quat(turn, rotation.ravel())
    return parent.add_body(
        pos=origin_m,
        quat=turns[0],
        explicitinertial=True,
        mass=weight.mass_kg,
        ipos=weight.com_m,
        iquat=turns[1],
        # MuJoCo takes no body without inertia; this one moves no torque by 1e-9 N·m.
        inertia=np.maximum(moments, 1e-12),
    )


# The contact's `solimp`: as hard as MuJoCo makes one, at every depth.
_BALL_MODEL = """
<mujoco>
  <option gravity="0 0 {gravity!r}" cone="elliptic"/>
  <worldbody>
    <geom name="plane" type="plane" size="0 0 1"/>
    <body>
      <freejoint/>
      <geom name="ball" type="sphere" size="{radius!r}" mass="1"/>
    </body>
  </worldbody>
  <contact>
    <pair geom1="plane" geom2="ball" condim="3" friction="0 0 0 0 0"
      solimp="0.9999 0.9999 0.001 0.5 2.0"/>
  </contact>
</mujoco>
"""


class _MujocoBallWorld:
    """A MuJoCo model of a plane and a ball; see `BallWorld` of `recorders.simulators.base`."""

    def __init__(self, radius_m: float, contact: ContactSettings) -> None:
        if contact.name != CALIBRATED.name:
            raise UsageError(_NOT_OURS.format(contact.name))
        self.engine = named_version("mujoco")
        self.radius_m = radius_m
        self.contact = contact
        text = _BALL_MODEL.format(gravity=-contact.gravity_m_s2, radius=radius_m)
        self._model = model = mujoco().MjModel.from_xml_string(text)
        self._data = mujoco().MjData(model)
        self._step = mujoco().mj_step
        self._position, self._velocity = self._data.qpos, self._data.qvel
        self._damping = model.pair_solref
        self._restitution = 0.0

    def place(self, gap_m: float, restitution: float) -> None:
        mujoco().mj_resetData(self._model, self._data)
        self._position[2] = self.radius_m + gap_m
        self._restitution = restitution

    def set_restitution(self, restitution: float) -> None:
        self._restitution = restitution

    def set_speed(self, speed_m_s: float) -> None:
        self._velocity[:] = 0.0, 0.0, speed_m_s, 0.0, 0.0, 0.0

    def step(self, period_s: float) -> tuple[float, float]:
        self._take(period_s)
        self._step(self._model, self._data)
        return float(self._position[2]), float(self._velocity[2])

    def steps(self, period_s: float, count: int) -> list[float]:
        self._take(period_s)
        step, model, data, position = self._step, self._model, self._data, self._position
        heights_m: list[float] = []
        for _ in range(count):
            step(model, data)
            heights_m.append(float(position[2]))
        return heights_m

    def impact(
        self,
        velocity_m_s: Array,
        spin_rad_s: Array,
        restitution: float,
        friction: float,
        inertia_share: float,
    ) -> tuple[Array, Array]:
        """Solve an impact in one step.

        MuJoCo solves the push and the friction as one convex problem, in which slip that is left
        lifts the ball. So slip is damped by what Coulomb's law takes of it, and none is left over.
        """
        self.place(-OVERLAP_M, restitution)
        moment = inertia_share * self.radius_m**2
        if self._model.body_inertia[1, 0] != moment:
            self._model.body_inertia[1] = moment
            mujoco().mj_setConst(self._model, self._data)
            self.place(-OVERLAP_M, restitution)
        self._model.pair_friction[0, :2] = friction
        slip_m_s = velocity_m_s + np.cross(spin_rad_s, [0.0, 0.0, -self.radius_m])
        taken = friction * (1 + restitution) * max(-float(velocity_m_s[2]), 0.0)
        share = taken * (1 + 1 / inertia_share) / max(float(np.hypot(*slip_m_s[:2])), 1e-12)
        self._model.pair_solreffriction[0] = 0.0, -min(share, 1.0) / IMPACT_S
        self._velocity[:3], self._velocity[3:] = velocity_m_s, spin_rad_s
        self.step(IMPACT_S)
        return self._velocity[:3].copy(), self._velocity[3:].copy()

    def _take(self, period_s: float) -> None:
        self._model.opt.timestep = period_s
        self._damping[0] = 0.0, -(1 + self._restitution) / period_s


name = named_version("mujoco")
ball_world = _MujocoBallWorld
