"""Robust least squares of a bounce: Student's t by reweighting, Levenberg and Marquardt's steps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.bounce_model import (
    CONTACT,
    FALL,
    FREEDOM,
    HIGH,
    IMPACT,
    LOW,
    PERSPECTIVE,
    SPAN,
    BounceSamples,
)
from analysis.drop.projection import Projection
from tunenet_logs.arrays import Array

_BENDS = 16
"""Pieces of a drop in each of which a lens's distortion is much the same."""

_FARTHEST = 1.5
"""How far from its start a fall time or an impact may go: a factor e^1.5, 1.5 fall times."""

_LEAST_DAMPING, _MOST_TRIES = 1e-9, 6
"""Of Levenberg and Marquardt: damping below which a step is Gauss-Newton's, and dampings a step."""


@dataclass(frozen=True, eq=False)
class BounceFit:
    """A fitted bounce.

    Attributes:
        samples: what was fitted.
        unknowns: shape (14,), see `bounce_model`.
        free: which of them were fitted.
        residuals: in the positions' unit, shape (T,).
        scale: robust standard deviation of them, not below the samples' noise.
    """

    samples: BounceSamples
    unknowns: Array
    free: tuple[int, ...]
    residuals: Array
    scale: float

    @property
    def effective_sample_factor(self) -> float:
        """How many samples count as one where a lens distorts the picture: that is no noise."""
        most = max(len(self.residuals) / _BENDS - 1, 0.0)
        return 1 + self.samples.distortion_variance_fraction * most

    @property
    def tail_sd(self) -> float:
        """Standard deviation by what 9 of 10 residuals lie within."""
        return float(np.quantile(np.abs(self.residuals), 0.9)) / 1.645

    def misfit_cost(self, scale: float) -> float:
        """Minus the log likelihood: Student's t, without constants.

        Args:
            scale: standard deviation of a position.
        """
        squares = (self.residuals / scale) ** 2
        robust = 0.5 * (FREEDOM + 1) * np.log1p(squares / FREEDOM).sum()
        return float(robust + len(self.residuals) * np.log(scale))

    def prior_cost(self) -> float:
        """Minus the logarithm of the priors' density, of those with an unknown that is free."""
        priors = self.samples.priors(self.unknowns)
        return sum(one.cost for one in priors if one.slopes.keys() & set(self.free))

    def cost(self, scale: float) -> float:
        """Minus the log posterior density."""
        return self.misfit_cost(scale) + self.prior_cost()

    def normal_equations(self) -> tuple[Array, Array]:
        """Of the reweighted samples and the priors: the matrix, and minus the cost's gradient."""
        jacobian = self.samples.jacobian(self.unknowns, self.free)
        weights = (FREEDOM + 1) / (FREEDOM + (self.residuals / self.scale) ** 2) / self.scale**2
        normal = jacobian.T @ (weights[:, None] * jacobian)
        gradient = -jacobian.T @ (weights * self.residuals)
        for prior in self.samples.priors(self.unknowns):
            row = np.array([prior.slopes.get(index, 0.0) for index in self.free])
            normal += prior.weight * np.outer(row, row)
            gradient -= prior.weight * prior.off * row
        return normal, gradient

    def projection(self) -> Projection:
        """The unknowns by their names."""
        values = self.unknowns.tolist()
        return Projection(
            contact=values[CONTACT],
            span=values[SPAN],
            perspective=values[PERSPECTIVE],
            impact_s=values[IMPACT],
            fall_time_s=float(np.exp(values[FALL])),
            bounce=self.samples.bounce(self.unknowns),
            residual_rms=float(np.sqrt(np.mean(self.residuals**2))),
            residual_max=float(np.abs(self.residuals).max()),
            bends=tuple(
                zip(
                    self.samples.bends_s,
                    self.samples.bend_rates(self.unknowns).tolist(),
                    strict=True,
                )
            ),
        )


def fit_bounce(
    samples: BounceSamples,
    start: Array,
    free: tuple[int, ...],
    most: int = 30,
    gain: float = 1e-6,
    scale: float | None = None,
) -> BounceFit:
    """The posterior's mode: Student's t by reweighting (Lange et al. 1989), Levenberg-Marquardt.

    Args:
        samples: what to explain.
        start: all unknowns, shape (14,).
        free: which of them to fit.
        most: iterations.
        gain: in cost a sample that ends them.
        scale: standard deviation of a position; None to estimate it after each iteration.
    """
    low, high = LOW.copy(), HIGH.copy()
    for index, reach in ((FALL, _FARTHEST), (IMPACT, _FARTHEST * float(np.exp(start[FALL])))):
        low[index], high[index] = start[index] - reach, start[index] + reach
    low[SPAN] = 1e-3 * start[SPAN]
    chosen = list(free)
    unknowns = np.clip(start, low, high)
    residuals = samples.residuals(unknowns)
    first = scale or _scale(residuals, samples.noise)
    fit = BounceFit(samples, unknowns, free, residuals, first)
    cost, damping = fit.cost(first), 1e-3
    for _ in range(most):
        normal, gradient = fit.normal_equations()
        before = cost
        for _ in range(_MOST_TRIES):
            damped = normal + damping * np.diag(np.diag(normal) + 1e-12)
            begin = fit.unknowns[chosen]
            step = _bounded(damped, gradient, low[chosen] - begin, high[chosen] - begin)
            unknowns = fit.unknowns.copy()
            unknowns[chosen] += step
            tried = replace(fit, unknowns=unknowns, residuals=samples.residuals(unknowns))
            tried_cost = tried.cost(fit.scale)
            if tried_cost < cost:
                fit, cost = tried, tried_cost
                damping = max(damping / 10, _LEAST_DAMPING)
                break
            damping *= 10
        gained = before - cost
        new = scale or _scale(fit.residuals, samples.noise)
        settled = gained < gain * len(samples.seconds) and abs(new / fit.scale - 1) < 0.01
        fit = replace(fit, scale=new)
        cost = fit.cost(new)
        if settled:
            break
    return fit


def best_of(fits: list[BounceFit]) -> BounceFit:
    """The likeliest of fits to the same samples."""
    scale = min(fit.scale for fit in fits)
    return min(fits, key=lambda fit: fit.cost(scale))


def _bounded(normal: Array, gradient: Array, low: Array, high: Array) -> Array:
    """The step of normal equations; what would leave its bounds ends there, and the rest follows.

    A step that is merely cut would leave a narrow valley.
    """
    step = np.linalg.lstsq(normal, gradient, rcond=None)[0]
    out = (step < low) | (step > high)
    if out.any() and not out.all():
        step[out] = np.clip(step, low, high)[out]
        rest = gradient[~out] - normal[np.ix_(~out, out)] @ step[out]
        step[~out] = np.linalg.lstsq(normal[np.ix_(~out, ~out)], rest, rcond=None)[0]
    return np.clip(step, low, high).astype(np.float64)


def _scale(residuals: Array, noise: float) -> float:
    """Standard deviation by the median of the moduli, not below the noise."""
    return max(noise, 1.4826 * float(np.median(np.abs(residuals))))
