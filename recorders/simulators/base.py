"""The interfaces of simulators and physics engines, and the settings of engines.

A `Simulator` rolls out episodes by its parameters; it is written against the few calls of an
`Engine`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Protocol, get_type_hints

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
    # mean and standard deviation of what others of its kind have: a weak prior; None if unknown
    usual: tuple[float, float] | None = None
    looks: int = 0  # places in the range at which a fit looks, as the cost has many minima

    def checked(self, value: float) -> float:
        """Return `value` if it is within bounds."""
        low, high = self.bounds
        if not (math.isfinite(value) and low <= value <= high):
            raise UsageError(f"{self.name} {value:g} is not a number from {low:g} to {high:g}")
        return float(value)


@cache
def limits_of(kind: type) -> dict[str, tuple[float, float, str]]:
    """Return what a dataclass's `Annotated` fields declare: least and greatest value, remark."""
    hints = get_type_hints(kind, include_extras=True).items()
    declared = {name: getattr(hint, "__metadata__", None) for name, hint in hints}
    return {
        name: (said[0], said[1], said[2] if len(said) > 2 else "")
        for name, said in declared.items()
        if said
    }


def check_limits(settings: Any) -> None:
    """Raise UsageError where a dataclass's value is beyond the limits that its field declares."""
    for name, (low, high, unit) in limits_of(type(settings)).items():
        value = getattr(settings, name)
        if not low <= value <= high:
            raise UsageError(f"{name} {value:g} is not from {low:g} to {high:g} {unit}".rstrip())


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
        """Roll out one episode; the same values give the same bits. UsageError for a bad value."""
        ...


class BallWorld(Protocol):
    """A plane at z = 0 and a ball of 1 kg over it; used for many rollouts.

    A step is semi-implicit Euler: v += -g dt, then z += v dt.
    """

    engine: str  # name and version
    radius_m: float
    contact: ContactSettings  # how contacts are solved

    def place(self, gap_m: float, restitution: float) -> None:
        """Put the ball at rest with its underside `gap_m` over the plane; forget what was."""
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
        """Solve an impact on the plane; return velocity and spin after it, each of shape (3,).

        z points away from the plane; `inertia_share` is the moment of inertia over m r^2.
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
        """Compute a path's torques, (T, J) [N·m], [N] if prismatic: rigid links, no friction."""
        ...

    def position_control(
        self, arm: Arm, path: JointPath, payload: Payload | None, settings: RolloutSettings
    ) -> Array:
        """Simulate motors that follow the path, from its first sample on, at `settings.times()`.

        Returns each joint's position [rad] and velocity [rad/s] after each step, and the motor's
        torque in it [N·m], shape (T - 1, J, 3).
        """
        ...


# ---- Settings of an arm's rollout

# Gravity in the base's frame of an arm that stands upright.
UPRIGHT_GRAVITY_M_S2 = (0.0, 0.0, -GRAVITY_M_S2)


@dataclass(frozen=True)
class RolloutSettings:
    """Settings of the engine and the arm's position control."""

    name: str  # the preset these belong to
    gravity_m_s2: tuple[float, float, float] = UPRIGHT_GRAVITY_M_S2  # of an arm that stands upright
    step_hz: Annotated[float, 10.0, 20_000.0] = 240.0  # of the simulation
    # Steps before the first sample, while the arm converges to its path, and those recorded.
    burn_in: Annotated[int, 1, 100_000] = 150
    samples: Annotated[int, 2, 1_000_000] = 1200
    force_nm: Annotated[float, 0.0, 1e6] = 500.0  # effort limit of a joint's motor
    position_gain: Annotated[float, 0.0, 1.0] = 0.3  # share of its error that a step takes away
    velocity_gain: Annotated[float, 0.0, 1.0] = 1.0  # likewise
    # With 50, the default, an arm lags by up to 0.004 rad.
    solver_iterations: Annotated[int, 1, 10_000] = 200
    is_damped: bool = False  # with the engine's damping: 0.007 N·m rms on the circle

    __post_init__ = check_limits

    def times(self) -> Array:
        """Return the times [s] the path is needed at, shape (burn_in + samples + 1,)."""
        return np.arange(self.burn_in + self.samples + 1) / self.step_hz


# ---- Contact settings: calibrated, and the paper's

IMPACT_S = 1e-6  # of a step that solves an impact: gravity changes the speed in it by 1e-5 m/s
OVERLAP_M = 1e-9  # of a ball in a plane at an impact: engines act only on what touches


@dataclass(frozen=True)
class ContactSettings:
    """How the engine solves contacts."""

    name: str  # the preset these belong to
    gravity_m_s2: float  # downward acceleration
    # Cut the step that reaches the surface so that it ends there, and integrate flight exactly;
    # else plain fixed steps.
    meet_impacts: bool


# The restitution that is set is the one that is got: nothing else of the engine loses or adds
# energy at an impact, and a step ends where the ball meets the surface.
CALIBRATED = ContactSettings("default", GRAVITY_M_S2, meet_impacts=True)

# The engine's defaults, stepped once a sample: the paper's simulator (PyBullet at 60 Hz).
PAPER = ContactSettings("paper", 9.8, meet_impacts=False)

PRESETS = {settings.name: settings for settings in (CALIBRATED, PAPER)}
