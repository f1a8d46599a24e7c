"""Simulate arms and a ball over a plane in PyBullet; the module is an `Engine`.

The library is imported when first needed, and without its greeting on standard error.
"""

from __future__ import annotations

import os
import sys
import tempfile
import weakref
from collections.abc import Mapping
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.base import IMPACT_S, OVERLAP_M, ContactSettings
from tunenet_logs.recorders.simulators.known import named_version

if TYPE_CHECKING:
    from tunenet_logs.recorders.simulators.arm.description import Arm, Payload
    from tunenet_logs.recorders.simulators.arm.path import JointPath
    from tunenet_logs.recorders.simulators.base import RolloutSettings

name = named_version("pybullet", "pybullet-arm64")

# Bullet's default. It is one global of the process, so it must be set even to its default.
_TYPICAL_CONTACT_DISTANCE_M = 0.02

# Fields of `ContactSettings` as keywords of `setPhysicsEngineParameter`.
_WORLD_KEYWORDS: Mapping[str, tuple[str, ...]] = {
    "contact_slop_m": ("contactSlop",),
    "error_reduction": ("erp", "contactERP"),
    "inelastic_below_m_s": ("restitutionVelocityThreshold",),
}

# Fields of `ContactSettings` as keywords of `changeDynamics`.
_BODY_KEYWORDS: Mapping[str, tuple[str, ...]] = {
    "solver_distance_m": ("contactProcessingThreshold",),
    "linear_damping": ("linearDamping",),
    "angular_damping": ("angularDamping",),
}


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


class _BulletBallWorld:
    """A physics client with a plane and a ball; see `simulators.base.BallWorld`."""

    engine = name

    def __init__(self, radius_m: float, contact: ContactSettings) -> None:
        self.radius_m = radius_m
        self.contact = contact
        self._bullet = bullet = pybullet()
        self._client = client = bullet.connect(bullet.DIRECT)
        weakref.finalize(self, bullet.disconnect, client)
        bullet.setGravity(0, 0, -contact.gravity_m_s2, physicsClientId=client)
        if world := _keywords(contact, _WORLD_KEYWORDS):
            bullet.setPhysicsEngineParameter(**world, physicsClientId=client)
        ground = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=client)
        sphere = bullet.createCollisionShape(
            bullet.GEOM_SPHERE, radius=radius_m, physicsClientId=client
        )
        self._body = _keywords(contact, _BODY_KEYWORDS)
        # Bullet multiplies the two restitutions, and a plane's is 0 by default.
        plane = bullet.createMultiBody(0, ground, physicsClientId=client)
        bullet.changeDynamics(
            plane, -1, restitution=1.0, lateralFriction=1.0, **self._body, physicsClientId=client
        )
        self._ball = bullet.createMultiBody(1.0, sphere, physicsClientId=client)
        self._fresh = bullet.saveState(physicsClientId=client)

    def place(self, gap_m: float, restitution: float) -> None:
        """Place the ball, dropping cached contacts that would change the next rollout."""
        bullet, client = self._bullet, self._client
        distance_m = self.contact.contact_distance_m
        bullet.restoreState(self._fresh, physicsClientId=client)
        bullet.setPhysicsEngineParameter(
            contactBreakingThreshold=(
                _TYPICAL_CONTACT_DISTANCE_M if distance_m is None else distance_m
            ),
            physicsClientId=client,
        )
        bullet.changeDynamics(self._ball, -1, **self._body, physicsClientId=client)
        self.set_restitution(restitution)
        bullet.resetBasePositionAndOrientation(
            self._ball, [0, 0, self.radius_m + gap_m], [0, 0, 0, 1], physicsClientId=client
        )
        self.set_speed(0.0)

    def set_restitution(self, restitution: float) -> None:
        self._bullet.changeDynamics(
            self._ball, -1, restitution=restitution, physicsClientId=self._client
        )

    def set_speed(self, speed_m_s: float) -> None:
        self._bullet.resetBaseVelocity(
            self._ball, [0, 0, speed_m_s], [0, 0, 0], physicsClientId=self._client
        )

    def step(self, period_s: float) -> tuple[float, float]:
        bullet, client = self._bullet, self._client
        bullet.setTimeStep(period_s, physicsClientId=client)
        bullet.stepSimulation(physicsClientId=client)
        position, _ = bullet.getBasePositionAndOrientation(self._ball, physicsClientId=client)
        velocity, _ = bullet.getBaseVelocity(self._ball, physicsClientId=client)
        return position[2], velocity[2]

    def steps(self, period_s: float, count: int) -> list[float]:
        client, ball = self._client, self._ball
        step = self._bullet.stepSimulation
        pose = self._bullet.getBasePositionAndOrientation
        self._bullet.setTimeStep(period_s, physicsClientId=client)
        heights_m: list[float] = []
        for _ in range(count):
            step(physicsClientId=client)
            position, _ = pose(ball, physicsClientId=client)
            heights_m.append(position[2])
        return heights_m

    def impact(
        self,
        velocity_m_s: Array,
        spin_rad_s: Array,
        restitution: float,
        friction: float,
        inertia_share: float,
    ) -> tuple[Array, Array]:
        bullet, client, ball = self._bullet, self._client, self._ball
        self.place(-OVERLAP_M, restitution)
        moment = inertia_share * self.radius_m**2
        bullet.changeDynamics(
            ball,
            -1,
            lateralFriction=friction,
            localInertiaDiagonal=[moment] * 3,
            physicsClientId=client,
        )
        kick = np.array([0.0, 0.0, self.contact.gravity_m_s2 * IMPACT_S])
        bullet.resetBaseVelocity(
            ball, (velocity_m_s + kick).tolist(), spin_rad_s.tolist(), physicsClientId=client
        )
        self.step(IMPACT_S)
        velocity, spin = bullet.getBaseVelocity(ball, physicsClientId=client)
        return np.array(velocity), np.array(spin)


