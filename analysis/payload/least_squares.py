"""Least squares for all terms at once, about values that come nearer with each step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr

from analysis.payload.arm_model import ArmModel
from analysis.payload.arm_motion import ArmMotion
from analysis.payload.evidence import Normal, posterior
from analysis.payload.fit_result import LEAST_MASS_KG
from analysis.payload.noise import Noise
from analysis.payload.terms import (
    CENTRE,
    MASS,
    Convention,
    Linear,
    LoggedArm,
    Terms,
    turning,
)
from tunenet_logs.arrays import Array

_MOST_LAG_S = 0.2
_NO_ARM_SDS = (10.0, 5.0, 5.0)
"""Offset, viscous and dry friction where torques may be anything [N·m]."""


@dataclass(frozen=True, eq=False)
class Steps:
    """All terms at the scale of their priors.

    Attributes:
        logs: the log and, where there is one, its tare.
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
    def of(
        cls,
        model: ArmModel,
        terms: Terms,
        motions: Sequence[ArmMotion],
        convention: Convention,
    ) -> Steps:
        """Before the first step."""
        logs = tuple(
            LoggedArm(model, terms, one, convention, which) for which, one in enumerate(motions)
        )
        noises = tuple(Noise.unknown(one.effort, one.used) for one in motions)
        values = np.zeros(len(terms.sds))
        return cls(logs, terms, convention, noises, values, np.diag(terms.sds**2), -np.inf)

    def taken(self, count: int) -> Steps:
        """So many steps of Gauss and Newton on, each with the noise that the one before leaves."""
        at = self
        for _ in range(count):
            at = at._next()
        return at

    @property
    def sds(self) -> Array:
        """Of the priors; those of the centre's first moments are by the mass, shape (N,)."""
        sds = self.terms.sds.copy()
        sds[CENTRE] *= max(abs(float(self.values[MASS])), LEAST_MASS_KG)
        return sds

    def normal(self) -> Normal:
        """What the logs say of the terms, linear about `values`."""
        return self._normal([one.about(self.values) for one in self.logs])

    def _next(self) -> Steps:
        lines = [one.about(self.values) for one in self.logs]
        moved, covariance = posterior(self._normal(lines), self.sds)
        lags = self.terms.places("lag")
        moved[lags] = np.clip(moved[lags], -_MOST_LAG_S, _MOST_LAG_S)
        left = [
            log.torques_nm - line.predicted_nm - line.slopes @ (moved - self.values)
            for log, line in zip(self.logs, lines, strict=True)
        ]
        noises = tuple(
            noise.looked_at(rest, line.slopes, covariance)
            for noise, rest, line in zip(self.noises, left, lines, strict=True)
        )
        mass_sds = float(moved[MASS]) / float(np.sqrt(covariance[MASS, MASS]))
        evidence = _log_evidence(noises, moved, covariance, self.sds) + float(log_ndtr(mass_sds))
        return replace(
            self, noises=noises, values=moved, covariance=covariance, log_evidence=evidence
        )

    def _normal(self, lines: Sequence[Linear]) -> Normal:
        return _summed(
            [
                noise.normal(
                    line.slopes, log.torques_nm - line.predicted_nm + line.slopes @ self.values
                )
                for noise, log, line in zip(self.noises, self.logs, lines, strict=True)
            ]
        )


def without_arm(motions: Sequence[ArmMotion], steps: int) -> float:
    """Log evidence that no arm is behind the torques, only offsets and friction of any size."""
    total = 0.0
    for motion in motions:
        _, velocity, _ = motion.at(motion.seconds)
        own = np.eye(velocity.shape[1])
        parts = [np.broadcast_to(own, (*velocity.shape, len(own)))]
        parts += [one[..., None] * own for one in (velocity, turning(velocity))]
        slopes = np.concatenate(parts, axis=-1)
        sds = np.repeat(_NO_ARM_SDS, len(own))
        noise, evidence = Noise.unknown(motion.effort, motion.used), -np.inf
        for _ in range(steps):
            values, covariance = posterior(noise.normal(slopes, motion.effort), sds)
            noise = noise.looked_at(motion.effort - slopes @ values, slopes, covariance)
            evidence = _log_evidence([noise], values, covariance, sds)
        total += evidence
    return total


def _summed(parts: Sequence[Normal]) -> Normal:
    precision = np.sum([one.precision for one in parts], axis=0)
    return Normal(precision, np.sum([one.pull for one in parts], axis=0))


def _log_evidence(noises: Sequence[Noise], values: Array, covariance: Array, sds: Array) -> float:
    """By Laplace's approximation."""
    density = sum(noise.log_density for noise in noises)
    scaled = covariance / np.multiply.outer(sds, sds)
    volume = 0.5 * float(np.linalg.slogdet(scaled)[1])
    return density + volume - 0.5 * float(np.sum((values / sds) ** 2))
