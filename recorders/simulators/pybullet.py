"""Simulate arms and a ball over a plane in PyBullet; the module is an `Engine`.

The library is imported when first needed, and without its greeting on standard error.
"""

from __future__ import annotations

import os
import sys
import tempfile
import weakref
from functools import cache, partial
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.base import CALIBRATED, IMPACT_S, OVERLAP_M, ContactSettings
from tunenet_logs.recorders.simulators.known import named_version

if TYPE_CHECKING:
    from tunenet_logs.recorders.simulators.arm.description import Arm, Payload
    from tunenet_logs.recorders.simulators.arm.path import JointPath
    from tunenet_logs.recorders.simulators.base import RolloutSettings

name = named_version("pybullet", "pybullet-arm64")


@cache
def pybullet() -> ModuleType:
    """Import the library's module, without its greeting on standard error."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        import pybullet as module  # prints its build time, past Python's own streams
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
    return module


class _Client:
    """The library's functions, bound to a physics client of its own."""

    # `pybullet_utils.BulletClient` does the same, and prints a line for each client (3.2.7).

    def __init__(self) -> None:
        self._number = pybullet().connect(pybullet().DIRECT)
        weakref.finalize(self, pybullet().disconnect, self._number)

    def __getattr__(self, name: str) -> Any:
        found = getattr(pybullet(), name)
        return partial(found, physicsClientId=self._number) if callable(found) else found


class _BulletBallWorld:
    """A physics client with a plane and a ball; see `simulators.base.BallWorld`."""

    engine = name

    def __init__(self, radius_m: float, contact: ContactSettings) -> None:
        self.radius_m = radius_m
        self.contact = contact
        self._bullet = bullet = _Client()
        # Bound once: a rollout calls them hundreds of times.
        self._change, self._set_velocity = bullet.changeDynamics, bullet.resetBaseVelocity
        self._set_period, self._step = bullet.setTimeStep, bullet.stepSimulation
        self._pose, self._velocity = bullet.getBasePositionAndOrientation, bullet.getBaseVelocity
        bullet.setGravity(0, 0, -contact.gravity_m_s2)
        # Bullet loses or adds energy at an impact in four ways. A contact made ahead of the
        # surfaces' meeting eats the rebound; error reduction pushes out what has sunk in, which
        # adds energy; a slop divided by a short step takes slop / dt off the rebound speed; damping
        # is a drag.
        is_off = contact.name == CALIBRATED.name
        names = "contactSlop", "erp", "contactERP", "restitutionVelocityThreshold"
        if is_off:
            bullet.setPhysicsEngineParameter(**dict.fromkeys(names, 0.0))
        names = "contactProcessingThreshold", "linearDamping", "angularDamping"
        self._body = dict.fromkeys(names, 0.0) if is_off else {}
        self._contact_m = 1e-4 if is_off else 0.02  # Bullet's default
        ground = bullet.createCollisionShape(bullet.GEOM_PLANE)
        sphere = bullet.createCollisionShape(bullet.GEOM_SPHERE, radius=radius_m)
        # Bullet multiplies the two restitutions, and a plane's is 0 by default.
        plane = bullet.createMultiBody(0, ground)
        bullet.changeDynamics(plane, -1, restitution=1.0, lateralFriction=1.0, **self._body)
        self._ball = bullet.createMultiBody(1.0, sphere)
        self._fresh = bullet.saveState()

    def place(self, gap_m: float, restitution: float) -> None:
        """Place the ball, dropping cached contacts that would change the next rollout."""
        bullet = self._bullet
        bullet.restoreState(self._fresh)
        # One global of the process, so it must be set even to its default.
        bullet.setPhysicsEngineParameter(contactBreakingThreshold=self._contact_m)
        self._change(self._ball, -1, **self._body)
        self.set_restitution(restitution)
        height_m = self.radius_m + gap_m
        bullet.resetBasePositionAndOrientation(self._ball, [0, 0, height_m], [0, 0, 0, 1])
        self.set_speed(0.0)

    def set_restitution(self, restitution: float) -> None:
        self._change(self._ball, -1, restitution=restitution)

    def set_speed(self, speed_m_s: float) -> None:
        self._set_velocity(self._ball, [0, 0, speed_m_s], [0, 0, 0])

    def step(self, period_s: float) -> tuple[float, float]:
        self._set_period(period_s)
        self._step()
        return self._pose(self._ball)[0][2], self._velocity(self._ball)[0][2]

    def steps(self, period_s: float, count: int) -> list[float]:
        step, pose, ball = self._step, self._pose, self._ball
        self._set_period(period_s)
        heights_m: list[float] = []
        for _ in range(count):
            step()
            heights_m.append(pose(ball)[0][2])
        return heights_m

    def impact(
        self,
        velocity_m_s: Array,
        spin_rad_s: Array,
        restitution: float,
        friction: float,
        inertia_share: float,
    ) -> tuple[Array, Array]:
        self.place(-OVERLAP_M, restitution)
        moments = [inertia_share * self.radius_m**2] * 3
        self._change(self._ball, -1, lateralFriction=friction, localInertiaDiagonal=moments)
        kick = np.array([0.0, 0.0, self.contact.gravity_m_s2 * IMPACT_S])
        self._set_velocity(self._ball, (velocity_m_s + kick).tolist(), spin_rad_s.tolist())
        self.step(IMPACT_S)
        velocity, spin = self._velocity(self._ball)
        return np.array(velocity), np.array(spin)


