"""Gauss-Newton over all terms at once: their values, their prior scales, and the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from analysis.payload.coloured_noise import Noises, estimated, unknown
from analysis.payload.evidence import (
    NormalEquations,
    TermPosterior,
    likeliest_scales,
    posterior,
    scaled,
)
from analysis.payload.held import MIN_MASS_KG
from analysis.payload.same_path import TorqueRows, rows_of
from analysis.payload.torque_model import Convention, Linearization, LoggedArm
from analysis.payload.torque_terms import CENTRE, INERTIA, MASS, Terms
from tunenet_logs.arrays import Array

# Lags, tilts and encoders' zeros are clipped here: torques are linear in them only while they are
# small.
_MAX_LAG_S, _MAX_TURN_RAD = 0.2, 0.2

# Noise before anything is fitted, and of the best sensor, by what a joint is built for.
_START_SHARE, _MIN_SHARE = 0.02, 2e-5

_ANY_OFFSET = 2.5  # logarithm of a scale with which an offset explains any constant torque
# Of the search for scales, in each iteration: it goes on where the last one ended. With 3 it stood
# still for some, and a wrong convention looked likelier by 130.
_SCALE_STEPS = 12


@dataclass(frozen=True, eq=False)
class GaussNewton:
    """Gauss-Newton iterate of all terms.

    Attributes:
        runs: The log and its tares.
        terms: The unknowns.
        convention: The driver's torque convention.
        known: Prior information on the arm, about terms of 0; None for nothing.
        noises: Of each series of rows (`same_path.rows_of`) and joint.
        found: Posterior of the terms.
        logs: Logarithms of the scale of each group.
        log_evidence: Up to a constant that all models of these runs share.
    """

    runs: tuple[LoggedArm, ...]
    terms: Terms
    convention: Convention
    known: NormalEquations | None
    noises: tuple[Noises, ...]
    found: TermPosterior
    logs: Mapping[str, float] = field(default_factory=dict)
    log_evidence: float = -np.inf

    @classmethod
    def start(
        cls,
        runs: tuple[LoggedArm, ...],
        convention: Convention,
        known: NormalEquations | None = None,
    ) -> GaussNewton:
        """Start with all terms at 0, the mean of their priors."""
        terms = runs[0].terms
        beside = next((run.covered for run in runs if run.covered is not None), None)
        log_s = runs[0].motion.seconds
        paired = [log_s[beside]] * 2 if beside is not None else [log_s]
        others = [run.motion.seconds for run in runs[1:] if run.covered is None]
        noises = tuple(
            tuple(unknown(seconds, _START_SHARE * scale) for scale in terms.scales_nm.tolist())
            for seconds in (*paired, *others)
        )
        sds = terms.sds
        nothing = TermPosterior(np.zeros(len(sds)), np.diag(sds), sds, -np.inf)
        return cls(runs, terms, convention, known, noises, nothing)

    def linearized(self) -> list[Linearization]:
        """Linearise each run about the present terms."""
        return [run.linearized(self.found.means, self.convention) for run in self.runs]

    def rows(self, lines: Sequence[Linearization]) -> list[TorqueRows]:
        """Build the least-squares rows of each run's linear model."""
        return rows_of(self.runs, lines, self.convention)

    def fitted(self, rows: Sequence[TorqueRows], at: Array, *, roughly: bool) -> GaussNewton:
        """Solve linear models for the terms, their groups' scales, then the noise of the residual.

        Args:
            rows: Of linear models of these runs.
            at: Terms about which they are linear, shape (N,).
            roughly: Whether it is only to be compared with others. Sensor offsets are then free: a
                convention shows in how torques change, not in what they are.
        """
        normal = self.normal_equations(rows, at)
        searched = self.groups
        if roughly:
            del searched["offset"]
        logs = likeliest_scales(normal, self._sds, searched, self.logs, _SCALE_STEPS)
        logs["offset"] = _ANY_OFFSET if roughly else logs["offset"]
        sds = scaled(self._sds, self.groups, logs)
        found = posterior(normal, sds)
        told = 1 - found.variances / np.maximum(sds, 1e-150) ** 2
        # A mass is 0 or more: its prior is half a normal one.
        mass_sds = float(found.means[MASS]) / float(np.sqrt(found.variances[MASS]))
        evidence = found.log_evidence + float(log_ndtr(mass_sds))
        for own, series in zip(self.noises, rows, strict=True):
            target = series.after_nm(-at)
            for joint in np.flatnonzero(series.used).tolist():
                evidence += own[joint].log_likelihood(target[:, joint])
        found = self._clipped(found)
        least_nm = _MIN_SHARE * self.terms.scales_nm
        noises: list[Noises] = []
        for own, series in zip(self.noises, rows, strict=True):
            residual_nm = series.after_nm(found.means - at)
            fitted = told[series.columns[:, series.own]].sum(axis=1)
            noises.append(estimated(own, residual_nm, fitted, least_nm, roughly=roughly))
        return replace(self, noises=tuple(noises), found=found, logs=logs, log_evidence=evidence)

    def with_usual_offsets(self) -> GaussNewton:
        """Return a copy whose sensor offsets have their usual prior again."""
        return replace(self, logs={**self.logs, "offset": 0.0})

    @property
    def groups(self) -> dict[str, NDArray[np.int64]]:
        """Terms that share a scale; the payload's mass and terms fixed at 0 have none."""
        of = self.terms.of
        return {
            name: indices
            for name, indices in of.items()
            if name != "payload" and self.terms.sds[indices].all()
        }

    @property
    def _sds(self) -> Array:
        """Prior deviations at scale 1, shape (N,); the payload's centre and inertia go by mass."""
        sds = self.terms.sds.copy()
        mass_kg = max(abs(float(self.found.means[MASS])), MIN_MASS_KG)
        sds[CENTRE] *= mass_kg
        sds[INERTIA] *= mass_kg
        return sds

    def normal_equations(self, rows: Sequence[TorqueRows], at: Array) -> NormalEquations:
        """Accumulate the normal equations of the terms, linear about `at`."""
        count = len(self.terms.sds)
        precision, gradient = np.zeros((count, count)), np.zeros(count)
        if self.known is not None:
            precision += self.known.precision
            gradient += self.known.gradient
        for noises, series in zip(self.noises, rows, strict=True):
            target = series.after_nm(-at)
            for joint in np.flatnonzero(series.used).tolist():
                columns, slopes = series.columns[joint], series.slopes[:, joint]
                weighed = noises[joint].weighed(slopes)
                precision[np.ix_(columns, columns)] += slopes.T @ weighed
                gradient[columns] += weighed.T @ target[:, joint]
        return NormalEquations(precision, gradient)

    def residual_nm(self, run: int, lines: Sequence[Linearization], change: Array) -> Array:
        """Return the residual after a `change` from the linearisation point, shape (T, J)."""
        measured_nm = self.runs[run].torques_nm(self.convention)
        return measured_nm - lines[run].predicted_nm - lines[run].moved_nm(change)

    def _clipped(self, found: TermPosterior) -> TermPosterior:
        means = found.means.copy()
        for name, most in (
            ("lag", _MAX_LAG_S),
            ("tilt", _MAX_TURN_RAD),
            ("zeros", _MAX_TURN_RAD),
        ):
            indices = self.terms.of[name]
            means[indices] = np.clip(means[indices], -most, most)
        return replace(found, means=means)
