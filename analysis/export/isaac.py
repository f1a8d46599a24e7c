"""USD for Isaac Sim: a scene with material and ball, or a payload's mass."""

from __future__ import annotations

from string import Template

from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    ball_lines,
    hash_comment,
    one_restitution_lines,
    payload_lines,
)

NAME, SUFFIX, LIBRARY = "isaac", ".usda", None
STEP_S = 1 / 240  # four steps for each frame at 60 Hz
_WARNINGS = ("This file has not been run in Isaac Sim by its writer.",)

_BALL = Template("""\
#usda 1.0
$head
(
    defaultPrim = "World"
    metersPerUnit = 1
    kilogramsPerUnit = 1
    upAxis = "Z"
)

def Xform "World"
{
    # If your stage has a scene, copy the two physxScene values into it, and leave this one out.
    def PhysicsScene "PhysicsScene" (
        prepend apiSchemas = ["PhysxSceneAPI"]
    )
    {
        vector3f physics:gravityDirection = (0, 0, -1)
        # Standard gravity, which the tuning assumed too.
        float physics:gravityMagnitude = 9.80665
        # Slower impacts do not bounce at all. PhysX's default is 2 m/s: nothing that falls less
        # than 0.2 m. A value under gravity times the step lets bodies tremble at rest.
        float physxScene:bounceThreshold = $threshold
        # Longer steps are less exact.
        uint physxScene:timeStepsPerSecond = $rate
    }

    def Material "BallMaterial" (
        prepend apiSchemas = ["PhysicsMaterialAPI", "PhysxMaterialAPI"]
    )
    {
        # The tuned one.
        float physics:restitution = $restitution
        # The default, average, would halve it with a ground of 0. Of two modes PhysX takes the
        # one that stands later in average, min, multiply, max: so this one wins, and the pair
        # has the ball's restitution unless the ground's is larger.
        uniform token physxMaterial:restitutionCombineMode = "max"
    }

    def Sphere "Ball" (
        prepend apiSchemas = [
            "PhysicsRigidBodyAPI", "PhysxRigidBodyAPI", "PhysicsCollisionAPI",
            "PhysicsMassAPI", "MaterialBindingAPI"
        ]
    )
    {
        double radius = $radius
        float3[] extent = [(-$radius, -$radius, -$radius), ($radius, $radius, $radius)]
        # A solid ball: 2/5 m r^2. Without a mass PhysX takes the density of water.
        float physics:mass = $mass
        float3 physics:diagonalInertia = ($moment, $moment, $moment)
        # Damping is a drag; what the restitution here stands for has it already.
        float physxRigidBody:linearDamping = 0
        float physxRigidBody:angularDamping = 0
        # The physics material: the one of the pictures is bound apart from it.
        rel material:binding:physics = </World/BallMaterial>
        # The recorded drop: the gap under the ball, and its radius. The ground is yours, at z = 0.
        double3 xformOp:translate = (0, 0, $centre)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
""")

_PAYLOAD = Template("""\
#usda 1.0
$head
(
    defaultPrim = "Payload"
    metersPerUnit = 1
    kilogramsPerUnit = 1
    upAxis = "Z"
)

# Reference it under the arm's tool frame, and fix it there with a PhysicsFixedJoint.
def Xform "Payload" (
    prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
)
{
    float physics:mass = $mass
    # In the tool frame.
    point3f physics:centerOfMass = ($x, $y, $z)
    # About the centre of mass; without it PhysX would take that of the shapes, and there are none.
    float3 physics:diagonalInertia = ($xx, $yy, $zz)
    quatf physics:principalAxes = (1, 0, 0, 0)
}
""")


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    step_s = STEP_S if ball.step_s is None else ball.step_s
    rate_hz = max(round(1 / step_s), 1)
    return _BALL.substitute(
        head=hash_comment([*ball_lines(ball), *one_restitution_lines(ball), *_WARNINGS]),
        threshold=repr(round(1.2 * 9.80665 / rate_hz, 4)),
        rate=rate_hz,
        restitution=repr(ball.restitution),
        radius=repr(ball.radius_m.value),
        mass=repr(ball.mass_kg.value),
        moment=repr(ball.moment_kg_m2),
        centre=repr(ball.radius_m.value + ball.drop_height_m.value),
    )


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`."""
    weight = payload.inertial
    xx, _, _, yy, _, zz = (repr(moment) for moment in weight.inertia_kg_m2)
    x, y, z = (repr(part) for part in weight.com_m)
    return _PAYLOAD.substitute(
        head=hash_comment(payload_lines(payload)),
        mass=repr(weight.mass_kg),
        x=x,
        y=y,
        z=z,
        xx=xx,
        yy=yy,
        zz=zz,
    )
