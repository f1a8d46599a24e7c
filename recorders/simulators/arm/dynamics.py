"""Joint torques along a path by the engine's inverse dynamics."""

from __future__ import annotations

import tempfile
from functools import cache

import numpy as np

from recorders.simulators.arm.description import Arm, Payload
from recorders.simulators.arm.path import JointPath
from recorders.simulators.engine import pybullet
from tunenet_logs.arrays import Array

GRAVITY_M_S2 = (0.0, 0.0, -9.81)
"""Of an arm that stands upright."""


def joint_efforts_nm(
    arm: Arm,
    path: JointPath,
    payload: Payload | None = None,
    gravity_m_s2: tuple[float, float, float] = GRAVITY_M_S2,
) -> Array:
    """Torques that move the arm along the path: rigid links, no friction.

    The engine keeps what it has computed for a body, whatever its masses become; so every call
    begins with an empty world.

    Returns:
        Shape (T, J) [N·m], or N of a joint that slides.

    Raises:
        UsageError: the path is none of this arm.
    """
    path.checked(arm)
    engine, client = pybullet(), _client()
    engine.resetSimulation(physicsClientId=client)
    body = load_arm(client, arm, payload)
    engine.setGravity(*gravity_m_s2, physicsClientId=client)
    solve = engine.calculateInverseDynamics
    rows = zip(
        path.position_rad.tolist(),
        path.velocity_rad_s.tolist(),
        path.acceleration_rad_s2.tolist(),
        strict=True,
    )
    return np.array([solve(body, *row, physicsClientId=client) for row in rows])


def held_efforts_nm(arm: Arm, path: JointPath) -> Array:
    """Torques of gravity alone on the empty arm, at rest in each of a path's positions.

    Returns:
        Shape (T, J) [N·m].

    Raises:
        UsageError: the path is none of this arm.
    """
    still = np.zeros_like(path.position_rad)
    return joint_efforts_nm(arm, JointPath(path.seconds, path.position_rad, still, still))


def load_arm(client: int, arm: Arm, payload: Payload | None, *, is_damped: bool = False) -> int:
    """The arm as a body of a world, fixed to it; without the engine's damping unless told."""
    engine = pybullet()
    engine.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=client)
    with tempfile.NamedTemporaryFile("w", suffix=".urdf", encoding="utf-8") as file:
        file.write(arm.urdf(payload))
        file.flush()
        body = engine.loadURDF(
            file.name,
            useFixedBase=True,
            flags=engine.URDF_USE_INERTIA_FROM_FILE,
            physicsClientId=client,
        )
    if not is_damped:
        for link in range(-1, engine.getNumJoints(body, physicsClientId=client)):
            engine.changeDynamics(
                body,
                link,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                physicsClientId=client,
            )
    return body


@cache
def _client() -> int:
    """One world for all inverse dynamics of the process."""
    engine = pybullet()
    return engine.connect(engine.DIRECT)
