"""Bayesian linear regression with hierarchical prior scales.

Each group of terms (all joints' offsets, say) has one scale: near 0 if a log shows none of it,
over 1 if it shows more than is usual. Scales are found together by evidence maximisation (type II
maximum likelihood, MacKay 1992); their uncertainty is then marginalised, one group at a time, and
widens the posterior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array

# Of a scale's logarithm: a thousandth; twelve times what is usual; three times that of what a maker
# or a calibration states. More of that would make any arm fit any torques.
_MIN, _MAX, _MAX_KNOWN = -7.0, 2.5, 1.1

# Groups of that kind; hoses without a bound would carry an arm's weight.
KNOWN = ("links", "gain", "tilt", "zeros", "lag", "hoses and gears")

# How fast a scale's prior falls below and above 1: in so many logarithms to a third.
_DOWN, _UP = 2.5, 0.6

# Logarithms of scales that are averaged over.
_GRID = np.array([-7.0, -4.0, -2.5, -1.5, -0.75, 0.0, 0.5, 1.0, 1.6, 2.3])

_IDEAL_ODDS = float(np.log(0.3 / 0.7))  # natural log of the odds that a log is a simulator's
_FLOOR = 1e-12  # of a variance, by the largest: rounding makes no variance 0


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Weighted normal equations: the sufficient statistics of linear least squares.

    Attributes:
        precision: A^T W A, shape (N, N).
        gradient: A^T W y, of the log likelihood at 0, shape (N,).
    """

    precision: Array
    gradient: Array

    def marginal(self, kept: NDArray[np.int64], sds: Array) -> NormalEquations:
        """Marginalise all but some terms (Schur complement).

        Args:
            kept: Indices of the terms that stay, shape (K,).
            sds: Of the others' priors about 0, shape (N,); those of the kept terms do not count.
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
        """Embed in `count` terms, of which these are the ones at `indices`."""
        precision, gradient = np.zeros((count, count)), np.zeros(count)
        precision[np.ix_(indices, indices)] = self.precision
        gradient[indices] = self.gradient
        return NormalEquations(precision, gradient)


@dataclass(frozen=True, eq=False)
class TermPosterior:
    """Gaussian posterior of all terms.

    Attributes:
        means: Shape (N,).
        root: R of the covariance R^T R, shape (N, N).
        sds: Of the priors, shape (N,).
        log_evidence: Of the samples under these priors, up to a constant that all priors share.
    """

    means: Array
    root: Array
    sds: Array
    log_evidence: float

    @cached_property
    def covariance(self) -> Array:
        """Posterior covariance, shape (N, N)."""
        return self.root.T @ self.root

    @cached_property
    def variances(self) -> Array:
        """Diagonal of the covariance, without the rest, shape (N,)."""
        return np.einsum("ij,ij->j", self.root, self.root)


def posterior(normal: NormalEquations, sds: Array) -> TermPosterior:
    """Compute the posterior under Gaussian priors about 0 of these standard deviations, shape (N,).

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
    """Find the logarithm of each group's prior scale by evidence maximisation.

    Args:
        normal: The samples.
        sds: Priors at scale 1, shape (N,).
        groups: Indices of the terms of each.
        start: Initial logarithms.
        steps: Of a quasi-Newton search.
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
        bounds=[(_MIN, _MAX_KNOWN if name in KNOWN else _MAX) for name in names],
        options={"maxiter": steps, "maxfun": 2 * steps},
    ).x
    return dict(zip(names, best.tolist(), strict=True))


def scaled(sds: Array, groups: Mapping[str, NDArray[np.int64]], logs: Mapping[str, float]) -> Array:
    """Scale the priors' standard deviations by group, shape (N,)."""
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
    """Marginalise the posterior of some terms over the groups' scales.

    To first order: the changes by each group's scale are added up.

    Args:
        found: At the likeliest scales.
        groups: Indices of the terms of each.
        logs: Logarithms of the likeliest scales.
        interest: Indices of the terms that are wanted, shape (I,).

    Returns:
        Means and covariance, shapes (I,) and (I, I).
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
        for log in _GRID[(_MAX_KNOWN if name in KNOWN else _MAX) > _GRID]:
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
    """Compute the posterior without some groups, as in a simulation, and its probability.

    Args:
        normal: The samples.
        found: With all groups.
        groups: Indices of the terms of each.
        logs: Logarithms of the likeliest scales.
        absent: Groups that are not there.

    Returns:
        The posterior, and its probability by Bayes factor; 3 of 10 logs are such a priori.
    """
    gone = [name for name in absent if name in groups]
    sds = scaled(found.sds, groups, {name: _MIN - logs[name] for name in gone})
    ideal = posterior(normal, sds)
    priors = sum(_log_prior(logs[name])[0] for name in gone)
    odds = ideal.log_evidence - posterior(normal, found.sds).log_evidence - priors + _IDEAL_ODDS
    return ideal, float(1 / (1 + np.exp(-np.clip(odds, -500, 500))))


def _at_least(covariance: Array, least: Array) -> Array:
    """Raise a covariance so that it is nowhere below another one."""
    root = np.linalg.cholesky(least + _FLOOR * np.max(np.diag(least)) * np.eye(len(least)))
    inside = np.linalg.solve(root, np.linalg.solve(root, covariance).T)
    values, axes = np.linalg.eigh((inside + inside.T) / 2)
    return root @ (axes * np.maximum(values, 1.0)) @ axes.T @ root.T


def _log_prior(log: float) -> tuple[float, float]:
    """Return the log prior of a scale's logarithm, up to a constant, and its slope."""
    up, down = np.exp(log / _UP), np.exp(-log / _DOWN)
    return -float(np.log(up + down)), -float((up / _UP - down / _DOWN) / (up + down))
