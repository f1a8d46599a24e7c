"""Greedy entropy search (Zhu et al. 2018, algorithm 2), as the TuneNet paper's appendix has it."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from analysis.estimators.base import Estimator, Problem, Trace
from analysis.estimators.search import Search
from tunenet_logs.arrays import Array

_BINS = 50
_SAMPLES = 100  # functions drawn from the process; both as in the TuneNet paper's appendix


class EntropySearch(Estimator):
    """Greedy search by the entropy of the minimiser's distribution.

    A Gaussian process (RBF kernel and noise, by maximum likelihood) is fitted to the L2 norm of
    the misfit over the parameter. Functions are drawn from it, noise included; P is the fraction
    of them that is smallest in each of 50 bins. The next rollout is at argmin P log P, of the bins
    with P > 0; the estimate is argmax P. The first rollout is at the initial guess.

    The likelihood is climbed from GPy's start (variance, length and noise 1) and from one of little
    noise. What the paper's authors run differs from their text: the first rollout is at a random
    bin, 200 functions are drawn rather than 100, and it stops the first time that the estimate is
    repeated.

    Args:
        bins: smallest and largest value looked at. The authors take those of the *test set's
            targets*, which no method that has to find them could know. Where they are the same
            there is one bin, which is the answer after the first rollout.
        seed: of its sampling.
        patience: steps in a row without a change of the estimate after which it stops; None to go
            on while there are rollouts.
        samples: functions drawn.
    """

    name = "entropy-search"

    def __init__(
        self,
        bins: tuple[float, float],
        seed: int,
        patience: int | None = 2,
        samples: int = _SAMPLES,
    ) -> None:
        self._bins = bins
        self._seed = seed
        self._patience = patience
        self._samples = samples

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Search with one rollout a step; see `Estimator.estimate`."""
        search = Search(problem, rollouts, keep_best=False)
        return search.run(lambda: self._optimize(search, problem))

    def _optimize(self, search: Search, problem: Problem) -> None:
        rng = np.random.default_rng(self._seed)
        bins = np.unique(np.linspace(*self._bins, _BINS))
        positions, errors = [problem.initial], [search.cost(problem.initial)]
        last, unchanged = -1, 0
        if len(bins) == 1:
            search.answer(bins)
            return
        while self._patience is None or unchanged < self._patience:
            probability = self._smallest(np.array(positions), np.array(errors), bins, rng)
            best = int(np.argmax(probability))
            search.answer(bins[best : best + 1])
            unchanged = unchanged + 1 if best == last else 0
            last = best
            is_possible = probability > 0
            logs = np.log2(np.where(is_possible, probability, 1.0))
            entropy = np.where(is_possible, probability * logs, np.inf)
            position = bins[[int(np.argmin(entropy))]]
            positions.append(position)
            errors.append(search.cost(position))

    def _smallest(
        self, positions: Array, errors: Array, bins: Array, rng: np.random.Generator
    ) -> Array:
        """Return P: how often each bin has the minimum of a sampled function, shape (bins,)."""
        process = _fitted(positions, errors, float(np.ptp(bins)))
        mean, covariance = process.predict(bins[:, None], return_cov=True)
        drawn = rng.multivariate_normal(
            mean, covariance, self._samples, check_valid="ignore", method="eigh"
        )
        return np.bincount(drawn.argmin(axis=1), minlength=len(bins)) / self._samples


def _fitted(positions: Array, errors: Array, width: float) -> Any:
    """Fit a Gaussian process by maximum likelihood to errors, shape (N,), at (N, 1).

    From GPy's start alone the likelihood often ends in a maximum where all is noise, so a second
    start has little of it.
    """
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    wide = (1e-8, 1e8)
    shortest, longest = width / _BINS, 10 * width
    power = float(np.mean(errors**2)) + 1e-6
    fits: list[Any] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        for variance, length, noise in ((1.0, 1.0, 1.0), (power, 0.3 * width, 1e-4 * power)):
            start = min(max(length, shortest), longest)
            kernel = ConstantKernel(variance, wide) * RBF(start, (shortest, longest))
            kernel += WhiteKernel(noise, wide)
            fits.append(GaussianProcessRegressor(kernel).fit(positions, errors))
    return max(fits, key=lambda fit: fit.log_marginal_likelihood_value_)
