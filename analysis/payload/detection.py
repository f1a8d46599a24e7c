"""An arm's motion that was found in an episode, and the estimation problem that it poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from analysis.estimators.base import Problem
from analysis.estimators.observation import Observation
from analysis.payload.arm_log import ArmLog
from analysis.payload.arm_motion import ArmMotion
from analysis.payload.fit_result import PayloadFit
from analysis.payload.presets import PAPER_GRAVITY_M_S2
from analysis.payload.readings import paper_torques, payload_readings
from analysis.payload.tare import Tare
from recorders.simulators.arm.description import Arm
from recorders.simulators.arm.dynamics import held_efforts_nm
from recorders.simulators.arm.path import JointPath
from recorders.simulators.arm.payload import TOPIC, PayloadSimulator
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode

EFFORT = f"{TOPIC}.effort"


@dataclass(frozen=True, eq=False)
class PayloadDetection:
    """An arm's motion in an episode, with the torques that it took, as one preset looks at it.

    Attributes:
        arm: as it is without a payload.
        log: fresh samples of its joints.
        start_ns: where the log's clock is 0.
        tare: the run with an empty gripper; None where there is none.
        fit: of all that is in the torques.
        path: how the joints moved when each torque was measured.
        phase_s: where on the paper's circle the log's clock begins, under the paper's presets.
        warnings: what a user should know, in words.
    """

    arm: Arm
    log: ArmLog
    start_ns: int
    motion: ArmMotion
    tare: Tare | None
    fit: PayloadFit
    path: JointPath
    phase_s: float | None
    warnings: tuple[str, ...]

    @property
    def topic(self) -> str:
        """Where the torques came from."""
        return self.log.effort.topic

    @property
    def step_hz(self) -> float:
        """Torques are asked of the simulator where they were measured."""
        return self.log.effort.rate_hz

    @property
    def window(self) -> Mapping[str, float]:
        """First and last torque that counts [s]."""
        return {"start_s": float(self.path.seconds[0]), "end_s": float(self.path.seconds[-1])}

    @property
    def extent(self) -> tuple[str, str]:
        """How long it moved."""
        return "motion", f"{self.path.seconds[-1] - self.path.seconds[0]:.1f} s"

    @property
    def physical(self) -> bool:
        """Whether the preset looks at the arm along its own motion, or at the paper's circle."""
        return self.phase_s is None

    @cached_property
    def effort_nm(self) -> Array:
        """Torques with the joint's sign and the arm's weight in them [N·m], shape (T, J)."""
        if self.fit.convention.has_gravity:
            return self.fit.effort_nm
        return self.fit.effort_nm + held_efforts_nm(self.arm.without_limits(), self.path)

    @cached_property
    def simulator(self) -> PayloadSimulator:
        """The arm along its own path; its payload's centre where the log tells it."""
        free = self.arm.without_limits()
        if not self.physical:
            return PayloadSimulator(free, self.path, gravity_m_s2=PAPER_GRAVITY_M_S2)
        centre = self.fit.centre
        com_m = centre.com_m if centre.is_told else (0.0, 0.0, 0.0)
        return PayloadSimulator(free, self.path, com_m)

    @cached_property
    def target(self) -> Observation:
        """o_T."""
        return self.observe(self.effort_nm)

    def observe(self, effort_nm: Array) -> Observation:
        """What the preset's network sees of torques along the path, shape (T, J)."""
        if self.phase_s is not None:
            return paper_torques(self.path.seconds, effort_nm, self.phase_s)
        own = self.simulator
        return payload_readings(effort_nm, own.empty_efforts_nm, own.efforts_nm_per_kg)


def payload_problem(found: PayloadDetection, initial: Array) -> Problem:
    """A simulator that moves the arm as it moved.

    Raises:
        UsageError: the initial value is out of bounds.
    """

    def observe(episode: Episode) -> Observation:
        return found.observe(episode.signals[EFFORT].values)

    return Problem(found.target, found.simulator, observe, initial)
