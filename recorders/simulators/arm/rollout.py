"""Roll out the paper's first experiment: an arm follows a path by position control."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recorders.simulators.arm.description import Arm, Payload
from recorders.simulators.arm.dynamics import UPRIGHT_GRAVITY_M_S2
from recorders.simulators.arm.path import JointPath
from recorders.simulators.engines import engine
from tunenet_logs.arrays import Array
from tunenet_logs.errors import UsageError

_LIMITS = (
    ("step_hz", 10.0, 20_000.0),
    ("burn_in", 1, 100_000),
    ("samples", 2, 1_000_000),
    ("force_nm", 0.0, 1e6),
    ("position_gain", 0.0, 1.0),
    ("velocity_gain", 0.0, 1.0),
    ("solver_iterations", 1, 10_000),
)


@dataclass(frozen=True)
class RolloutSettings:
    """Settings of the engine and the arm's position control.

    Attributes:
        name: the preset these belong to.
        gravity_m_s2: of an arm that stands upright.
        step_hz: of the simulation.
        burn_in: steps before the first sample, while the arm converges to its path.
        samples: steps that are recorded.
        force_nm: effort limit of a joint's motor.
        position_gain: share of a position error that a step takes away.
        velocity_gain: share of a velocity error likewise.
        solver_iterations: with 50, the engine's default, an arm lags by up to 0.004 rad at the
            paper's gains.
        is_damped: with the engine's default damping, which takes 0.007 N·m rms on the circle.

    Raises:
        UsageError: a value is not finite or out of range.
    """

    name: str
    gravity_m_s2: tuple[float, float, float] = UPRIGHT_GRAVITY_M_S2
    step_hz: float = 240.0
    burn_in: int = 150
    samples: int = 1200
    force_nm: float = 500.0
    position_gain: float = 0.3
    velocity_gain: float = 1.0
    solver_iterations: int = 200
    is_damped: bool = False

    def __post_init__(self) -> None:
        for name, low, high in _LIMITS:
            value = getattr(self, name)
            if not low <= value <= high:
                raise UsageError(f"{name} {value:g} is not from {low:g} to {high:g}")

    def times(self) -> Array:
        """Return the times [s] the path is needed at, shape (burn_in + samples + 1,)."""
        return np.arange(self.burn_in + self.samples + 1) / self.step_hz


# The torques are those of rigid links: inverse dynamics along the path gives them too.
CALIBRATED = RolloutSettings("default")

# Gains and gravity of the paper's authors, the rest as PyBullet comes.
PAPER = RolloutSettings(
    "paper",
    gravity_m_s2=(0.0, 0.0, -10.0),
    position_gain=0.03,
    solver_iterations=50,
    is_damped=True,
)

PRESETS = {settings.name: settings for settings in (CALIBRATED, PAPER)}


@dataclass(frozen=True, eq=False)
class Rollout:
    """Recording of one rollout.

    Attributes:
        path: states before each recorded step; accelerations are those of the step.
        effort_nm: motor torques in that step, shape (samples, J).
    """

    path: JointPath
    effort_nm: Array


def roll_out(
    arm: Arm,
    path: JointPath,
    payload: Payload | None = None,
    settings: RolloutSettings = CALIBRATED,
) -> Rollout:
    """Follow a path and record the motors' torques, deterministically.

    Args:
        arm: with limits that the path keeps: motors would fight them.
        path: at `settings.times()`.
        payload: None for an empty gripper.
        settings: of engine and motors.

    Raises:
        UsageError: the path does not fit the arm.
        ValueError: the path has other times.
    """
    path.checked(arm)
    if not np.allclose(path.seconds, settings.times(), rtol=0, atol=1e-9):
        raise ValueError("a rollout's path is wanted at settings.times()")
    states = engine().position_control(arm, path, payload, settings)
    before, after = states[settings.burn_in - 1 : -1], states[settings.burn_in :]
    acceleration = (after[..., 1] - before[..., 1]) * settings.step_hz
    seconds = settings.times()[: settings.samples]
    return Rollout(JointPath(seconds, before[..., 0], before[..., 1], acceleration), after[..., 2])
