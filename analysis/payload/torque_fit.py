"""What an arm holds, from its torques: mass, centre of mass, and how sure each is.

Torques are linear in the payload. What makes it hard is all else that is in them: friction,
offsets, gains, a lag, links that weigh something else than the model's. They are fitted too, with
priors whose scale the log decides on (`evidence.py`), and with a run of the empty gripper (a tare)
that has all of them but the payload. A cross-check has none of that, and another engine's model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from analysis.payload.arm_motion import ArmMotion
from analysis.payload.evidence import Ideal, Level, WeightedModel, weighted_models
from analysis.payload.fit_result import LEAST_MASS_KG, Centre, FitResidual, Nuisance, PayloadFit
from analysis.payload.gauss_newton import GaussNewton, log_evidence_without_arm
from analysis.payload.torque_model import (
    CENTRE,
    CONVENTIONS,
    MASS,
    OFFSET_SD_NM,
    ArmModel,
    Convention,
    make_terms,
)
from analysis.statistics import ModelEstimate, average
from recorders.simulators.arm.description import Arm, Payload
from recorders.simulators.arm.dynamics import held_efforts_nm, joint_efforts_nm
from recorders.simulators.arm.path import JointPath
from tunenet_logs.arrays import Array

_ITERATIONS, _FINAL_ITERATIONS = 5, 4
"""Of Gauss-Newton: with each convention, enough to choose one; then more with the best."""

_PAYLOAD = np.arange(CENTRE.stop)
"""Indices of the payload's terms."""

_SCALES = (Level(0.0, 0.2), Level(1 / 3, 0.2), Level(1.0, 0.4), Level(3.0, 0.2))
_FREE = (Level(1.0, 1.0),)
LEVELS: Mapping[str, Sequence[Level]] = {
    "offset": _SCALES,
    "friction": _SCALES,
    "gain": (Level(0.0, 0.05), Level(1.0, 0.95)),
    "links": (Level(0.0, 0.05), Level(1.0, 0.95)),
    "lag": (Level(0.0, 0.1), Level(1.0, 0.9)),
    "drift": (Level(0.0, 0.85), Level(1.0, 0.1), Level(3.0, 0.05)),
    "centre": (Level(0.0, 0.5), Level(1.0, 0.5)),
}
"""Scales of each group's priors, with their prior probabilities: gains, links and lags are hardly
ever exact; zeros seldom drift within minutes; a payload may well be in the tool frame."""

SIMULATED = Ideal(("offset", "friction", "gain", "links", "drift"), 0.3)
"""A log may be a simulator's, which has none of these."""


def fit_payload(
    arm: Arm,
    motion: ArmMotion,
    tare: ArmMotion | None = None,
) -> PayloadFit:
    """Find mass and centre of mass of what an arm holds.

    Gauss-Newton from 0 with each convention of a driver; the one with the highest Laplace evidence
    is then averaged over how large each group of terms may be.

    Args:
        arm: as it is without a payload.
        motion: while it held it.
        tare: while it held nothing, with the same driver: any motion will do.
    """
    model = ArmModel(arm)
    motions = [motion] if tare is None else [motion, tare]
    terms = make_terms(arm.joint_names, len(motions))
    fits = [
        GaussNewton.start(model, terms, motions, convention).iterated(_ITERATIONS)
        for convention in CONVENTIONS
    ]
    best, second, *_ = sorted(fits, key=lambda fit: -fit.log_evidence)
    return _averaged(
        best.iterated(_FINAL_ITERATIONS),
        convention_odds=best.log_evidence - second.log_evidence,
        arm_odds=best.log_evidence - log_evidence_without_arm(motions, _ITERATIONS),
    )


def _averaged(fit: GaussNewton, *, convention_odds: float, arm_odds: float) -> PayloadFit:
    """Bayesian average over how large each group of terms may be."""
    terms, lines = fit.terms, [log.linearized(fit.values) for log in fit.logs]
    normal = fit.normal_equations(lines)
    levels = {name: choice for name, choice in LEVELS.items() if name in terms.groups}
    groups = {name: terms.indices(name) for name in levels}
    models = weighted_models(normal, fit.sds, groups, levels, _PAYLOAD, SIMULATED)
    free = {**levels, "centre": _FREE}
    free_models = weighted_models(normal, fit.sds, groups, free, _PAYLOAD, SIMULATED)
    mass_sds = [float(np.sqrt(model.covariance[MASS, MASS])) for model in models]
    estimates = [
        ModelEstimate(float(model.means[MASS]), (sd, sd), model.weight)
        for model, sd in zip(models, mass_sds, strict=True)
    ]
    mass_kg, interval95 = average(estimates, 0.0, np.inf)
    means, covariance = _moments(models)
    log, line = fit.logs[0], lines[0]
    tare_residual = None
    for tare, tare_line in zip(fit.logs[1:], lines[1:], strict=True):
        used, slopes = tare.motion.used, tare_line.slopes
        residual_nm = tare.torques_nm - tare_line.predicted_nm - slopes @ (means - fit.values)
        tare_residual = FitResidual(residual_nm[:, used], tare.torques_nm[:, used])
    sds = np.sqrt(np.diag(fit.covariance))
    return PayloadFit(
        mass_kg=mass_kg,
        interval95=interval95,
        signed_kg=float(means[MASS]),
        sd_kg=float(np.sqrt(covariance[MASS, MASS])),
        centre=_centre(free_models),
        off_centre=sum(model.weight for model in models if model.levels["centre"]),
        convention=fit.convention,
        convention_odds=convention_odds,
        arm_odds=arm_odds,
        nuisances=tuple(
            Nuisance(name, terms.groups[k], float(means[k]), float(sds[k]), float(terms.sds[k]))
            for k, name in enumerate(terms.names)
            if k >= CENTRE.stop
        ),
        bound_kg=mass_sds[0],
        model=models[0].levels,
        seconds=log.motion.seconds,
        effort_nm=log.torques_nm,
        predicted_nm=line.predicted_nm + line.slopes @ (means - fit.values),
        used=log.motion.used,
        lag_s=float(means[terms.indices("lag")[0]]),
        tare_residual=tare_residual,
    )


