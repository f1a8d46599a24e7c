"""Drake: an SDF with ball and ground, whose Hunt-Crossley dissipation gives the restitution.

The contact force is F = k x (1 + d x'). A body that meets it at speed v and leaves at e v obeys,
with u = d v and without gravity,

    u - ln(1 + u) = -e u - ln(1 - e u),

independent of its mass and the stiffness k: the restitution falls with speed (Hunt and Crossley,
"Coefficient of restitution interpreted as damping in vibroimpact", 1975).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    ball_lines,
    payload_lines,
    xml_comment,
)
from tunenet_logs.analysis.export.sdf import payload_model
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

# ---- Contact law: dissipation from restitution, and restitution from dissipation.

MIN_RESTITUTION = 0.01  # a smaller restitution takes a dissipation without bound
_BEND = 1e-4  # of u, below which both sides are the same but for rounding, and e = 1 - 2 u / 3


def dissipation(restitution: float, speed_m_s: float) -> float:
    """Solve for the dissipation d [s/m] of a restitution at this speed; see `MIN_RESTITUTION`."""
    wanted = max(restitution, MIN_RESTITUTION)
    low, high = 0.0, 1 / wanted
    for _ in range(100):
        middle = (low + high) / 2
        low, high = (middle, high) if _restitution(middle) > wanted else (low, middle)
    return low / speed_m_s


def restitution(dissipation_s_m: float, speed_m_s: float) -> float:
    """Solve for the coefficient of restitution at this impact speed."""
    return _restitution(dissipation_s_m * speed_m_s)


def _restitution(u: float) -> float:
    if u < _BEND:
        return 1 - 2 * u / 3
    low, high = 0.0, min(1.0, 1 / u)
    taken = u - math.log1p(u)
    for _ in range(100):
        middle = (low + high) / 2
        given = -middle * u - math.log1p(-middle * u) if middle * u < 1 else math.inf
        low, high = (middle, high) if given < taken else (low, middle)
    return (low + high) / 2


# ---- Files: the SDF of a ball or a payload, and the drop in Drake.

NAME, SUFFIX, LIBRARY = "drake", ".sdf", "pydrake"
STEP_S = None  # the plant is to be continuous: its integrator chooses its steps
_DEPTH = 0.05  # of the radius, that the ball sinks in: little beside a bounce, yet no stiff problem
_BALL = """\
<?xml version="1.0"?>
{head}
<sdf version="1.7" xmlns:drake="http://drake.mit.edu">
  <world name="drop">
    <model name="ground">
      <static>true</static>
      <link name="ground">
        <collision name="surface">
          <geometry>
            <plane><normal>0 0 1</normal><size>10 10</size></plane>
          </geometry>
          <drake:proximity_properties>
            <!-- The same as the ball's: Drake weighs the two by their stiffness. A ground that
                 says nothing has Drake's default, and the pair something between. -->
            <drake:hunt_crossley_dissipation>{dissipation}</drake:hunt_crossley_dissipation>
            <!-- So stiff that only the ball gives way. -->
            <drake:point_contact_stiffness>1e12</drake:point_contact_stiffness>
          </drake:proximity_properties>
        </collision>
      </link>
    </model>
    <!-- For a scene of your own copy this model, and give your ground the properties above. -->
    <model name="ball">
      <!-- The recorded drop: the gap under the ball, and its radius. -->
      <pose>0 0 {centre} 0 0 0</pose>
      <link name="ball">
        <!-- A solid ball: 2/5 m r^2. -->
        <inertial>
          <mass>{mass}</mass>
          <inertia>
            <ixx>{moment}</ixx><ixy>0</ixy><ixz>0</ixz>
            <iyy>{moment}</iyy><iyz>0</iyz><izz>{moment}</izz>
          </inertia>
        </inertial>
        <collision name="surface">
          <geometry>
            <sphere><radius>{radius}</radius></sphere>
          </geometry>
          <drake:proximity_properties>
            <!-- d of F = k x (1 + d v) [s/m], solved for the restitution at one speed (see above).
                 Drake passes over SDF's own bounce and restitution_coefficient. -->
            <drake:hunt_crossley_dissipation>{dissipation}</drake:hunt_crossley_dissipation>
            <!-- k [N/m]: at that speed the ball sinks in by a twentieth of its radius. It does not
                 change the restitution, only how long a contact lasts. -->
            <drake:point_contact_stiffness>{stiffness}</drake:point_contact_stiffness>
          </drake:proximity_properties>
        </collision>
        <visual name="surface">
          <geometry>
            <sphere><radius>{radius}</radius></sphere>
          </geometry>
        </visual>
      </link>
    </model>
  </world>
