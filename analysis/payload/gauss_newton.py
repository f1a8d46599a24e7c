"""Gauss-Newton with re-estimated noise: all terms at once, and what noise is left of the torques.

The noise is estimated for each joint, robust to spikes (weights that fall off beyond some standard
deviations, iteratively reweighted least squares) and with its autocorrelation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from analysis.payload.arm_motion import ArmMotion
from analysis.payload.evidence import NormalEquations, posterior
from analysis.payload.fit_result import LEAST_MASS_KG
from analysis.payload.torque_model import (
    CENTRE,
    MASS,
    ArmModel,
    Convention,
    Linearization,
    LoggedArm,
    Terms,
    smooth_sign,
)
from analysis.statistics import correlation_time
from tunenet_logs.arrays import Array

_MOST_LAG_S = 0.2
"""Lags are clipped here: the torques are linear in a lag only while it is short beside a motion."""

_NO_ARM_SDS = (10.0, 5.0, 5.0)
"""Offset, viscous and dry friction where torques may be anything [N·m, N·m s/rad, N·m]."""

_SPIKE_SDS = 3.5
"""Residual beyond which a sample counts for less: 1 of 2000 where noise is normal."""

_LEAST_SD_NM = 2e-3
"""No sensor's is less."""

_MOST_SD_FALL = 5.0
"""Factor by which the noise falls at most from one iteration to the next: a first fit that happens
to be near a joint's torques would give it all the weight."""


@dataclass(frozen=True, eq=False)
class Noise:
    """Of the torques of one log.

    Attributes:
        sds_nm: of each joint [N·m], shape (J,).
        effective_sample_factor: how many samples are worth an independent one, shape (J,).
        weights: of each sample, 1 but for spikes, and 0 of a joint that is left out, shape (T, J).
    """

    sds_nm: Array
    effective_sample_factor: Array
    weights: Array

    @classmethod
    def unknown(cls, effort_nm: Array, used: NDArray[np.bool_]) -> Noise:
        """Before anything is fitted: 1 N·m.

        Args:
            effort_nm: [N·m], shape (T, J).
            used: which joints count, shape (J,).
        """
        ones = np.ones(effort_nm.shape[1])
        return cls(ones, ones, np.where(used, np.ones_like(effort_nm), 0.0))

    def normal_equations(self, slopes: Array, target_nm: Array) -> NormalEquations:
        """Weighted sums of slopes, shape (T, J, N), and of what they are to explain, (T, J)."""
        weights = self.weights / (self.sds_nm**2 * self.effective_sample_factor)
        flat = slopes.reshape(-1, slopes.shape[-1])
        weighted = flat * weights.reshape(-1, 1)
        return NormalEquations(flat.T @ weighted, weighted.T @ target_nm.ravel())

    def reestimated(self, residual_nm: Array, slopes: Array, covariance: Array) -> Noise:
        """The noise that the residuals of a fit show.

        Args:
            residual_nm: [N·m], shape (T, J).
            slopes: of the fit, shape (T, J, N).
            covariance: of its terms, shape (N, N).
        """
        deviations = np.abs(residual_nm) / self.sds_nm
        weights = (_SPIKE_SDS / np.maximum(deviations, _SPIKE_SDS)) ** 2 * (self.weights > 0)
        sds, factors = np.empty_like(self.sds_nm), np.empty_like(self.sds_nm)
        for joint, residual in enumerate(residual_nm.T):
            weighted = slopes[:, joint] * weights[:, joint, None]
            precision = weighted.T @ slopes[:, joint] / self.sds_nm[joint] ** 2
            precision = precision / self.effective_sample_factor[joint]
            fitted = float(np.sum(precision * covariance))  # terms that this joint determines
            count = float(weights[:, joint].sum())
            squares = float(weights[:, joint] @ residual**2)
            freedom = max(count - fitted, 1.0)
            least = max(self.sds_nm[joint] / _MOST_SD_FALL, _LEAST_SD_NM)
            sds[joint] = max(np.sqrt(squares / freedom), least)
            factors[joint] = correlation_time(residual * np.sqrt(weights[:, joint]), round(fitted))
        return Noise(sds, factors, weights)


