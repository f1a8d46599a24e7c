"""Problem, Estimator, Trace: what every method is given and what it returns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from analysis.tunenet.network import Model
from recorders.simulators.base import Parameter, Simulator
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.errors import UsageError


@dataclass(frozen=True, eq=False)
class Observation:
    """The paper's o: a curve on a fixed grid, which a network or a cost looks at.

    Attributes:
        values: float64, shape (L, C); NaN where the episode shows nothing.
        axis: the L points of the grid, increasing.
        axis_name: what the axis is, with its unit.
        value_names: what the C channels are, with their units.

    Raises:
        ValueError: shapes disagree.
    """

    values: Array
    axis: Array
    axis_name: str
    value_names: tuple[str, ...]

    def __post_init__(self) -> None:
        expected = (len(self.axis), len(self.value_names))
        if self.values.shape != expected:
            raise ValueError(f"values have shape {self.values.shape}, expected {expected}")
        self.values.flags.writeable = False
        self.axis.flags.writeable = False


def resample(axis: Array, values: Array, wanted: Array) -> Array:
    """Linear interpolation at `wanted`, NaN outside (Resample of algorithm 1).

    Args:
        axis: shape (T,), increasing.
        values: shape (T,).
        wanted: shape (L,).

    Returns:
        Shape (L,).
    """
    return np.interp(wanted, axis, values, left=np.nan, right=np.nan)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One rollout of the simulator and what an observer sees of it."""

    episode: Episode
    observation: Observation


@dataclass(frozen=True, eq=False)
class ExtraEstimate:
    """A quantity that an exact fit finds beside the tuned parameters, where the log allows it.

    Attributes:
        name: the field's standard term, e.g. "payload_com".
        unit: of all its numbers.
        values: shape (C,).
        interval95: lower and upper end for each, shape (C, 2).
    """

    name: str
    unit: str
    values: Array
    interval95: Array


@dataclass(frozen=True, eq=False)
class FitResult:
    """What an experiment's exact fit finds.

    Attributes:
        values: of the tuned parameters, shape (P,).
        interval95: lower and upper end for each, shape (P, 2).
        extra: what else it finds.
        detail: the fit itself, for the experiment's own checks and review.
        path: values on the way, each of shape (P,) or more, where it goes step by step.
    """

    values: Array
    interval95: Array
    extra: tuple[ExtraEstimate, ...] = ()
    detail: Any = None
    path: tuple[Array, ...] = ()


class Problem:
    """A target to match, a simulator to match it with, and an exact fit where there is one.

    Args:
        target: o_T, what is to be matched.
        simulator: f, set up like the target's rig.
        observe: z_P, what an observer sees of a rollout; comparable with `target`.
        initial: the P values that the estimation starts from, of the simulator's first P
            parameters; the others stay as the simulator has them.
        residual_units: one unit of a network's answer in each parameter's unit, shape (P,); all 1
            if None.
        exact_fit: from P starting values to the parameters that explain every sample best; it
            returns None where the log shows too little. None where no such fit exists.
        train: trains a network for this problem alone; None where one is shipped, or none exists.

    Raises:
        UsageError: an initial value is missing, not finite or out of bounds.
    """

    def __init__(
        self,
        target: Observation,
        simulator: Simulator,
        observe: Callable[[Episode], Observation],
        initial: Array,
        exact_fit: Callable[[Array], FitResult | None] | None = None,
        residual_units: Array | None = None,
        train: Callable[[], Model] | None = None,
    ) -> None:
        self.target = target
        self.simulator = simulator
        self.parameters: tuple[Parameter, ...] = simulator.parameters[: len(initial)]
        """What is to be found."""
        self.rollouts = 0
        """Simulator runs so far: every method pays for each."""
        self.exact_fit = exact_fit
        self.train = train
        if len(initial) != len(self.parameters):
            names = ", ".join(parameter.name for parameter in simulator.parameters)
            raise UsageError(f"{len(initial)} initial values for {names}; give one for each")
        self.residual_units = np.ones(len(initial)) if residual_units is None else residual_units
        self.initial = np.array(
            [
                parameter.checked(value)
                for parameter, value in zip(self.parameters, initial, strict=True)
            ]
        )
        self._observe = observe

    def evaluate(self, values: Array) -> Evaluation:
        """Run the simulator at `values`, shape (P,) or (S,), and observe it."""
        names = [parameter.name for parameter in self.parameters]
        settings: Mapping[str, float] = dict(zip(names, map(float, values), strict=True))
        self.rollouts += 1
        episode = self.simulator.rollout(settings)
        return Evaluation(episode, self._observe(episode))

    def misfit(self, evaluation: Evaluation) -> Array:
        """Simulated less observed, shape (L * C,); 0 where either shows nothing."""
        difference = evaluation.observation.values - self.target.values
        return np.where(np.isfinite(difference), difference, 0.0).ravel()

    @property
    def searched(self) -> tuple[Parameter, ...]:
        """What a search by trial varies: S, the P parameters first, then what else is unsure."""
        return self.parameters

    @property
    def ranges(self) -> Array:
        """Where it looks: the smallest and the largest value of each, shape (S, 2)."""
        return np.array([parameter.bounds for parameter in self.searched])

    @property
    def start(self) -> Array:
        """Where it begins, shape (S,): `initial`, and guesses of what else is unsure."""
        return self.initial

    def clamp(self, values: Array) -> Array:
        """The nearest values within physical bounds, shape (P,) or (S,)."""
        bounds = [parameter.bounds for parameter in self.searched[: len(values)]]
        low, high = np.array(bounds).T
        return np.clip(values, low, high)


@dataclass(frozen=True, eq=False)
class Step:
    """One iterate: the method's answer after a number of rollouts.

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
    """The iterates of one estimation, the initial guess first, by increasing rollouts.

    Attributes:
        fit: the exact fit whose values the last step has; None where no fit ended it.
        method: where less was done than the estimator's name says; "" for all of it.
    """

    steps: tuple[Step, ...]
    fit: FitResult | None = None
    method: str = ""

    @property
    def estimate(self) -> Array:
        """The last iterate, shape (P,)."""
        return self.steps[-1].values

    def after(self, rollouts: int) -> Array:
        """The answer to whoever pays for this number of rollouts, shape (P,)."""
        return [step for step in self.steps if step.rollouts <= rollouts][-1].values


@dataclass(frozen=True)
class Setup:
    """What a method may be built from.

    Attributes:
        model: the network for the task and preset; None for a method that uses none.
        seed: of the methods that draw.
    """

    model: Model | None = None
    seed: int = 0


class Estimator(ABC):
    """A method: from a problem to a trace of iterates."""

    name: str
    """What it is called on the command line and in tables."""

    uses_network: ClassVar[bool] = False
    """Whether `build` needs `Setup.model`; it then starts from the task's initial guess.

    The others start from the middle of the parameters' ranges.
    """

    takes_one_parameter: ClassVar[bool] = False
    """Whether it finds the first parameter alone; the others then stay at their first guess."""

    takes_steps: ClassVar[bool] = True
    """Whether it starts somewhere and spends rollouts."""

    @classmethod
    def build(cls, setup: Setup) -> Estimator:  # noqa: ARG003 (most methods need nothing)
        """The method as `--method` offers it."""
        return cls()

    @abstractmethod
    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Spend at most `rollouts` on the problem.

        Returns:
            An answer for every count of rollouts at which there is a new one; the first for none.

        Raises:
            NotFoundError: the method does not fit the problem; the message says why.
        """
