"""MuJoCo: an MJCF file with ball, floor and their contact, or with a payload.

MuJoCo's contacts have stiffness and damping, and no restitution. With no stiffness and the damping
(1 + e) / h, one step of length h turns the speed v into -e v, so the file is valid for one time
step. A margin of half the ball's motion in a step accounts for the part of it that is past the
surface.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from tunenet_logs.analysis.export.exported import ExportedBall, ExportedPayload, filled, xml_comment
from tunenet_logs.episode import Array

NAME, SUFFIX, LIBRARY = "mujoco", ".xml", "mujoco"
# In one the ball sinks in by speed times step: a ball of .2 that falls .2 m rebounds .002 off (at
# .5 ms .005), and slip of a 2 cm ball at 10 m/s ends 3 % off: friction acts nearer to its centre.
STEP_S = 0.0002
HAS_AIR = True
_AIR_KG_M3 = 1.2  # density of the air at 20 °C
_TRAPS = (
    "The damping below is (1 + e) / time step: with another time step, compute it again. The",
    "integrators Euler and implicitfast bounce alike; with RK4, which many walkers' scenes have,",
    "nothing bounces: set the scene's integrator to implicitfast.",
    "The popular recipe, a stiff spring with e's damping ratio, is up to .15 off for dull balls.",
    "Not expressed here: a restitution that depends on speed. Friction is MuJoCo's default, 1: a",
    "drop does not identify it. A ball that still slips as it leaves is thrown up too fast, by",
    "friction times its slip: MuJoCo solves both in one convex problem.",
)


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    step_s = STEP_S if ball.step_s is None else ball.step_s
    area_m2 = math.pi * ball.radius_m.value**2
    drag = ball.drag_1_m * ball.mass_kg.value / (_AIR_KG_M3 * area_m2)
    return filled(
        "mujoco_ball.xml",
        xml_comment,
        ball,
        _TRAPS,
        _number,
        step=step_s,
        density=_AIR_KG_M3 if drag else 0.0,
        damping=-(1 + ball.restitution) / step_s,
        slip=-1 / step_s,
        impedance="0.9999 0.9999 0.001 0.5 2",
        margin=1.0 * step_s,  # what a ball moves in a step at 1 m/s: half of a fall of .2 m
        drag=drag,
    )


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`."""
    return filled("mujoco_payload.xml", xml_comment, payload, number=_number)


def _number(value: float) -> str:
    return f"{value:.10g}"


def dropped(path: Path, height_m: float, seconds: float) -> tuple[Array, Array]:
    """See `CanDrop`."""
    import mujoco

    load, make, step = (getattr(mujoco, name) for name in ("MjModel", "MjData", "mj_step"))
    model = load.from_xml_path(str(path))
    data = make(model)
    radius_m = float(model.geom("tuned_ball").size[0])
    data.qpos[2] = radius_m + height_m
    heights_m = [height_m]
    for _ in range(math.ceil(seconds / model.opt.timestep)):
        step(model, data)
        heights_m.append(float(data.qpos[2]) - radius_m)
    return np.arange(len(heights_m)) * model.opt.timestep, np.array(heights_m)
