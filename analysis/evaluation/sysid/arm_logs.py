"""Simulate logs of a planar arm under servos, with its owner's model."""

from __future__ import annotations

import numpy as np

from analysis.evaluation.sysid.model_log import (
    COMMANDS_HZ,
    STATES_HZ,
    ModelLog,
    Sensed,
    recorded,
    sample_times,
)
from analysis.evaluation.sysid.pendulum import EARTH
from analysis.evaluation.sysid.planar_arm import LINKS_M, Commands, PlanarArm
from tunenet_logs.arrays import Array

JOINTS = ("shoulder", "elbow")
PAYLOAD, DELAY, ELBOW_DAMPING = "body/payload.mass", "delay/commands", "joint/elbow.damping"

_TUNE = (f"{PAYLOAD}=0.05:3", f"{DELAY}=0:0.1")
_LENGTH_S = 8.0

ELBOW = '<joint name="elbow" type="hinge" axis="0 -1 0" damping="0.3" armature="0.02"/>'
ELBOW_SERVO = '<position name="elbow" joint="elbow" kp="60" kv="3"/>'

_BRAKE = """\
  <equality>
    <joint joint1="elbow" polycoef="{angle:.9f} 0 0 0 0" solref="0.002 1"
           solimp="0.99 0.9999 0.001 0.5 2"/>
  </equality>
"""

_ARM = """\
<mujoco model="planar arm">
  <option timestep="0.001" integrator="RK4" gravity="{gravity}"/>
  <worldbody>
    <body name="upper_arm">
      <joint name="shoulder" type="hinge" axis="0 -1 0" damping="0.3" armature="0.02"/>
      <inertial pos="0 0 -{first_middle:g}" mass="1.5" diaginertia="0.02 0.02 0.002"/>
      <body name="forearm" pos="0 0 -{first:g}"{turned}>
        {elbow}
        <inertial pos="0 0 -{second_middle:g}" mass="1" diaginertia="0.008 0.008 0.001"/>
        <body name="payload" pos="0 0 -{second:g}">
          <inertial pos="0 0 0" mass="1" diaginertia="0.00016 0.00016 0.00016"/>
        </body>
      </body>
    </body>
  </worldbody>
{brake}  <actuator>
    <position name="shoulder" joint="shoulder" kp="120" kv="12"/>
    {servo}
  </actuator>
</mujoco>
"""


def arm_model(
    *,
    gravity: str = EARTH,
    links_m: tuple[float, float] = LINKS_M,
    held_rad: float | None = None,
    welded_rad: float | None = None,
) -> str:
    """Return the MJCF text of an owner's model.

    Args:
        gravity: three numbers [m/s²].
        links_m: lengths of the two links, with their centres in the middle.
        held_rad: where a brake holds the elbow; None without one.
        welded_rad: angle between the links of a model that has no elbow; None of one that has.
    """
    welded = welded_rad is not None
    return _ARM.format(
        gravity=gravity,
        first=links_m[0],
        second=links_m[1],
        first_middle=links_m[0] / 2,
        second_middle=links_m[1] / 2,
        turned=f' axisangle="0 -1 0 {np.degrees(welded_rad):.6f}"' if welded else "",
        elbow="" if welded else ELBOW,
        servo="" if welded else ELBOW_SERVO,
        brake="" if held_rad is None else _BRAKE.format(angle=held_rad),
    )


def arm_log(seed: int, noise: float = 1.0) -> ModelLog:
    """Simulate a motion of 8 s, of which payload and delay are tuned."""
    rng = np.random.default_rng((seed, 2))
    return _log(PlanarArm.drawn(rng), Commands.drawn(rng), noise, rng)


def arm_with_a_brake(seed: int, noise: float = 1.0) -> ModelLog:
    """Simulate the same with the elbow held, so that its damping is unidentifiable."""
    rng = np.random.default_rng((seed, 3))
    arm, drawn = PlanarArm.drawn(rng, elbow_is_held=True), Commands.drawn(rng)
    drawn.amplitudes[:, 1] = 0.0
    return _log(arm, drawn, noise, rng)


def _log(arm: PlanarArm, commands: Commands, noise: float, rng: np.random.Generator) -> ModelLog:
    told_s = sample_times(_LENGTH_S, COMMANDS_HZ, rng)
    told_rad: Array = commands.at(told_s)
    seconds = sample_times(_LENGTH_S, STATES_HZ, rng)
    angles_rad, speeds, torques = arm.moved(seconds, told_s, told_rad)
    sensed = {
        "/joint_states.position": Sensed(seconds, angles_rad, JOINTS, "rad"),
        "/joint_states.velocity": Sensed(seconds, speeds, JOINTS, "rad/s"),
        "/joint_states.effort": Sensed(seconds, torques, JOINTS, "N·m"),
        "/joint_commands.position": Sensed(told_s, told_rad, JOINTS, "rad", 0.0),
    }
    episode, clean, sizes = recorded(sensed, noise, rng)
    truth = {PAYLOAD: arm.payload_kg, DELAY: arm.delay_s}
    if not arm.elbow_is_held:
        return ModelLog(episode, truth, arm_model(), _TUNE, (), clean, sizes)
    truth[ELBOW_DAMPING] = 0.3
    model = arm_model(held_rad=float(commands.middle[1]))
    tune = (*_TUNE, f"{ELBOW_DAMPING}=0:2")
    return ModelLog(episode, truth, model, tune, (ELBOW_DAMPING,), clean, sizes)
