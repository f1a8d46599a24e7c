"""Gauss-Newton over all terms at once: their values, their scales, and what noise is left."""

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
from analysis.payload.held import LEAST_MASS_KG
from analysis.payload.same_path import TorqueRows, rows_of
from analysis.payload.torque_model import Convention, Linearization, LoggedArm
from analysis.payload.torque_terms import CENTRE, INERTIA, MASS, Terms
from tunenet_logs.arrays import Array

_MOST_LAG_S, _MOST_TURN_RAD = 0.2, 0.2
"""Lags, tilts and encoders' zeros are clipped here: torques are linear in them only while they are
small."""

_START_SHARE, _LEAST_SHARE = 0.02, 2e-5
"""Noise before anything is fitted, and of the best sensor, by what a joint is built for."""

_ANY_OFFSET = 2.5
"""Logarithm of a scale with which an offset explains any constant torque."""

_SCALE_STEPS = 12
"""Of the search for scales, in each iteration: it goes on where the last one ended. With 3 it stood
still for some, and a wrong convention looked likelier by 130."""


@dataclass(frozen=True, eq=False)
class GaussNewton:
    """A fit of all terms.

    Attributes:
        runs: the log and its tares.
        terms: the unknowns.
        convention: what the driver means by torque.
        known: what is known of the arm from elsewhere, about terms of 0; None for nothing.
        noises: of each series of rows (`same_path.rows_of`) and joint.
        found: the terms.
        logs: logarithms of the scale of each group.
        log_evidence: up to what all models of these runs share.
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
        """All terms at 0, the mean of their priors."""
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
        """Of each run, about the terms that are found."""
        return [run.linearized(self.found.means, self.convention) for run in self.runs]

    def rows(self, lines: Sequence[Linearization]) -> list[TorqueRows]:
        """What least squares sees of each run's linear model."""
        return rows_of(self.runs, lines, self.convention)

    def fitted(self, rows: Sequence[TorqueRows], at: Array, *, roughly: bool) -> GaussNewton:
        """The terms of linear models, the scales of their groups, then the noise that is left.

        Args:
            rows: of linear models of these runs.
            at: the values of the terms about which they are, shape (N,).
            roughly: whether it is only to be compared with others. Sensors' offsets may then be
                anything: what a driver means shows in how torques change, not in what they are.
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
        least_nm = _LEAST_SHARE * self.terms.scales_nm
        noises: list[Noises] = []
        for own, series in zip(self.noises, rows, strict=True):
            residual_nm = series.after_nm(found.means - at)
            fitted = told[series.columns[:, series.own]].sum(axis=1)
            noises.append(estimated(own, residual_nm, fitted, least_nm, roughly=roughly))
        return replace(self, noises=tuple(noises), found=found, logs=logs, log_evidence=evidence)

    def with_usual_offsets(self) -> GaussNewton:
        """The same, sensors' offsets no longer of any size."""
        return replace(self, logs={**self.logs, "offset": 0.0})

    @property
    def groups(self) -> dict[str, NDArray[np.int64]]:
        """Terms that share a scale; the payload's mass has none, and nothing else that is 0."""
        of = self.terms.of
        return {
            name: indices
            for name, indices in of.items()
            if name != "payload" and self.terms.sds[indices].all()
        }

    @property
    def _sds(self) -> Array:
        """At scale 1; those of the payload's centre and inertia are by its mass, shape (N,)."""
        sds = self.terms.sds.copy()
        mass_kg = max(abs(float(self.found.means[MASS])), LEAST_MASS_KG)
        sds[CENTRE] *= mass_kg
        sds[INERTIA] *= mass_kg
        return sds

    def normal_equations(self, rows: Sequence[TorqueRows], at: Array) -> NormalEquations:
        """Of the terms themselves, linear about `at`."""
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
        """Measured less predicted, the terms changed by `change` from where lines are, (T, J)."""
        measured_nm = self.runs[run].torques_nm(self.convention)
        return measured_nm - lines[run].predicted_nm - lines[run].moved_nm(change)

    def _clipped(self, found: TermPosterior) -> TermPosterior:
        means = found.means.copy()
        for name, most in (
            ("lag", _MOST_LAG_S),
            ("tilt", _MOST_TURN_RAD),
            ("zeros", _MOST_TURN_RAD),
        ):
            indices = self.terms.of[name]
            means[indices] = np.clip(means[indices], -most, most)
        return replace(found, means=means)
