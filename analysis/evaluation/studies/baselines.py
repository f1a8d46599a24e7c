"""Methods to compare ours with: CMA-ES, a constant, direct prediction, entropy search, NPE.

Those of the paper's table 2 are set up as its appendix or its authors' code has them. `BestVisited`
answers with the best place that another method has visited.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.estimators.base import (
    Estimator,
    Observation,
    Problem,
    Search,
    Step,
    Trace,
)
from tunenet_logs.analysis.tunenet.network import Model, PairSet
from tunenet_logs.episode import Array

# ---- The best of the points visited by another method.


class BestVisited(Estimator):
    """Another method's iterates, each judged by its own rollout; the last, unjudged one is left.

    Where noise lets a step lead away, the misfit of its rollout says so, and costs nothing: it was
    made anyway.
    """

    def __init__(self, method: Estimator) -> None:
        self._method = method
        self.name = f"best visited by {method.name}"

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """See `Estimator.estimate`."""
        least = np.inf
        steps = [Step(problem.initial, 0)]
        for step in self._method.estimate(problem, rollouts).steps:
            if step.evaluation is None:
                continue
            cost = float(np.linalg.norm(problem.misfit(step.evaluation)))
            if cost < least:
                least = cost
                judged = min(step.rollouts + 1, problem.rollouts)
                steps.append(Step(step.values, judged, step.evaluation))
        return Trace(tuple(steps))


# ---- CMA-ES (Hansen 2016), set up as for the paper's table 2.


class CmaEs(Estimator):
    """CMA-ES by pycma on the L2 norm of the misfit: population 10, sigma 0.1, tolfun 0.1.

    It needs two parameters: the paper's authors let it look for the height of release as well,
    whose first guess is right. After each generation the answer is the distribution's mean, as they
    read it, and not the best place visited; before the first generation is complete it is the
    initial guess, and a budget's remainder that makes no generation is not spent. A point out of
    bounds costs what the nearest one within costs. The paper's columns for 1, 5 and 10 rollouts are
    all the value after the first generation.
    """

    name = "cma-es"

    def __init__(self, seed: int, population: int = 10) -> None:
        self._seed = seed
        self._population = population

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Run whole generations; see `Estimator.estimate`."""
        search = Search(problem, rollouts, keep_best=False)
        return search.run(lambda: self._optimize(search, problem))

    def _optimize(self, search: Search, problem: Problem) -> None:
        import cma

        # pycma takes a seed of 0 as "by the clock"
        options = {"popsize": self._population, "seed": self._seed + 1, "tolfun": 0.1}
        options |= {"verbose": -9, "verb_log": 0}
        strategy = cma.CMAEvolutionStrategy(problem.initial, 0.1, options)
        while search.left >= self._population and not strategy.stop():
            points = strategy.ask()
            strategy.tell(points, [search.cost(point) for point in points])
            search.answer(strategy.result.xfavorite)


# ---- One value for every target: what any method has to beat.


class Constant(Estimator):
    """Constant answer, without a rollout.

    The Mean of the paper's table 2 is given the mean of the test set's targets, which no method
    that has to find them could know.
    """

    name = "mean"

    def __init__(self, value: float) -> None:
        self._value = value

    def estimate(self, problem: Problem, rollouts: int) -> Trace:  # noqa: ARG002 (needs none)
        """Answer without a rollout; see `Estimator.estimate`."""
        return Trace((Step(problem.clamp(np.array([self._value])), 0),))


# ---- Direct prediction of the parameters: the network sees the target alone.


class Direct(Estimator):
    """Paper's network with its proposed input zeroed, so that its output is the parameter.

    "Zeroed" is meant before the scaling. With the raw scaling of the preset `paper-code`, which the
    paper's authors use for it, the network sees exact zeros. With another one it sees a constant,
    which its first layer's bias absorbs.
    """

    name = "direct"

    def __init__(self, model: Model) -> None:
        self._model = model

    def estimate(self, problem: Problem, rollouts: int) -> Trace:  # noqa: ARG002 (needs none)
        """Predict without a rollout; see `Estimator.estimate`."""
        target = problem.target.values[None]
        found = self._model(np.zeros_like(target), target)[0]
        return Trace((Step(problem.clamp(found), 0),))


