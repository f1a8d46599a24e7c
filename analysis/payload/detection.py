"""Detect an arm's motion in an episode, and read those of its empty runs (tares)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from analysis.estimators.base import Observation
from analysis.payload.arm_card import ArmCard
from analysis.payload.arm_log import JOINT_UNITS, ArmLog, read_arm_log
from analysis.payload.arm_motion import ArmMotion, arm_motion
from analysis.payload.driver_quirks import check_joints
from analysis.payload.fit_result import PayloadFit
from analysis.payload.presets import (
    PAPER_GRAVITY_M_S2,
    circle_phase_s,
    paper_torques,
    payload_readings,
)
from analysis.payload.torque_fit import fit_payload
from analysis.payload.torque_model import CONVENTIONS, Convention
from analysis.payload.torque_terms import GAIN
from analysis.plausible import plausible
from analysis.selection import Selection
from recorders.simulators.arm.description import Arm
from recorders.simulators.arm.dynamics import held_efforts_nm
from recorders.simulators.arm.path import JointPath
from recorders.simulators.arm.payload import PAYLOAD_MASS, TOPIC, PayloadSimulator
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError, NotFoundError
from tunenet_logs.left_out import LeftOut
from tunenet_logs.measured import measured
from tunenet_logs.one_clock import jump_warnings, on_one_clock
from tunenet_logs.reader import read_episode

EFFORT = f"{TOPIC}.effort"  # the simulated torques
# Of the paper's circle, which takes 5 s: its network fills in what little is missing.
_MIN_OF_CIRCLE_S = 4.0

# From the paper's circle at any joint: a controller's error, and no other motion.
_OFF_CIRCLE_RAD = 0.1

_SAME_FRACTION = 0.5  # of a log's torques, in a tare to the last bit: no other run repeats as many


@dataclass(frozen=True, eq=False)
class Tare:
    """Empty run as it was read."""

    log: ArmLog
    motion: ArmMotion


def read_tares(arm: Arm, log: ArmLog, selection: Selection) -> tuple[Tare, ...]:
    """Read a selection's empty runs, all different; see `read_tare`.

    Raises:
        NotFoundError: One cannot be used, is no empty run, or occurs twice.
    """
    found: list[Tare] = []
    for tare in selection.tares:
        one = read_tare(tare, arm, log, selection)
        if any(_is_same_run(known.log, one.log) for known in found):
            name = f" {tare}" if isinstance(tare, Path) else ""
            raise NotFoundError(f"--tare{name}: is a run that was named before; name each one once")
        found.append(one)
    return tuple(found)


def _is_same_run(known: ArmLog, other: ArmLog) -> bool:
    """Return whether most torques of one log occur bit by bit in the other."""
    there = {row.tobytes() for row in known.effort.values}
    same = sum(row.tobytes() in there for row in other.effort.values)
    return same > _SAME_FRACTION * len(other.effort.values)


def read_tare(tare: Path | Episode, arm: Arm, log: ArmLog, selection: Selection) -> Tare:
    """Read an empty run.

    Args:
        tare: Its log, or an episode.
        arm: Whose joints are looked for.
        log: Of the run with the payload.
        selection: How that log was read, and a preferred topic; None for that of its torques.

    Raises:
        NotFoundError: It cannot be used, or is no empty run.
    """
    name = f" {tare}" if isinstance(tare, Path) else ""
    try:
        recorded = read_episode(tare, selection.reading) if isinstance(tare, Path) else tare
        recorded = measured(recorded)
        recorded = plausible(recorded) if isinstance(tare, Path) else recorded
        episode = on_one_clock(recorded)
        prefer = selection.topic or log.effort.topic
        has_joints = any(signal.unit in JOINT_UNITS for signal in episode.signals_of(prefer))
        empty = read_arm_log(
            episode,
            arm,
            topic=prefer if has_joints else None,
            torque_constants=selection.torque_constants,
        )
        check_joints(empty.joints, log.joints)
        mass_kg = episode.info.truth.get(PAYLOAD_MASS.name, 0.0)
        if mass_kg > 0:
            raise NotFoundError(
                f"held {mass_kg:g} kg, as it says", "name a run with nothing in the gripper"
            )
        if _is_same_run(empty, log):
            raise NotFoundError(
                "has the torques of the log itself",
                "name another run, with nothing in the gripper",
            )
        motion = arm_motion(empty)
        return Tare(replace(empty, warnings=(*empty.warnings, *jump_warnings(recorded))), motion)
    except (LogError, NotFoundError) as error:
        reason = error.what.removeprefix(f"{tare}: ")
        raise NotFoundError(f"--tare{name}: {reason}", error.remedy) from error


def conventions_of(selection: Selection) -> tuple[Convention, ...]:
    """Return the torque conventions that the user's statements leave possible."""
    sign = {"joint": 1, "load": -1, None: None}[selection.effort_sign]
    full = {"included": True, "compensated": False, None: None}[selection.gravity]
    return tuple(
        known
        for known in CONVENTIONS
        if sign in (None, known.sign) and full in (None, known.has_gravity)
    )