ball_world = _BulletBallWorld


def _keywords(contact: ContactSettings, table: Mapping[str, tuple[str, ...]]) -> dict[str, Any]:
    """Return PyBullet's keywords of the settings that differ from its defaults."""
    return {
        keyword: value
        for field, keywords in table.items()
        if (value := getattr(contact, field)) is not None
        for keyword in keywords
    }


def inverse_dynamics(
    arm: Arm, path: JointPath, payload: Payload | None, gravity_m_s2: tuple[float, float, float]
) -> Array:
    """Compute the torques along a path, shape (T, J) [N·m]; see `Engine`."""
    # Bullet caches what it has computed for a body, even when its masses change; so every call
    # begins with an empty world.
    bullet, client = pybullet(), _arm_client("inverse dynamics")
    bullet.resetSimulation(physicsClientId=client)
    body = _load_arm(client, arm, payload, is_damped=False)
    bullet.setGravity(*gravity_m_s2, physicsClientId=client)
    solve = bullet.calculateInverseDynamics
    rows = zip(
        path.position_rad.tolist(),
        path.velocity_rad_s.tolist(),
        path.acceleration_rad_s2.tolist(),
        strict=True,
    )
    return np.array([solve(body, *row, physicsClientId=client) for row in rows])


def position_control(
    arm: Arm, path: JointPath, payload: Payload | None, settings: RolloutSettings
) -> Array:
    """Simulate the states after each step, shape (steps, J, 3); see `Engine`."""
    bullet, client = pybullet(), _arm_client("rollout")
    bullet.resetSimulation(physicsClientId=client)
    bullet.setPhysicsEngineParameter(
        numSolverIterations=settings.solver_iterations, physicsClientId=client
    )
    bullet.setTimeStep(1.0 / settings.step_hz, physicsClientId=client)
    bullet.setGravity(*settings.gravity_m_s2, physicsClientId=client)
    body = _load_arm(client, arm, payload, is_damped=settings.is_damped)
    joints = list(range(len(arm.joints)))
    targets, speeds = path.position_rad.tolist(), path.velocity_rad_s.tolist()
    for joint in joints:
        bullet.resetJointState(
            body, joint, targets[0][joint], speeds[0][joint], physicsClientId=client
        )
    states: list[list[tuple[float, float, float]]] = []
    for target, speed in zip(targets[:-1], speeds[1:], strict=True):
        bullet.setJointMotorControlArray(
            body,
            joints,
            bullet.POSITION_CONTROL,
            targetPositions=target,
            targetVelocities=speed,
            forces=[settings.force_nm] * len(joints),
            positionGains=[settings.position_gain] * len(joints),
            velocityGains=[settings.velocity_gain] * len(joints),
            physicsClientId=client,
        )
        bullet.stepSimulation(physicsClientId=client)
        found = bullet.getJointStates(body, joints, physicsClientId=client)
        states.append([(state[0], state[1], state[3]) for state in found])  # [2]: reaction forces
    return np.array(states)


def _load_arm(client: int, arm: Arm, payload: Payload | None, *, is_damped: bool) -> int:
    """Load the arm with a fixed base; with Bullet's default damping or with none."""
    bullet = pybullet()
    bullet.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=client)
    with tempfile.NamedTemporaryFile("w", suffix=".urdf", encoding="utf-8") as file:
        file.write(arm.urdf(payload))
        file.flush()
        body = bullet.loadURDF(
            file.name,
            useFixedBase=True,
            flags=bullet.URDF_USE_INERTIA_FROM_FILE,
            physicsClientId=client,
        )
    if not is_damped:
        for link in range(-1, bullet.getNumJoints(body, physicsClientId=client)):
            bullet.changeDynamics(
                body,
                link,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                physicsClientId=client,
            )
    return body


@cache
def _arm_client(_purpose: str) -> int:
    """Connect one client for all calls of one purpose in the process."""
    bullet = pybullet()
    return bullet.connect(bullet.DIRECT)