def direct_pairs(pairs: PairSet) -> PairSet:
    """Pair each target with one observation of zeros whose parameters are 0.

    The residual of such a pair is the parameter itself, so training needs nothing of its own.
    """
    nothing = np.zeros_like(pairs.observations[:1])
    return PairSet(
        observations=np.concatenate([pairs.observations, nothing]),
        values=np.concatenate([pairs.values, np.zeros_like(pairs.values[:1])]),
        proposed=np.full_like(pairs.proposed, len(pairs.values)),
        target=pairs.target,
    )


# ---- Greedy entropy search (Zhu et al. 2018, algorithm 2), as the TuneNet paper's appendix has it.

_BINS = 50


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

    The bins lie between the smallest and the largest value looked at: the authors take those of the
    *test set's targets*, which no method that has to find them could know. Where they are the same
    there is one bin, which is the answer after the first rollout. It stops after `patience` steps
    in a row without a change of the estimate; None to go on while there are rollouts.
    """

    name = "entropy-search"

    def __init__(
        self, bins: tuple[float, float], seed: int, patience: int | None = 2, samples: int = 100
    ) -> None:
        self._bins, self._seed, self._patience, self._samples = bins, seed, patience, samples

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
            process = _fitted(np.array(positions), np.array(errors), float(np.ptp(bins)))
            mean, covariance = process.predict(bins[:, None], return_cov=True)
            drawn = rng.multivariate_normal(
                mean, covariance, self._samples, check_valid="ignore", method="eigh"
            )
            smallest = drawn.argmin(axis=1)
            probability = np.bincount(smallest, minlength=len(bins)) / self._samples
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


# ---- Neural posterior estimation (NPE): a density of the parameter from the target alone.


@dataclass(frozen=True, eq=False)
class GridDensity:
    """Density of one parameter, constant within each cell of a grid."""

    edges: Array  # of the cells, ascending, shape (N + 1,)
    below: Array  # probability of less than each edge, from 0 to 1, shape (N + 1,)

    @classmethod
    def from_logs(cls, edges: Array, logs: Array) -> GridDensity:
        """Normalise log densities at the middles of the cells, shape (N,).

        What the density has outside the grid is left out, and the rest scaled up to 1.
        """
        mass = np.exp(logs - logs.max()) * np.diff(edges)
        below = np.concatenate([np.zeros(1), np.cumsum(mass)])
        return cls(edges, below / below[-1])

    @property
    def mean(self) -> float:
        """Expectation."""
        return float(np.diff(self.below) @ middles(self.edges))

    def quantile(self, probability: float) -> float:
        """Return the value below which this much of the probability lies."""
        return float(np.interp(probability, self.below, self.edges))

    def interval(self) -> tuple[float, float]:
        """Return the equal-tailed 95 % credible interval."""
        return self.quantile(0.025), self.quantile(0.975)


class Posterior(Protocol):
    """Trained conditional density of a parameter, given an observation."""

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the prior, outside of which the density is 0."""
        ...

    def log_density(self, observation: Array, values: Array) -> Array:
        """Return log densities at `values`, shape (N,), for an observation of shape (L,)."""
        ...


class NeuralPosterior(Estimator):
    """Posterior mean as an answer: no rollout, and no first guess.

    The network is trained once and answers for any target (amortised). Nothing is drawn: its
    density is evaluated on a grid, so the same target always has the same answer.
    """

    name = "npe"

    def __init__(self, posterior: Posterior) -> None:
        self._posterior = posterior

    def density(self, target: Observation) -> GridDensity:
        """Return the parameter's posterior, given a target whose values have shape (L, 1)."""
        # of the prior's range, 1/4000 is far below any posterior's width
        edges = np.linspace(*self._posterior.bounds, 4001)
        seen = target.values.ravel()
        return GridDensity.from_logs(edges, self._posterior.log_density(seen, middles(edges)))

    def estimate(self, problem: Problem, rollouts: int) -> Trace:  # noqa: ARG002 (needs none)
        """Answer without a rollout; see `Estimator.estimate`."""
        found = np.array([self.density(problem.target).mean])
        return Trace((Step(problem.clamp(found), 0),))


