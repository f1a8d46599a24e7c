"""Laplace approximation of a ball's likelihood in slope and drag.

All other unknowns are marginalised in closed form. Where impacts were heard, each may return the
ball a little faster or slower than the law has it: these deviations are unknowns, too, which
pictures and sound share, and how large they are is left open (`SCATTERS`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.drop.bounce_fit import BounceFit
from analysis.drop.bounce_model import DRAG, FREEDOM, RESTITUTION, SLOPE, TOUCH
from analysis.drop.contact_bound import ContactBound
from analysis.drop.heard_touches import SCATTERS
from analysis.drop.own_restitutions import moved_by_own
from tunenet_logs.arrays import Array

# Standard deviations of slope and drag [1 / drop height] where the samples tell nothing.
WIDEST = (0.3, 0.5)

ANY_RESTITUTION_SD = 0.3  # of a restitution of which the samples tell nothing near the fit
# Added to each unknown's weight, of one: some that no sample moves are left where they are.
_UNKNOWN = 1e-12

# Times that samples are weighed anew by how far they are off, where deviations explain it.
_REWEIGHTED = 6


@dataclass(frozen=True, eq=False)
class BallLikelihood:
    """Normal likelihood of slope and drag, without their priors.

    Attributes:
        middle: most likely slope and drag times drop height, shape (2,).
        precision: of the two, shape (2, 2).
        value: the restitution there.
        moves: derivatives of the restitution by each of the two, shape (2,).
        restitution_sd: standard deviation given the two.
        log_evidence: logarithm of the likelihood there, without a constant.
        bound: on the contact's duration, where impacts were heard.
    """

    middle: Array
    precision: Array
    value: float
    moves: Array
    restitution_sd: float
    log_evidence: float = 0.0
    bound: ContactBound | None = None

    @property
    def sds(self) -> Array:
        """Standard deviations of slope and drag, shape (2,)."""
        return np.sqrt(np.diag(np.linalg.inv(self.precision + np.diag(np.array(WIDEST) ** -2))))

    @property
    def correlation(self) -> float:
        """Correlation of slope and drag."""
        covariance = np.linalg.inv(self.precision + np.diag(np.array(WIDEST) ** -2))
        return float(covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]))

    def log_density(self, slopes: Array, drags: Array) -> Array:
        """Return the log density (no constant) at slopes and drags * drop height, shape (M,)."""
        off = np.column_stack([slopes, drags]) - self.middle
        log = self.log_evidence - 0.5 * np.einsum("mi,ij,mj->m", off, self.precision, off)
        return log if self.bound is None else log + self.bound.log_likelihood(off)

    def restitution(self, slopes: Array, drags: Array) -> Array:
        """Return the likeliest restitution at each slope and drag, shape (M,)."""
        off = np.column_stack([slopes, drags]) - self.middle
        found = self.value + off @ self.moves
        return found if self.bound is None else found + self.bound.restitution_moved(off)

    def sd_of_all(self, slopes: Array, drags: Array, weights: Array) -> float:
        """Return the restitution's sd given slope and drag, averaged over both."""
        if self.bound is None:
            return self.restitution_sd
        off = np.column_stack([slopes, drags]) - self.middle
        taken = float(weights @ self.bound.variance_taken(off))
        return float(np.sqrt(max(self.restitution_sd**2 - taken, 0.0)))


