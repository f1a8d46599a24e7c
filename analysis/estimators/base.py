"""Problem, Estimator, Trace: the interface of every estimation method."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tunenet_logs.analysis.record import Gap, Posterior
from tunenet_logs.analysis.tunenet.network import Model
from tunenet_logs.episode import Array, Episode
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.recorders.simulators.base import Parameter, Simulator


@dataclass(frozen=True, eq=False)
class Observation:
    """The paper's o: a curve on a fixed grid, input of a network or a cost."""

    values: Array  # float64, shape (L, C); NaN where the episode shows nothing
    axis: Array  # The L points of the grid, increasing
    axis_name: str  # What the axis is, with its unit
    value_names: tuple[str, ...]  # What the C channels are, with their units

    def __post_init__(self) -> None:
        expected = (len(self.axis), len(self.value_names))
        if self.values.shape != expected:
            raise ValueError(f"values have shape {self.values.shape}, expected {expected}")
        self.values.flags.writeable = False
        self.axis.flags.writeable = False


def resample(axis: Array, values: Array, wanted: Array) -> Array:
    """Interpolate linearly at `wanted`, shape (L,); NaN outside (Resample of algorithm 1)."""
    return np.interp(wanted, axis, values, left=np.nan, right=np.nan)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One rollout of the simulator and its observation."""

    episode: Episode
    observation: Observation


@dataclass(frozen=True, eq=False)
class ExtraEstimate:
    """Quantity that an exact fit identifies beside the tuned parameters."""

    name: str  # The field's standard term, e.g. "payload_com"
    unit: str  # Of all its numbers
    values: Array  # Shape (C,)
    interval95: Array  # Lower and upper end for each, shape (C, 2)


@dataclass(frozen=True, eq=False)
class FitResult:
    """Result of an experiment's exact fit."""

    values: Array  # Of the tuned parameters, shape (P,)
    interval95: Array  # Lower and upper end for each, shape (P, 2)
    extra: tuple[ExtraEstimate, ...] = ()  # Other quantities that were identified
    detail: Any = None  # The fit itself, for the experiment's own checks and review
    path: tuple[Array, ...] = ()  # Iterates, each of shape (P,) or more, if the fit is iterative
    posterior: Posterior | None = None  # Of the tuned parameters, if their joint one is known
    gaps: tuple[Gap, ...] = ()  # Of each signal, as given and tuned


class Problem:
    """Target to match, simulator to match it with, and an exact fit where there is one."""

    def __init__(
        self,
        target: Observation,  # o_T, the observation to match
        simulator: Simulator,  # f, set up like the target's rig
        observe: Callable[[Episode], Observation],  # z_P, from a rollout
        initial: Array,  # of the simulator's first P parameters; the others stay as it has them
        # from P starting values to the parameters that explain every sample best; None if the log
        # shows too little
        exact_fit: Callable[[Array], FitResult | None] | None = None,
        residual_units: Array | None = None,  # of a network's outputs, shape (P,); None for 1
        # trains a network for this problem alone; None if one is shipped, or none exists
        train: Callable[[], Model] | None = None,
    ) -> None:
        self.target, self.simulator, self._observe = target, simulator, observe
        self.exact_fit, self.train = exact_fit, train
        self.parameters: tuple[Parameter, ...] = simulator.parameters[: len(initial)]
        self.rollouts = 0  # simulator runs so far: every method pays for each
        if len(initial) != len(self.parameters):
            names = ", ".join(parameter.name for parameter in simulator.parameters)
            raise UsageError(f"{len(initial)} initial values for {names}; give one for each")
        self.residual_units = np.ones(len(initial)) if residual_units is None else residual_units
        pairs = zip(self.parameters, initial, strict=True)
        self.initial = np.array([parameter.checked(value) for parameter, value in pairs])

    def evaluate(self, values: Array) -> Evaluation:
        """Roll out the simulator at `values`, shape (P,) or (S,), and observe it."""
        names = [parameter.name for parameter in self.parameters]
        self.rollouts += 1
        episode = self.simulator.rollout(dict(zip(names, map(float, values), strict=True)))
        return Evaluation(episode, self._observe(episode))

    def misfit(self, evaluation: Evaluation) -> Array:
        """Return the residual, simulated less observed, shape (L * C,); 0 where undefined."""
        difference = evaluation.observation.values - self.target.values
        return np.where(np.isfinite(difference), difference, 0.0).ravel()

    @property
    def searched(self) -> tuple[Parameter, ...]:
        """Parameters that a search varies: S, the P parameters first, then uncertain others."""
        return self.parameters

    @property
    def ranges(self) -> Array:
        """Bounds of the search, shape (S, 2)."""
        return np.array([parameter.bounds for parameter in self.searched])

    @property
    def start(self) -> Array:
        """Start of the search, shape (S,): `initial`, and guesses of uncertain others."""
        return self.initial

    def clamp(self, values: Array) -> Array:
        """Clip values to the physical bounds, shape (P,) or (S,)."""
        bounds = [parameter.bounds for parameter in self.searched[: len(values)]]
        return np.clip(values, *np.array(bounds).T)


