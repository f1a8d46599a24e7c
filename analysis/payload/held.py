"""Physically consistent payload from the fitted terms.

Mass is not below 0, and mass, first moments and inertia are together those of some distribution of
mass: the pseudo-inertia matrix is positive semidefinite (Wensing, Kim and Slotine 2018). Such
bodies are a convex set, so that the mean of sampled ones is one of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.payload.torque_model import moments
from analysis.payload.torque_terms import CENTRE, INERTIA, MASS
from analysis.statistics import TWO_SIDED
from recorders.simulators.arm.description import PAYLOAD_RADIUS_M
from tunenet_logs.arrays import Array

Three = tuple[float, float, float]
Pair = tuple[float, float]

MIN_MASS_KG = 0.05  # below which a payload has no centre of mass that torques show
# Of each axis of a centre of mass: its interval is then narrower than a hand.
_IDENTIFIABLE_SD_M = 0.012

_MAX_M = 0.5  # of a centre along an axis: no hand holds a thing by a point further away
# Standard deviation of a moment of inertia, of the largest one: from which on it is told.
_TOLD_SHARE = 0.2

# Bodies that are drawn, and how many of them there must be.
_DRAWS, _MIN_DRAWS, _SEED = 4000, 200, 17


@dataclass(frozen=True)
class Centre:
    """Centre of mass of the payload in the tool frame.

    Attributes:
        com_m: x, y, z [m].
        sds_m: Standard deviation of each [m].
        mass_kg: That it is the centre of.
        kg_for_m: Error of a mass that is fitted with the centre in the tool frame, per metre that
            the centre is off along x, y, z.
    """

    com_m: Three
    sds_m: Three
    mass_kg: float
    kg_for_m: Three

    @property
    def is_identifiable(self) -> bool:
        """Whether the log identifies it beside the mass."""
        return max(self.sds_m) < _IDENTIFIABLE_SD_M and self.mass_kg > MIN_MASS_KG

    @property
    def likely_m(self) -> Three:
        """Centre of mass for a simulation: the tool frame's origin if this one cannot be."""
        can_be = self.mass_kg > MIN_MASS_KG and max(map(abs, self.com_m)) < _MAX_M
        return self.com_m if can_be else (0.0, 0.0, 0.0)

    @property
    def loose(self) -> tuple[str, ...]:
        """Axes along which it is not identifiable, with their standard deviations."""
        return tuple(
            f"{axis} (sd {1000 * sd:.0f} mm)"
            for axis, sd in zip("xyz", self.sds_m, strict=True)
            if sd >= _IDENTIFIABLE_SD_M
        )

    @property
    def interval95(self) -> tuple[Pair, ...]:
        """Lower and upper end of each axis [m]."""
        pairs = zip(self.com_m, self.sds_m, strict=True)
        return tuple((mean - TWO_SIDED * sd, mean + TWO_SIDED * sd) for mean, sd in pairs)


@dataclass(frozen=True)
class Inertia:
    """Moments of inertia about the centre of mass, along the tool frame's axes.

    Attributes:
        kg_m2: xx, xy, yy, xz, yz, zz.
        interval95: Of each.
    """

    kg_m2: tuple[float, ...]
    interval95: tuple[Pair, ...]


@dataclass(frozen=True)
class Held:
    """Payload of the arm.

    Attributes:
        mass_kg: 0 or more.
        interval95: Of the mass [kg]; from 0 if it is not significant.
        signed_kg: Mass as fitted, which may be below 0.
        sd_kg: Its standard deviation.
        centre: Of mass, whether identifiable or not.
        inertia: None if unidentifiable.
    """

    mass_kg: float
    interval95: Pair
    signed_kg: float
    sd_kg: float
    centre: Centre
    inertia: Inertia | None


