"""Robust MAP fit of a bounce: Student's t by reweighting, Levenberg-Marquardt steps."""

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

_BENDS = 16  # pieces of a drop in each of which a lens's distortion is much the same
# How far from its start a fall time or an impact may go: a factor e^1.5, 1.5 fall times.
_FARTHEST = 1.5

# Of Levenberg and Marquardt: damping below which a step is Gauss-Newton's, and dampings a step.
_MIN_DAMPING, _MAX_TRIES = 1e-9, 6


@dataclass(frozen=True, eq=False)
class BounceFit:
    """Bounce fitted to samples.

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
        """Samples that count as one where a lens distorts the picture: that is no noise."""
        most = max(len(self.residuals) / _BENDS - 1, 0.0)
        return 1 + self.samples.distortion_variance_fraction * most

    @property
    def tail_sd(self) -> float:
        """Standard deviation by the 90 % quantile of the absolute residuals."""
        return float(np.quantile(np.abs(self.residuals), 0.9)) / 1.645

    def misfit_cost(self, scale: float) -> float:
        """Return the negative Student's t log likelihood for a position sd, without constants."""
        squares = (self.residuals / scale) ** 2
        robust = 0.5 * (FREEDOM + 1) * np.log1p(squares / FREEDOM).sum()
        return float(robust + len(self.residuals) * np.log(scale))

    def prior_cost(self) -> float:
        """Return the negative log density of the priors that involve a free unknown."""
        priors = self.samples.priors(self.unknowns)
        return sum(one.cost for one in priors if one.slopes.keys() & set(self.free))

    def cost(self, scale: float) -> float:
        """Return the negative log posterior density."""
        return self.misfit_cost(scale) + self.prior_cost()

    def normal_equations(self) -> tuple[Array, Array]:
        """Return the reweighted normal matrix with the priors, and minus the cost's gradient."""
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
        """Return the fitted camera and ball."""
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
    """Fit the posterior mode: Student's t by reweighting (Lange et al. 1989), Levenberg-Marquardt.

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
        for _ in range(_MAX_TRIES):
            damped = normal + damping * np.diag(np.diag(normal) + 1e-12)
            begin = fit.unknowns[chosen]
            step = _bounded(damped, gradient, low[chosen] - begin, high[chosen] - begin)
            unknowns = fit.unknowns.copy()
            unknowns[chosen] += step
            tried = replace(fit, unknowns=unknowns, residuals=samples.residuals(unknowns))
            tried_cost = tried.cost(fit.scale)
            if tried_cost < cost:
                fit, cost = tried, tried_cost
                damping = max(damping / 10, _MIN_DAMPING)
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
    """Return the likeliest of several fits to the same samples."""
    scale = min(fit.scale for fit in fits)
    return min(fits, key=lambda fit: fit.cost(scale))


def _bounded(normal: Array, gradient: Array, low: Array, high: Array) -> Array:
    """Solve the normal equations within bounds: what would leave them ends there, the rest follows.

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
    """Estimate the standard deviation by the median absolute residual, not below the noise."""
    return max(noise, 1.4826 * float(np.median(np.abs(residuals))))
