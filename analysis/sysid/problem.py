"""A simulator's parameters to be found from a log, as estimators take it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from analysis.estimators.base import Evaluation, FitResult, Problem
from analysis.sysid.fit import SimulatorFit, fit_simulator
from analysis.sysid.network import observation, trained_network
from analysis.sysid.source import Connected, Rollouts
from analysis.tunenet.network import Model
from tunenet_logs.arrays import Array


class SimulatorProblem(Problem):
    """See `Problem`; what of the initial state is unsure is found with the fit.

    Args:
        connected: the simulator, driven as the log was.
        initial: of the tuned parameters, shape (T,).
        digest: of the model and what is tuned.
    """

    def __init__(self, connected: Connected, initial: Array, digest: str) -> None:
        self._connected = connected
        self._digest = digest
        simulator, target = connected.simulator, connected.target
        self._all = tuple(sorted(simulator.parameters, key=lambda one: one.prior_sd is not None))
        self._rest = np.array([one.initial for one in self._all[len(initial) :]])
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
        """One rollout from the initial state that the fit found, if it did."""
        self.rollouts += 1
        row = np.concatenate([values, self._rest])
        episode = self._connected.rollouts(row[None])[0]
        return Evaluation(episode, self._observe(episode))

    def _counted(self, rollouts: Rollouts) -> Callable[[Array], Array]:
        """What rollouts show at the log's stamps; each is charged."""
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
