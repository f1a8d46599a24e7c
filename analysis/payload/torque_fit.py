"""What an arm holds, from its torques: mass, centre of mass, inertia, and how sure each is.

Torques are linear in the payload. What makes it hard is all else that is in them: friction,
offsets, gains, a lag, links that weigh something else than the model's, a base that is not level.
They are fitted too, with priors whose scale the log decides on (`evidence.py`), and with runs of
the empty gripper (tares) that have all of them but the payload.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from analysis.payload.arm_motion import ArmMotion
from analysis.payload.evidence import NormalEquations, averaged, without
from analysis.payload.fit_result import FitResidual, Nuisance, PayloadFit
from analysis.payload.gauss_newton import GaussNewton
from analysis.payload.held import held
from analysis.payload.same_path import along
from analysis.payload.torque_model import (
    CONVENTIONS,
    ArmModel,
    Convention,
    Linearization,
    LoggedArm,
)
from analysis.payload.torque_terms import (
    MASS,
    NOT_SIMULATED,
    PAYLOAD_TERMS,
    Terms,
    make_terms,
    torque_scales_nm,
)
from recorders.simulators.arm.description import Arm
from tunenet_logs.arrays import Array

_SHARED_SD = 1.2
"""Factor on standard deviations where runs share an arm: what a model of it lacks is in none of
them alone. By made arms of another generator, whose intervals held 88 to 92 % without it."""

_COMPARISONS, _ITERATIONS = 3, 3
"""Fits of linear models, enough to choose a convention; then of Gauss-Newton with the best."""


def fit_payload(
    arm: Arm,
    motion: ArmMotion,
    tares: Sequence[ArmMotion] = (),
    *,
    conventions: Sequence[Convention] = CONVENTIONS,
    known: NormalEquations | None = None,
) -> PayloadFit:
    """Find mass, centre of mass and inertia of what an arm holds.

    Linear models of all conventions of a driver are compared by their evidence. Gauss-Newton goes
    on with the best one, and its answer is averaged over how large each group of terms may be.

    Args:
        arm: as it is without a payload.
        motion: while it held it.
        tares: while it held nothing, with the same driver: any motions will do.
        conventions: that the driver may have, as far as its owner knows.
        known: what other runs said of the arm's own terms (`PayloadFit.learnt`).
    """
    model = ArmModel(arm)
    motions: list[ArmMotion] = [motion]
    covered: list[NDArray[np.bool_] | None] = [None]
    for tare in tares:
        beside = along(motion, tare) if not any(one is not None for one in covered) else None
        motions.append(tare if beside is None else beside[0])
        covered.append(None if beside is None else beside[1])
    empty_nm = [model.empty_nm(*one.at(one.seconds)) for one in motions]
    scales_nm = torque_scales_nm(arm, motions, empty_nm)
    drifts = known is not None or len(motions) > 1
    terms = make_terms(arm, scales_nm, len(motions), drifts=drifts)
    if known is not None:
        known = known.among(terms.arms, len(terms.names))
    runs = tuple(
        LoggedArm(model, terms, one, number, inside)
        for number, (one, inside) in enumerate(zip(motions, covered, strict=True))
    )
    best, odds, arm_odds = _likeliest(runs, conventions, known)
    for _ in range(_ITERATIONS - 1):
        best = best.fitted(best.linearized(), best.found.means, roughly=False)
    at, lines = best.found.means, best.linearized()
    best = best.fitted(lines, at, roughly=False)
    # A run to come drifts from these, even where one alone does not show what drifted.
    drifting = make_terms(arm, scales_nm, len(motions), drifts=True).sds
    priors = np.where(terms.sds > 0, best.found.sds, drifting)
    learnt = best.normal_equations(lines, at).marginal(terms.arms, priors)
    return _result(best, lines, at, (odds, arm_odds), learnt)


def _likeliest(
    runs: tuple[LoggedArm, ...], conventions: Sequence[Convention], known: NormalEquations | None
) -> tuple[GaussNewton, float, float]:
    """The fit with the likeliest of some conventions.

    Returns:
        It, by how much its log evidence leads that of every other convention (less than 0 where one
        that was left out is likelier), and that of torques that no arm is behind.
    """
    with_gravity = [run.linearized(np.zeros(len(run.terms.sds)), CONVENTIONS[0]) for run in runs]
    held_nm = [run.model.gravity_nm(run.motion.at(run.motion.seconds)[0]) for run in runs]
    without = [
        replace(line, predicted_nm=line.predicted_nm - own_nm)
        for line, own_nm in zip(with_gravity, held_nm, strict=True)
    ]
    fits = {
        convention: _compared(
            GaussNewton.start(runs, convention, known),
            with_gravity if convention.has_gravity else without,
        )
        for convention in CONVENTIONS
    }
    best = max(conventions, key=lambda convention: fits[convention].log_evidence)
    evidence = fits[best].log_evidence
    others = [fit.log_evidence for convention, fit in fits.items() if convention != best]
    no_arm = _compared(
        GaussNewton.start(runs, best, known),
        [_without_arm(line, runs[0].terms) for line in with_gravity],
    )
    return fits[best].with_usual_offsets(), evidence - max(others), evidence - no_arm.log_evidence


def _compared(fit: GaussNewton, lines: Sequence[Linearization]) -> GaussNewton:
    """A rough fit of lines about 0."""
    for _ in range(_COMPARISONS):
        fit = fit.fitted(lines, np.zeros(len(fit.terms.sds)), roughly=True)
    return fit


def _without_arm(line: Linearization, terms: Terms) -> Linearization:
    """Torques of sensors and friction alone."""
    kept = np.isin(np.array(terms.groups), ("offset", "friction", "drift", "warming"))
    slopes = line.slopes * kept[line.columns]
    return Linearization(np.zeros_like(line.predicted_nm), line.columns, slopes)


def _payload(
    fit: GaussNewton, lines: Sequence[Linearization], at: Array
) -> tuple[Array, Array, float]:
    """Means of the payload's terms, shape (10,), their covariance, (10, 10), and a bound [kg].

    An average of two models: an arm with all that arms have, and a simulated one, with none of it.
    """
    own = np.arange(PAYLOAD_TERMS)
    means, covariance = averaged(fit.found, fit.groups, fit.logs, own)
    if len(fit.runs) > 1 or fit.known is not None:
        covariance = _SHARED_SD**2 * covariance
    normal = fit.normal_equations(lines, at)
    ideal, weight = without(normal, fit.found, fit.groups, fit.logs, NOT_SIMULATED)
    off = ideal.means[own] - means
    covariance = (1 - weight) * covariance + weight * ideal.covariance[np.ix_(own, own)]
    likelier = ideal if weight > 0.5 else fit.found
    bound_kg = float(np.sqrt(likelier.covariance[MASS, MASS]))
    means = means + weight * off
    return means, covariance + weight * (1 - weight) * np.outer(off, off), bound_kg


def _result(
    fit: GaussNewton,
    lines: Sequence[Linearization],
    at: Array,
    odds: tuple[float, float],
    learnt: NormalEquations,
) -> PayloadFit:
    """Args: odds: of the convention, and of the arm."""
    terms, found = fit.terms, fit.found
    means, covariance, bound_kg = _payload(fit, lines, at)
    change = found.means - at
    log = fit.runs[0]
    residual_nm = fit.residual_nm(0, lines, change)
    tare_residuals = tuple(
        FitResidual(
            fit.residual_nm(run.run, lines, change)[:, run.motion.used],
            run.torques_nm(fit.convention)[:, run.motion.used],
            terms.scales_nm[run.motion.used],
        )
        for run in fit.runs[1:]
    )
    effort_nm = log.torques_nm(fit.convention)
    sds = np.sqrt(np.diag(found.covariance))
    lag = int(terms.of["lag"][0])
    return PayloadFit(
        held=held(means, covariance),
        convention=fit.convention,
        convention_odds=odds[0],
        arm_odds=odds[1],
        nuisances=tuple(
            Nuisance(
                name, terms.groups[k], float(found.means[k]), float(sds[k]), float(terms.sds[k])
            )
            for k, name in enumerate(terms.names)
            if k >= PAYLOAD_TERMS and terms.sds[k]
        ),
        bound_kg=bound_kg,
        scales={name: float(np.exp(log)) for name, log in fit.logs.items()},
        scales_nm=terms.scales_nm,
        seconds=log.motion.seconds,
        effort_nm=effort_nm,
        predicted_nm=effort_nm - residual_nm,
        used=log.motion.used,
        lag_s=float(found.means[lag]),
        tare_residuals=tare_residuals,
        learnt=learnt,
    )
