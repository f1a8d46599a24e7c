"""What binds a kind of episode to its simulator, its observations and its weights."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Any, Protocol

from analysis.drop.checks import Check
from analysis.drop.rebounds import Rebound
from analysis.estimators.base import Problem, Step
from analysis.tracking.track import Hints
from analysis.tunenet.checkpoint import Purpose
from analysis.tunenet.network import Network
from analysis.tunenet.pairs import PairSet
from analysis.tunenet.training import Recipe
from recorders.simulators.balls import Ball
from recorders.simulators.base import Parameter
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.progress import Progress


@dataclass(frozen=True)
class Selection:
    """Which part of a log to look at: a topic, and seconds from the log's first sample on.

    Attributes:
        hints: where the ball is in a picture, for those who know.
        ball: what was dropped, for those who know: then the air's drag on it is known.
        fit_drag: whether to find the drag from the bounces instead.
        tare: a log of the same arm with nothing in its gripper, or what was read of one.
        arm: whose URDF, and the link that holds the payload; None for the Jaco.
    """

    topic: str | None = None
    start_s: float | None = None
    end_s: float | None = None
    hints: Hints = field(default_factory=Hints)
    ball: Ball = field(default_factory=Ball)
    fit_drag: bool = False
    tare: Path | Episode | None = None
    arm: tuple[Path, str] | None = None

    @property
    def ball_options(self) -> tuple[str, ...]:
        """Those given that are for a filmed ball, as a user names them."""
        told = ("the ball's size and mass",) if self.ball != Ball() else ()
        return (*self.hints.options, *told, *(("--fit-drag",) if self.fit_drag else ()))

    @property
    def arm_options(self) -> tuple[str, ...]:
        """Those given that are for an arm, as a user names them."""
        tare = ("--tare",) if self.tare is not None else ()
        return (*tare, *(("--urdf",) if self.arm is not None else ()))


@dataclass(frozen=True)
class CrossCheck:
    """A second opinion that shares nothing with the estimate but the log.

    Attributes:
        advice: what to do where the two disagree, as one short order.
    """

    method: str
    value: float
    agrees: bool
    advice: str = ""


@dataclass(frozen=True, eq=False)
class ExtraEstimate:
    """A quantity that a refinement tells beside the task's parameters, where the log allows it.

    Attributes:
        name: the field's standard term, e.g. "payload_com".
        unit: of all its numbers.
        values: shape (C,).
        interval95: shape (C, 2).
    """

    name: str
    unit: str
    values: Array
    interval95: Array


@dataclass(frozen=True, eq=False)
class FitResult:
    """What a refinement makes of the network's estimate.

    Attributes:
        values: shape (P,).
        interval95: lower and upper end for each, shape (P, 2).
        check: whether the interval is narrow enough to be of use.
        rebounds: each impact that says something of its own, in order.
        further: what else it tells.
        fit: the fit itself, for the review; None where that needs nothing of it.
    """

    values: Array
    interval95: Array
    check: Check
    rebounds: tuple[Rebound, ...] = ()
    further: tuple[ExtraEstimate, ...] = ()
    fit: Any = None


class Detection(Protocol):
    """What a task found in an episode, as far as others than the task need to know."""

    @property
    def topic(self) -> str:
        """Where it was found."""
        ...

    @property
    def step_hz(self) -> float:
        """The simulator's steps a second."""
        ...

    @property
    def window(self) -> Mapping[str, float]:
        """Its moments by name [s since the log's first sample]."""
        ...

    @property
    def extent(self) -> tuple[str, str]:
        """A measure of it, e.g. ("drop", "1.100 m"), for a table."""
        ...

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know, in words."""
        ...


@dataclass(frozen=True)
class Preset:
    """One way of doing a task.

    Attributes:
        purpose: what its weights are for.
        network: its architecture.
        recipe: how it is trained.
        make_pairs: (pairs wanted or None, seed, processes or None, progress) -> training data.
        physical: whether its value is the object's own, or a number of this engine's settings.
    """

    purpose: Purpose
    network: Network
    recipe: Recipe
    make_pairs: Callable[[int | None, int, int | None, Progress], PairSet]
    physical: bool


class Claim(IntEnum):
    """What a task says of an episode."""

    NONE = 0
    PERHAPS = 1
    PLAINLY = 2


class Task(Protocol):
    """A kind of experiment. What `find` returns is for the task's own other methods."""

    @property
    def name(self) -> str:
        """What `tunenet-train` and weights call it."""
        ...

    @property
    def kind(self) -> str:
        """What logs, results and `tunenet-tune` call it: one kind may be observed in two ways."""
        ...

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """How likely the episode holds what this task looks at, in the topic if one is named."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What it estimates."""
        ...

    @property
    def occasion(self) -> str:
        """What a user does again where a log does not suffice, e.g. "drop"."""
        ...

    @property
    def presets(self) -> Mapping[str, Preset]:
        """By name; "default" is one of them."""
        ...

    def find(self, episode: Episode, selection: Selection, preset: str) -> Detection:
        """What is to be matched.

        Raises:
            NotFoundError: the selection does not show the experiment; the message says why.
        """
        ...

    def problem(self, found: Any, initial: Array) -> Problem:
        """The estimation problem for it.

        Raises:
            NotFoundError: the simulator cannot be set up like it.
            UsageError: the initial value is out of bounds.
        """
        ...

    def refine(self, found: Any, estimate: Array) -> FitResult | None:
        """The exact value near the network's, shape (P,); None where there is no such method."""
        ...

    def checks(self, found: Any, last: Step, refined: FitResult | None) -> tuple[Check, ...]:
        """What speaks for and against the last iterate: the refined one if there is one."""
        ...

    def cross_check(self, found: Any, estimate: Array) -> CrossCheck | None:
        """A second opinion; None where the log allows none."""
        ...
