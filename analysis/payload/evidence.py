"""Linear terms whose scales the samples themselves decide on.

Each group of terms (all joints' offsets, say) has one scale: near 0 where a log shows none of it,
over 1 where it shows more than is usual. The likeliest scales are found together (type II maximum
likelihood, MacKay 1992); what the samples cannot tell of a scale is then averaged over, one group
at a time, and widens the answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array

_LEAST, _MOST, _MOST_KNOWN = -7.0, 2.5, 1.1
"""Of a scale's logarithm: a thousandth; twelve times what is usual; three times that of what a
maker or a calibration states. More of that would make any arm fit any torques."""

KNOWN = ("links", "gain", "tilt", "zeros", "lag", "hoses and gears")
"""Groups of that kind; hoses without a bound would carry an arm's weight."""

_DOWN, _UP = 2.5, 0.6
"""How fast a scale's prior falls below and above 1: in so many logarithms to a third."""

_GRID = np.array([-7.0, -4.0, -2.5, -1.5, -0.75, 0.0, 0.5, 1.0, 1.6, 2.3])
"""Logarithms of scales that are averaged over."""

_IDEAL_ODDS = float(np.log(0.3 / 0.7))
"""Natural log of the odds that a log is a simulator's."""

_FLOOR = 1e-12
"""Of a variance, by the largest: rounding makes no variance 0."""


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """What weighted samples say of linear terms: all that least squares needs of them.

    Attributes:
        precision: slopes' sum of squares A^T W A, shape (N, N).
        gradient: A^T W y, of the log likelihood at 0, shape (N,).
    """

    precision: Array
    gradient: Array

    def marginal(self, kept: NDArray[np.int64], sds: Array) -> NormalEquations:
        """What the samples say of some terms, whatever the others are.

        Args:
            kept: indices of the terms that stay, shape (K,).
            sds: of the others' priors about 0, shape (N,); those of the kept terms do not count.
        """
        others = np.setdiff1d(np.arange(len(sds)), kept)
        scale = sds[others]
        # In units of the priors, so that one of width 0 is no special case.
        inner = scale[:, None] * self.precision[np.ix_(others, others)] * scale
        inner[np.diag_indices_from(inner)] += 1.0
        across = self.precision[np.ix_(kept, others)] * scale
        solved = np.linalg.solve(inner, np.column_stack([across.T, scale * self.gradient[others]]))
        precision = self.precision[np.ix_(kept, kept)] - across @ solved[:, :-1]
        gradient = self.gradient[kept] - across @ solved[:, -1]
        seen = np.diag(precision) > 0  # rounding may leave less of what shows nothing
        return NormalEquations(
            (precision + precision.T) / 2 * np.outer(seen, seen), gradient * seen
        )

    def among(self, indices: NDArray[np.int64], count: int) -> NormalEquations:
        """The same of `count` terms, of which these are the ones at `indices`."""
        precision, gradient = np.zeros((count, count)), np.zeros(count)
        precision[np.ix_(indices, indices)] = self.precision
        gradient[indices] = self.gradient
        return NormalEquations(precision, gradient)


@dataclass(frozen=True, eq=False)
class TermPosterior:
    """Of all terms.

    Attributes:
        means: shape (N,).
        root: R of the covariance R^T R, shape (N, N).
        sds: of the priors, shape (N,).
        log_evidence: of the samples under these priors, up to what all priors share.
    """

    means: Array
    root: Array
    sds: Array
    log_evidence: float

    @cached_property
    def covariance(self) -> Array:
        """Shape (N, N)."""
        return self.root.T @ self.root

    @cached_property
    def variances(self) -> Array:
        """The covariance's diagonal, which a search needs without the rest, shape (N,)."""
        return np.einsum("ij,ij->j", self.root, self.root)


def posterior(normal: NormalEquations, sds: Array) -> TermPosterior:
    """Under normal priors about 0 of these standard deviations, shape (N,).

    Solved in units of the priors, so that a prior of width 0 is no special case.
    """
    from scipy.linalg import cholesky, get_lapack_funcs

    inner = sds[:, None] * normal.precision * sds
    inner[np.diag_indices_from(inner)] += 1.0
    factor = cholesky(inner, lower=True, check_finite=False)
    (inverse,) = get_lapack_funcs(("trtri",), (factor,))
    root = inverse(factor, lower=1)[0] * sds
    means = root.T @ (root @ normal.gradient)
    log_det = 2 * float(np.sum(np.log(np.diag(factor))))
    evidence = 0.5 * float(means @ normal.gradient) - 0.5 * log_det
    return TermPosterior(means, root, sds, evidence)


