"""Identify an arm's payload from its torques: mass, centre of mass, inertia, with intervals.

Torques are linear in the payload. Nuisance terms make it hard: friction, offsets, gains, a lag,
link masses other than the model's, a base that is not level. They are fitted too, with priors
whose scale the log decides on (`evidence.py`), and with runs of the empty gripper (tares) that
have all of them but the payload.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from analysis.payload.arm_motion import ArmMotion
from analysis.payload.evidence import NormalEquations, averaged, without
from analysis.payload.fit_result import FitResidual, Nuisance, PayloadFit
from analysis.payload.gauss_newton import GaussNewton
from analysis.payload.held import held
from analysis.payload.same_path import TorqueRows, along, rows_of
from analysis.payload.torque_model import (
    CONVENTIONS,
    ArmModel,
    Convention,
    Linearization,
    LoggedArm,
)
from analysis.payload.torque_terms import (
    GAIN,
    MASS,
    NOT_SIMULATED,
    PAYLOAD_TERMS,
    Terms,
    make_terms,
    torque_scales_nm,
)
from recorders.simulators.arm.description import Arm
from tunenet_logs.arrays import Array

# Factor on standard deviations where runs share an arm: what a model of it lacks is in none of them
# alone. By made arms of another generator, whose intervals held 88 to 92 % without it.
_SHARED_SD = 1.2

# Fits of linear models to choose a convention: of all four, then of those that may still win; and
# of Gauss-Newton with the best.
_COMPARISONS, _MORE_COMPARISONS, _ITERATIONS = 3, 6, 3

# Log evidence by which a convention may be behind and still win: noise settles slowly.
_MAX_BEHIND = 50.0


def fit_payload(
    arm: Arm,
    motion: ArmMotion,
    tares: Sequence[ArmMotion] = (),
    *,
    conventions: Sequence[Convention] = CONVENTIONS,
    known: NormalEquations | None = None,
    gain: float = GAIN,
) -> PayloadFit:
    """Fit mass, centre of mass and inertia of an arm's payload.

    Linear models of all torque conventions are compared by their evidence. Gauss-Newton refines the
    best one, and its posterior is marginalised over the scale of each group of terms.

    Args:
        arm: Without a payload.
        motion: While it held it.
        tares: While it held nothing, with the same driver: any motions will do.
        conventions: Possible ones, as far as the user does not state one.
        known: What other runs identified of the arm's own terms (`PayloadFit.learnt`).
        gain: Usual error of the torques, as a fraction: of each joint alone, and, as far as it is
            more than a driver's own, of all joints in common.
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
    terms = make_terms(arm, scales_nm, len(motions), drifts=drifts, gain=gain)
    if known is not None:
        known = known.among(terms.arms, len(terms.names))
    runs = tuple(
        LoggedArm(model, terms, one, number, inside)
        for number, (one, inside) in enumerate(zip(motions, covered, strict=True))
    )
    best, odds, arm_odds = _likeliest(runs, conventions, known)
    for _ in range(_ITERATIONS - 1):
        best = best.fitted(best.rows(best.linearized()), best.found.means, roughly=False)
    at, lines = best.found.means, best.linearized()
    rows = best.rows(lines)
    best = best.fitted(rows, at, roughly=False)
    normal = best.normal_equations(rows, at)
    # A run to come drifts from these, even where one alone does not show what drifted.
    drifting = make_terms(arm, scales_nm, len(motions), drifts=True).sds
    priors = np.where(terms.sds > 0, best.found.sds, drifting)
    learnt = normal.marginal(terms.arms, priors)
    common = np.sqrt(max(gain**2 - GAIN**2, 0.0))
    return _result(best, lines, at, normal, (odds, arm_odds), learnt, common)


def _likeliest(
    runs: tuple[LoggedArm, ...], conventions: Sequence[Convention], known: NormalEquations | None
) -> tuple[GaussNewton, float, float]:
    """Fit all conventions, and return the likeliest allowed one with its log evidence ratios.

    The first is over every other convention (below 0 if one that was excluded is likelier), the
    second over a model without an arm.
    """
    nothing = np.zeros(len(runs[0].terms.sds))
    lines = {
        convention: [run.linearized(nothing, convention) for run in runs]
        for convention in CONVENTIONS
    }
    rows = {convention: rows_of(runs, lines[convention], convention) for convention in CONVENTIONS}
    fits = {
        convention: _compared(
            GaussNewton.start(runs, convention, known), rows[convention], _COMPARISONS
        )
        for convention in CONVENTIONS
    }
    for _ in range(_MORE_COMPARISONS):
        leader = max(fit.log_evidence for fit in fits.values())
        near = [one for one, fit in fits.items() if fit.log_evidence > leader - _MAX_BEHIND]
        if len(near) == 1:
            break
        fits |= {one: _compared(fits[one], rows[one], 1) for one in near}
    best = max(conventions, key=lambda convention: fits[convention].log_evidence)
    evidence = fits[best].log_evidence
    others = [fit.log_evidence for convention, fit in fits.items() if convention != best]
    no_arm = _compared(
        GaussNewton.start(runs, best, known),
        rows_of(runs, [_without_arm(line, runs[0].terms) for line in lines[best]], best),
        _COMPARISONS,
    )
    odds = evidence - max(others), evidence - no_arm.log_evidence
    return fits[best].with_usual_offsets(), *odds


def _compared(fit: GaussNewton, rows: Sequence[TorqueRows], count: int) -> GaussNewton:
    """Run some rough fits of linear models about 0, each with the last one's noise."""
    for _ in range(count):
        fit = fit.fitted(rows, np.zeros(len(fit.terms.sds)), roughly=True)
    return fit


def _without_arm(line: Linearization, terms: Terms) -> Linearization:
    """Keep only the torques of sensors and friction."""
    kept = np.isin(np.array(terms.groups), ("offset", "friction", "drift", "warming"))
    slopes = line.slopes * kept[line.columns]
    return Linearization(np.zeros_like(line.predicted_nm), line.columns, slopes)


def _payload(fit: GaussNewton, normal: NormalEquations) -> tuple[Array, Array, float]:
    """Return means of the payload's terms, shape (10,), covariance, (10, 10), and a bound [kg].

    Averages two models: an arm with all nuisance terms, and a simulated one, without any.
    """
    own = np.arange(PAYLOAD_TERMS)
    means, covariance = averaged(fit.found, fit.groups, fit.logs, own)
    if len(fit.runs) > 1 or fit.known is not None:
        covariance = _SHARED_SD**2 * covariance
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
    normal: NormalEquations,
    odds: tuple[float, float],
    learnt: NormalEquations,
    common: float,
) -> PayloadFit:
    """Args: odds: of the convention, and of the arm. common: error of all torques, a fraction."""
    terms, found = fit.terms, fit.found
    means, covariance, bound_kg = _payload(fit, normal)
    covariance = covariance + common**2 * np.outer(means, means)
    change = found.means - at
    log = fit.runs[0]
    residual_nm = fit.residual_nm(0, lines, change)
    tare_residuals = []
    for run in fit.runs[1:]:
        counted = np.ix_(run.inside, run.motion.used)
        tare_residuals.append(
            FitResidual(
                fit.residual_nm(run.run, lines, change)[counted],
                run.torques_nm(fit.convention)[counted],
                terms.scales_nm[run.motion.used],
            )
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
        tare_residuals=tuple(tare_residuals),
        learnt=learnt,
    )