def held(means: Array, covariance: Array) -> Held:
    """Build a payload from the Gaussian posterior of its terms, shapes (10,) and (10, 10)."""
    signed_kg, sd_kg = float(means[MASS]), float(np.sqrt(covariance[MASS, MASS]))
    centre = _centre(means, covariance)
    inertia = _inertia(means, covariance) if centre.is_identifiable else None
    interval95 = _interval(signed_kg, sd_kg)
    return Held(max(signed_kg, 0.0), interval95, signed_kg, sd_kg, centre, inertia)


def _interval(mean_kg: float, sd_kg: float) -> Pair:
    """Return the 95 % interval of a Gaussian, truncated at 0 if its mean is hardly above."""
    from scipy.special import ndtr, ndtri

    if mean_kg > TWO_SIDED * sd_kg:
        return mean_kg - TWO_SIDED * sd_kg, mean_kg + TWO_SIDED * sd_kg
    above = float(ndtr(mean_kg / sd_kg))
    # Far below 0, the part above it is an exponential's: the quantile by its tail.
    end = mean_kg - sd_kg * float(ndtri(0.05 * above))
    return 0.0, end


def _centre(means: Array, covariance: Array) -> Centre:
    """Divide first moments by the mass, with first-order error propagation."""
    mass_kg = max(float(means[MASS]), MIN_MASS_KG)
    com_m = means[CENTRE] / mass_kg
    # The error of a quotient to first order: its Jacobian by mass and first moments.
    to_com = np.concatenate([-com_m[:, None], np.eye(3)], axis=1) / mass_kg
    own = covariance[: CENTRE.stop, : CENTRE.stop]
    sds_m = np.sqrt(np.diag(to_com @ own @ to_com.T))
    precision = np.linalg.inv(own)
    kg_for_m = precision[MASS, CENTRE] / precision[MASS, MASS] * mass_kg
    x, y, z = com_m.tolist()
    sd_x, sd_y, sd_z = sds_m.tolist()
    kg_x, kg_y, kg_z = kg_for_m.tolist()
    return Centre((x, y, z), (sd_x, sd_y, sd_z), float(means[MASS]), (kg_x, kg_y, kg_z))


def _inertia(means: Array, covariance: Array) -> Inertia | None:
    """Average sampled inertias with a positive semidefinite pseudo-inertia."""
    rng = np.random.default_rng(_SEED)
    drawn = rng.multivariate_normal(means, covariance, _DRAWS, method="eigh")
    tensors = np.einsum("nk,kij->nij", drawn[:, INERTIA], np.stack(moments()))
    tensors += 0.4 * PAYLOAD_RADIUS_M**2 * drawn[:, MASS, None, None] * np.eye(3)
    masses, firsts = drawn[:, MASS], drawn[:, CENTRE]
    pseudo = np.zeros((_DRAWS, 4, 4))
    traces = np.trace(tensors, axis1=1, axis2=2)
    pseudo[:, :3, :3] = 0.5 * traces[:, None, None] * np.eye(3) - tensors
    pseudo[:, :3, 3] = pseudo[:, 3, :3] = firsts
    pseudo[:, 3, 3] = masses
    there = np.linalg.eigvalsh(pseudo)[:, 0] >= 0
    if np.count_nonzero(there) < _MIN_DRAWS:
        return None
    masses, firsts = masses[there, None, None], firsts[there]
    about = np.einsum("ni,ni->n", firsts, firsts)[:, None, None] * np.eye(3)
    own = tensors[there] - (about - np.einsum("ni,nj->nij", firsts, firsts)) / masses
    rows = own[:, *np.tril_indices(3)]
    if np.std(rows, axis=0).max() > _TOLD_SHARE * np.abs(np.mean(rows, axis=0)).max():
        return None
    lows, highs = np.quantile(rows, (0.025, 0.975), axis=0)
    return Inertia(
        tuple(np.mean(rows, axis=0).tolist()),
        tuple(zip(lows.tolist(), highs.tolist(), strict=True)),
    )
