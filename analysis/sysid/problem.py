"""Estimation problem of a simulator's parameters and uncertain initial state."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from analysis.estimators.base import Evaluation, FitResult, Problem
from analysis.sysid.fit import SimulatorFit, fit_simulator
from analysis.sysid.network import MAX_SPREADS, observation, trained_network
from analysis.sysid.source import Connected, Rollouts
from analysis.tunenet.network import Model
from recorders.simulators.base import Parameter
from tunenet_logs.arrays import Array

_PRIOR_WIDTHS = 3.0  # standard deviations to each side in which a search by trial looks
# Of a column, in its spread, in a search's cost: no simulator is right beyond all digits.
_MIN_NOISE, _MIN_SPREAD = 0.01, 1e-12


class SimulatorProblem(Problem):
    """See `Problem`; uncertain initial states are fitted, too.

    Args:
        connected: The simulator, driven as the log was.
        initial: Of the tuned parameters, shape (T,).
        digest: Of the model and what is tuned.
    """

    def __init__(self, connected: Connected, initial: Array, digest: str) -> None:
        self._connected = connected
        self._digest = digest
        simulator, target = connected.simulator, connected.target
        self._all = tuple(sorted(simulator.parameters, key=lambda one: one.prior_sd is not None))
        self._rest = np.array([one.initial for one in self._all[len(initial) :]])
        shares = [one.noise / max(one.spread, _MIN_SPREAD) for one in target.columns]
        self._noises = np.maximum(shares, _MIN_NOISE)
        super().__init__(
            observation(target, target.values),
            simulator,
            lambda episode: observation(target, target.seen_in(episode)),
            initial,
            self._fit,
            train=self._trained,
        )
        self.parameters = self._all[: len(initial)]

    def evaluate(self, values: Array) -> Evaluation:
        """Roll out once, by default from the initial state of the fit; see `Problem.evaluate`."""
        self.rollouts += 1
        row = np.concatenate([values, self._rest[len(values) - len(self.parameters) :]])
        episode = self._connected.rollouts(row[None])[0]
        return Evaluation(episode, self._observe(episode))

    @property
    def searched(self) -> tuple[Parameter, ...]:
        """Tuned parameters, then uncertain initial states."""
        return self._all

    @property
    def ranges(self) -> Array:
        """The user's ranges, and those of priors; widened to contain the start."""
        low, high = np.array([_range(one) for one in self._all]).T
        return np.stack([np.minimum(low, self.start), np.maximum(high, self.start)], axis=1)

    @property
    def start(self) -> Array:
        """See `Problem.start`."""
        return np.concatenate([self.initial, self._rest])

    def misfit(self, evaluation: Evaluation) -> Array:
        """See `Problem.misfit`; in units of each column's noise.

        A column that a rollout loses at once has the largest residual there is.
        """
        is_lost = np.isnan(evaluation.observation.values) & np.isfinite(self.target.values)
        off = np.where(is_lost.ravel(), MAX_SPREADS, super().misfit(evaluation))
        return (off.reshape(is_lost.shape) / self._noises).ravel()

    def _counted(self, rollouts: Rollouts) -> Callable[[Array], Array]:
        """Wrap rollouts, observed at the log's stamps; each is charged."""
        target = self._connected.target

        def run(values: Array) -> Array:
            self.rollouts += len(values)
            return np.stack([target.seen_in(episode) for episode in rollouts(values)])

        return run

    def _fit(self, start: Array) -> FitResult:
        finer = self._connected.finer
        fit = fit_simulator(
            self._counted(self._connected.rollouts),
            None if finer is None else self._counted(finer),
            self._connected.target,
            self._all,
            start,
            np.array([self._connected.unresolved.get(one.name, 0.0) for one in self._all]),
        )
        found: SimulatorFit = fit.detail
        self._rest = found.solution.values[len(start) :]
        return fit

    def _trained(self) -> Model:
        count = len(self.parameters)
        return trained_network(
            self._connected.rollouts,
            self._connected.target,
            self._all,
            count,
            self._digest,
        )


def _range(parameter: Parameter) -> tuple[float, float]:
    """Return the search range of a parameter."""
    if parameter.prior_sd is None:
        return parameter.training_range
    reach = _PRIOR_WIDTHS * parameter.prior_sd
    low, high = parameter.bounds
    return max(parameter.initial - reach, low), min(parameter.initial + reach, high)