@dataclass(frozen=True, eq=False)
class PayloadDetection:
    """An arm's motion in an episode with its torques, as one preset observes it.

    The driver's torque convention (sign, with or without the arm's weight) is identified by the
    fit, which is made when first needed, and is the result of the method "fit" too.

    Attributes:
        physical: Whether the preset observes the arm's own motion, or the paper's circle.
        arm: Without a payload.
        log: Fresh samples of its joints.
        start_ns: Origin of the log's clock.
        motion: Joint motion at any time.
        tares: Runs with an empty gripper.
        conventions: Possible torque conventions, as far as the user does not state one.
        warnings: For the user.
        card: What other runs identified of the arm; None for nothing.
        gain: Usual error of the torques, as a fraction.
    """

    physical: bool
    arm: Arm
    log: ArmLog
    start_ns: int
    motion: ArmMotion
    tares: tuple[Tare, ...]
    conventions: tuple[Convention, ...]
    warnings: tuple[str, ...]
    card: ArmCard | None = None
    gain: float = GAIN

    @property
    def topic(self) -> str:
        """Topic of the torques."""
        return self.log.effort.topic

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """Samples missing from torques and positions, the tares' too."""
        of_tares = (one for tare in self.tares for one in tare.log.left_out)
        return (*self.log.left_out, *(one._replace(name=f"tare: {one.name}") for one in of_tares))

    @property
    def window(self) -> Mapping[str, float]:
        """Times of the first and last torque used [s]."""
        return {"start_s": float(self.path.seconds[0]), "end_s": float(self.path.seconds[-1])}

    @property
    def extent(self) -> tuple[str, str]:
        """Duration of the motion."""
        return "motion", f"{self.path.seconds[-1] - self.path.seconds[0]:.1f} s"

    @cached_property
    def path(self) -> JointPath:
        """Joint positions, velocities and accelerations at the torques' stamps."""
        return JointPath(self.motion.seconds, *self.motion.at(self.motion.seconds))

    @cached_property
    def fit(self) -> PayloadFit:
        """Fit of payload and nuisance terms to the torques.

        Raises:
            NotFoundError: The mass is over the highest that any arm holds.
        """
        fit = self._fitted([tare.motion for tare in self.tares])
        most_kg = PAYLOAD_MASS.bounds[1]
        if fit.held.mass_kg > most_kg:
            raise NotFoundError(
                f"these torques hold {fit.held.mass_kg:.3g} kg, over {most_kg:g} kg",
                "say their unit with --effort-unit, or record torques in N·m",
            )
        return fit

    def _fitted(self, empty: Sequence[ArmMotion]) -> PayloadFit:
        """Fit with the card as a prior, if there is one.

        Raises:
            NotFoundError: The card has numbers that are no arm's.
        """
        known = self.card.learnt if self.card else None
        try:
            return fit_payload(
                self.arm,
                self.motion,
                empty,
                conventions=self.conventions,
                known=known,
                gain=self.gain,
            )
        except np.linalg.LinAlgError as error:
            if self.card is None:
                raise
            raise NotFoundError(
                f"--arm-card {self.card.file}: what it says of the arm and these torques go "
                "together with no arm; write the card anew"
            ) from error

    @cached_property
    def phase_s(self) -> float | None:
        """Phase on the paper's circle where the log's clock begins; None if the preset needs none.

        Raises:
            NotFoundError: It is another motion, or too little of it is there.
        """
        if self.physical:
            return None
        phase_s, off_rad = circle_phase_s(self.path)
        if off_rad > _OFF_CIRCLE_RAD:
            raise NotFoundError(
                "the paper's network knows one motion, the circle of `tunenet-record --simulate "
                f"payload`; this one is up to {off_rad:.2f} rad off it: use --preset default"
            )
        seconds = self.path.seconds[-1] - self.path.seconds[0]
        if seconds < _MIN_OF_CIRCLE_S:
            raise NotFoundError(
                f"{seconds:.1f} s of the circle are there, the paper's network needs "
                f"{_MIN_OF_CIRCLE_S:g} s: record a whole turn, or use --preset default"
            )
        return phase_s

    @cached_property
    def effort_nm(self) -> Array:
        """Torques with the joint's sign, the arm's weight included [N·m], shape (T, J)."""
        if self.fit.convention.has_gravity:
            return self.fit.effort_nm
        return self.fit.effort_nm + held_efforts_nm(self.arm.without_limits(), self.path)

    @cached_property
    def simulator(self) -> PayloadSimulator:
        """Simulator of the arm along its own path, with the payload's centre as fitted."""
        free = self.arm.without_limits()
        if not self.physical:
            return PayloadSimulator(free, self.path, gravity_m_s2=PAPER_GRAVITY_M_S2)
        return PayloadSimulator(free, self.path, self.fit.held.centre.likely_m)

    def observe(self, effort_nm: Array) -> Observation:
        """Observe torques along the path [N·m], shape (T, J), as the preset's network does."""
        if self.phase_s is not None:
            return paper_torques(self.path.seconds, effort_nm, self.phase_s)
        own = self.simulator
        return payload_readings(effort_nm, own.empty_efforts_nm, own.efforts_nm_per_kg)
