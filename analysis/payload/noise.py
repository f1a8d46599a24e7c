"""Noise of joint torques, and Bayesian linear regression with hierarchical prior scales.

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
from scipy.linalg import cho_solve_banded, cholesky, cholesky_banded, get_lapack_funcs

from tunenet_logs.episode import Array

# ---- Noise of a series: white noise plus an Ornstein-Uhlenbeck process
# Unmodelled effects (ripple, hoses, warming) look like correlated noise; taken for white, intervals
# would be too narrow. The process has a tridiagonal precision at any stamps: weighting costs O(T).


@dataclass(frozen=True, eq=False)
class SeriesNoise:
    """Noise of one joint's torques in one run."""

    seconds: Array  # of the samples [s], shape (T,)
    weights: Array  # of each sample's white noise: 1, less for spikes, shape (T,)
    white_nm: float  # standard deviation of the white part
    wander_nm: float  # of the Ornstein-Uhlenbeck part; 0 for none
    time_s: float  # its time constant

    @cached_property
    def _factor(self) -> tuple[Array, float]:
        """Cholesky factor of both parts' precision, and the log det of the correlated one's."""
        both, log_det = _walk(self.seconds, self.time_s, self.wander_nm)
        both[1] += self.weights / self.white_nm**2
        return cholesky_banded(both), log_det

    def weighed(self, columns: Array) -> Array:
        """Multiply columns, shape (T, C), by the inverse covariance."""
        white = (self.weights / self.white_nm**2)[:, None]
        weighed = white * columns
        if not self.wander_nm:
            return weighed
        return weighed - white * cho_solve_banded((self._factor[0], False), weighed)

    def wandering(self, residual: Array) -> Array:
        """Estimate the correlated part of residuals, shape (T,): its posterior mean."""
        if not self.wander_nm:
            return np.zeros_like(residual)
        weighed = self.weights / self.white_nm**2 * residual
        return cho_solve_banded((self._factor[0], False), weighed)

    def log_likelihood(self, residual: Array) -> float:
        """Return the log likelihood of residuals, (T,); spikes' weights are not in the log det."""
        log_det = 2 * len(self.seconds) * np.log(self.white_nm)
        if self.wander_nm:
            factor, of_walk = self._factor
            log_det = log_det + 2 * np.sum(np.log(factor[1])) - of_walk
        weighed = self.weighed(residual[:, None])[:, 0]
        return -0.5 * (float(residual @ weighed) + float(log_det))


Noises = tuple[SeriesNoise, ...]  # of each joint in one run


def estimated(
    before: Noises, residual_nm: Array, fitted: Array, least_nm: Array, *, roughly: bool
) -> Noises:
    """Estimate the noise of a fit's residuals by maximum likelihood.

    All time constants and variances of all joints are one banded system, without a link between
    them: one call instead of hundreds. `residual_nm` (T, J) [N·m], `fitted` (J,), `least_nm` (J,).
    """
    count, joints = residual_nm.shape
    seconds = before[0].seconds
    left = np.column_stack(
        [
            residual - noise.wandering(residual)
            for noise, residual in zip(before, residual_nm.T, strict=True)
        ]
    )
    # By the middle: spikes do not count.
    usual = np.maximum(np.median(np.abs(left), axis=0) / 0.6745, least_nm)
    spike_sds = 3.5  # beyond it a sample counts for less: 1 of 2000 where noise is normal
    weights = (spike_sds / np.maximum(np.abs(left) / usual, spike_sds)) ** 2
    # Time constants [s], and variances by the white one's, that are tried.
    step = 2 if roughly else 1
    times_s = (0.15, 0.5, 1.5, 5.0)[::step]
    ratios = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)[::step]
    tried = [(time_s, ratio) for time_s in times_s for ratio in ratios]
    bands, walks = np.zeros((2, len(tried), joints, count)), np.zeros(len(tried))
    for number, (time_s, ratio) in enumerate(tried):
        walk, walks[number] = _walk(seconds, time_s, np.sqrt(ratio))
        bands[:, number] = walk[:, None]
    bands[1] += weights.T
    factor = cholesky_banded(bands.reshape(2, -1), check_finite=False)
    weighed = weights * residual_nm
    right = np.broadcast_to(weighed.T, (len(tried), joints, count)).ravel()
    solved = cho_solve_banded((factor, False), right, check_finite=False)
    solved = solved.reshape(len(tried), joints, count)
    log_dets = 2 * np.log(factor[1]).reshape(len(tried), joints, count).sum(axis=2) - walks[:, None]
    power = (np.sum(weighed * residual_nm, axis=0) - (solved * weighed.T).sum(axis=2)) / count
    plain = np.sum(weighed * residual_nm, axis=0) / count
    power, log_dets = np.vstack([plain, power]), np.vstack([np.zeros(joints), log_dets])
    scores = -0.5 * (count * np.log(np.maximum(power, 1e-300)) + log_dets)
    # What is under the least noise of a sensor is rounding, and shows no correlation.
    scores[1:, plain <= least_nm**2] = -np.inf
    best = np.argmax(scores, axis=0)
    renewed: list[SeriesNoise] = []
    for joint, choice in enumerate(best.tolist()):
        time_s, ratio = (1.0, 0.0) if choice == 0 else tried[choice - 1]
        freedom = max(count - float(fitted[joint]), 1.0)
        white = float(np.sqrt(power[choice, joint] * count / freedom))
        # Factor by which noise falls at most from one estimate to the next: a first fit that
        # happens to be near a joint's torques would give it all the weight
        white = max(white, float(least_nm[joint]), before[joint].white_nm / 25.0)
        wander = white * float(np.sqrt(ratio))
        renewed.append(SeriesNoise(seconds, weights[:, joint], white, wander, time_s))
    return tuple(renewed)


