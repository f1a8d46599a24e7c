"""The payload: the mass in an arm's gripper, from the torques of its joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from analysis.drop.checks import Check
from analysis.estimators.base import Problem, Step
from analysis.experiment import Claim, CrossCheck, ExtraEstimate, FitResult, Preset, Selection
from analysis.payload.arm_checks import arm_checks
from analysis.payload.arm_log import ArmLog, read_arm_log
from analysis.payload.arm_motion import arm_motion
from analysis.payload.checks import payload_checks, simulation_check, sure_check
from analysis.payload.detection import EFFORT, PayloadDetection, payload_problem
from analysis.payload.presets import PRESETS
from analysis.payload.readings import circle_phase_s
from analysis.payload.tare import read_tare
from analysis.payload.torque_fit import fit_payload
from analysis.payload.two_rollout_mass import secant
from recorders.simulators.arm.description import jaco, read_arm
from recorders.simulators.arm.path import JointPath
from recorders.simulators.arm.payload import PAYLOAD_MASS
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.errors import NotFoundError

_LEAST_OF_CIRCLE_S = 4.0
_OFF_CIRCLE_RAD = 0.1
_AGREEMENT, _TARED_AGREEMENT = (0.25, 0.1), (0.05, 0.02)
"""How far the cross-check may be off [kg], and by which share of the mass: it has no friction."""

_DISAGREEMENT = "record the empty gripper along the same motion and name it with --tare"
_TARED_DISAGREEMENT = (
    "record the tare and the log within minutes of each other, along the same motion, sensors "
    "zeroed once before both"
)


class PayloadTask:
    """See `Task`."""

    name = "payload"
    kind = "payload"
    occasion = "run"
    parameters = (PAYLOAD_MASS,)

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """By its torques, or joints without; see `Task.claim`."""
        signals = episode.signals.values() if topic is None else episode.signals_of(topic)
        units = {one.unit for one in signals}
        if "N·m" in units:
            return Claim.PLAINLY
        return Claim.PERHAPS if "rad" in units else Claim.NONE

    @property
    def presets(self) -> Mapping[str, Preset]:
        """See `Task.presets`."""
        return PRESETS

    def find(self, episode: Episode, selection: Selection, preset: str) -> PayloadDetection:
        """The arm's motion; see `Task.find`."""
        arm = jaco() if selection.arm is None else read_arm(*selection.arm)
        log = read_arm_log(
            episode,
            arm,
            topic=selection.topic,
            start_s=selection.start_s,
            end_s=selection.end_s,
        )
        motion = arm_motion(log)
        warnings = list(log.warnings)
        if selection.ball_options:
            warnings.append(f"{', '.join(selection.ball_options)} not used: this is a payload")
        empty = None
        if selection.tare is not None:
            empty = read_tare(selection.tare, arm, log, selection.topic)
            warnings += [f"tare: {one}" for one in empty.log.warnings]
        fit = fit_payload(arm, motion, None if empty is None else empty.motion)
        _check_mass(fit.mass_kg)
        physical = PRESETS[preset].physical
        path = JointPath(motion.seconds, *motion.at(motion.seconds))
        start_ns = min(int(one.stamps_ns[0]) for one in _joint_signals(episode, log))
        return PayloadDetection(
            arm=arm,
            log=log,
            start_ns=start_ns,
            motion=motion,
            tare=empty,
            fit=fit,
            path=path,
            phase_s=None if physical else _phase_s(path),
            warnings=tuple(warnings),
        )

    def problem(self, found: PayloadDetection, initial: Array) -> Problem:
        """See `Task.problem`."""
        return payload_problem(found, initial)

    def refine(self, found: PayloadDetection, estimate: Array) -> FitResult | None:
        """All that is in the torques, fitted; see `Task.refine`."""
        del estimate  # the torques are linear in the mass: the fit needs no start
        if not found.physical:
            return None
        fit, centre = found.fit, found.fit.centre
        further = ()
        if centre.is_told:
            ends = np.array(centre.interval95)
            further = (ExtraEstimate("payload_com", "m", np.array(centre.com_m), ends),)
        return FitResult(
            values=np.array([fit.mass_kg]),
            interval95=np.array([fit.interval95]),
            check=sure_check(fit),
            further=further,
            fit=fit,
        )

    def checks(
        self, found: PayloadDetection, last: Step, refined: FitResult | None
    ) -> tuple[Check, ...]:
        """See `Task.checks`."""
        assert last.evaluation is not None
        simulated_nm = last.evaluation.episode.signals[EFFORT].values
        checks = [*arm_checks(found.log, found.motion, found.arm)]
        if found.tare is not None:
            own = arm_checks(found.tare.log, found.tare.motion, found.arm)
            checks += [replace(one, name=f"tare: {one.name}") for one in own]
        checks += payload_checks(found.fit, found.arm, found.log)
        checks.append(simulation_check(found.effort_nm - simulated_nm))
        return (*checks, refined.check) if refined else tuple(checks)

    def cross_check(self, found: PayloadDetection, estimate: Array) -> CrossCheck | None:
        """A line through the torques of 0 and 1 kg, with nothing else in them but offsets."""
        if not found.physical:
            return None
        fit, tare = found.fit, found.tare
        empty = None if tare is None else tare.motion
        mass_kg = secant(found.arm, found.motion, fit.convention, fit.lag_s, empty)
        least_kg, share = _AGREEMENT if tare is None else _TARED_AGREEMENT
        margin = least_kg + share * float(estimate[0]) + 2 * fit.sd_kg
        advice = _DISAGREEMENT if tare is None else _TARED_DISAGREEMENT
        agrees = bool(abs(mass_kg - estimate[0]) < margin)
        return CrossCheck("secant through two rollouts", mass_kg, agrees, advice)


def _check_mass(mass_kg: float) -> None:
    """Refuse a mass that no arm holds.

    Raises:
        NotFoundError: it is over the highest.
    """
    most_kg = PAYLOAD_MASS.bounds[1]
    if mass_kg > most_kg:
        raise NotFoundError(
            f"these torques hold {mass_kg:.3g} kg, over {most_kg:g} kg: are the torques in N·m?"
        )


def _joint_signals(episode: Episode, log: ArmLog) -> list:
    fields = [one for one in (log.position, log.velocity, log.effort) if one is not None]
    return [one for field in fields for one in episode.signals_of(field.topic)]


def _phase_s(path: JointPath) -> float:
    """Where on the circle that the paper's network knows the measured path begins.

    Raises:
        NotFoundError: it is another motion, or too little of it is there.
    """
    phase_s, off_rad = circle_phase_s(path)
    if off_rad > _OFF_CIRCLE_RAD:
        raise NotFoundError(
            "the paper's network knows one motion, the circle of `tunenet-record --simulate "
            f"payload`; this one is up to {off_rad:.2f} rad off it: use --preset default"
        )
    seconds = path.seconds[-1] - path.seconds[0]
    if seconds < _LEAST_OF_CIRCLE_S:
        raise NotFoundError(
            f"{seconds:.1f} s of the circle are there, the paper's network needs "
            f"{_LEAST_OF_CIRCLE_S:g} s: record a whole turn, or use --preset default"
        )
    return phase_s
