"""PyBullet: a Python file that sets up contacts and drops the ball, with the ball's URDF beside it.

The settings are the calibrated ones of `tunenet_logs.recorders.simulators.base`, for a plain
stepping loop as users write.
"""

from __future__ import annotations

from pathlib import Path
from string import Template

from tunenet_logs.analysis.export import urdf
from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    ball_lines,
    dropped_by,
    hash_comment,
    one_restitution_lines,
    payload_lines,
)
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

NAME, SUFFIX, COMPANION_SUFFIX, LIBRARY = "pybullet", ".py", ".urdf", "pybullet"

# The ball sinks in by speed times step before it bounces. When a ball of .3 falls .3 to 3 m, it is
# .034 off at PyBullet's own 1/240 s, and .006 with this step (`python -m tests.bench.engines`).
STEP_S = 1 / 960

# For restitutions under the second: what a ball sinks in is a larger part of a low rebound.
_SHORT_STEP_S, _DULL = 1 / 3840, 0.25

_BALL = Template('''\
$head
import math
from pathlib import Path

import pybullet

# The ball's own: the floor's is 1, because Bullet multiplies the two.
RESTITUTION = $restitution
RADIUS_M = $radius
# The recorded drop: the gap under the ball, in a fall without air.
DROP_HEIGHT_M = $height
# Plain steps. In one the ball sinks in by speed times step before it bounces: longer steps are
# less exact, most of all for low drops and low restitutions.
STEP_S = $step
# Standard gravity, which the tuning assumed too.
GRAVITY_M_S2 = $gravity
# The ball's link, with mass and inertia; it lies beside this file.
BALL_URDF = Path(__file__).with_suffix(".urdf")


def set_up_world(client):
    """Gravity, time step, and contacts that neither eat nor add energy."""
    pybullet.setGravity(0, 0, -GRAVITY_M_S2, physicsClientId=client)
    pybullet.setPhysicsEngineParameter(
        fixedTimeStep=STEP_S,
        # By default a contact is made 20 mm ahead, which eats the rebound at small steps.
        # It is one value for the whole process: set it again if other code changes it.
        contactBreakingThreshold=1e-4,
        # A slop is divided by the step and taken off the rebound's speed.
        contactSlop=0.0,
        # Pushing out what has sunk in adds energy. Set both to .02 if a resting ball must not
        # stay a little below the surface.
        erp=0.0,
        contactERP=0.0,
        # Slower impacts would not bounce at all.
        restitutionVelocityThreshold=0.0,
        physicsClientId=client,
    )


def set_contact(body, restitution, client):
    """Give every link of a body this restitution, and no damping."""
    for link in range(-1, pybullet.getNumJoints(body, physicsClientId=client)):
        pybullet.changeDynamics(
            body,
            link,
            # A negative one would be ignored silently.
            restitution=restitution,
            # The solver works on surfaces that touch, not on those that come near.
            contactProcessingThreshold=0.0,
            # The default of .04 is a drag.
            linearDamping=0.0,
            angularDamping=0.0,
            physicsClientId=client,
        )


def add_floor(client):
    """A plane at z = 0. Its restitution is 0 by default, and the product would be 0."""
    shape = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
    floor = pybullet.createMultiBody(0, shape, physicsClientId=client)
    set_contact(floor, 1.0, client)
    return floor


def add_ball(client, position):
    """The tuned ball, its centre at a position [m]."""
    ball = pybullet.loadURDF(str(BALL_URDF), position, physicsClientId=client)
    set_contact(ball, RESTITUTION, client)
    return ball


def drop(height_m=DROP_HEIGHT_M, seconds=3.0):
    """Let the ball fall; seconds since the release, and heights of its underside [m]."""
    client = pybullet.connect(pybullet.DIRECT)
    set_up_world(client)
    add_floor(client)
    ball = add_ball(client, [0, 0, RADIUS_M + height_m])
    times_s, heights_m = [0.0], [height_m]
    for step in range(1, math.ceil(seconds / STEP_S) + 1):
        pybullet.stepSimulation(physicsClientId=client)
        position, _ = pybullet.getBasePositionAndOrientation(ball, physicsClientId=client)
        times_s.append(step * STEP_S)
        heights_m.append(position[2] - RADIUS_M)
    pybullet.disconnect(client)
    return times_s, heights_m


if __name__ == "__main__":
    times_s, heights_m = drop()
    first = next(k for k in range(1, len(heights_m)) if heights_m[k] > heights_m[k - 1])
    rebound_m = max(heights_m[first:])
    print(f"rebound {rebound_m:.4f} m of {DROP_HEIGHT_M:.4f} m")
    print(f"restitution {(rebound_m / DROP_HEIGHT_M) ** 0.5:.4f}, set {RESTITUTION:.4f}")
''')

