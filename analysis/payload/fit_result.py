"""Result of a fit of an arm's torques: the payload, and all nuisance terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.payload.evidence import NormalEquations
from analysis.payload.held import MIN_MASS_KG, Held
from analysis.payload.torque_model import Convention
from tunenet_logs.arrays import Array


@dataclass(frozen=True)
class Nuisance:
    """One nuisance term.

    Attributes:
        name: In words.
        group: That it is scaled with (`torque_terms.make_terms`).
        value: Its mean [N·m, N·m for each rad/s or rad/s², m, rad, s, or a fraction].
        sd: Standard deviation, in the same unit.
        prior_sd: Of its prior about 0 at scale 1, in the same unit.
    """

    name: str
    group: str
    value: float
    sd: float
    prior_sd: float


@dataclass(frozen=True, eq=False)
class FitResidual:
    """Residual of a fit to the torques of one run.

    Attributes:
        residual_nm: Measured less predicted, of the joints that were fitted [N·m], shape (T, U).
        effort_nm: As measured, of the same [N·m], shape (T, U).
        scales_nm: Rated torque of these joints [N·m], shape (U,).
    """

    residual_nm: Array
    effort_nm: Array
    scales_nm: Array


@dataclass(frozen=True, eq=False)
class PayloadFit:
    """Fit of the payload and all nuisance terms.

    Attributes:
        held: Mass, centre of mass and inertia.
        convention: Sign of the torques, and whether gravity is included.
        convention_odds: Log evidence (natural) by which it leads the next one; below 0 if the
            log speaks for one that the user excluded.
        arm_odds: Log evidence over a model without an arm.
        nuisances: All other terms.
        bound_kg: Cramér-Rao bound of the mass's standard deviation, under the likeliest scales.
        scales: Of each group of terms, relative to its usual size.
        scales_nm: Rated torque of each joint [N·m], shape (J,).
        seconds: Of the torques [s], shape (T,).
        effort_nm: As measured, with the joint's sign [N·m], shape (T, J).
        predicted_nm: By the fit [N·m], shape (T, J).
        used: Joints that were fitted, shape (J,).
        lag_s: Of the torques behind the positions [s].
        tare_residuals: Of the empty runs' torques.
        learnt: What all runs identify of the arm's own terms (`Terms.arms`), for later logs.
    """

    held: Held
    convention: Convention
    convention_odds: float
    arm_odds: float
    nuisances: tuple[Nuisance, ...]
    bound_kg: float
    scales: Mapping[str, float]
    scales_nm: Array
    seconds: Array
    effort_nm: Array
    predicted_nm: Array
    used: NDArray[np.bool_]
    lag_s: float
    tare_residuals: tuple[FitResidual, ...]
    learnt: NormalEquations

    @property
    def residual_nm(self) -> Array:
        """Residual, measured less predicted [N·m], shape (T, J)."""
        return self.effort_nm - self.predicted_nm

    @property
    def residual(self) -> FitResidual:
        """Residual of the joints that were fitted."""
        used = self.used
        return FitResidual(self.residual_nm[:, used], self.effort_nm[:, used], self.scales_nm[used])

    @property
    def identifiability(self) -> str:
        """Whether mass, centre of mass and inertia are identifiable, in a sentence."""
        centre = self.held.centre
        if centre.is_identifiable:
            spread = ", ".join(f"{1000 * sd:.1f}" for sd in centre.sds_m)
            told = f"mass and centre of mass are told apart (sd of the centre: {spread} mm)"
            if self.held.inertia:
                return f"{told}, and its inertia"
            return f"{told}; its inertia needs faster turns of the hand, there and back in a second"
        if centre.mass_kg <= MIN_MASS_KG:
            return "the payload is too light for its centre of mass to show"
        most_g = 10 * max(abs(kg_for_m) for kg_for_m in centre.kg_for_m)
        remedy = "turn the hand by 90° about two axes in the motion (the last three joints)"
        if not self.tare_residuals:
            remedy = f"record the empty gripper too (--tare), and {remedy}"
        return (
            f"the log cannot tell the payload's mass from its centre along "
            f"{', '.join(centre.loose)}: 1 cm off the tool frame is {most_g:.0f} g; {remedy}"
        )