def _walk(seconds: Array, time_s: float, sd: float) -> tuple[Array, float]:
    """Return the banded Ornstein-Uhlenbeck inverse covariance, (2, T), at (T,) [s]; its log det."""
    alike = np.exp(-np.diff(seconds) / time_s)
    own = 1 / np.maximum(1 - alike**2, 1e-12)
    bands = np.zeros((2, len(seconds)))
    bands[1] = 1.0
    bands[1, 1:] += alike**2 * own
    bands[1, :-1] += alike**2 * own
    bands[0, 1:] = -alike * own
    log_det = float(np.sum(np.log(own))) - 2 * len(seconds) * float(np.log(sd))
    return bands / sd**2, log_det


def unknown(seconds: Array, sd_nm: float) -> SeriesNoise:
    """Return white noise of this standard deviation, before anything is fitted."""
    return SeriesNoise(seconds, np.ones(len(seconds)), sd_nm, 0.0, 1.0)


# ---- Regression: normal equations, posterior, and the scales of groups of terms

# Bounds of a scale's logarithm: a thousandth; twelve times what is usual; three times that of what
# a maker or a calibration states. More of that would make any arm fit any torques.
_MIN, _MAX, _MAX_KNOWN = -7.0, 2.5, 1.1
# Groups of the last kind; hoses without a bound would carry an arm's weight.
KNOWN = ("links", "gain", "tilt", "zeros", "lag", "hoses and gears")
# How fast a scale's prior falls below and above 1: in so many logarithms to a third.
_DOWN, _UP = 2.5, 0.6
# Logarithms of scales that are averaged over.
_GRID = np.array([-7.0, -4.0, -2.5, -1.5, -0.75, 0.0, 0.5, 1.0, 1.6, 2.3])


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Weighted normal equations: the sufficient statistics of linear least squares."""

    precision: Array  # a^T W A, shape (N, N)
    gradient: Array  # a^T W y, of the log likelihood at 0, shape (N,)

    def marginal(self, kept: NDArray[np.int64], sds: Array) -> NormalEquations:
        """Marginalise all but some terms (Schur complement): `kept` (K,), `sds` (N,)."""
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
        precision = (precision + precision.T) / 2 * np.outer(seen, seen)
        return NormalEquations(precision, gradient * seen)

    def among(self, indices: NDArray[np.int64], count: int) -> NormalEquations:
        """Embed in `count` terms, of which these are the ones at `indices`."""
        precision, gradient = np.zeros((count, count)), np.zeros(count)
        precision[np.ix_(indices, indices)] = self.precision
        gradient[indices] = self.gradient
        return NormalEquations(precision, gradient)


@dataclass(frozen=True, eq=False)
class TermPosterior:
    """Gaussian posterior of all terms."""

    means: Array  # shape (N,)
    root: Array  # R of the covariance R^T R, shape (N, N)
    sds: Array  # of the priors, shape (N,)
    log_evidence: float  # of the samples under these priors, up to a constant that all priors share

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
    """Find the logarithm of each group's prior scale by evidence maximisation: `sds` (N,).

    By Newton's method within bounds, for so many steps at most, from `start`.
    """
    names = tuple(groups)
    members = np.zeros((len(sds), len(names)))  # which terms are whose
    for column, indices in enumerate(groups.values()):
        members[indices, column] = 1.0
    low, high = _MIN, np.array([_MAX_KNOWN if name in KNOWN else _MAX for name in names])
    logs = np.clip(np.array([start.get(name, 0.0) for name in names]), low, high)

    def at(logs: Array) -> tuple[float, Array, Array]:
        """Return the log evidence with the priors of the scales, its slopes and curvature."""
        own = scaled(sds, groups, dict(zip(names, logs.tolist(), strict=True)))
        # In units of the priors: the precision, its inverse, and the means.
        inner = own[:, None] * normal.precision * own
        inner[np.diag_indices_from(inner)] += 1.0
        factor = cholesky(inner, lower=True, check_finite=False)
        (inverse,) = get_lapack_funcs(("potri",), (factor,))
        spread = np.tril(inverse(factor, lower=1)[0])
        spread += np.tril(spread, -1).T
        pull = own * normal.gradient
        means = spread @ pull
        value = 0.5 * float(means @ pull) - float(np.sum(np.log(np.diag(factor))))
        squares = members.T @ (means**2 + np.diag(spread))
        told = 4.0 * np.outer(means, means) * spread + 2.0 * spread**2
        curvature = members.T @ told @ members - 2.0 * np.diag(squares)
        up, down = np.exp(logs / _UP), np.exp(-logs / _DOWN)  # as in `_log_prior`
        value -= float(np.log(up + down).sum())
        slopes = squares - members.sum(axis=0) - (up / _UP - down / _DOWN) / (up + down)
        bent = up * down * (1 / _UP + 1 / _DOWN) ** 2 / (up + down) ** 2
        return value, slopes, curvature - np.diag(bent)

    here = at(logs)
    for _ in range(steps):
        value, slopes, curvature = here
        free = ~(((logs <= low) & (slopes < 0)) | ((logs >= high) & (slopes > 0)))
        bends, axes = np.linalg.eigh(curvature[np.ix_(free, free)])
        step = np.zeros(len(logs))
        # Uphill also where the evidence is not concave.
        step[free] = axes @ (axes.T @ slopes[free] / np.maximum(np.abs(bends), 0.1))
        step /= max(1.0, float(np.abs(step).max(initial=0.0)) / 2.0)  # two logarithms at most
        for _ in range(6):
            tried = np.clip(logs + step, low, high)
            there = at(tried)
            if there[0] > value:
                break
            step /= 4.0
        else:
            break
        logs, here = tried, there
        if there[0] - value < 1e-3:
            break
    return dict(zip(names, logs.tolist(), strict=True))


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

    To first order: the changes by each group's scale are added up. `interest` (I,).
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
    # Raise the covariance so that it is nowhere below half of the one that was; rounding makes no
    # variance 0.
    wider, least = covariance + wider, 0.5 * covariance
    root = np.linalg.cholesky(least + 1e-12 * np.max(np.diag(least)) * np.eye(count))
    inside = np.linalg.solve(root, np.linalg.solve(root, wider).T)
    values, axes = np.linalg.eigh((inside + inside.T) / 2)
    return means + shift, root @ (axes * np.maximum(values, 1.0)) @ axes.T @ root.T


def without(
    normal: NormalEquations,
    found: TermPosterior,
    groups: Mapping[str, NDArray[np.int64]],
    logs: Mapping[str, float],
    absent: Sequence[str],
) -> tuple[TermPosterior, float]:
    """Compute the posterior without some groups, as in a simulation, and its probability."""
    gone = [name for name in absent if name in groups]
    sds = scaled(found.sds, groups, {name: _MIN - logs[name] for name in gone})
    ideal = posterior(normal, sds)
    priors = sum(_log_prior(logs[name])[0] for name in gone)
    odds = ideal.log_evidence - posterior(normal, found.sds).log_evidence - priors
    odds += float(np.log(0.3 / 0.7))  # three logs of ten are a simulator's
    return ideal, float(1 / (1 + np.exp(-np.clip(odds, -500, 500))))


def _log_prior(log: float) -> tuple[float, float]:
    """Return the log prior of a scale's logarithm, up to a constant, and its slope."""
    up, down = np.exp(log / _UP), np.exp(-log / _DOWN)
    return -float(np.log(up + down)), -float((up / _UP - down / _DOWN) / (up + down))