@dataclass(frozen=True, eq=False)
class GaussNewton:
    """A fit of all terms, at the scale 1 of their priors.

    Attributes:
        logs: the log and, where there is one, its tare.
        terms: the unknowns.
        convention: what the driver means by torque.
        noises: of each log.
        values: of all terms, shape (N,).
        covariance: of them, shape (N, N).
        log_evidence: up to what all models of these logs share.
    """

    logs: tuple[LoggedArm, ...]
    terms: Terms
    convention: Convention
    noises: tuple[Noise, ...]
    values: Array
    covariance: Array
    log_evidence: float

    @classmethod
    def start(
        cls,
        model: ArmModel,
        terms: Terms,
        motions: Sequence[ArmMotion],
        convention: Convention,
    ) -> GaussNewton:
        """All terms at 0, the mean of their priors."""
        logs = tuple(
            LoggedArm(model, terms, motion, convention, which)
            for which, motion in enumerate(motions)
        )
        noises = tuple(Noise.unknown(motion.effort, motion.used) for motion in motions)
        values = np.zeros(len(terms.sds))
        return cls(logs, terms, convention, noises, values, np.diag(terms.sds**2), -np.inf)

    def iterated(self, count: int) -> GaussNewton:
        """Runs `count` Gauss-Newton iterations, re-estimating the noise after each."""
        fit = self
        for _ in range(count):
            lines = [log.linearized(fit.values) for log in fit.logs]
            values, covariance = posterior(fit.normal_equations(lines), fit.sds)
            lags = fit.terms.indices("lag")
            values[lags] = np.clip(values[lags], -_MOST_LAG_S, _MOST_LAG_S)
            residuals_nm = [
                log.torques_nm - line.predicted_nm - line.slopes @ (values - fit.values)
                for log, line in zip(fit.logs, lines, strict=True)
            ]
            noises = tuple(
                noise.reestimated(residual_nm, line.slopes, covariance)
                for noise, residual_nm, line in zip(fit.noises, residuals_nm, lines, strict=True)
            )
            # A mass is 0 or more: its prior is half a normal one.
            mass_sds = float(values[MASS]) / float(np.sqrt(covariance[MASS, MASS]))
            evidence = _log_evidence(noises, values, covariance, fit.sds)
            fit = replace(
                fit,
                noises=noises,
                values=values,
                covariance=covariance,
                log_evidence=evidence + float(log_ndtr(mass_sds)),
            )
        return fit

    @property
    def sds(self) -> Array:
        """Of the priors; those of the centre's first moments are by the mass, shape (N,)."""
        sds = self.terms.sds.copy()
        sds[CENTRE] *= max(abs(float(self.values[MASS])), LEAST_MASS_KG)
        return sds

    def normal_equations(self, lines: Sequence[Linearization]) -> NormalEquations:
        """Of the terms themselves, linear about `values`.

        Args:
            lines: of each log about `values`.
        """
        parts = [
            noise.normal_equations(
                line.slopes, log.torques_nm - line.predicted_nm + line.slopes @ self.values
            )
            for noise, log, line in zip(self.noises, self.logs, lines, strict=True)
        ]
        precision = np.sum([part.precision for part in parts], axis=0)
        return NormalEquations(precision, np.sum([part.gradient for part in parts], axis=0))


def log_evidence_without_arm(motions: Sequence[ArmMotion], iterations: int) -> float:
    """Log evidence that no arm is behind the torques, only offsets and friction of any size."""
    total = 0.0
    for motion in motions:
        _, velocity, _ = motion.at(motion.seconds)
        own = np.eye(velocity.shape[1])
        parts = [np.broadcast_to(own, (*velocity.shape, len(own)))]
        parts += [values[..., None] * own for values in (velocity, smooth_sign(velocity))]
        slopes = np.concatenate(parts, axis=-1)
        sds = np.repeat(_NO_ARM_SDS, len(own))
        noise, evidence = Noise.unknown(motion.effort, motion.used), -np.inf
        for _ in range(iterations):
            values, covariance = posterior(noise.normal_equations(slopes, motion.effort), sds)
            noise = noise.reestimated(motion.effort - slopes @ values, slopes, covariance)
            evidence = _log_evidence([noise], values, covariance, sds)
        total += evidence
    return total


def _log_evidence(noises: Sequence[Noise], values: Array, covariance: Array, sds: Array) -> float:
    """By Laplace's approximation, the noise at its likeliest.

    Args:
        noises: of each log.
        values: of the terms at the maximum, shape (N,).
        covariance: of them, shape (N, N).
        sds: of their priors, shape (N,).
    """
    density = sum(-float(np.sum(noise.weights * np.log(noise.sds_nm))) for noise in noises)
    scaled = covariance / np.multiply.outer(sds, sds)
    volume = 0.5 * float(np.linalg.slogdet(scaled)[1])
    return density + volume - 0.5 * float(np.sum((values / sds) ** 2))
