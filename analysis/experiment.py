"""Interface of an experiment: detect it, pose an estimation problem, check the estimate."""

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
    """What an experiment found in an episode, as far as others need to know."""

    @property
    def topic(self) -> str:
        """Topic that shows it."""
        ...

    @property
    def window(self) -> Mapping[str, float]:
        """Times of its events by name [s since the log's first sample]."""
        ...

    @property
    def extent(self) -> tuple[str, str]:
        """A measure of it for a table, e.g. ("drop", "1.100 m")."""
        ...

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user."""
        ...

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """Samples that are missing from each of its signals."""
        ...


@dataclass(frozen=True)
class Training:
    """How the network of a preset is trained.

    Attributes:
        purpose: What its weights are for.
        network: Its architecture.
        recipe: Its hyperparameters.
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
        physical: Whether its value is the object's own, or a number of one engine's settings.
        parameters: That are estimated.
        method: Default; see `registry.METHODS`.
        training: Of its network; None for an experiment without one, or whose problems train
            their own.
        starts_as_given: Whether every method starts from the parameters' own initial values.
    """

    physical: bool
    parameters: tuple[Parameter, ...]
    method: str
    training: Training | None = None
    starts_as_given: bool = False


def presets_of(
    trainings: Mapping[str, Training], ours: tuple[Parameter, ...], papers: tuple[Parameter, ...]
) -> dict[str, Preset]:
    """Build our preset, whose estimate is physical, and the paper's, which is its engine's."""
    return {
        name: Preset(True, ours, "tunenet+refine", training)
        if name == "default"
        else Preset(False, papers, "tunenet", training)
        for name, training in trainings.items()
    }


class Experiment(Protocol):
    """A kind of experiment, observed in one way; only it reads what its `detect` returns."""

    @property
    def name(self) -> str:
        """Name in `tunenet-train` and in weights."""
        ...

    @property
    def kind(self) -> str:
        """Name in logs, results and `--task`: one kind may be observed in several ways."""
        ...

    @property
    def occasion(self) -> str:
        """What a user repeats if a log does not suffice, e.g. "drop"."""
        ...

    @property
    def observed(self) -> str:
        """What it looks at in a log, e.g. "pictures of a ball"."""
        ...

    @property
    def takes(self) -> frozenset[Subject]:
        """Subjects of the options that it uses; others change nothing."""
        ...

    @property
    def presets(self) -> Mapping[str, Preset]:
        """Presets by name; "default" is one of them."""
        ...

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """Rate how likely the episode shows it, in the topic if one is named."""
        ...

    def detect(self, episode: Episode, selection: Selection, preset: str) -> Any:
        """Detect it in an episode, as a `Detection`; nothing is estimated here.

        Raises:
            NotFoundError: The selection does not show the experiment; the message says why.
        """
        ...

    def problem(self, detection: Any, initial: Array) -> Problem:
        """Pose the estimation problem of a detection; `initial` has the shape (P,).

        Raises:
            NotFoundError: The detection is no such experiment, or cannot be simulated.
            UsageError: The initial value is out of bounds.
        """
        ...

    def checks(self, detection: Any, last: Step, fit: FitResult | None) -> tuple[Check, ...]:
        """Check the last iterate; `fit` is the exact fit that gave it, if one did."""
        ...

    def cross_check(self, detection: Any, estimate: Array) -> CrossCheck | None:
        """Estimate independently of `estimate`, shape (P,); None if the log allows none."""
        ...

    def motion(self, detection: Any, trace: Trace) -> Motion | None:
        """Compare the tuned simulator's motion with the observed one; None if it has none."""
        ...

    def rebounds(self, detection: Any, trace: Trace) -> tuple[Rebound, ...]:
        """List impacts with their restitution, in order; none if nothing bounces."""
        ...

    def review(self, stream: RecordingStream, tuning: Tuning) -> Container | None:
        """Log its part of the review to a stream, and return the layout that shows it.

        Of a tuning without a detection but with a refused one: what that shows, None if nothing.
        """
        ...
