"""Integrate a pendulum with viscous and dry friction from reversal to reversal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

from analysis.evaluation.sysid.model_log import (
    GRAVITY_M_S2,
    STATES_HZ,
    ModelLog,
    Sensed,
    recorded,
    sample_times,
)
from tunenet_logs.arrays import Array

JOINT = "hinge"  # by the name of which log and model know it
DAMPING, FRICTION, ARMATURE, MASS = (
    f"joint/{JOINT}.damping",
    f"joint/{JOINT}.frictionloss",
    f"joint/{JOINT}.armature",
    "body/bob.mass",
)

_TUNE = (f"{DAMPING}=0:0.2", f"{FRICTION}=0:0.3", f"{ARMATURE}=0:0.1")

_LENGTH_S = 8.0
_MASS_KG, _ARM_M, _INERTIA_KG_M2 = 1.0, 0.4, 0.005

_MAX_REVERSALS = 200

_MIN_RAD_S = 1e-12  # speed that the pendulum has just after a reversal
_TOLERANCE = 1e-11

# Dry friction's rows work against the speed that a step would end with: with a damping of 1.9 over
# the step (3800), friction turns over in the middle of a step in the mean, as dry friction does.
PENDULUM = """\
<mujoco model="pendulum">
  <option timestep="0.0005" integrator="implicitfast" gravity="{gravity}"/>
  <worldbody>
    <body name="bob">
      <joint name="hinge" type="hinge" axis="0 -1 0" damping="0.01" frictionloss="0.01"
             armature="0.002" solreffriction="-1e-6 -3800" solimpfriction="0.99 0.999 0.001 0.5 2"/>
      <inertial pos="0 0 -0.4" mass="{mass}" diaginertia="0.005 0.005 0.005"/>
    </body>
  </worldbody>
</mujoco>
"""

EARTH = f"0 0 -{GRAVITY_M_S2}"


@dataclass(frozen=True)
class Pendulum:
    """Pendulum released at rest.

    Attributes:
        damping: [N·m·s/rad].
        friction: dry [N·m].
        armature: [kg·m²], beside the bob's own inertia.
        angle_rad: from which it is let go.
    """

    damping: float
    friction: float
    armature: float
    angle_rad: float
    inertia: float = field(init=False)

    def __post_init__(self) -> None:
        own = _MASS_KG * _ARM_M**2 + _INERTIA_KG_M2
        object.__setattr__(self, "inertia", own + self.armature)

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Pendulum:
        """Draw a pendulum."""
        damping = float(np.exp(rng.uniform(np.log(0.02), np.log(0.1))))
        friction, armature = float(rng.uniform(0.02, 0.12)), float(rng.uniform(0.01, 0.05))
        angle_rad = float(rng.uniform(1.2, 2.4) * rng.choice([-1.0, 1.0]))
        return cls(damping, friction, armature, angle_rad)

    def pull(self, angle_rad: float) -> float:
        """Return gravity's torque [N·m]."""
        return -_MASS_KG * GRAVITY_M_S2 * _ARM_M * float(np.sin(angle_rad))

    def at(self, seconds: Array) -> Array:
        """Return angle [rad] and speed [rad/s] at increasing times from 0 on, shape (T, 2).

        Friction is exact: it has one sign from one reversal to the next, and holds the pendulum
        for good where gravity pulls less.
        """
        out = np.empty((len(seconds), 2))
        now_s, angle_rad, last_s = 0.0, self.angle_rad, float(seconds[-1])
        for _ in range(_MAX_REVERSALS):
            left = seconds >= now_s
            if abs(self.pull(angle_rad)) <= self.friction or now_s >= last_s:
                out[left] = (angle_rad, 0.0)
                return out
            way = float(np.sign(self.pull(angle_rad)))
            end_s, solution, angle_rad = self._until_it_turns(now_s, angle_rad, way, last_s)
            inside = left & (seconds <= end_s)
            out[inside] = solution(seconds[inside]).T
            now_s = end_s
        raise AssertionError("the pendulum turns too often")

    def _until_it_turns(
        self, now_s: float, angle_rad: float, way: float, last_s: float
    ) -> tuple[float, Callable[[Array], Array], float]:
        def rates(_: float, state: Array) -> list[float]:
            torque = self.pull(state[0]) - self.damping * state[1] - way * self.friction
            return [state[1], torque / self.inertia]

        def turns(_: float, state: Array) -> float:
            return float(state[1])

        turns.terminal, turns.direction = True, -way  # pyright: ignore[reportFunctionMemberAccess]
        solved = solve_ivp(
            rates,
            (now_s, last_s + 1e-9),
            [angle_rad, way * _MIN_RAD_S],
            "DOP853",
            dense_output=True,
            events=turns,
            rtol=_TOLERANCE,
            atol=_TOLERANCE,
        )
        return float(solved.t[-1]), solved.sol, float(solved.y[0, -1])


def pendulum_log(seed: int, noise: float = 1.0) -> ModelLog:
    """Simulate a swing of 8 s, of which three parameters are tuned."""
    rng = np.random.default_rng((seed, 1))
    pendulum = Pendulum.drawn(rng)
    seconds = sample_times(_LENGTH_S, STATES_HZ, rng)
    motion = pendulum.at(seconds)
    sensed = {
        "/joint_states.position": Sensed(seconds, motion[:, :1], (JOINT,), "rad"),
        "/joint_states.velocity": Sensed(seconds, motion[:, 1:], (JOINT,), "rad/s"),
    }
    episode, clean, sizes = recorded(sensed, noise, rng)
    truth = {DAMPING: pendulum.damping, FRICTION: pendulum.friction, ARMATURE: pendulum.armature}
    return ModelLog(episode, truth, pendulum_model(), _TUNE, (), clean, sizes)


def pendulum_of_unknown_mass(seed: int, noise: float = 1.0) -> ModelLog:
    """Simulate the same with the bob's mass tuned as well: a swing determines ratios alone."""
    log = pendulum_log(seed, noise)
    truth = {**log.truth, MASS: _MASS_KG}
    model = pendulum_model(mass_kg=1.3)
    tune = (*_TUNE, f"{MASS}=0.2:3")
    return ModelLog(log.episode, truth, model, tune, tuple(truth), log.clean, log.noise)


def pendulum_model(*, gravity: str = EARTH, mass_kg: float = _MASS_KG) -> str:
    """Return the MJCF text of an owner's model; gravity of three numbers [m/s²]."""
    return PENDULUM.format(gravity=gravity, mass=mass_kg)
