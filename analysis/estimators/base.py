"""Problem, Estimator, Trace: one loop fills every table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from analysis.estimators.observation import Observation
from recorders.simulators.base import Parameter, Simulator
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode


class CountingSimulator:
    """A simulator that knows how often it was asked, so that every method pays alike."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self.rollouts = 0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """See `Simulator.parameters`."""
        return self._simulator.parameters

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """See `Simulator.rollout`."""
        self.rollouts += 1
        return self._simulator.rollout(values)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One rollout of the simulator and what an observer sees of it."""

    episode: Episode
    observation: Observation


class Problem:
    """A target to match and a simulator to match it with.

    Args:
        target: o_T, what is to be matched.
        simulator: f, set up like the target's rig.
        observe: z_P, what an observer sees of a rollout; comparable with `target`.
        initial: the P values that tuning starts from.

    Raises:
        UsageError: an initial value is not finite or out of bounds.
    """

    def __init__(
        self,
        target: Observation,
        simulator: Simulator,
        observe: Callable[[Episode], Observation],
        initial: Array,
    ) -> None:
        self.target = target
        self.initial = np.array(
            [one.checked(value) for one, value in zip(simulator.parameters, initial, strict=True)]
        )
        self._simulator = CountingSimulator(simulator)
        self._observe = observe

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What is to be found."""
        return self._simulator.parameters

    @property
    def rollouts(self) -> int:
        """Simulator runs so far."""
        return self._simulator.rollouts

    def evaluate(self, values: Array) -> Evaluation:
        """Run the simulator at `values`, shape (P,), and observe it."""
        named = {one.name: float(value) for one, value in zip(self.parameters, values, strict=True)}
        episode = self._simulator.rollout(named)
        return Evaluation(episode, self._observe(episode))

    def misfit(self, evaluation: Evaluation) -> Array:
        """What the observation of `evaluation` has more than the target has, shape (L * C,).

        0 where either shows nothing.
        """
        difference = evaluation.observation.values - self.target.values
        return np.where(np.isfinite(difference), difference, 0.0).ravel()

    def clamp(self, values: Array) -> Array:
        """The nearest values that physics allows, shape (P,)."""
        low, high = np.array([one.bounds for one in self.parameters]).T
        return np.clip(values, low, high)


@dataclass(frozen=True, eq=False)
class Step:
    """One iterate: the method's answer after so many rollouts.

    Attributes:
        values: shape (P,).
        rollouts: simulator runs that led to it.
        evaluation: its own rollout, where the method made one.
    """

    values: Array
    rollouts: int
    evaluation: Evaluation | None = None


@dataclass(frozen=True, eq=False)
class Trace:
    """The iterates of one estimation, the initial guess first, by increasing rollouts."""

    steps: tuple[Step, ...]

    @property
    def estimate(self) -> Array:
        """The last iterate, shape (P,)."""
        return self.steps[-1].values

    def after(self, rollouts: int) -> Array:
        """The answer to whoever pays for so many rollouts, shape (P,)."""
        return [step for step in self.steps if step.rollouts <= rollouts][-1].values


class Estimator(Protocol):
    """A method: from a problem to a trace of iterates."""

    @property
    def name(self) -> str:
        """What it is called on the command line and in tables."""
        ...

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Spend at most `rollouts` on the problem.

        Returns:
            An answer for every count of rollouts at which there is a new one; the first for none.
        """
        ...
