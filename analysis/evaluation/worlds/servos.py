"""Simulate servos that swing a load, without an engine, with their owners' MuJoCo models.

A fourth-order Runge-Kutta step takes what is smooth; dry friction then takes speed away, at most
all of it (Moreau's time stepping). Each servo has some of the terms that `--tune actuators` knows
and lacks the others. `sample_logs/models/servo.*` is made by

    python -m tunenet_logs.analysis.evaluation.worlds.servos
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import copysign, exp, sin
from pathlib import Path

import numpy as np

from tunenet_logs.analysis.api import save_episode
from tunenet_logs.analysis.evaluation.worlds.machines import (
    GRAVITY_M_S2,
    ModelLog,
    Sensed,
    recorded,
    sample_times,
)
from tunenet_logs.episode import Array

STEP_S = 2e-4
NAME = "servo"  # of the joint and its actuator
LOAD_KG, REACH_M = 0.5, 0.1
TICK_RAD = 2 * np.pi / 4096  # of its encoder
COUNT_HZ = 150.0
LIMIT_N_M = 0.9  # of its torque, in its owner's model
LENGTH_S = 6.0

MODEL = f"""\
<mujoco model="servo">
  <option timestep="0.001" integrator="implicitfast" gravity="0 0 -{GRAVITY_M_S2}"/>
  <worldbody>
    <body name="arm">
      <joint name="{NAME}" axis="0 1 0" damping="0.02" frictionloss="0.03" armature="0.002"
        solreffriction="-1e-6 -1900" solimpfriction="0.99 0.999 0.001 0.5 2"/>
      <inertial pos="0 0 -{REACH_M}" mass="{LOAD_KG}" diaginertia="2e-5 2e-5 2e-5"/>
    </body>
  </worldbody>
  <actuator>
    <position name="{NAME}" joint="{NAME}" kp="2" forcerange="-{LIMIT_N_M} {LIMIT_N_M}"/>
  </actuator>
</mujoco>
"""


@dataclass(frozen=True)
class Servo:
    """A servo's terms, by the fields of their addresses."""

    kp: float
    damping: float  # with power
    armature: float
    frictionloss: float
    forcerange: float = LIMIT_N_M
    load_friction: float = 0.0
    stribeck_load: float = 0.0
    stribeck_speed: float = 0.5
    zero: float = 0.0
    commands: float = 0.0  # delay

    def moved(self, seconds: Array, told_s: Array, told_rad: Array) -> Array:
        """Return what its encoder shows, shape (T,), of commands that hold until the next."""
        count = int(seconds[-1] / STEP_S) + 2
        grid_s = STEP_S * np.arange(count)
        place = np.searchsorted(told_s, grid_s - self.commands, "right") - 1
        commands = (told_rad[np.maximum(place, 0)] + self.zero).tolist()
        inertia = LOAD_KG * REACH_M**2 + 2e-5 + self.armature
        pull = LOAD_KG * GRAVITY_M_S2 * REACH_M

        def motor(angle: float, speed: float, command: float) -> float:
            wanted = self.kp * (command - angle)
            return copysign(min(abs(wanted), self.forcerange), wanted) - self.damping * speed

        def rate(angle: float, speed: float, command: float) -> float:
            return (motor(angle, speed, command) - pull * sin(angle)) / inertia

        angle, speed = self.zero, 0.0
        shown = np.empty(count)
        half = STEP_S / 2
        for step, command in enumerate(commands):
            shown[step] = angle
            a1 = rate(angle, speed, command)
            v2 = speed + half * a1
            a2 = rate(angle + half * speed, v2, command)
            v3 = speed + half * a2
            a3 = rate(angle + half * v2, v3, command)
            v4 = speed + STEP_S * a3
            a4 = rate(angle + STEP_S * v3, v4, command)
            carried = abs(motor(angle, speed, command) + pull * sin(angle))
            at_rest = exp(-abs(speed) / self.stribeck_speed)
            rubs = self.load_friction + self.stribeck_load * at_rest
            most = STEP_S * (self.frictionloss + rubs * carried) / inertia
            before = speed
            speed += STEP_S * (a1 + 2 * a2 + 2 * a3 + a4) / 6
            speed -= copysign(min(abs(speed), most), speed)
            angle += STEP_S * (before + speed) / 2
        return np.interp(seconds, grid_s, shown) - self.zero