</sdf>
"""


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    speed_m_s, radius_m = ball.speed_m_s.value, ball.radius_m.value
    damping_s_m = dissipation(ball.restitution, speed_m_s)
    return _BALL.format(
        head=xml_comment([*ball_lines(ball), *_lines(ball, damping_s_m)]),
        dissipation=repr(damping_s_m),
        stiffness=repr(ball.mass_kg.value * (speed_m_s / (_DEPTH * radius_m)) ** 2),
        centre=repr(radius_m + ball.drop_height_m.value),
        mass=repr(ball.mass_kg.value),
        moment=repr(ball.moment_kg_m2),
        radius=repr(radius_m),
    )


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`."""
    return payload_model(xml_comment(payload_lines(payload)), payload.inertial)


def dropped(
    path: Path, height_m: float, seconds: float, step_s: float = 0.0
) -> tuple[Array, Array]:
    """See `CanDrop`; the plant is continuous, as the file asks, unless a step [s] is given."""
    from pydrake import all as pydrake  # pyright: ignore[reportMissingImports] (an extra)

    builder = pydrake.DiagramBuilder()
    plant, _ = pydrake.AddMultibodyPlantSceneGraph(builder, time_step=step_s)
    pydrake.Parser(plant).AddModels(str(path))
    plant.mutable_gravity_field().set_gravity_vector([0, 0, -GRAVITY_M_S2])
    plant.Finalize()
    simulator = pydrake.Simulator(builder.Build())
    pydrake.ResetIntegratorFromFlags(simulator, "runge_kutta3", _MAX_STEP_S)
    simulator.get_mutable_integrator().set_target_accuracy(_ACCURACY)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    ball = plant.GetBodyByName("ball")
    at_m = plant.EvalBodyPoseInWorld(context, ball).translation()
    shape = plant.GetCollisionGeometriesForBody(ball)[0]
    inspector = plant.EvalSceneGraphInspector(context)
    radius_m = inspector.GetShape(shape).radius()
    plant.SetFreeBodyPose(context, ball, pydrake.RigidTransform([*at_m[:2], radius_m + height_m]))
    times_s = np.arange(0.0, seconds, _MAX_STEP_S)
    heights_m = np.empty(len(times_s))
    for index, at_s in enumerate(times_s):
        simulator.AdvanceTo(at_s)
        heights_m[index] = plant.EvalBodyPoseInWorld(context, ball).translation()[2] - radius_m
    return times_s, heights_m


# Of Drake's integrator: its error is then far under the model's own.
_MAX_STEP_S, _ACCURACY = 1e-3, 1e-5


def _lines(ball: ExportedBall, damping_s_m: float) -> list[str]:
    """Tabulate the restitution of this contact over speed, beside the tuned law."""
    at_m_s = ball.speed_m_s.value
    lines = [
        "Not expressed here: the air's drag, and the tuned law over speed. Drake's contact is Hunt",
        "and Crossley's: its restitution falls with speed by a law of its own. This file has that",
        f"of {at_m_s:.2f} m/s; for another one, export again for that speed. By the formula:",
        "  speed [m/s]   restitution in Drake",
        *(
            f"  {factor * at_m_s:11.3f}   {restitution(damping_s_m, factor * at_m_s):20.3f}"
            for factor in (0.5, 1.0, 2.0)
        ),
        "Use a continuous plant, MultibodyPlant(time_step=0.0): with steps of 1 ms restitutions",
        "were up to 0.8 too low. Drake's gravity is 9.81 m/s^2 unless it is set to 9.80665.",
    ]
    if ball.restitution < MIN_RESTITUTION:
        lines.append(
            f"A restitution under {MIN_RESTITUTION:g} has no dissipation: "
            f"{MIN_RESTITUTION:g} stands for it."
        )
    return lines
