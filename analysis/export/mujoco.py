"""MuJoCo: an MJCF file with ball, floor and their contact, or with a payload.

MuJoCo's contacts have stiffness and damping, and no restitution. With no stiffness and the damping
(1 + e) / h, one step of length h turns the speed v into -e v, so the file is valid for one time
step. A margin of half the ball's motion in a step accounts for the part of it that is past the
surface.
"""

from __future__ import annotations

import math
from pathlib import Path
from string import Template

import numpy as np

from tunenet_logs.analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    ball_lines,
    payload_lines,
    xml_comment,
)
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

NAME, SUFFIX, LIBRARY = "mujoco", ".xml", "mujoco"

# In one the ball sinks in by speed times step: a ball of .2 that falls .2 m rebounds .002 off (at
# .5 ms .005), and slip of a 2 cm ball at 10 m/s ends 3 % off: friction acts nearer to its centre.
STEP_S = 0.0002

HAS_AIR = True

# The margin is what a ball moves in a step at this speed: half of a fall of .2 m.
_MARGIN_SPEED_M_S = 1.0

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

_BALL = Template("""\
$head
<mujoco model="tuned ball">
  <!-- Standard gravity, which the tuning assumed too. The elliptic cone keeps Coulomb's friction
       the same in all directions. The air's density: it slows every body of the scene. -->
  <option timestep="$step" gravity="0 0 -$gravity" cone="elliptic" density="$density"/>
  <worldbody>
    <geom name="tuned_floor" type="plane" size="0 0 1"/>
    <!-- The recorded drop: the gap under the ball, and its radius. -->
    <body name="tuned_ball" pos="0 0 $centre">
      <freejoint/>
      <!-- A solid ball: 2/5 m r^2. Scenes that compute inertias from shapes pass over it. -->
      <inertial pos="0 0 0" mass="$mass" diaginertia="$moment $moment $moment"/>
      <!-- For floors of your own copy this geom: with a higher priority than theirs, its contact
           is the one that counts. solref: no stiffness, and the damping. solimp: as hard as
           MuJoCo takes; its default is up to .10 off. Slip is then damped like the bounce, and
           a rolling start comes out too slow (.49 of the speed, where a rigid ball keeps .71):
           only a pair, as below, has a damping of its own for slip.
           fluidcoef: the drag coefficient that the tuned drag is with this radius and mass, in
           air of the density above; most scenes have none (density 0), and then no drag. -->
      <geom name="tuned_ball" type="sphere" size="$radius" mass="$mass" condim="3" priority="1"
            solref="0 $damping" solimp="$impedance" margin="$margin"
            fluidshape="ellipsoid" fluidcoef="$drag 0 0 0 0"/>
    </body>
  </worldbody>
  <contact>
    <!-- On this floor: the same bounce, and slip that ends in one step as far as friction can. -->
    <pair name="tuned_bounce" geom1="tuned_floor" geom2="tuned_ball" condim="3"
          friction="1 1 0.005 0.0001 0.0001" solref="0 $damping"
          solreffriction="0 $slip" solimp="$impedance" margin="$margin"/>
  </contact>
</mujoco>
""")

_PAYLOAD = Template("""\
$head
<mujoco model="payload">
  <!-- Without this, MuJoCo would compute inertias from shapes, and there are none. -->
  <compiler inertiafromgeom="false"/>
  <worldbody>
    <!-- Copy this body into the arm's file, inside of the body of its tool, at the tool frame. -->
    <body name="payload">
      <!-- The centre of mass in the tool frame; a solid ball's inertia about it. -->
      <inertial pos="$com" mass="$mass" diaginertia="$moments"/>
    </body>
  </worldbody>
</mujoco>
""")


def ball_text(ball: ExportedBall) -> str:
    """See `ExportFormat`."""
    step_s = STEP_S if ball.step_s is None else ball.step_s
    area_m2 = math.pi * ball.radius_m.value**2
    drag = ball.drag_1_m * ball.mass_kg.value / (_AIR_KG_M3 * area_m2)
    return _BALL.substitute(
        head=xml_comment([*ball_lines(ball), *_TRAPS]),
        step=_number(step_s),
        gravity=_number(GRAVITY_M_S2),
        density=_number(_AIR_KG_M3 if drag else 0.0),
        centre=_number(ball.radius_m.value + ball.drop_height_m.value),
        radius=_number(ball.radius_m.value),
        mass=_number(ball.mass_kg.value),
        moment=_number(ball.moment_kg_m2),
        damping=_number(-(1 + ball.restitution) / step_s),
        slip=_number(-1 / step_s),
        impedance="0.9999 0.9999 0.001 0.5 2",
        margin=_number(_MARGIN_SPEED_M_S * step_s),
        drag=_number(drag),
    )


def payload_text(payload: ExportedPayload) -> str:
    """See `ExportFormat`."""
    moment = _number(payload.inertial.inertia_kg_m2[0])
    return _PAYLOAD.substitute(
        head=xml_comment(payload_lines(payload)),
        com=" ".join(map(_number, payload.com_m)),
        mass=_number(payload.mass_kg),
        moments=" ".join([moment] * 3),
    )


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
