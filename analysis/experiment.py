"""Interface of an experiment: detect it, pose an estimation problem, check the estimate.

`Tuning` is the result for one log, with all that a review draws; its `Record` is what is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from tunenet_logs.analysis.checks import Check, CrossCheck, Verdict
from tunenet_logs.analysis.estimators.base import FitResult, Problem, Step, Trace
from tunenet_logs.analysis.options import Subject, TuneOptions
from tunenet_logs.analysis.record import Estimate, Motion, Provenance, Rebound, Record
from tunenet_logs.analysis.tunenet.network import Network, PairSet, Recipe, Workers
from tunenet_logs.analysis.tunenet.weights import Purpose
from tunenet_logs.episode import IMPLAUSIBLE, Array, Episode, LeftOut, added
from tunenet_logs.recorders.simulators.base import Parameter
from tunenet_logs.terminal import Progress, short_name

if TYPE_CHECKING:
    import pandas as pd
    from rerun import RecordingStream
    from rerun.blueprint import Container, View


class Claim(IntEnum):
    """How likely an episode shows an experiment."""

    NONE = 0
    POSSIBLE = 1
    CERTAIN = 2


class Detection(Protocol):
    """What an experiment found in an episode, as far as others need to know."""

    topic: str  # that shows it
    window: Mapping[str, float]  # times of its events by name [s since the log's first sample]
    extent: tuple[str, str]  # a measure of it for a table, e.g. ("drop", "1.100 m")
    warnings: tuple[str, ...]  # for the user
    left_out: tuple[LeftOut, ...]  # samples that are missing from each of its signals


@dataclass(frozen=True)
class Training:
    """How the network of a preset is trained."""

    purpose: Purpose  # what its weights are for
    network: Network  # its architecture
    recipe: Recipe  # its hyperparameters
    # (pairs wanted or None, seed, workers, progress) -> training data
    make_pairs: Callable[[int | None, int, Workers, Progress], PairSet]


@dataclass(frozen=True)
class Preset:
    """One way of simulating and observing an experiment."""

    physical: bool  # whether its value is the object's own, or a number of one engine's settings
    parameters: tuple[Parameter, ...]  # that are estimated
    method: str  # default; see `registry.METHODS`
    training: Training | None = None  # None without a network, or where problems train their own
    starts_as_given: bool = False  # whether every method starts from the parameters' own values


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

    name: str  # in `tunenet-train` and in weights
    kind: str  # in logs, results and `--task`: one kind may be observed in several ways
    occasion: str  # what a user repeats if a log does not suffice, e.g. "drop"
    observed: str  # what it looks at in a log, e.g. "pictures of a ball"

    @property
    def accepted_options(self) -> frozenset[Subject]:
        """Subjects of the options that it uses; others change nothing."""
        ...

    @property
    def presets(self) -> Mapping[str, Preset]:
        """Presets by name; "default" is one of them."""
        ...

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """Rate how likely the episode shows it, in the topic if one is named."""
        ...

    def detect(self, episode: Episode, selection: TuneOptions, preset: str) -> Any:
        """Detect it in an episode, as a `Detection`; NotFoundError says why it is not there."""
        ...

    def problem(self, detection: Any, initial: Array) -> Problem:
        """Pose the estimation problem of a detection; `initial` has the shape (P,).

        NotFoundError if it cannot be simulated, UsageError if `initial` is out of bounds.
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

    def example(self, stream: RecordingStream) -> View | None:
        """Log how a recording looks that can be used, for one that cannot; None for no picture."""
        ...


# ---- Plausible values: remove those that nothing measures, so that no sum overflows later.

_MAX_SIZE = 1e12  # of anything in any unit: squares and their sums stay finite


def drop_invalid_samples(episode: Episode) -> Episode:
    """Remove values that nothing measures; a warning counts them by topic."""
    signals = dict(episode.signals)
    warnings: list[str] = []
    for name, signal in episode.signals.items():
        size = np.abs(signal.values)
        # Of what is smaller, a ratio could be infinite.
        is_huge, is_tiny = size > _MAX_SIZE, (size > 0) & (size < 1e-60)
        if not is_huge.any() and not is_tiny.any():
            continue
        values = np.where(is_huge, np.nan, np.where(is_tiny, 0.0, signal.values))
        rows = {IMPLAUSIBLE: int(np.count_nonzero(is_huge.any(axis=1)))}
        signals[name] = replace(signal, values=values, left_out=added(signal.left_out, rows))
        if is_huge.any():
            warnings.append(
                f"{short_name(name)}: {np.count_nonzero(is_huge)} values beyond {_MAX_SIZE:g} were "
                "left out; nothing measures them"
            )
    if all(signals[name] is signal for name, signal in episode.signals.items()):
        return episode
    return replace(episode, signals=signals, warnings=(*episode.warnings, *warnings))


# ---- Tuning: the result for one log, and its record.