def middles(edges: Array) -> Array:
    """Return the midpoints of the cells between edges, shape (N,)."""
    return (edges[1:] + edges[:-1]) / 2


# ---- The bridge to `sbi`, which trains the posterior by its defaults.
# Its words on standard output and its warnings stay here, and so do its logs for TensorBoard.


@dataclass(frozen=True, eq=False)
class SbiPosterior:
    """Trained network as plain numbers, which travel between processes; see `Posterior`."""

    bounds: tuple[float, float]  # of the uniform prior
    inputs: int  # L, numbers in an observation
    # by the library's names, the offsets and gains of its standardisation among them
    weights: Mapping[str, NDArray[Any]]

    def log_density(self, observation: Array, values: Array) -> Array:
        """See `Posterior.log_density`."""
        import torch

        condition = torch.tensor(observation[None], dtype=torch.float32)
        parameters = torch.tensor(values[:, None, None], dtype=torch.float32)
        with torch.no_grad():
            logs = self._network.log_prob(parameters, condition)
        return logs[:, 0].numpy().astype(np.float64)

    @cached_property
    def _network(self) -> Any:
        """Network of the library; built once a process."""
        import torch

        with _quietly():
            some = torch.arange(2.0)[:, None]  # gives shapes; the scaling is among the weights
            network = _builder()(some, some.repeat(1, self.inputs))
        network.load_state_dict({name: torch.tensor(one) for name, one in self.weights.items()})
        return network.eval()

    def __getstate__(self) -> dict[str, Any]:
        """Return the numbers alone, for another process."""
        return {name: getattr(self, name) for name in ("bounds", "inputs", "weights")}


def train_posterior(
    observations: Array,
    values: Array,
    bounds: tuple[float, float],
    seed: int,
    epochs: int | None = None,
) -> SbiPosterior:
    """Train by neural posterior estimation (NPE-C of Greenberg et al. 2019, in one round).

    The same seed on the same machine gives the same weights, and torch's own generator is left as
    it was.

    Args:
        observations: of the simulations, shape (N, L).
        values: their parameters, drawn evenly from `bounds`, shape (N,).
        bounds: of the uniform prior.
        seed: of the first weights, the validation set and the batches.
        epochs: most passes; None for as many as the library finds useful.
    """
    import torch

    torch.set_num_threads(1)  # as in `train`; the count of threads decides the last bits
    with _quietly(), torch.random.fork_rng(devices=[]):
        from sbi.inference import NPE
        from sbi.utils import BoxUniform

        torch.manual_seed(seed)
        low, high = (torch.tensor([bound]) for bound in bounds)
        inference = NPE(
            BoxUniform(low, high),
            _builder(),
            show_progress_bars=False,
            tracker=cast(Any, _NoTracker()),
        )
        seen = torch.tensor(observations, dtype=torch.float32)
        wanted = torch.tensor(values[:, None], dtype=torch.float32)
        inference.append_simulations(wanted, seen)
        network = inference.train(
            # The library's 200, 5e-4, 20 passes without improvement and 50 hidden units leave
            # larger errors (chosen on seeds that no table is made of).
            training_batch_size=50,
            learning_rate=1e-3,
            stop_after_epochs=100,
            max_num_epochs=epochs or 2**31 - 1,
        )
    weights = {name: one.numpy().copy() for name, one in network.state_dict().items()}
    return SbiPosterior(bounds, observations.shape[1], weights)


def _builder() -> Any:
    """Make a builder of mixture density networks: 10 Gaussians, standardised inputs.

    For one parameter the library's default, an autoregressive flow, is a single Gaussian.
    """
    from sbi.neural_nets import posterior_nn

    return posterior_nn("mdn", z_score_x="independent", hidden_features=256)


@contextmanager
def _quietly() -> Iterator[None]:
    """Silence what the library prints or warns of."""
    nowhere = io.StringIO()
    with warnings.catch_warnings(), redirect_stdout(nowhere), redirect_stderr(nowhere):
        warnings.simplefilter("ignore")
        yield


class _NoTracker:
    """Tracker that logs nothing: the library's default makes a folder of logs where it stands."""

    log_dir = None

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *_, **__: None
