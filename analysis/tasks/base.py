"""What binds a kind of episode to its simulator, its observations and its weights."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from analysis.estimators.base import Problem, Step
from analysis.observe.quality import Check
from analysis.observe.tracking.track import Hints
from analysis.refine.rebounds import Rebound
from analysis.tunenet.checkpoint import Purpose
from analysis.tunenet.network import Network
from analysis.tunenet.pairs import PairSet
from analysis.tunenet.training import Recipe
from recorders.simulators.balls import Ball
from recorders.simulators.base import Parameter
from tunenet_logs.episode import Episode
from tunenet_logs.progress import Progress

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Selection:
    """Which part of a log to look at: a topic, and seconds from the log's first sample on.

    Attributes:
        hints: where the ball is in a picture, for those who know.
        ball: what was dropped, for those who know: then the air's drag on it is known.
        fit_drag: whether to find the drag from the bounces instead.
    """

    topic: str | None = None
    start_s: float | None = None
    end_s: float | None = None
    hints: Hints = field(default_factory=Hints)
    ball: Ball = field(default_factory=Ball)
    fit_drag: bool = False


@dataclass(frozen=True)
class CrossCheck:
    """A second opinion that shares nothing with the estimate but the log."""

    method: str
    value: float
    agrees: bool


@dataclass(frozen=True, eq=False)
class Refined:
    """What a refinement makes of the network's estimate.

    Attributes:
        values: shape (P,).
        interval95: lower and upper end for each, shape (P, 2).
        check: whether the interval is narrow enough to be of use.
        rebounds: each impact that says something of its own, in order.
    """

    values: Array
    interval95: Array
    check: Check
    rebounds: tuple[Rebound, ...] = ()


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

    def fits(self, episode: Episode, topic: str | None) -> bool:
        """Whether the episode holds what this task looks at, in the topic if one is named."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What it estimates."""
        ...

    @property
    def presets(self) -> Mapping[str, Preset]:
        """By name; "default" is one of them."""
        ...

    def find(self, episode: Episode, selection: Selection, preset: str) -> Any:
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

    def refine(self, found: Any, estimate: Array) -> Refined | None:
        """The exact value near the network's, shape (P,); None where there is no such method."""
        ...

    def checks(self, found: Any, last: Step, refined: Refined | None) -> tuple[Check, ...]:
        """What speaks for and against the last iterate: the refined one if there is one."""
        ...

    def cross_check(self, found: Any, estimate: Array) -> CrossCheck | None:
        """A second opinion; None where the log allows none."""
        ...