def likeliest_scales(
    normal: NormalEquations,
    sds: Array,
    groups: Mapping[str, NDArray[np.int64]],
    start: Mapping[str, float],
    steps: int,
) -> dict[str, float]:
    """Logarithms of each group's scale.

    Args:
        normal: the samples.
        sds: priors at scale 1, shape (N,).
        groups: indices of the terms of each.
        start: where to begin.
        steps: of a quasi-Newton search.
    """
    from scipy.optimize import minimize

    names = tuple(groups)

    def cost(logs: Array) -> tuple[float, Array]:
        own = scaled(sds, groups, dict(zip(names, logs.tolist(), strict=True)))
        found = posterior(normal, own)
        squares = (found.means**2 + found.variances) / np.maximum(own, 1e-150) ** 2 - 1
        slopes = np.array([float(squares[groups[name]].sum()) for name in names])
        priors = [_log_prior(log) for log in logs.tolist()]
        value = found.log_evidence + sum(prior for prior, _ in priors)
        return -value, -(slopes + np.array([slope for _, slope in priors]))

    best: NDArray = minimize(
        cost,
        np.array([start.get(name, 0.0) for name in names]),
        jac=True,
        method="L-BFGS-B",
        bounds=[(_LEAST, _MOST_KNOWN if name in KNOWN else _MOST) for name in names],
        options={"maxiter": steps, "maxfun": 2 * steps},
    ).x
    return dict(zip(names, best.tolist(), strict=True))


def scaled(sds: Array, groups: Mapping[str, NDArray[np.int64]], logs: Mapping[str, float]) -> Array:
    """Priors at these scales, shape (N,)."""
    own = sds.copy()
    for name, indices in groups.items():
        own[indices] *= np.exp(logs.get(name, 0.0))
    return own


def averaged(
    found: TermPosterior,
    groups: Mapping[str, NDArray[np.int64]],
    logs: Mapping[str, float],
    interest: NDArray[np.int64],
) -> tuple[Array, Array]:
    """Means and covariance of some terms, over how large each group may be.

    To first order: what one group's scale changes is added up over the groups.

    Args:
        found: at the likeliest scales.
        groups: indices of the terms of each.
        logs: logarithms of the likeliest scales.
        interest: indices of the terms that are wanted, shape (I,).

    Returns:
        Shapes (I,) and (I, I).
    """
    count = len(interest)
    means, covariance = found.means[interest], found.covariance[np.ix_(interest, interest)]
    shift, wider = np.zeros(count), np.zeros((count, count))
    for name, indices in groups.items():
        rows = np.concatenate([interest, np.setdiff1d(indices, interest)])
        own = np.flatnonzero(np.isin(rows, indices))
        precision = np.linalg.inv(found.covariance[np.ix_(rows, rows)])
        gradient = precision @ found.means[rows]
        priors = found.sds[rows[own]] / np.exp(logs[name])
        precision[own, own] -= 1 / found.sds[rows[own]] ** 2
        tried: list[tuple[float, NDArray, NDArray]] = []
        for log in _GRID[(_MOST_KNOWN if name in KNOWN else _MOST) > _GRID]:
            under = precision.copy()
            under[own, own] += 1 / (priors * np.exp(log)) ** 2
            spread = np.linalg.inv(under)
            middle = spread @ gradient
            evidence = 0.5 * float(middle @ gradient) - 0.5 * float(np.linalg.slogdet(under)[1])
            weight = evidence - len(own) * log + _log_prior(float(log))[0]
            tried.append((weight, middle[:count], spread[:count, :count]))
        weights = np.exp(np.array([one[0] for one in tried]) - max(one[0] for one in tried))
        weights /= weights.sum()
        middle = sum(weight * one[1] for weight, one in zip(weights, tried, strict=True))
        shift += middle - means
        for weight, (_, at, spread) in zip(weights, tried, strict=True):
            wider += weight * (spread - covariance + np.outer(at - middle, at - middle))
    return means + shift, _at_least(covariance + wider, 0.5 * covariance)


def without(
    normal: NormalEquations,
    found: TermPosterior,
    groups: Mapping[str, NDArray[np.int64]],
    logs: Mapping[str, float],
    absent: Sequence[str],
) -> tuple[TermPosterior, float]:
    """The same terms where some groups are not there at all, as in a simulation.

    Args:
        normal: the samples.
        found: with all groups.
        groups: indices of the terms of each.
        logs: logarithms of the likeliest scales.
        absent: groups that are not there.

    Returns:
        The terms, and the probability of that before all else is weighed: 3 of 10 logs are such.
    """
    gone = [name for name in absent if name in groups]
    sds = scaled(found.sds, groups, {name: _LEAST - logs[name] for name in gone})
    ideal = posterior(normal, sds)
    priors = sum(_log_prior(logs[name])[0] for name in gone)
    odds = ideal.log_evidence - posterior(normal, found.sds).log_evidence - priors + _IDEAL_ODDS
    return ideal, float(1 / (1 + np.exp(-np.clip(odds, -500, 500))))


def _at_least(covariance: Array, least: Array) -> Array:
    """A covariance that is nowhere below another one."""
    root = np.linalg.cholesky(least + _FLOOR * np.max(np.diag(least)) * np.eye(len(least)))
    inside = np.linalg.solve(root, np.linalg.solve(root, covariance).T)
    values, axes = np.linalg.eigh((inside + inside.T) / 2)
    return root @ (axes * np.maximum(values, 1.0)) @ axes.T @ root.T


def _log_prior(log: float) -> tuple[float, float]:
    """Of a scale's logarithm, up to a constant, and its slope."""
    up, down = np.exp(log / _UP), np.exp(-log / _DOWN)
    return -float(np.log(up + down)), -float((up / _UP - down / _DOWN) / (up + down))
