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

from tunenet_logs.analysis.export.exported import ExportedBall, filled, xml_comment
from tunenet_logs.analysis.export.templated import SDF
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

# ---- Contact law: dissipation from restitution, and restitution from dissipation.

MIN_RESTITUTION = 0.01  # a smaller restitution takes a dissipation without bound


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
    # Below this u both sides are the same but for rounding, and e = 1 - 2 u / 3.
    if u < 1e-4:
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
# Of Drake's integrator: its error is then far under the model's own.
_MAX_STEP_S, _ACCURACY = 1e-3, 1e-5


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    speed_m_s = ball.speed_m_s.value
    damping_s_m = dissipation(ball.restitution, speed_m_s)
    lines = [
        "Not expressed here: the air's drag, and the tuned law over speed. Drake's contact is Hunt",
        "and Crossley's: its restitution falls with speed by a law of its own. This file has that",
        f"of {speed_m_s:.2f} m/s; for another one, export again for that speed. By the formula:",
        "  speed [m/s]   restitution in Drake",
        *(
            f"  {factor * speed_m_s:11.3f}   {restitution(damping_s_m, factor * speed_m_s):20.3f}"
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
    # The ball sinks in by a twentieth of its radius: little beside a bounce, yet no stiff problem.
    stiffness = ball.mass_kg.value * (speed_m_s / (0.05 * ball.radius_m.value)) ** 2
    return filled(
        "drake_ball.sdf", xml_comment, ball, lines, dissipation=damping_s_m, stiffness=stiffness
    )


payload_text = SDF.payload_text


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
