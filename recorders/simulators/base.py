"""The interfaces of simulators and physics engines, and the settings of engines.

A `Simulator` rolls out episodes by its parameters; it is written against the few calls of an
`Engine`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tunenet_logs.episode import Array, Episode
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.arm.description import Arm, Payload
from tunenet_logs.recorders.simulators.arm.path import JointPath

# Standard gravity (ISO 80000-3); at sea level it is 9.780 (equator) to 9.832 (poles).
GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True)
class Parameter:
    """A physical parameter of a simulator."""

    name: str  # the field's standard term, e.g. "restitution".
    unit: str  # "1" where it has none
    bounds: tuple[float, float]  # smallest and largest value that physics allows
    training_range: tuple[float, float]  # from where training pairs are drawn
    initial: float  # the guess that tuning starts from
    prior_sd: float | None = None  # of a measured guess, as a log's initial state is

    def checked(self, value: float) -> float:
        """Return `value` if it is within bounds."""
        low, high = self.bounds
        if not (math.isfinite(value) and low <= value <= high):
            raise UsageError(f"{self.name} {value:g} is not a number from {low:g} to {high:g}")
        return float(value)


class Simulator(Protocol):
    """An episode source that can be rolled out again with other parameters."""

    @property
    def engine(self) -> str:
        """Engine with its version, as `EpisodeInfo.source` begins: "pybullet 3.2.7"."""
        ...

    @property
    def step_hz(self) -> float:
        """Rate of simulation steps [Hz]."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The tunable parameters."""
        ...

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """Roll out one episode; the same values give the same bits.

        Raises:
            UsageError: a value is missing, not finite or out of bounds.
        """
        ...


class BallWorld(Protocol):
    """A plane at z = 0 and a ball of 1 kg over it; used for many rollouts.

    A step is semi-implicit Euler: v += -g dt, then z += v dt.
    """

    engine: str  # name and version
    radius_m: float
    contact: ContactSettings  # how contacts are solved

    def place(self, gap_m: float, restitution: float) -> None:
        """Put the ball at rest with its underside `gap_m` over the plane.

        Nothing of an earlier rollout remains: the same calls give the same bits.
        """
        ...

    def set_restitution(self, restitution: float) -> None:
        """Set the coefficient of restitution of the next impacts."""
        ...

    def set_speed(self, speed_m_s: float) -> None:
        """Set the ball's upward speed."""
        ...

    def step(self, period_s: float) -> tuple[float, float]:
        """Step once; return the centre's height [m] and the upward speed [m/s]."""
        ...

    def steps(self, period_s: float, count: int) -> list[float]:
        """Step `count` times; return the centre's height after each [m]."""
        ...

    def impact(
        self,
        velocity_m_s: Array,
        spin_rad_s: Array,
        restitution: float,
        friction: float,
        inertia_share: float,
    ) -> tuple[Array, Array]:
        """Solve an impact on the plane: velocity and spin after it, each of shape (3,).

        Args:
            velocity_m_s: before it, z towards the plane negative, shape (3,).
            spin_rad_s: before it, shape (3,).
            restitution: of the impact.
            friction: Coulomb's coefficient.
            inertia_share: the ball's moment of inertia over its mass and radius squared.
        """
        ...


class Engine(Protocol):
    """A physics engine, such as a module with these names."""

    name: str  # with its version, as a log and a tuning state it: "pybullet 3.2.7"

    def ball_world(self, radius_m: float, contact: ContactSettings) -> BallWorld:
        """Make a ball over a plane."""
        ...

    def inverse_dynamics(
        self,
        arm: Arm,
        path: JointPath,
        payload: Payload | None,
        gravity_m_s2: tuple[float, float, float],
    ) -> Array:
        """Compute the torques along a path: rigid links, no friction.

        Returns:
            Shape (T, J) [N·m], or [N] for a prismatic joint.
        """
        ...

    def position_control(
        self, arm: Arm, path: JointPath, payload: Payload | None, settings: RolloutSettings
    ) -> Array:
        """Simulate motors that follow the path; return the states after each step.

        Args:
            arm: starts at the path's first sample.
            path: one sample more than steps, at `settings.times()`.
            payload: None for an empty gripper.
            settings: of engine and motors.

        Returns:
            Position [rad], velocity [rad/s] and the motor's torque in the step [N·m] of each
            joint, shape (T - 1, J, 3).
        """
        ...