_PAYLOAD = Template('''\
$head
from pathlib import Path

import pybullet

# The payload's link, with mass, centre and inertia; it lies beside this file.
PAYLOAD_URDF = Path(__file__).with_suffix(".urdf")
MASS_KG = $mass
# In the tool frame.
COM_M = $com


def mount(arm, tool_link, client=0):
    """Fix the payload to a link of a loaded arm, in the link's own frame; body and constraint.

    The inverse dynamics of the arm do not see it, and would not see a mass that is changed later
    either: for those, copy the link into the arm's URDF, and load a fresh body.
    """
    payload = pybullet.loadURDF(
        str(PAYLOAD_URDF),
        # Else PyBullet takes the inertia from shapes, and there are none.
        flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
        physicsClientId=client,
    )
    # It is put where it belongs first: a constraint that is far off would throw the arm about.
    tool = pybullet.getLinkState(
        arm, tool_link, computeForwardKinematics=True, physicsClientId=client
    )[4:6]
    pose = pybullet.multiplyTransforms(*tool, COM_M, [0, 0, 0, 1])
    pybullet.resetBasePositionAndOrientation(payload, *pose, physicsClientId=client)
    # A body's pose is that of its centre of mass here, and so are a constraint's ends.
    local = pybullet.getDynamicsInfo(arm, tool_link, physicsClientId=client)[3:5]
    parent_position, parent_turn = pybullet.invertTransform(*local)
    child_position = [-value for value in COM_M]
    constraint = pybullet.createConstraint(
        arm,
        tool_link,
        payload,
        -1,
        pybullet.JOINT_FIXED,
        [0, 0, 0],
        parent_position,
        child_position,
        parent_turn,
        [0, 0, 0, 1],
        physicsClientId=client,
    )
    return payload, constraint


if __name__ == "__main__":
    world = pybullet.connect(pybullet.DIRECT)
    body = pybullet.loadURDF(
        str(PAYLOAD_URDF), flags=pybullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=world
    )
    print(f"mass {pybullet.getDynamicsInfo(body, -1, physicsClientId=world)[0]:.4f} kg")
''')


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    return _BALL.substitute(
        head=hash_comment([*ball_lines(ball), *one_restitution_lines(ball)]),
        restitution=repr(ball.restitution),
        radius=repr(ball.radius_m.value),
        height=repr(ball.drop_height_m.value),
        step=repr(_step_s(ball)),
        gravity=repr(GRAVITY_M_S2),
    )


def _step_s(ball: ExportedBall) -> float:
    if ball.step_s is not None:
        return ball.step_s
    return STEP_S if ball.restitution >= _DULL else _SHORT_STEP_S


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`."""
    return _PAYLOAD.substitute(
        head=hash_comment(payload_lines(payload)),
        mass=repr(payload.mass_kg),
        com=repr(payload.com_m),
    )


def companion(item: ExportedBall | ExportedPayload) -> str:
    """Return the text of the URDF beside it."""
    return urdf.ball_text(item) if isinstance(item, ExportedBall) else urdf.payload_text(item)


def dropped(path: Path, height_m: float, seconds: float) -> tuple[Array, Array]:
    """See `CanDrop`."""
    return dropped_by(path, height_m, seconds)