def drawn(rng: np.random.Generator, size: float) -> Servo:
    """Draw a servo; each term beyond the first four is there in half of them, of so many sizes."""

    def near(middle: float) -> float:
        return float(middle * np.exp(rng.uniform(-0.7, 0.7)))

    def maybe(value: float, absent: float = 0.0) -> float:
        return value if rng.random() < 0.5 else absent

    load = maybe(near(0.15 * size))
    return Servo(
        kp=near(2.0),
        damping=near(0.06),
        armature=near(0.003),
        frictionloss=near(0.02),
        forcerange=maybe(float(rng.uniform(0.6, 0.75)), LIMIT_N_M),
        load_friction=load,
        stribeck_load=maybe(near(0.1 * size)) if load else 0.0,
        zero=maybe(0.04 * size * float(rng.choice([-1.0, 1.0]))),
        commands=maybe(near(0.015 * size)),
    )


def servo_log(seed: int, noise: float = 1.0) -> ModelLog:
    """Simulate steps and sweeps of 6 s; `noise` is the size of what MuJoCo's servos lack."""
    rng = np.random.default_rng((seed, 58))
    servo = drawn(rng, noise)
    told_s = np.arange(0.0, LENGTH_S, 0.01)
    phase = 2 * np.pi * (0.3 * told_s + 0.12 * told_s**2)
    steps = np.repeat(rng.uniform(-0.8, 0.8, 12), 50)[: len(told_s)]
    reach = float(rng.uniform(0.7, 1.1))
    ease = np.minimum(told_s / 0.3, 1.0)
    told_rad = ease * np.where(told_s % 3 < 1.5, reach * np.sin(phase), steps)
    return _log(servo, rng, told_s, told_rad)


def slow_servo_log(seed: int, noise: float = 1.0) -> ModelLog:
    """Simulate one slow rise: it tells no gain from friction by load, and nothing of a limit."""
    rng = np.random.default_rng((seed, 59))
    servo = replace(drawn(rng, noise), forcerange=LIMIT_N_M, commands=0.0)
    told_s = np.arange(0.0, LENGTH_S, 0.01)
    told_rad = 0.05 * (1 - np.cos(np.pi * told_s / LENGTH_S))
    log = _log(servo, rng, told_s, told_rad)
    return replace(log, unidentifiable=(f"actuator/{NAME}.kp",))


def _log(servo: Servo, rng: np.random.Generator, told_s: Array, told_rad: Array) -> ModelLog:
    seconds = sample_times(LENGTH_S, COUNT_HZ, rng)
    shown = np.round(servo.moved(seconds, told_s, told_rad) / TICK_RAD) * TICK_RAD
    names = (NAME,)
    sensed = {
        "/joint_states.position": Sensed(seconds, shown[:, None], names, "rad", 0.0),
        "/joint_commands.position": Sensed(told_s, told_rad[:, None], names, "rad", 0.0),
    }
    kinds = {"kp": "actuator", "forcerange": "actuator", "commands": "delay"}
    joints = ("damping", "armature", "frictionloss")
    truth: dict[str, float] = {}
    for field, value in vars(servo).items():
        kind = kinds.get(field, "joint" if field in joints else "servo")
        address = f"{kind}/{NAME}.{field}" if kind != "delay" else "delay/commands"
        truth[address] = value
    return recorded(sensed, 1.0, rng, truth, MODEL, ("actuators",))


SAMPLE = 0  # seed of the sample, a servo with a limit and a delay


def write_sample(folder: Path) -> None:
    """Write the sample's log and its owner's model."""
    log = servo_log(SAMPLE)
    save_episode(log.episode, folder / "servo.mcap", overwrite=True)
    (folder / "servo.xml").write_text(log.model)


if __name__ == "__main__":
    write_sample(Path("sample_logs/models"))