ball_world = _BulletBallWorld


def inverse_dynamics(
    arm: Arm, path: JointPath, payload: Payload | None, gravity_m_s2: tuple[float, float, float]
) -> Array:
    """Compute the torques along a path, shape (T, J) [N·m]; see `Engine`."""
    # Bullet caches what it has computed for a body, even when its masses change; so every call
    # begins with an empty world.
    bullet = _arm_client("inverse dynamics")
    bullet.resetSimulation()
    body = _load_arm(bullet, arm, payload, is_damped=False)
    bullet.setGravity(*gravity_m_s2)
    solve = bullet.calculateInverseDynamics
    quantities = path.position_rad, path.velocity_rad_s, path.acceleration_rad_s2
    rows = zip(*(quantity.tolist() for quantity in quantities), strict=True)
    return np.array([solve(body, *row) for row in rows])


def position_control(
    arm: Arm, path: JointPath, payload: Payload | None, settings: RolloutSettings
) -> Array:
    """Simulate the states after each step, shape (steps, J, 3); see `Engine`."""
    bullet = _arm_client("rollout")
    bullet.resetSimulation()
    bullet.setPhysicsEngineParameter(numSolverIterations=settings.solver_iterations)
    bullet.setTimeStep(1.0 / settings.step_hz)
    bullet.setGravity(*settings.gravity_m_s2)
    body = _load_arm(bullet, arm, payload, is_damped=settings.is_damped)
    joints = list(range(len(arm.joints)))
    targets, speeds = path.position_rad.tolist(), path.velocity_rad_s.tolist()
    for joint in joints:
        bullet.resetJointState(body, joint, targets[0][joint], speeds[0][joint])
    control, states_of = bullet.setJointMotorControlArray, bullet.getJointStates
    step = bullet.stepSimulation
    states: list[list[tuple[float, float, float]]] = []
    for target, speed in zip(targets[:-1], speeds[1:], strict=True):
        control(
            body,
            joints,
            bullet.POSITION_CONTROL,
            targetPositions=target,
            targetVelocities=speed,
            forces=[settings.force_nm] * len(joints),
            positionGains=[settings.position_gain] * len(joints),
            velocityGains=[settings.velocity_gain] * len(joints),
        )
        step()
        # [2] of a state: reaction forces
        states.append([(state[0], state[1], state[3]) for state in states_of(body, joints)])
    return np.array(states)


def _load_arm(bullet: _Client, arm: Arm, payload: Payload | None, *, is_damped: bool) -> int:
    """Load the arm with a fixed base; with Bullet's default damping or with none."""
    bullet.setPhysicsEngineParameter(enableFileCaching=0)
    with tempfile.NamedTemporaryFile("w", suffix=".urdf", encoding="utf-8") as file:
        file.write(arm.urdf(payload))
        file.flush()
        flags = bullet.URDF_USE_INERTIA_FROM_FILE
        body = bullet.loadURDF(file.name, useFixedBase=True, flags=flags)
    if not is_damped:
        undamped = {"linearDamping": 0.0, "angularDamping": 0.0, "jointDamping": 0.0}
        for link in range(-1, bullet.getNumJoints(body)):
            bullet.changeDynamics(body, link, **undamped)
    return body


@cache
def _arm_client(_purpose: str) -> _Client:
    """Connect one client for all calls of one purpose in the process."""
    return _Client()