@dataclass(frozen=True, eq=False)
class Tuning:
    """Result for one log, with its samples.

    Attributes:
        reason: Why the verdict is not "ok"; None if it is.
        experiment: None if the log could not be read.
        episode: The log as it was read; None if it could not be.
        detection: What the experiment found in it, a `Detection`; None if nothing.
        refused: A detection that poses no problem, for a review to show; None if there is none.
        trace: The iterates, each with its rollout; None if there are none.
        parameters: The P parameters that were estimated; none if nothing was.
        rollouts: All simulator runs, those that check the answer too.
        simulator: "engine", "preset", "step_hz"; None if nothing was simulated.
        digest: SHA-256 of the weights; "" without.
        seconds: Wall time of "read", "observe", "tune", "total".
        provenance: None if it was not recorded.
    """

    log: Path
    task: str | None
    preset: str
    verdict: Verdict
    reason: str | None
    experiment: Experiment | None = None
    episode: Episode | None = None
    detection: Any = None
    refused: Any = None
    trace: Trace | None = None
    parameters: tuple[Parameter, ...] = ()
    rollouts: int = 0
    cross_check: CrossCheck | None = None
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()
    simulator: Mapping[str, Any] | None = None
    method: str | None = None
    digest: str = ""
    seconds: dict[str, float] = field(default_factory=dict)
    provenance: Provenance | None = None

    @cached_property
    def record(self) -> Record:
        """Its `Record`: what a JSON holds, without the log's samples."""
        return record_of(self)

    def to_frame(self) -> pd.DataFrame:
        """Return the values as a table; see `Record.to_frame`."""
        return self.record.to_frame()

    def __repr__(self) -> str:
        """Say verdict and values in one line."""
        return repr(self.record)

    def _repr_html_(self) -> str:
        return self.record._repr_html_()

    @property
    def physical(self) -> bool:
        """Whether the values are the object's own, or numbers of one engine's settings."""
        return self.experiment is None or self.experiment.presets[self.preset].physical

    @property
    def estimate(self) -> Array | None:
        """Tuned values, shape (P,); None for a rejected log."""
        if self.trace is None or self.verdict == "rejected":
            return None
        return self.trace.estimate

    @property
    def interval95(self) -> Array | None:
        """95 % intervals of the tuned values, shape (P, 2); None if no valid one exists.

        An interval reflects noise: where a check doubts the model, it would be overconfident.
        """
        if self.estimate is None or self.trace is None or self.trace.fit is None:
            return None
        doubts = [check for check in self.checks if check.invalidates_interval and not check.passed]
        if doubts or (self.cross_check is not None and not self.cross_check.agrees):
            return None
        return self.trace.fit.interval95


def record_of(tuning: Tuning) -> Record:
    """Build the record of a tuning."""
    detection, trace, experiment = tuning.detection, tuning.trace, tuning.experiment
    intervals = tuning.interval95
    estimates: list[Estimate] = []
    motion, rebounds, iterations = Motion(), (), ()
    if trace is not None and experiment is not None:
        names = [parameter.name for parameter in tuning.parameters]
        motion = experiment.motion(detection, trace) or Motion()
        if tuning.estimate is not None:
            for index, parameter in enumerate(tuning.parameters):
                ends = None if intervals is None else tuple(intervals[index].tolist())
                value = float(tuning.estimate[index])
                estimates.append(Estimate(parameter.name, parameter.unit, value, ends))
            for extra in trace.fit.extra if trace.fit else ():
                ends = None if intervals is None else tuple(map(tuple, extra.interval95.tolist()))
                values = tuple(extra.values.tolist())
                estimates.append(Estimate(extra.name, extra.unit, values, ends))
        # What has no known unit has no value.
        estimates = [one for one in estimates if one.name not in motion.unknown]
        named = [zip(names, step.values.tolist(), strict=True) for step in trace.steps]
        iterations = tuple(
            {name: value for name, value in step if name not in motion.unknown} for step in named
        )
        if estimates and tuning.physical:
            rebounds = experiment.rebounds(detection, trace)
        if intervals is None:
            rebounds = tuple(replace(bounce, interval95=None) for bounce in rebounds)
    times_s = {} if detection is None else detection.window
    return Record(
        log=tuning.log.name,
        task=tuning.task,
        verdict=tuning.verdict,
        reason=tuning.reason,
        estimates=tuple(estimates),
        physical=tuning.physical,
        method=tuning.method,
        rollouts=tuning.rollouts,
        iterations=iterations,
        is_fitted=trace is not None and trace.fit is not None,
        rebounds=rebounds,
        cross_check=tuning.cross_check,
        checks=tuning.checks,
        warnings=tuning.warnings,
        simulator=tuning.simulator,
        weights={"preset": tuning.preset, "sha256": tuning.digest} if tuning.digest else None,
        ball=tuning.episode and tuning.episode.info.notes.get("ball"),
        topic=None if detection is None else detection.topic,
        window=None if detection is None else {name: float(at) for name, at in times_s.items()},
        seconds=tuning.seconds,
        provenance=tuning.provenance,
        posterior=None if intervals is None or not trace or not trace.fit else trace.fit.posterior,
        gaps=trace.fit.gaps if trace and trace.fit else (),
        motion=motion,
    )
