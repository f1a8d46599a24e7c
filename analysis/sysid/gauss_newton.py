"""Nonlinear least squares by rollouts: Levenberg-Marquardt with finite differences.

The columns' noise is not known beforehand: in the end, each is weighted by its residual.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from analysis.sysid.compared import ComparedColumns
from analysis.sysid.differences import Differences, differences
from recorders.simulators.base import Parameter
from tunenet_logs.arrays import Array

# Rollouts at values of shape (N, P) -> what they show at the log's stamps, shape (N, M).
Run = Callable[[Array], Array]

_MAX_STEPS, _MAX_DAMPINGS = 25, 7
# How often columns are weighed by what is left of them, and by how much that may still change.
_WEIGHED, _SAME_NOISE = 3, 0.1

_COARSE_SHARE, _JUMPY_FACTOR = 0.03, 5.0
_MAX_STEP = 0.5  # of a parameter's range
_FLAT = 1e-4  # precision of a parameter of which nothing is known, in its range
# Of the finite differences, as a share of a parameter's range; the first of a prior is 0.2.
_FIRST_DIFFERENCE, _MIN_DIFFERENCE, _MAX_DIFFERENCE = 3e-3, 1e-5, 2e-2

# Once it is known, a step changes what is seen by this many noises, rms: contacts and dry friction
# make rollouts rough where they are looked at more closely.
_CHANGE = 0.5

_WORTH = 2.0  # of the cost: what a parabola through it has to promise where no step helps
_FOLLOWED = 4  # steps of all others where one parameter is moved
# Standard deviations, and a change of the cost, below which a step is the last.
_STILL, _NO_GAIN = 0.05, 0.05

_LOST = 3.0  # spreads of a column that a sample counts as off where a rollout has diverged
# Of a column, as a share of its spread: a simulator is never weighed as more exact than this.
_MIN_NOISE = 1e-3


@dataclass(frozen=True, eq=False)
class Solution:
    """Least-squares solution.

    Attributes:
        values: Of all parameters, shape (P,).
        residuals: Simulated less observed, shape (M,).
        slopes: Jacobian of the rollouts, shape (M, P).
        noise: RMS residual of each column, shape (C,).
        path: The values of each step, the start first.
        chosen: Which of the M values it was fitted to.
        bends: Second differences of the rollouts, by the parameters, shape (P, M).
    """

    values: Array
    residuals: Array
    slopes: Array
    noise: Array
    path: tuple[Array, ...]
    chosen: NDArray[np.bool_]
    bends: Array


def ranges_of(parameters: Sequence[Parameter]) -> Array:
    """Return each parameter's scale: its range, or its prior's sd; shape (P,)."""
    widths = [
        one.training_range[1] - one.training_range[0] if one.prior_sd is None else one.prior_sd
        for one in parameters
    ]
    return np.array(widths)


@dataclass(eq=False)
class RolloutLeastSquares:
    """Least squares on one log.

    Attributes:
        run: Makes rollouts.
        target: Columns to compare with.
        parameters: All that are fitted, P of them.
        until_s: Later samples are left out; None for all.
    """

    run: Run
    target: ComparedColumns
    parameters: tuple[Parameter, ...]
    until_s: float | None = None

    def __post_init__(self) -> None:
        self._scales = ranges_of(self.parameters)
        self._bounds = np.array([one.bounds for one in self.parameters]).T
        self._centres = np.array([one.initial for one in self.parameters])
        self._precision = np.array(
            [0.0 if one.prior_sd is None else one.prior_sd**-2 for one in self.parameters]
        )
        ends = self.target.end_s if self.until_s is None else self.until_s
        self.chosen = self.target.seconds <= ends
        self._spread = np.array([column.spread for column in self.target.columns])
        self._floor = np.maximum(_MIN_NOISE * self._spread, 1e-12)
        has_prior = self._precision > 0
        self._least = _MIN_DIFFERENCE * self._scales
        self._most = np.where(has_prior, 1.0, _MAX_DIFFERENCE) * self._scales
        self._steps = np.where(has_prior, 0.2, _FIRST_DIFFERENCE) * self._scales
        self._known: Differences | None = None

    def residuals(self, values: Array) -> Array:
        """Return simulated less observed, (N, M), at values of shape (N, P)."""
        off = self.run(values) - self.target.values
        lost = self.target.per_value(_LOST * self._spread)
        return np.where(np.isfinite(off), off, lost)

    def cost(self, residuals: Array, values: Array, noise: Array) -> float:
        """Return twice the negative log likelihood and prior, up to a constant.

        Args:
            residuals: Shape (M,).
            values: They belong to, shape (P,).
            noise: Of each column, shape (C,).
        """
        scaled = residuals / self.target.per_value(noise)
        fit = float(np.sum(scaled[self.chosen] ** 2))
        return fit + float(np.sum(self._precision * (values - self._centres) ** 2))

    def curvature(self, solution: Solution, along: Array) -> float:
        """Return the linearised rise of the cost per squared step along (P,)."""
        weights = self.chosen / self.target.per_value(solution.noise) ** 2
        change = solution.slopes @ along
        prior = float(np.sum(self._precision * along**2))
        return max(float(np.sum(weights * change**2)) + prior, 1e-300)

    def inflation(self, solution: Solution) -> Array:
        """Return the ratio of each sd to that with all others known, shape (P,)."""
        normal, _ = self._equations(
            solution.values, solution.residuals, solution.slopes, solution.noise
        )
        return np.sqrt(np.diag(normal) * np.diag(np.linalg.inv(normal)))

    def follow(
        self, solution: Solution, number: int, step: float, along: Array
    ) -> tuple[float, float]:
        """Return the profile cost: one parameter a step off, all others refitted.

        Args:
            solution: Where to start.
            number: Of the parameter.
            step: How far it is off.
            along: How the others follow, by its unit, shape (P,).

        Returns:
            The cost, and how far the parameter is off within its bounds.
        """
        values = np.clip(solution.values + step * along, *self._bounds)
        others = np.arange(len(values)) != number
        residuals = self.residuals(values[None])[0]
        least = self.cost(residuals, values, solution.noise)
        for _ in range(_FOLLOWED):
            normal, slope = self._equations(values, residuals, solution.slopes, solution.noise)
            step_by = np.zeros(len(values))
            step_by[others] = -np.linalg.solve(normal[np.ix_(others, others)], slope[others])
            tried = np.clip(values + step_by * self._scales, *self._bounds)
            off = self.residuals(tried[None])[0]
            cost = self.cost(off, tried, solution.noise)
            if cost >= least:
                break
            gain = least - cost
            values, residuals, least = tried, off, cost
            if gain < _NO_GAIN:
                break
        return least, abs(float(values[number] - solution.values[number]))

    def left(self, residuals: Array) -> Array:
        """Return the RMS residual of each column, shape (C,)."""
        return np.maximum(self.target.rms(residuals, self.chosen), self._floor)

    def coarse(self) -> Array:
        """Return the residual scale of each column far from the solution, shape (C,).

        Columns that jump do not count where others do: whether their jumps meet says nothing of how
        far off a delay is.
        """
        noise = np.array([column.noise for column in self.target.columns])
        jumpy = np.array([column.is_jumpy for column in self.target.columns])
        off = np.maximum(np.maximum(self._floor, _COARSE_SHARE * self._spread), noise)
        return off if jumpy.all() else np.where(jumpy, _JUMPY_FACTOR * off, off)

    def solve(self, start: Array) -> Solution:
        """Iterate from values of shape (P,) until steps are small beside the noise.

        All columns have equal weight at first; then each by its residual.
        """
        values = np.clip(start, *self._bounds)
        path = [values]
        residuals = self.residuals(values[None])[0]
        noise = self.coarse()
        if np.any(self.left(residuals) > noise):
            values, residuals = self._descend(values, residuals, noise, path)
        for _ in range(_WEIGHED):
            noise = self.left(residuals)
            values, residuals = self._descend(values, residuals, noise, path, is_central=True)
            if np.allclose(self.left(residuals), noise, rtol=_SAME_NOISE):
                break
        seen = self._differences(values, residuals, is_central=True)
        return Solution(values, residuals, seen.slopes, noise, tuple(path), self.chosen, seen.bends)

    def _descend(
        self,
        values: Array,
        residuals: Array,
        noise: Array,
        path: list[Array],
        *,
        is_central: bool = False,
    ) -> tuple[Array, Array]:
        """Descend with fixed noise of each column; append each step to the path."""
        cost = self.cost(residuals, values, noise)
        damping = 1e-4
        for _ in range(_MAX_STEPS):
            beside = self._differences(values, residuals, is_central=is_central)
            normal, slope = self._equations(values, residuals, beside.slopes, noise)
            sd = np.sqrt(np.diag(np.linalg.inv(normal))) * self._scales
            seen = np.sqrt(np.diag(normal) / self.chosen.sum()) / self._scales
            self._steps = np.clip(_CHANGE / seen, self._least, self._most)
            tried, off, new = values, residuals, cost
            for tries in range(_MAX_DAMPINGS):
                step = self._step(values, normal, slope, damping)
                tried = np.clip(values + step, *self._bounds)
                if np.all(np.abs(tried - values) < _STILL * sd):
                    if not tries:
                        return values, residuals
                    break
                off = self.residuals(tried[None])[0]
                new = self.cost(off, tried, noise)
                if new < cost:
                    break
                damping = max(damping, 1e-3) * 10
            if new >= cost:  # slopes over a kink may point uphill
                lowest = beside.lowest(partial(self.cost, noise=noise), _WORTH)
                if lowest is None:
                    return values, residuals
                tried, damping = np.clip(lowest, *self._bounds), 1e-4
                off = self.residuals(tried[None])[0]
                new = self.cost(off, tried, noise)
                if new >= cost:
                    return values, residuals
            damping = max(damping / 30, 1e-7)
            moved, gain = np.abs(tried - values), cost - new
            values, residuals, cost = tried, off, new
            path.append(values)
            if np.all(moved < _STILL * sd) or gain < _NO_GAIN:
                break
        return values, residuals

    def _differences(
        self, values: Array, residuals: Array, *, is_central: bool = False
    ) -> Differences:
        """Return differences, one-sided on the way, central at its end; reuse near ones."""
        known = self._known
        enough = known is not None and known.is_central >= is_central
        if known is None or not enough or not known.is_near(values, self._steps):
            known = differences(
                self.residuals, values, residuals, self._steps, self._bounds, is_central=is_central
            )
        self._known = known
        return known

    def one_step(self, solution: Solution) -> tuple[Array, Array]:
        """Refit to the chosen samples by one Gauss-Newton step from another solution.

        Its slopes are those of the other: if a solution explains what is left out, too, the step is
        small.
        """
        noise = self.left(solution.residuals)
        values = solution.values
        normal, slope = self._equations(values, solution.residuals, solution.slopes, noise)
        tried = np.clip(values + self._step(values, normal, slope, 0.0), *self._bounds)
        return tried, self.residuals(tried[None])[0]

    def _equations(
        self, values: Array, residuals: Array, slopes: Array, noise: Array
    ) -> tuple[Array, Array]:
        """Return the normal equations in units of the ranges: (P, P) and (P,)."""
        weights = self.chosen / self.target.per_value(noise) ** 2
        scaled = slopes * self._scales
        precision = self._precision * self._scales**2
        normal = scaled.T @ (weights[:, None] * scaled)
        normal[np.diag_indices_from(normal)] += precision + _FLAT
        slope = scaled.T @ (weights * residuals)
        return normal, slope + precision * (values - self._centres) / self._scales

    def _step(self, values: Array, normal: Array, slope: Array, damping: float) -> Array:
        """Return a damped step, shape (P,), with active bounds fixed."""
        low, high = self._bounds
        free = ~(((values <= low) & (slope > 0)) | ((values >= high) & (slope < 0)))
        step = np.zeros(len(values))
        part = normal[np.ix_(free, free)]
        step[free] = -np.linalg.solve(part + damping * np.diag(np.diag(part)), slope[free])
        tuned = np.abs(step[self._precision == 0]).max(initial=0.0)
        return step * self._scales * min(1.0, _MAX_STEP / max(tuned, 1e-12))
