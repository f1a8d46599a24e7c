"""Payload experiment: the mass in an arm's gripper, from the torques of its joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from analysis.checks import Check, CrossCheck
from analysis.estimators.base import ExtraEstimate, FitResult, Problem, Step, Trace
from analysis.experiment import Claim, Preset
from analysis.motion import Motion
from analysis.payload.arm_log import read_arm_log
from analysis.payload.arm_motion import arm_motion
from analysis.payload.checks import (
    arm_checks,
    numbered,
    payload_checks,
    simulation_check,
    sure_check,
)
from analysis.payload.detection import EFFORT, PayloadDetection, conventions_of, read_tares
from analysis.payload.presets import PRESETS
from analysis.payload.secant import secant
from analysis.payload.torque_terms import CURRENT_GAIN, GAIN
from analysis.payload.which_arm import which_arm
from analysis.record import Rebound
from analysis.selection import Selection, Subject
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.measured import measured
from tunenet_logs.unused_reading import said_unused

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from analysis.record import Tuning

# How far the cross-check may be off, by what the arm weighs and by the payload's mass: it has no
# friction.
_AGREEMENT, _TARED_AGREEMENT = (0.06, 0.1), (0.03, 0.05)

_DISAGREEMENT = "record the empty gripper along the same motion and name it with --tare"
_TARED_DISAGREEMENT = (
    "record the tare and the log within minutes of each other, along the same motion, sensors "
    "zeroed once before both"
)


class PayloadExperiment:
    """See `Experiment`."""

    name = "payload"
    kind = "payload"
    occasion = "run"
    observed = "torques of an arm"
    takes: frozenset[Subject] = frozenset(("arm",))
    presets: Mapping[str, Preset] = PRESETS

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """Claim logs with joint torques, perhaps with joints; see `Experiment.claim`."""
        episode = measured(episode)
        signals = episode.signals.values() if topic is None else episode.signals_of(topic)
        units = {signal.unit for signal in signals}
        if "N·m" in units:
            return Claim.PLAINLY
        return Claim.PERHAPS if "rad" in units else Claim.NONE

    def detect(self, episode: Episode, selection: Selection, preset: str) -> PayloadDetection:
        """Read the arm's motion, and its empty runs; see `Experiment.detect`."""
        episode = measured(episode)
        chosen = which_arm(episode, selection.arm, selection.topic)
        arm = chosen.arm
        log = read_arm_log(
            episode,
            arm,
            topic=selection.topic,
            start_s=selection.start_s,
            end_s=selection.end_s,
            torque_constants=selection.torque_constants,
        )
        motion = arm_motion(log)
        warnings = [*chosen.remarks, *log.warnings]
        card = selection.arm_card
        if card is not None:
            card.check_arm(arm, log.joints)
        tares = read_tares(arm, log, selection)
        for name, tare in numbered("tare", tares):
            warnings += [f"{name}: {warning}" for warning in tare.log.warnings]
        fields = [field for field in (log.position, log.velocity, log.effort) if field is not None]
        start_ns = min(
            int(signal.stamps_ns[0])
            for field in fields
            for signal in episode.signals_of(field.topic)
        )
        are_currents = selection.of_currents and not said_unused(
            "--torque-constants", episode.warnings
        )
        return PayloadDetection(
            physical=PRESETS[preset].physical,
            arm=arm,
            log=log,
            start_ns=start_ns,
            motion=motion,
            tares=tares,
            conventions=conventions_of(selection),
            warnings=tuple(warnings),
            card=card,
            gain=CURRENT_GAIN if are_currents else GAIN,
        )

    def problem(self, detection: PayloadDetection, initial: Array) -> Problem:
        """Pose the problem of an arm driven along its path; `initial` has the shape (1,) [kg].

        Raises:
            NotFoundError: The preset cannot use the motion or the torques.
            UsageError: The initial value is out of bounds.
        """

        def exact_fit(start: Array) -> FitResult:
            """Fit the torques; they are linear in the mass, so no start is needed."""
            del start
            fit, centre = detection.fit.held, detection.fit.held.centre
            extra: tuple[ExtraEstimate, ...] = ()
            if centre.is_identifiable:
                ends = np.array(centre.interval95)
                extra = (ExtraEstimate("payload_com", "m", np.array(centre.com_m), ends),)
            if fit.inertia:
                values, ends = np.array(fit.inertia.kg_m2), np.array(fit.inertia.interval95)
                extra += (ExtraEstimate("payload_inertia", "kg·m²", values, ends),)
            values, ends = np.array([fit.mass_kg]), np.array([fit.interval95])
            return FitResult(values, ends, extra, detection.fit)

        return Problem(
            detection.observe(detection.effort_nm),
            detection.simulator,
            lambda episode: detection.observe(episode.signals[EFFORT].values),
            initial,
            exact_fit if detection.physical else None,
        )

    def checks(
        self, detection: PayloadDetection, last: Step, fit: FitResult | None
    ) -> tuple[Check, ...]:
        """See `Experiment.checks`."""
        assert last.evaluation is not None
        simulated_nm = last.evaluation.episode.signals[EFFORT].values
        checks = [*arm_checks(detection.log, detection.motion, detection.arm)]
        for name, tare in numbered("tare", detection.tares):
            own = arm_checks(tare.log, tare.motion, detection.arm)
            checks += [replace(check, name=f"{name}: {check.name}") for check in own]
        found, arm = detection.fit, detection.arm
        is_stated = len(detection.conventions) == 1
        checks += payload_checks(found, arm, detection.log, is_stated=is_stated)
        checks.append(simulation_check(detection.effort_nm - simulated_nm, found.scales_nm))
        return (*checks, sure_check(found, arm)) if fit else tuple(checks)

    def cross_check(self, detection: PayloadDetection, estimate: Array) -> CrossCheck | None:
        """Estimate the mass by the secant through torques of 0 and 1 kg, with offsets only."""
        if not detection.physical:
            return None
        fit = detection.fit
        mass_kg = secant(
            detection.arm,
            detection.motion,
            fit.convention,
            fit.lag_s,
            com_m=fit.held.centre.likely_m,
            scales_nm=fit.scales_nm,
            tares=[tare.motion for tare in detection.tares],
        )
        share, fraction = _TARED_AGREEMENT if detection.tares else _AGREEMENT
        arm_kg = sum(joint.link.mass_kg for joint in detection.arm.joints)
        margin_kg = share * arm_kg + fraction * float(estimate[0]) + 2 * fit.held.sd_kg
        advice = _TARED_DISAGREEMENT if detection.tares else _DISAGREEMENT
        # Friction and gains are left in its torques: its noise would be a small part of its error.
        return CrossCheck.judged(
            "secant through two rollouts",
            mass_kg,
            float(estimate[0]),
            margin_kg,
            sd=None,
            advice=advice,
        )

    def motion(self, detection: PayloadDetection, trace: Trace) -> Motion | None:
        """Return None: the review shows the torques; see `Experiment.motion`."""
        del detection, trace

    def rebounds(self, detection: PayloadDetection, trace: Trace) -> tuple[Rebound, ...]:
        """Return none; see `Experiment.rebounds`."""
        del detection, trace
        return ()

    def review(self, stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
        """See `Experiment.review`."""
        if tuning.detection is None:
            return None
        from analysis.payload.review.views import log_payload

        return log_payload(stream, tuning)
