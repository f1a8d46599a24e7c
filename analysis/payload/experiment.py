"""Payload experiment: the mass in an arm's gripper, from the torques of its joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from tunenet_logs.analysis.checks import Check, CrossCheck
from tunenet_logs.analysis.estimators.base import ExtraEstimate, FitResult, Problem, Step, Trace
from tunenet_logs.analysis.experiment import Claim, Preset, Tuning
from tunenet_logs.analysis.options import Subject, TuneOptions
from tunenet_logs.analysis.payload.arm_card import (
    MAX_CARD_BYTES,
    ArmCard,
    arm_sha256,
    card_in,
    card_text,
)
from tunenet_logs.analysis.payload.arm_log import read_arm_log, which_arm
from tunenet_logs.analysis.payload.checks import (
    PAYLOAD,
    arm_checks,
    numbered,
    payload_checks,
    sure_check,
)
from tunenet_logs.analysis.payload.detection import EFFORT, PRESETS, PayloadDetection, read_tares
from tunenet_logs.analysis.payload.torque_model import (
    CONVENTIONS,
    CURRENT_GAIN,
    GAIN,
    ArmMotion,
    Convention,
    arm_motion,
    arm_terms,
)
from tunenet_logs.analysis.record import Motion, Rebound
from tunenet_logs.episode import Array, Episode
from tunenet_logs.errors import LogError
from tunenet_logs.reader import said_unused, without_commands
from tunenet_logs.recorders.simulators.arm.description import Arm, Payload
from tunenet_logs.recorders.simulators.arm.path import JointPath
from tunenet_logs.recorders.simulators.arm.payload import held_efforts_nm, joint_efforts_nm
from tunenet_logs.terminal import listed
from tunenet_logs.writing.owned_path import OutputPlace

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb


# ---- Arm card of a tuning, saved


def save_arm_card(tuning: Tuning, path: Path, *, overwrite: bool) -> None:
    """Write what a tuning identified of its arm, added to the card that it was made with."""
    detection = tuning.detection
    provenance = tuning.provenance
    is_payload = isinstance(detection, PayloadDetection) and tuning.verdict != "rejected"
    if not is_payload or provenance is None:
        raise LogError(
            f"{path}: not written: {tuning.log} shows no payload, and so no arm",
            "name a log of an arm that moves",
        )
    log = {"log": tuning.log.name, "sha256": provenance.log_sha256}
    before = detection.card.runs if detection.card else ()
    card = ArmCard(
        arm_sha256(detection.arm),
        detection.log.joints,
        (*before, log, *map(dict, provenance.tares)),
        arm_terms(detection.arm),
        detection.fit.learnt,
    )
    with card_place(path, card, overwrite=overwrite).replacing() as unfinished:
        unfinished.write_text(card_text(card), "utf-8", errors="backslashreplace")


def card_place(path: Path, card: ArmCard | None, *, overwrite: bool) -> OutputPlace:
    """Return the output place of a card; without one, that of any card."""

    def knows(file: BinaryIO) -> Sequence[str] | None:
        there = card_in(file.read(MAX_CARD_BYTES + 1), path.name)
        is_same = card is None or there.sha256s == card.sha256s
        return () if is_same else [run["log"] for run in there.runs]

    runs = listed(run["log"] for run in card.runs) if card else ""
    elsewhere = "choose another --save-arm-card"
    return OutputPlace(path, "card", knows, runs, elsewhere, overwrite=overwrite)


# ---- Cross-check: a secant through two rollouts in another engine's inverse dynamics


def secant(
    arm: Arm,
    motion: ArmMotion,
    convention: Convention,
    lag_s: float,
    *,
    com_m: tuple[float, float, float],
    scales_nm: Array,
    tares: Sequence[ArmMotion] = (),
) -> float:
    """Estimate the mass by a secant through rollouts of 0 and 1 kg [kg]; it may be below 0.

    Torques are linear in the mass, so the arm without a payload and with 1 kg, driven along the
    logged motion, give it by least squares in closed form. Only sensor offsets are removed.
    """
    arm = arm.without_limits()
    masses_kg = []
    for run in (motion, *tares):
        path = JointPath(run.seconds, *run.at(run.seconds - lag_s))
        empty_nm = joint_efforts_nm(arm, path)
        slopes = joint_efforts_nm(arm, path, Payload(1.0, com_m)) - empty_nm
        if not convention.has_gravity:
            empty_nm -= held_efforts_nm(arm, path)
        residual = convention.sign * run.effort - empty_nm
        # An offset of normal prior is projected out of both, less so where the noise is large.
        noise = np.var(residual - np.mean(residual, axis=0), axis=0)
        # Usual offset of a sensor, by what its joint is built for
        offsets = (0.01 * scales_nm) ** 2
        free = offsets / (offsets + noise / len(residual))
        residual -= free * np.mean(residual, axis=0)
        slopes -= free * np.mean(slopes, axis=0)
        slopes, residual = slopes[:, run.used], residual[:, run.used]
        masses_kg.append(float(np.sum(slopes * residual) / np.sum(slopes**2)))
    return masses_kg[0] - float(np.mean(masses_kg[1:] or [0.0]))


# ---- Payload as an experiment


class PayloadExperiment:
    """See `Experiment`."""

    name = "payload"
    kind = "payload"
    occasion = "run"
    observed = "torques of an arm"
    accepted_options: frozenset[Subject] = frozenset(("arm",))
    presets: Mapping[str, Preset] = PRESETS

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """Claim logs with joint torques, perhaps with joints; see `Experiment.claim`."""
        episode = without_commands(episode)
        signals = episode.signals.values() if topic is None else episode.signals_of(topic)
        units = {signal.unit for signal in signals}
        if "N·m" in units:
            return Claim.CERTAIN
        return Claim.POSSIBLE if "rad" in units else Claim.NONE

    def detect(self, episode: Episode, selection: TuneOptions, preset: str) -> PayloadDetection:
        """Read the arm's motion, and its empty runs; see `Experiment.detect`."""
        episode = without_commands(episode)
        arm, remarks = which_arm(episode, selection.given_arm, selection.topic)
        log = read_arm_log(
            episode,
            arm,
            topic=selection.topic,
            start_s=selection.start_s,
            end_s=selection.end_s,
            torque_constants=selection.effort_constants,
        )
        motion = arm_motion(log)
        warnings = [*remarks, *log.warnings]
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
        are_currents = bool(selection.torque_constants) and not said_unused(
            "--torque-constants", episode.warnings
        )
        # The torque conventions that the user's statements leave possible.
        sign = {"joint": 1, "load": -1, None: None}[selection.effort_sign]
        full = {"included": True, "compensated": False, None: None}[selection.gravity]
        conventions = tuple(
            known
            for known in CONVENTIONS
            if sign in (None, known.sign) and full in (None, known.has_gravity)
        )
        return PayloadDetection(
            physical=PRESETS[preset].physical,
            arm=arm,
            log=log,
            start_ns=start_ns,
            motion=motion,
            tares=tares,
            conventions=conventions,
            warnings=tuple(warnings),
            card=card,
            gain=CURRENT_GAIN if are_currents else GAIN,
        )

    def problem(self, detection: PayloadDetection, initial: Array) -> Problem:
        """Pose the problem of an arm driven along its path; `initial` has the shape (1,) [kg]."""

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
        left = (detection.effort_nm - simulated_nm) / found.scales_nm
        rms = float(np.sqrt(np.mean(left**2)))
        checks.append(PAYLOAD["simulation fits"].measured(100 * rms))
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
        # How far it may be off, by what the arm weighs and by the payload's mass: it has no
        # friction.
        share, fraction = 0.06, 0.1
        advice = "record the empty gripper along the same motion and name it with --tare"
        if detection.tares:
            share, fraction = 0.03, 0.05
            advice = (
                "record the tare and the log within minutes of each other, along the same motion, "
                "sensors zeroed once before both"
            )
        arm_kg = sum(joint.link.mass_kg for joint in detection.arm.joints)
        mine_kg = float(estimate[0])
        margin_kg = share * arm_kg + fraction * mine_kg + 2 * fit.held.sd_kg
        # Friction and gains are left in its torques: its noise would be a small part of its error.
        name = "secant through two rollouts"
        return CrossCheck.judged(name, mass_kg, mine_kg, margin_kg, sd=None, advice=advice)

    def motion(self, detection: PayloadDetection, trace: Trace) -> Motion | None:
        """Return None: the review shows the torques; see `Experiment.motion`."""
        del detection, trace

    def rebounds(self, detection: PayloadDetection, trace: Trace) -> tuple[Rebound, ...]:
        """Return none; see `Experiment.rebounds`."""
        del detection, trace
        return ()

    def example(self, stream: rr.RecordingStream) -> rrb.View | None:  # noqa: ARG002
        """Return None: any smooth motion will do."""
        return None

    def review(self, stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
        """See `Experiment.review`."""
        if tuning.detection is None:
            return None
        from tunenet_logs.analysis.payload.review import log_payload

        return log_payload(stream, tuning)
