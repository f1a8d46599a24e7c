"""Neural posterior estimation: a density of the parameter, read off the target alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from analysis.estimators.base import Estimator, Observation, Problem, Step, Trace
from tunenet_logs.arrays import Array

INTERVAL = (0.025, 0.975)
"""Quantiles between which a 95 % credible interval lies."""

_CELLS = 4000
"""Of the grid: 1/4000 of the prior's range is far below any posterior's width."""


@dataclass(frozen=True, eq=False)
class GridDensity:
    """A density of one parameter, constant within each cell of a grid.

    Attributes:
        edges: of the cells, ascending, shape (N + 1,).
        below: probability of less than each edge, from 0 to 1, shape (N + 1,).
    """

    edges: Array
    below: Array

    @classmethod
    def from_logs(cls, edges: Array, logs: Array) -> GridDensity:
        """From log densities at the middles of the cells, up to a constant, shape (N,).

        What the density has outside the grid is left out, and the rest scaled up to 1.
        """
        mass = np.exp(logs - logs.max()) * np.diff(edges)
        below = np.concatenate([np.zeros(1), np.cumsum(mass)])
        return cls(edges, below / below[-1])

    @property
    def mean(self) -> float:
        """Its expectation."""
        return float(np.diff(self.below) @ middles(self.edges))

    def quantile(self, probability: float) -> float:
        """The value below which this much of the probability lies."""
        return float(np.interp(probability, self.below, self.edges))

    def interval(self) -> tuple[float, float]:
        """The 95 % credible interval, with as much on either side of it."""
        low, high = (self.quantile(probability) for probability in INTERVAL)
        return low, high


class Posterior(Protocol):
    """A trained network that knows the density of a parameter, given what is seen."""

    @property
    def bounds(self) -> tuple[float, float]:
        """Of the prior, outside of which the density is nothing."""
        ...

    def log_density(self, observation: Array, values: Array) -> Array:
        """Log densities at `values`, shape (N,), for an observation of shape (L,)."""
        ...


class NeuralPosterior(Estimator):
    """Answers with the mean of a posterior: no rollout, and no first guess.

    The network is trained once and answers for any target (amortised). Nothing is drawn: its
    density is evaluated on a grid, so the same target always has the same answer.

    Args:
        posterior: of the one parameter of the problems to come.
    """

    name = "npe"

    def __init__(self, posterior: Posterior) -> None:
        self._posterior = posterior

    def density(self, target: Observation) -> GridDensity:
        """The posterior of the parameter, given a target whose values have shape (L, 1)."""
        edges = np.linspace(*self._posterior.bounds, _CELLS + 1)
        seen = target.values.ravel()
        return GridDensity.from_logs(edges, self._posterior.log_density(seen, middles(edges)))

    def estimate(self, problem: Problem, rollouts: int) -> Trace:  # noqa: ARG002 (needs none)
        """No rollout; see `Estimator.estimate`."""
        found = np.array([self.density(problem.target).mean])
        return Trace((Step(problem.clamp(found), 0),))


def middles(edges: Array) -> Array:
    """Of the cells between them, shape (N,)."""
    return (edges[1:] + edges[:-1]) / 2