@dataclass(frozen=True, eq=False)
class Step:
    """One iterate: the method's answer after a number of rollouts."""

    values: Array  # Shape (P,)
    rollouts: int  # Simulator runs that led to it
    evaluation: Evaluation | None = None  # Its own rollout, if the method made one


@dataclass(frozen=True, eq=False)
class Trace:
    """Iterates of one estimation, the initial guess first, by increasing rollouts."""

    steps: tuple[Step, ...]
    fit: FitResult | None = None  # whose values the last step has; None if no fit ended it
    method: str = ""  # Name of what was done, if less than the estimator's name says; else ""

    @property
    def estimate(self) -> Array:
        """Last iterate, shape (P,)."""
        return self.steps[-1].values

    def after(self, rollouts: int) -> Array:
        """Return the estimate after at most this number of rollouts, shape (P,)."""
        return [step for step in self.steps if step.rollouts <= rollouts][-1].values


class Estimator(ABC):
    """Estimation method: from a problem to a trace of iterates."""

    name: str  # what it is called on the command line and in tables
    # Whether it is given a model; it then starts from the task's initial guess, the others from
    # the middle of the parameters' ranges
    uses_network: ClassVar[bool] = False
    # Whether it finds the first parameter alone; the others then stay at their first guess
    takes_one_parameter: ClassVar[bool] = False
    takes_steps: ClassVar[bool] = True  # whether it starts somewhere and spends rollouts

    def __init__(self, model: Model | None = None) -> None:
        self.model = model  # its network, if it uses one

    @abstractmethod
    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Spend at most `rollouts` on the problem; NotFoundError where the method does not fit it.

        The trace has a step for every count of rollouts at which the answer changed.
        """


# ---- Search: cost, rollout budget and best value of a black-box optimizer.


class _Spent(Exception):  # noqa: N818 (it ends a search; nothing is wrong)
    """No rollout is left."""


class Search:
    """Rollouts of one problem, each charged to a budget, with the best of them or the last answer.

    An external optimizer calls `cost` or `misfit` freely; `run` ends it when the budget is spent.
    The answer is the best rollout, or the last one given to `answer` without `keep_best`.
    """

    def __init__(
        self, problem: Problem, rollouts: int, *, keep_best: bool = True, least: float = np.inf
    ) -> None:
        self._problem, self._rollouts, self._keep_best = problem, rollouts, keep_best
        self.least = least  # smallest cost so far
        self._steps = [Step(problem.initial, 0)]

    def run(self, optimize: Callable[[], object]) -> Trace:
        """Run an optimizer until it is done or the budget is spent."""
        with suppress(_Spent):
            optimize()
        return Trace(tuple(self._steps))

    @property
    def left(self) -> int:
        """Number of rollouts left."""
        return max(0, self._rollouts - self._problem.rollouts)

    def evaluate(self, values: Array) -> Evaluation:
        """See `Problem.evaluate`, at the nearest values to `values` within bounds."""
        if not self.left:
            raise _Spent
        values = self._problem.clamp(np.atleast_1d(np.asarray(values, dtype=np.float64)))
        evaluation = self._problem.evaluate(values)
        cost = float(np.linalg.norm(self._problem.misfit(evaluation)))
        if cost < self.least:
            self.least = cost
            if self._keep_best:
                own = values[: len(self._problem.parameters)]
                self._steps.append(Step(own, self._problem.rollouts, evaluation))
        return evaluation

    def misfit(self, values: Array) -> Array:
        """Return `Problem.misfit` at `values` of shape (P,) or (S,)."""
        return self._problem.misfit(self.evaluate(values))

    def cost(self, values: Array) -> float:
        """Return the L2 norm of the residual at `values`."""
        return float(np.linalg.norm(self.misfit(values)))

    def answer(self, values: Array) -> None:
        """Append the optimizer's present answer, shape (P,), to the trace if it is new."""
        values = self._problem.clamp(np.atleast_1d(np.asarray(values, dtype=np.float64)))
        if not np.array_equal(values, self._steps[-1].values):
            self._steps.append(Step(values, self._problem.rollouts))


def check_one_parameter(problem: Problem, method: str) -> Parameter:
    """Return the problem's only parameter."""
    if len(problem.parameters) != 1:
        names = ", ".join(parameter.name for parameter in problem.parameters)
        what = f"the method {method} is for one parameter, not for {names}"
        raise NotFoundError(what, "leave --method out, or choose fit")
    return problem.parameters[0]
