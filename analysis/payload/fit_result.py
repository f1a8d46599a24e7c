"""What a fit of an arm's torques finds: the payload, and all else that is in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.payload.torque_model import Convention
from analysis.statistics import TWO_SIDED
from tunenet_logs.arrays import Array

Three = tuple[float, float, float]

LEAST_MASS_KG = 0.05
"""Below which a payload has no centre of mass that torques show."""

_IDENTIFIABLE_SD_M = 0.008
"""Of each axis of a centre of mass: its interval is then narrower than a hand."""


@dataclass(frozen=True)
class Nuisance:
    """One term that is not the payload's.

    Attributes:
        name: in words.
        group: "offset", "friction", "gain", "links", "lag" or "drift".
        value: its mean [N·m, N·m for each rad/s, m, s, or a fraction].
        sd: standard deviation, in the same unit.
        prior_sd: of its prior about 0, in the same unit.
    """

    name: str
    group: str
    value: float
    sd: float
    prior_sd: float


@dataclass(frozen=True)
class Centre:
    """Where the payload's centre of mass is in the tool frame, if it may be anywhere.

    Attributes:
        com_m: x, y, z [m].
        sds_m: standard deviation of each [m].
        mass_kg: with the centre free.
        mass_sd_kg: its standard deviation.
        kg_for_m: by how much the mass that is fitted with the centre in the tool frame is wrong,
            for each m that it is off along x, y, z.
    """

    com_m: Three
    sds_m: Three
    mass_kg: float
    mass_sd_kg: float
    kg_for_m: Three

    @property
    def is_identifiable(self) -> bool:
        """Whether the log determines it beside the mass."""
        return max(self.sds_m) < _IDENTIFIABLE_SD_M and self.mass_kg > LEAST_MASS_KG

    @property
    def interval95(self) -> tuple[tuple[float, float], ...]:
        """Lower and upper end of each axis [m]."""
        pairs = zip(self.com_m, self.sds_m, strict=True)
        return tuple((mean - TWO_SIDED * sd, mean + TWO_SIDED * sd) for mean, sd in pairs)


@dataclass(frozen=True, eq=False)
class FitResidual:
    """What a fit does not explain of the torques of one run.

    Attributes:
        residual_nm: measured less predicted, of the joints that were fitted [N·m], shape (T, U).
        effort_nm: as measured, of the same [N·m], shape (T, U).
    """

    residual_nm: Array
    effort_nm: Array


@dataclass(frozen=True, eq=False)
class PayloadFit:
    """What is in the gripper.

    Attributes:
        mass_kg: 0 or more.
        interval95: of the mass [kg].
        signed_kg: the mass as fitted, which may be below 0.
        sd_kg: its standard deviation.
        centre: of mass, whether the log determines it or not.
        off_centre: probability that it is not the tool frame's origin.
        convention: sign of the torques, and whether gravity is in them.
        convention_odds: log evidence (natural) by which it leads the next one.
        arm_odds: log evidence by which it leads torques that no arm is behind.
        nuisances: all other terms.
        bound_kg: Cramér-Rao bound of the mass's standard deviation, under the likeliest model.
        model: scale of each group's priors in the likeliest model; 0 where it has none of them.
        seconds: of the torques [s], shape (T,).
        effort_nm: as measured, with the joint's sign [N·m], shape (T, J).
        predicted_nm: by the fit [N·m], shape (T, J).
        used: joints that were fitted, shape (J,).
        lag_s: of the torques behind the positions [s].
        tare_residual: of the empty run's torques; None where there is none.
    """

    mass_kg: float
    interval95: tuple[float, float]
    signed_kg: float
    sd_kg: float
    centre: Centre
    off_centre: float
    convention: Convention
    convention_odds: float
    arm_odds: float
    nuisances: tuple[Nuisance, ...]
    bound_kg: float
    model: Mapping[str, float]
    seconds: Array
    effort_nm: Array
    predicted_nm: Array
    used: NDArray[np.bool_]
    lag_s: float
    tare_residual: FitResidual | None

    @property
    def residual_nm(self) -> Array:
        """Measured less predicted [N·m], shape (T, J)."""
        return self.effort_nm - self.predicted_nm

    @property
    def identifiability(self) -> str:
        """Whether mass and centre of mass are told apart, in a sentence."""
        centre = self.centre
        if centre.is_identifiable:
            spread = ", ".join(f"{1000 * sd:.1f}" for sd in centre.sds_m)
            return f"mass and centre of mass are told apart (sd of the centre: {spread} mm)"
        if centre.mass_kg <= LEAST_MASS_KG:
            return "the payload is too light for its centre of mass to show"
        loose = [
            f"{axis} (sd {1000 * sd:.0f} mm)"
            for axis, sd in zip("xyz", centre.sds_m, strict=True)
            if sd >= _IDENTIFIABLE_SD_M
        ]
        most_g = 10 * max(abs(kg_for_m) for kg_for_m in centre.kg_for_m)
        remedy = "turn the hand by 90° about two axes in the motion (the last three joints)"
        if self.tare_residual is None:
            remedy = f"record the empty gripper too (--tare), and {remedy}"
        return (
            f"the log cannot tell the payload's mass from its centre along {', '.join(loose)}: "
            f"1 cm off the tool frame is {most_g:.0f} g; {remedy}"
        )
