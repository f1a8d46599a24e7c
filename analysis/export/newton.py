"""Newton: a Python file that builds the ball and its ground and drops it with the XPBD solver."""

from __future__ import annotations

from pathlib import Path
from string import Template

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

NAME, SUFFIX, LIBRARY = "newton", ".py", "newton"

# At 1/240 s the effective restitution is up to .014 off when the ball falls .3 to 3 m, with this
# step .004 (`python -m tests.bench.engines`).
STEP_S = 1 / 960

_BALL = Template('''\
$head
# Written for Newton 1.8.
import math

import newton
import warp as wp

# XPBD takes the mean of the two shapes': ball and ground both have the tuned one.
RESTITUTION = $restitution
RADIUS_M = $radius
MASS_KG = $mass
# A solid ball: 2/5 m r^2.
MOMENT_KG_M2 = $moment
# The recorded drop: the gap under the ball, in a fall without air.
DROP_HEIGHT_M = $height
# Longer steps are less exact, and impacts slower than 2 g times the step do not bounce.
STEP_S = $step
# Standard gravity, which the tuning assumed too; Newton's own is 9.81.
GRAVITY_M_S2 = $gravity


def shape():
    """Of ball and ground. A density would be added to the ball's own mass."""
    return newton.ModelBuilder.ShapeConfig(density=0.0, restitution=RESTITUTION)


def add_ball(builder, position):
    """The tuned ball, its centre at a position [m]; the body's index."""
    moment = MOMENT_KG_M2
    body = builder.add_body(
        xform=wp.transform(wp.vec3(*position), wp.quat_identity()),
        mass=MASS_KG,
        inertia=wp.mat33(moment, 0.0, 0.0, 0.0, moment, 0.0, 0.0, 0.0, moment),
    )
    builder.add_shape_sphere(body, radius=RADIUS_M, cfg=shape())
    return body


def make_solver(model):
    """Restitution is off by default, and Newton's MuJoCo solver has none."""
    return newton.solvers.SolverXPBD(model, enable_restitution=True)


def drop(height_m=DROP_HEIGHT_M, seconds=3.0):
    """Let the ball fall; seconds since the release, and heights of its underside [m]."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -GRAVITY_M_S2))
    builder.add_ground_plane(cfg=shape())
    ball = add_ball(builder, (0.0, 0.0, RADIUS_M + height_m))
    model = builder.finalize()
    solver = make_solver(model)
    collisions = newton.CollisionPipeline(model)
    contacts = collisions.contacts()
    before, after, control = model.state(), model.state(), model.control()
    times_s, heights_m = [0.0], [height_m]
    for step in range(1, math.ceil(seconds / STEP_S) + 1):
        before.clear_forces()
        collisions.collide(before, contacts)
        solver.step(before, after, control, contacts, STEP_S)
        before, after = after, before
        times_s.append(step * STEP_S)
        heights_m.append(float(before.body_q.numpy()[ball][2]) - RADIUS_M)
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
# Written for Newton 1.8.
import newton
import warp as wp

MASS_KG = $mass
# In the tool frame.
COM_M = $com
# About the centre of mass, along the tool frame's axes.
INERTIA_KG_M2 = $inertia


def add_payload(builder, tool_body, tool_frame=None):
    """Fix the payload to a body of the arm, at its tool frame; the payload's body and joint.

    Call it before `builder.add_articulation(joints)`, and put the joint last among those joints:
    Newton takes no model with a joint outside. It has no shape: nothing of it collides.
    """
    tool_frame = wp.transform_identity() if tool_frame is None else tool_frame
    payload = builder.add_link(
        mass=MASS_KG, com=wp.vec3(*COM_M), inertia=wp.mat33(*INERTIA_KG_M2), label="payload"
    )
    joint = builder.add_joint_fixed(parent=tool_body, child=payload, parent_xform=tool_frame)
    return payload, joint


if __name__ == "__main__":
    arm = newton.ModelBuilder()
    payload, _ = add_payload(arm, -1)
    print(f"mass {arm.body_mass[payload]:.4f} kg")
''')


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    return _BALL.substitute(
        head=hash_comment([*ball_lines(ball), *one_restitution_lines(ball)]),
        restitution=repr(ball.restitution),
        radius=repr(ball.radius_m.value),
        mass=repr(ball.mass_kg.value),
        moment=repr(ball.moment_kg_m2),
        height=repr(ball.drop_height_m.value),
        step=repr(STEP_S if ball.step_s is None else ball.step_s),
        gravity=repr(GRAVITY_M_S2),
    )


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`."""
    weight = payload.inertial
    return _PAYLOAD.substitute(
        head=hash_comment(payload_lines(payload)),
        mass=repr(weight.mass_kg),
        com=repr(weight.com_m),
        inertia=repr(tuple(weight.tensor().ravel().tolist())),
    )


def dropped(path: Path, height_m: float, seconds: float) -> tuple[Array, Array]:
    """See `CanDrop`."""
    return dropped_by(path, height_m, seconds)