def ball_likelihoods(fit: BounceFit, factor: float) -> list[BallLikelihood]:
    """Marginalise a fit's likelihood, `factor` samples as one; if impacts are heard, by scatter."""
    if fit.samples.heard is None:
        linear = _Linear.of(fit, factor)
        return [_of_law(fit, *linear.equations(*linear.weights()))]
    law = replace(fit.samples, heard=replace(fit.samples.heard, scatter=0.0))
    linear = _Linear.of(replace(fit, samples=law), factor)
    own = np.arange(len(fit.free), linear.jacobian.shape[1])
    known = np.diag(_known(fit, len(own)))
    weights = linear.weights()[0], np.ones(len(linear.off))
    for _ in range(_REWEIGHTED):
        normal, gradient = linear.equations(*weights)
        peaks = [_peak(one + known, gradient) for one in _scattered(normal, own)]
        log = np.array([peak[1] for peak in peaks]) + _log_priors(len(own))
        likely = np.exp(log - log.max())
        weights = linear.weights(likely @ np.array([peak[0] for peak in peaks]) / likely.sum())
    normal, gradient = linear.equations(*weights)
    found = [_of_law(fit, one, gradient) for one in _scattered(normal, own)]
    return [
        replace(one, log_evidence=one.log_evidence + float(prior))
        for one, prior in zip(found, _log_priors(len(own)), strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _Linear:
    """Samples and priors of a fit, linearised in its unknowns.

    Attributes:
        jacobian: of the positions over the fit's unknowns, and over each impact's deviation from
            the law where impacts were heard, shape (T, U).
        residuals: shape (T,).
        scale: of a residual.
        factor: how many samples count as one.
        rows: of the priors, in their standard deviations, shape (P, U).
        off: likewise, shape (P,).
        freedom: of each prior's t, shape (P,).
    """

    jacobian: Array
    residuals: Array
    scale: float
    factor: float
    rows: Array
    off: Array
    freedom: Array

    @classmethod
    def of(cls, fit: BounceFit, factor: float) -> _Linear:
        """Linearise a fit, without the priors of slope and drag."""
        samples, free = fit.samples, fit.free
        priors = [
            one
            for one in samples.priors(fit.unknowns)
            if one.measured or {SLOPE, DRAG}.isdisjoint(one.slopes)
        ]
        rows = np.array([[one.slopes.get(index, 0.0) / one.sd for index in free] for one in priors])
        jacobian = samples.jacobian(fit.unknowns, free)
        if samples.heard is not None:
            own, touches = moved_by_own(samples, fit.unknowns)
            beside = np.zeros((len(rows), own.shape[1]))
            beside[[one.measured for one in priors]] = samples.heard.whitening @ touches
            jacobian, rows = np.hstack([jacobian, own]), np.hstack([rows, beside])
        off = np.array([one.off / one.sd for one in priors])
        freedom = np.array([one.freedom for one in priors])
        return cls(jacobian, fit.residuals, fit.scale, factor, rows, off, freedom)

    def weights(self, step: Array | None = None) -> tuple[Array, Array]:
        """Reweight samples and priors by how far they are off after a step, shape (U,)."""
        residuals, off = self.residuals, self.off
        if step is not None:
            residuals, off = residuals + self.jacobian @ step, off + self.rows @ step
        seen = (FREEDOM + 1) / (FREEDOM + (residuals / self.scale) ** 2)
        is_normal = np.isinf(self.freedom)
        freedom = np.where(is_normal, 1.0, self.freedom)
        likely = np.where(is_normal, 1.0, (freedom + 1) / (freedom + off**2))
        return seen / (self.scale**2 * self.factor), likely

    def equations(self, seen: Array, likely: Array) -> tuple[Array, Array]:
        """Return the normal matrix and minus the gradient for such weights."""
        normal = self.jacobian.T @ (seen[:, None] * self.jacobian)
        normal += self.rows.T @ (likely[:, None] * self.rows)
        gradient = -self.jacobian.T @ (seen * self.residuals) - self.rows.T @ (likely * self.off)
        return normal, gradient


def _scattered(normal: Array, own: NDArray[np.intp]) -> list[Array]:
    """Add each scatter as the standard deviation of the deviations."""
    found: list[Array] = []
    for scatter in SCATTERS:
        found.append(normal.copy())
        found[-1][own, own] += scatter**-2
    return found


def _log_priors(count: int) -> Array:
    """Return each scatter's log prior, with the normalisation of so many deviations."""
    return np.log(list(SCATTERS.values())) - count * np.log(list(SCATTERS))


def _known(fit: BounceFit, more: int) -> Array:
    """Return the least that is known of a fit's unknowns, as weights, shape (U,)."""
    least = {RESTITUTION: ANY_RESTITUTION_SD, SLOPE: WIDEST[0], DRAG: WIDEST[1]}
    return np.array([least.get(index, np.inf) for index in fit.free] + [np.inf] * more) ** -2


def _peak(normal: Array, gradient: Array) -> tuple[Array, float]:
    """Return a normal likelihood's mode and the logarithm of its integral."""
    diagonal = np.diag(normal)
    unit = np.where(diagonal > 0, diagonal, 1.0) ** -0.5
    scaled = normal * np.outer(unit, unit) + _UNKNOWN * np.eye(len(unit))
    step = unit * np.linalg.solve(scaled, unit * gradient)
    log = 0.5 * gradient @ step - 0.5 * np.linalg.slogdet(scaled)[1] + np.log(unit).sum()
    return step, float(log)


def _of_law(fit: BounceFit, normal: Array, gradient: Array) -> BallLikelihood:
    """Marginalise all unknowns but slope and drag."""
    free = list(fit.free)
    normal = normal.copy()
    known = free.index(RESTITUTION)
    normal[known, known] += ANY_RESTITUTION_SD**-2  # a hop that is not seen tells little
    order = np.array([free.index(SLOPE), free.index(DRAG)])
    others = np.delete(np.arange(len(normal)), order)
    inverse = np.linalg.pinv(normal[np.ix_(others, others)])
    across = normal[np.ix_(others, order)]
    precision = normal[np.ix_(order, order)] - across.T @ inverse @ across
    pull = gradient[order] - across.T @ inverse @ gradient[others]
    step = np.linalg.inv(precision + np.diag(np.array(WIDEST) ** -2)) @ pull
    log = _peak(normal[np.ix_(others, others)], gradient[others])[1]

    def alone(index: int) -> tuple[float, Array, int]:
        """Return an unknown's likeliest value, how it moves with the two, and its row."""
        at = int(np.flatnonzero(others == free.index(index))[0])
        moves = -(inverse @ across)[at]
        value = fit.unknowns[index] + (inverse @ gradient[others])[at] + moves @ step
        return float(value), moves, at

    value, moves, at = alone(RESTITUTION)
    found = BallLikelihood(
        fit.unknowns[[SLOPE, DRAG]] + step,
        precision,
        value,
        moves,
        float(np.sqrt(inverse[at, at])),
        log + float(pull @ step - 0.5 * step @ precision @ step),
    )
    if fit.samples.heard is None:
        return found
    lasts_s, lasts_moves, row = alone(TOUCH)
    sd_s = float(np.sqrt(inverse[row, row]))
    bound = ContactBound(lasts_s, lasts_moves, sd_s, float(inverse[at, row]) / sd_s)
    return replace(found, bound=bound)
