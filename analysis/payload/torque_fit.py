"""What an arm holds, from its torques: mass, centre of mass, and how sure each is.

Torques are linear in the payload. What makes it hard is all else that is in them: friction,
offsets, gains, a lag, links that weigh something else than the model's. They are fitted too, with
priors whose scale the log decides on (`evidence.py`), and with a run of the empty gripper (a tare)
that has all of them but the payload.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from analysis.model_averaging import ModelEstimate, average
from analysis.payload.arm_model import ArmModel
from analysis.payload.arm_motion import ArmMotion
from analysis.payload.evidence import Ideal, Level, Model, weighed_models
from analysis.payload.fit_result import LEAST_MASS_KG, Centre, Left, Nuisance, PayloadFit
from analysis.payload.least_squares import Steps, without_arm
from analysis.payload.terms import CENTRE, CONVENTIONS, MASS, make_terms
from recorders.simulators.arm.description import Arm
from tunenet_logs.arrays import Array

_STEPS, _MORE_STEPS = 5, 4
_PAYLOAD = np.arange(CENTRE.stop)
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
"""What a group of terms may be, and how likely it is before the log is looked at."""
SIMULATED = Ideal(("offset", "friction", "gain", "links", "drift"), 0.3)


def fit_payload(
    arm: Arm,
    motion: ArmMotion,
    tare: ArmMotion | None = None,
) -> PayloadFit:
    """Find mass and centre of mass of what an arm holds.

    Args:
        arm: as it is without a payload.
        motion: while it held it.
        tare: while it held nothing, with the same driver: any motion will do.
    """
    model = ArmModel(arm)
    motions = [motion] if tare is None else [motion, tare]
    terms = make_terms(arm.joint_names, len(motions))
    fits = [Steps.of(model, terms, motions, one).taken(_STEPS) for one in CONVENTIONS]
    best, second, *_ = sorted(fits, key=lambda one: -one.log_evidence)
    arm_odds = best.log_evidence - without_arm(motions, _STEPS)
    return _averaged(
        best.taken(_MORE_STEPS),
        motion,
        tare,
        convention_odds=best.log_evidence - second.log_evidence,
        arm_odds=arm_odds,
    )


def _averaged(
    steps: Steps,
    motion: ArmMotion,
    tare: ArmMotion | None,
    *,
    convention_odds: float,
    arm_odds: float,
) -> PayloadFit:
    """Over how large each group of terms may be."""
    terms = steps.terms
    levels = {name: choice for name, choice in LEVELS.items() if name in terms.groups}
    models = _models(steps, levels)
    likeliest = models[0]
    mass_kg, interval95 = average([_opinion(one) for one in models], 0.0, np.inf)
    means, spread = _moments(models)
    line = steps.logs[0].about(steps.values)
    sds = np.sqrt(np.diag(steps.covariance))
    first = CENTRE.stop
    rows = zip(
        *(terms.names[first:], terms.groups[first:], means[first:], sds[first:]),
        terms.sds[first:],
        strict=True,
    )
    return PayloadFit(
        mass_kg=mass_kg,
        interval95=interval95,
        signed_kg=float(means[MASS]),
        sd_kg=float(np.sqrt(spread[MASS, MASS])),
        centre=_centre(_models(steps, {**levels, "centre": _FREE})),
        off_centre=sum(one.weight for one in models if one.levels["centre"]),
        convention=steps.convention,
        convention_odds=convention_odds,
        arm_odds=arm_odds,
        nuisances=tuple(
            Nuisance(name, group, float(mean), float(sd), float(prior))
            for name, group, mean, sd, prior in rows
        ),
        bound_kg=float(np.sqrt(likeliest.watched[MASS, MASS])),
        model=likeliest.levels,
        seconds=motion.seconds,
        effort_nm=steps.logs[0].torques_nm,
        predicted_nm=line.predicted_nm + line.slopes @ (means - steps.values),
        used=motion.used,
        lag_s=float(means[terms.places("lag")[0]]),
        tare_left=_tare_left(steps, tare, means),
    )


def _tare_left(steps: Steps, tare: ArmMotion | None, means: Array) -> Left | None:
    if tare is None:
        return None
    line, effort_nm = steps.logs[1].about(steps.values), steps.logs[1].torques_nm
    residual_nm = effort_nm - line.predicted_nm - line.slopes @ (means - steps.values)
    return Left(residual_nm[:, tare.used], effort_nm[:, tare.used])


def _models(steps: Steps, levels: Mapping[str, Sequence[Level]]) -> tuple[Model, ...]:
    groups = {name: steps.terms.places(name) for name in levels}
    return weighed_models(steps.normal(), steps.sds, groups, levels, _PAYLOAD, SIMULATED)


def _opinion(model: Model) -> ModelEstimate:
    sd = float(np.sqrt(model.watched[MASS, MASS]))
    return ModelEstimate(float(model.means[MASS]), (sd, sd), model.weight)


def _moments(models: Sequence[Model]) -> tuple[Array, Array]:
    """Means of all terms, shape (N,), and covariance of the payload's, (4, 4), over models."""
    means = np.sum([one.weight * one.means for one in models], axis=0)
    apart = [(one.means - means)[_PAYLOAD] for one in models]
    spreads = [
        one.weight * (one.watched + np.outer(off, off))
        for one, off in zip(models, apart, strict=True)
    ]
    return means, np.sum(spreads, axis=0)


def _centre(models: Sequence[Model]) -> Centre:
    """Under models that leave it free."""
    means, spread = _moments(models)
    mass_kg = max(float(means[MASS]), LEAST_MASS_KG)
    com_m = means[CENTRE] / mass_kg
    to_com = np.concatenate([-com_m[:, None], np.eye(3)], axis=1) / mass_kg
    sds_m = np.sqrt(np.diag(to_com @ spread @ to_com.T))
    precision = np.linalg.inv(models[0].watched)
    kg_for_m = precision[MASS, CENTRE] / precision[MASS, MASS] * mass_kg
    return Centre(
        com_m=_three(com_m),
        sds_m=_three(sds_m),
        mass_kg=float(means[MASS]),
        mass_sd_kg=float(np.sqrt(spread[MASS, MASS])),
        kg_for_m=_three(kg_for_m),
    )


def _three(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (float(one) for one in values)
    return x, y, z
