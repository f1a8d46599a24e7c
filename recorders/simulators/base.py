"""The interfaces of simulators and physics engines."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from tunenet_logs.episode import Episode
from tunenet_logs.errors import UsageError

if TYPE_CHECKING:
    from recorders.simulators.arm.description import Arm, Payload
    from recorders.simulators.arm.path import JointPath
    from recorders.simulators.arm.rollout import RolloutSettings
    from recorders.simulators.contact import ContactSettings
    from tunenet_logs.arrays import Array

# Standard gravity (ISO 80000-3); at sea level it is 9.780 (equator) to 9.832 (poles).
GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True)
class Parameter:
    """A physical parameter of a simulator.

    Attributes:
        name: the field's standard term, e.g. "restitution".
        unit: "1" where it has none.
        bounds: smallest and largest value that physics allows.
        training_range: from where training pairs are drawn.
        initial: the guess that tuning starts from.
        prior_sd: prior standard deviation of that guess, where it is measured and not chosen, as a
            log's initial state is; None for what is tuned.
    """

    name: str
    unit: str
    bounds: tuple[float, float]
    training_range: tuple[float, float]
    initial: float
    prior_sd: float | None = None

    def checked(self, value: float) -> float:
        """Return `value` if it is within bounds.

        Raises:
            UsageError: not finite, or out of bounds.
        """
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

    Attributes:
        engine: name and version.
        contact: how contacts are solved.
    """

    engine: str
    radius_m: float
    contact: ContactSettings

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
    """A physics engine, such as a module with these names.

    Attributes:
        name: with its version, as a log and a tuning state it: "pybullet 3.2.7".
    """

    name: str

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
