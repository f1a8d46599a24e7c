"""Least squares by rollouts: Gauss-Newton steps with finite differences, damped where they fail.

The columns' noise is not known beforehand: each column is weighed by what is left of it, so that
the cost is that of a normal likelihood from which the variances are maximized out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from analysis.sysid.compared import Compared
from recorders.simulators.base import Parameter
from tunenet_logs.arrays import Array

Run = Callable[[Array], Array]
"""Rollouts at values of shape (N, P) -> what they show at the log's stamps, shape (N, M)."""

_MOST_STEPS, _MOST_DAMPINGS = 25, 7
_STEP = 1e-3
"""Of the finite differences, as a share of a parameter's range or of its prior."""

_STILL = 0.02
"""Standard deviations: a step below this many is the last."""

_LOST = 3.0
"""Spreads of a column that a sample counts as off where a rollout has diverged."""

_LEAST_NOISE = 1e-4
"""Of a column, as a share of its spread: a simulator is never weighed as more exact than this."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the steps end.

    Attributes:
        values: of all parameters, shape (P,).
        residuals: simulated less observed, shape (M,).
        slopes: of what the rollouts show by the parameters, shape (M, P).
        noise: what is left of each column, shape (C,).
        cost: twice the negative logarithm of the likelihood, but for a constant.
        path: the values of each step, the start first.
        chosen: which of the M values it was fitted to.
    """

    values: Array
    residuals: Array
    slopes: Array
    noise: Array
    cost: float
    path: tuple[Array, ...]
    chosen: Array


def ranges_of(parameters: Sequence[Parameter]) -> Array:
    """What a parameter is expected to vary by, shape (P,)."""
    widths = [
        one.training_range[1] - one.training_range[0] if one.prior_sd is None else one.prior_sd
        for one in parameters
    ]
    return np.array(widths)


@dataclass(eq=False)
class GaussNewton:
    """Least squares on one log.

    Attributes:
        run: makes rollouts.
        target: what they are compared with.
        parameters: all that are looked for, P of them.
        until_s: later samples are left out; None for all.
    """

    run: Run
    target: Compared
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
        noise = np.array([column.noise for column in self.target.columns])
        self._floor = np.maximum(np.maximum(noise, _LEAST_NOISE * self._spread), 1e-12)

    def residuals(self, values: Array) -> Array:
        """Simulated less observed at values of shape (N, P), shape (N, M)."""
        off = self.run(values) - self.target.values
        lost = self.target.per_value(_LOST * self._spread)
        return np.where(np.isfinite(off), off, lost)

    def cost(self, residuals: Array, values: Array) -> float:
        """See `Solution.cost`."""
        left = self.noise(residuals)
        counts = np.bincount(self.target.which[self.chosen], minlength=len(left))
        squares = self.target.rms(residuals, self.chosen) ** 2
        fit = float(np.sum(counts * (2 * np.log(left) + squares / left**2)))
        return fit + float(np.sum(self._precision * (values - self._centres) ** 2))

    def noise(self, residuals: Array) -> Array:
        """What is left of each column, but no less than its noise, shape (C,)."""
        return np.maximum(self.target.rms(residuals, self.chosen), self._floor)

    def solve(self, start: Array) -> Solution:
        """Step from values of shape (P,) until steps are small beside what the noise allows."""
        values = np.clip(start, *self._bounds)
        residuals = self.residuals(values[None])[0]
        cost = self.cost(residuals, values)
        path = [values]
        damping = 1e-3
        for _ in range(_MOST_STEPS):
            slopes = self._slopes(values, residuals)
            step = None
            for _ in range(_MOST_DAMPINGS):
                step, sd = self._step(values, residuals, slopes, damping)
                tried = np.clip(values + step, *self._bounds)
                off = self.residuals(tried[None])[0]
                new = self.cost(off, tried)
                if new < cost:
                    damping = max(damping / 10, 1e-7)
                    break
                if np.all(np.abs(tried - values) < _STILL * sd):
                    step = None
                    break
                damping = max(damping, 1e-4) * 10
            else:
                step = None
            if step is None:
                break
            moved = np.abs(tried - values)
            values, residuals, cost = tried, off, new
            path.append(values)
            if np.all(moved < _STILL * sd):
                break
        slopes = self._slopes(values, residuals, is_central=True)
        noise = self.noise(residuals)
        return Solution(values, residuals, slopes, noise, cost, tuple(path), self.chosen)

    def _slopes(self, values: Array, residuals: Array, *, is_central: bool = False) -> Array:
        """Finite differences, shape (M, P): to one side on the way, to both at its end."""
        low, high = self._bounds
        steps = _STEP * self._scales
        steps = np.where(values + steps > high, -steps, steps)
        count = len(values)
        rows = np.repeat(values[None], 2 * count if is_central else count, axis=0)
        for number in range(count):
            rows[number, number] += steps[number]
            if is_central and low[number] <= values[number] - steps[number] <= high[number]:
                rows[count + number, number] -= steps[number]
        off = self.residuals(rows)
        before = off[count:] if is_central else np.repeat(residuals[None], count, axis=0)
        widths = np.diag(rows[:count]) - (np.diag(rows[count:]) if is_central else values)
        return ((off[:count] - before) / widths[:, None]).T

    def _step(
        self, values: Array, residuals: Array, slopes: Array, damping: float
    ) -> tuple[Array, Array]:
        """A damped step, and what the noise leaves unsure of each parameter; each shape (P,)."""
        weights = self.chosen / self.target.per_value(self.noise(residuals)) ** 2
        scaled = slopes * self._scales
        normal = scaled.T @ (weights[:, None] * scaled)
        precision = self._precision * self._scales**2
        slope = scaled.T @ (weights * residuals)
        slope += precision * (values - self._centres) / self._scales
        normal[np.diag_indices_from(normal)] += precision + 1e-4
        low, high = self._bounds
        held = ((values <= low) & (slope > 0)) | ((values >= high) & (slope < 0))
        free = ~held
        step, sd = np.zeros(len(values)), np.zeros(len(values))
        part = normal[np.ix_(free, free)]
        damped = part + damping * np.diag(np.diag(part))
        step[free] = -np.linalg.solve(damped, slope[free])
        sd[free] = np.sqrt(np.diag(np.linalg.inv(part)))
        most = np.abs(step).max(initial=0.0)
        if most > 0.5 * len(step) and not self._precision.all():
            step *= 0.5 * len(step) / most
        return step * self._scales, np.maximum(sd, 1e-9) * self._scales
