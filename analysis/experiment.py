"""What an experiment is to the road: it detects, poses a problem, and checks the answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Protocol

from analysis.checks import Check, CrossCheck
from analysis.estimators.base import FitResult, Problem, Step, Trace
from analysis.motion import Motion
from analysis.record import Rebound
from analysis.selection import Selection, Subject
from analysis.tunenet.checkpoint import Purpose
from analysis.tunenet.network import Network
from analysis.tunenet.pairs import PairSet, Workers
from analysis.tunenet.training import Recipe
from recorders.simulators.base import Parameter
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.left_out import LeftOut
from tunenet_logs.terminal import Progress

if TYPE_CHECKING:
    from rerun import RecordingStream
    from rerun.blueprint import Container

    from analysis.record import Tuning


class Claim(IntEnum):
    """How likely an episode shows an experiment."""

    NONE = 0
    PERHAPS = 1
    PLAINLY = 2


class Detection(Protocol):
    """What an experiment found in an episode, as far as others than itself need to know."""

    @property
    def topic(self) -> str:
        """Where it was found."""
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

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """What each signal lacks in which it was found."""
        ...


@dataclass(frozen=True)
class Training:
    """How the network of a preset comes about.

    Attributes:
        purpose: what its weights are for.
        network: its architecture.
        recipe: how it is trained.
        make_pairs: (pairs wanted or None, seed, workers, progress) -> training data.
    """

    purpose: Purpose
    network: Network
    recipe: Recipe
    make_pairs: Callable[[int | None, int, Workers, Progress], PairSet]


@dataclass(frozen=True)
class Preset:
    """One way of simulating and observing an experiment.

    Attributes:
        physical: whether its value is the object's own, or a number of one engine's settings.
        parameters: what is estimated with it.
        method: which is used unless the user names another; see `registry.METHODS`.
        training: of its network; None for an experiment without one, or whose problems train
            their own.
        starts_as_given: whether every method starts from the parameters' own initial values.
    """

    physical: bool
    parameters: tuple[Parameter, ...]
    method: str
    training: Training | None = None
    starts_as_given: bool = False


def presets_of(
    trainings: Mapping[str, Training], ours: tuple[Parameter, ...], papers: tuple[Parameter, ...]
) -> dict[str, Preset]:
    """Ours, whose answer is the object's own, and the paper's, whose answer is its engine's.

    Args:
        trainings: of their networks, by name.
        ours: parameters that the preset default estimates.
        papers: those of the others.
    """
    return {
        name: Preset(True, ours, "tunenet+refine", training)
        if name == "default"
        else Preset(False, papers, "tunenet", training)
        for name, training in trainings.items()
    }


class Experiment(Protocol):
    """A kind of experiment, observed in one way. What `detect` returns is for its own methods."""

    @property
    def name(self) -> str:
        """What `tunenet-train` and weights call it."""
        ...

    @property
    def kind(self) -> str:
        """What logs, results and `--task` call it: one kind may be observed in several ways."""
        ...

    @property
    def occasion(self) -> str:
        """What a user does again where a log does not suffice, e.g. "drop"."""
        ...

    @property
    def observed(self) -> str:
        """What it looks at in a log, e.g. "pictures of a ball"."""
        ...

    @property
    def takes(self) -> frozenset[Subject]:
        """What may be said of it beforehand; other options change nothing."""
        ...

    @property
    def presets(self) -> Mapping[str, Preset]:
        """By name; "default" is one of them."""
        ...

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """How likely the episode shows it, in the topic if one is named."""
        ...

    def detect(self, episode: Episode, selection: Selection, preset: str) -> Any:
        """Find it in an episode, as a `Detection`; nothing is estimated here.

        Raises:
            NotFoundError: the selection does not show the experiment; the message says why.
        """
        ...

    def problem(self, detection: Any, initial: Array) -> Problem:
        """The estimation problem that a detection poses; `initial` has the shape (P,).

        Raises:
            NotFoundError: the detection is no such experiment, or cannot be simulated.
            UsageError: the initial value is out of bounds.
        """
        ...

    def checks(self, detection: Any, last: Step, fit: FitResult | None) -> tuple[Check, ...]:
        """What speaks for and against the last iterate; `fit` is what it came from, if it did."""
        ...

    def cross_check(self, detection: Any, estimate: Array) -> CrossCheck | None:
        """A second estimate beside `estimate`, shape (P,); None where the log allows none."""
        ...

    def motion(self, detection: Any, trace: Trace) -> Motion | None:
        """The tuned simulator's motion beside the observed one; None where it has none."""
        ...

    def rebounds(self, detection: Any, trace: Trace) -> tuple[Rebound, ...]:
        """Impacts with a restitution of their own, in order; none for what does not bounce."""
        ...

    def review(self, stream: RecordingStream, tuning: Tuning) -> Container | None:
        """Send its part of the review to a stream, and return the layout that shows it.

        Of a tuning without a detection but with a refused one: what that shows, None if nothing.
        """
        ...
