"""Neural posterior estimation: a density of the parameter from the target alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from analysis.estimators.base import Estimator, Observation, Problem, Step, Trace
from tunenet_logs.arrays import Array

INTERVAL = (0.025, 0.975)  # quantiles between which a 95 % credible interval lies
_CELLS = 4000  # of the grid: 1/4000 of the prior's range is far below any posterior's width


@dataclass(frozen=True, eq=False)
class GridDensity:
    """Density of one parameter, constant within each cell of a grid.

    Attributes:
        edges: of the cells, ascending, shape (N + 1,).
        below: probability of less than each edge, from 0 to 1, shape (N + 1,).
    """

    edges: Array
    below: Array

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
        low, high = (self.quantile(probability) for probability in INTERVAL)
        return low, high


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
        edges = np.linspace(*self._posterior.bounds, _CELLS + 1)
        seen = target.values.ravel()
        return GridDensity.from_logs(edges, self._posterior.log_density(seen, middles(edges)))

    def estimate(self, problem: Problem, rollouts: int) -> Trace:  # noqa: ARG002 (needs none)
        """Answer without a rollout; see `Estimator.estimate`."""
        found = np.array([self.density(problem.target).mean])
        return Trace((Step(problem.clamp(found), 0),))


def middles(edges: Array) -> Array:
    """Return the midpoints of the cells between edges, shape (N,)."""
    return (edges[1:] + edges[:-1]) / 2