def _moments(models: Sequence[WeightedModel]) -> tuple[Array, Array]:
    """Means of all terms, shape (N,), and covariance of the payload's, (4, 4), of a mixture."""
    means = np.sum([model.weight * model.means for model in models], axis=0)
    parts = []
    for model in models:
        off = (model.means - means)[_PAYLOAD]
        parts.append(model.weight * (model.covariance + np.outer(off, off)))
    return means, np.sum(parts, axis=0)


def _centre(models: Sequence[WeightedModel]) -> Centre:
    """First moments over the mass, under models that leave both free."""
    means, covariance = _moments(models)
    mass_kg = max(float(means[MASS]), LEAST_MASS_KG)
    com_m = means[CENTRE] / mass_kg
    # The error of a quotient to first order: its Jacobian by mass and first moments.
    to_com = np.concatenate([-com_m[:, None], np.eye(3)], axis=1) / mass_kg
    sds_m = np.sqrt(np.diag(to_com @ covariance @ to_com.T))
    precision = np.linalg.inv(models[0].covariance)
    kg_for_m = precision[MASS, CENTRE] / precision[MASS, MASS] * mass_kg
    x, y, z = com_m.tolist()
    sd_x, sd_y, sd_z = sds_m.tolist()
    kg_x, kg_y, kg_z = kg_for_m.tolist()
    return Centre(
        com_m=(x, y, z),
        sds_m=(sd_x, sd_y, sd_z),
        mass_kg=float(means[MASS]),
        mass_sd_kg=float(np.sqrt(covariance[MASS, MASS])),
        kg_for_m=(kg_x, kg_y, kg_z),
    )


def secant(
    arm: Arm,
    motion: ArmMotion,
    convention: Convention,
    lag_s: float,
    tare: ArmMotion | None = None,
) -> float:
    """The mass [kg] by a line through two rollouts, as a cross-check; it may be below 0.

    Torques are linear in the mass, so the arm without a payload and with 1 kg, driven along the
    logged motion, give it by least squares in closed form. Only the sensors' offsets are taken out.

    Args:
        arm: as it is without a payload.
        motion: while it held it.
        convention: what its driver means by torque.
        lag_s: of the torques behind the positions [s].
        tare: while it held nothing: its mean residuals are the offsets.
    """
    arm = arm.without_limits()
    path = JointPath(motion.seconds, *motion.at(motion.seconds - lag_s))
    empty_nm = _empty_nm(arm, path, convention)
    for_kg = joint_efforts_nm(arm, path, Payload(1.0)) - joint_efforts_nm(arm, path)
    residual = convention.sign * motion.effort - empty_nm
    used = motion.used
    if tare is None:
        # An offset of normal prior is projected out of both, less so where the noise is large.
        noise = np.var(residual - np.mean(residual, axis=0), axis=0)
        free = OFFSET_SD_NM**2 / (OFFSET_SD_NM**2 + noise / len(residual))
        residual = residual - free * np.mean(residual, axis=0)
        slopes = for_kg - free * np.mean(for_kg, axis=0)
    else:
        tare_path = JointPath(tare.seconds, *tare.at(tare.seconds - lag_s))
        tare_nm = _empty_nm(arm, tare_path, convention)
        residual = residual - np.mean(convention.sign * tare.effort - tare_nm, axis=0)
        slopes = for_kg
        used = used & tare.used
    slopes, residual = slopes[:, used], residual[:, used]
    return float(np.sum(slopes * residual) / np.sum(slopes**2))


def _empty_nm(arm: Arm, path: JointPath, convention: Convention) -> Array:
    """Torques of the empty arm as a driver of that convention gives them [N·m], shape (T, J)."""
    empty_nm = joint_efforts_nm(arm, path)
    return empty_nm if convention.has_gravity else empty_nm - held_efforts_nm(arm, path)