# ---- Settings of an arm's rollout

# Gravity in the base's frame of an arm that stands upright.
UPRIGHT_GRAVITY_M_S2 = (0.0, 0.0, -GRAVITY_M_S2)

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
    """Settings of the engine and the arm's position control."""

    name: str  # the preset these belong to
    gravity_m_s2: tuple[float, float, float] = UPRIGHT_GRAVITY_M_S2  # of an arm that stands upright
    step_hz: float = 240.0  # of the simulation
    burn_in: int = 150  # steps before the first sample, while the arm converges to its path
    samples: int = 1200  # steps that are recorded
    force_nm: float = 500.0  # effort limit of a joint's motor
    position_gain: float = 0.3  # share of a position error that a step takes away
    velocity_gain: float = 1.0  # share of a velocity error likewise
    solver_iterations: int = 200  # with 50, the default, an arm lags by up to 0.004 rad
    is_damped: bool = False  # with the engine's damping: 0.007 N·m rms on the circle

    def __post_init__(self) -> None:
        for name, low, high in _LIMITS:
            value = getattr(self, name)
            if not low <= value <= high:
                raise UsageError(f"{name} {value:g} is not from {low:g} to {high:g}")

    def times(self) -> Array:
        """Return the times [s] the path is needed at, shape (burn_in + samples + 1,)."""
        return np.arange(self.burn_in + self.samples + 1) / self.step_hz


# ---- Contact settings: calibrated, and the paper's

IMPACT_S = 1e-6  # of a step that solves an impact: gravity changes the speed in it by 1e-5 m/s
OVERLAP_M = 1e-9  # of a ball in a plane at an impact: engines act only on what touches


@dataclass(frozen=True)
class ContactSettings:
    """How the engine solves contacts; None is the engine's default."""

    name: str  # the preset these belong to
    gravity_m_s2: float  # downward acceleration
    # Cut the step that reaches the surface so that it ends there, and integrate flight exactly;
    # else plain fixed steps.
    meet_impacts: bool
    resting_speed_m_s: float = 0.0  # rebounds slower than this are at rest (with `meet_impacts`)
    contact_distance_m: float | None = None  # between surfaces, at which a contact is made
    solver_distance_m: float | None = None  # from which the solver works on a contact
    contact_slop_m: float | None = None  # overlap that the solver leaves
    error_reduction: float | None = None  # fraction of an overlap that one step takes away
    inelastic_below_m_s: float | None = None  # slower impacts have a restitution of 0
    linear_damping: float | None = None  # fraction of its speed that a body loses in a second
    angular_damping: float | None = None  # the same of its spin


# The restitution that is set is the one that is got. An engine can lose or add energy at an impact
# in four ways. A contact made ahead of the surfaces' meeting eats the rebound; error reduction
# pushes out what has sunk in, which adds energy; a slop divided by a short step takes slop / dt off
# the rebound speed; damping is a drag. All are off, and a step ends where it meets the surface.
CALIBRATED = ContactSettings(
    name="default",
    gravity_m_s2=GRAVITY_M_S2,
    meet_impacts=True,
    resting_speed_m_s=0.01,
    contact_distance_m=1e-4,
    solver_distance_m=0.0,
    contact_slop_m=0.0,
    error_reduction=0.0,
    inelastic_below_m_s=0.0,
    linear_damping=0.0,
    angular_damping=0.0,
)

# The engine's defaults, stepped once a sample: the paper's simulator (PyBullet at 60 Hz).
PAPER = ContactSettings(name="paper", gravity_m_s2=9.8, meet_impacts=False)

PRESETS = {settings.name: settings for settings in (CALIBRATED, PAPER)}
