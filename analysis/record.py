"""Result for one log: a `Tuning`, with all that a review draws, and its `Record`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.checks import Check, CrossCheck, Verdict
from analysis.estimators.base import Trace
from analysis.motion import Motion
from recorders.simulators.base import Parameter
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode

if TYPE_CHECKING:
    import pandas as pd

    from analysis.experiment import Experiment


@dataclass(frozen=True)
class Provenance:
    """Provenance of a record.

    Attributes:
        version: Of this package.
        log_sha256: Of the log; of a folder, of the names and contents of its files.
        options: Those that differ from the defaults, by name.
        tares: Name and SHA-256 of each empty run.
        date: When it was tuned, ISO 8601 in UTC.
        engine: Simulator with its version; None if nothing was simulated.
    """

    version: str
    log_sha256: str
    options: Mapping[str, Any]
    tares: tuple[Mapping[str, str], ...]
    date: str
    engine: str | None


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
        doubts = [check for check in self.checks if check.doubts_model and not check.passed]
        if doubts or (self.cross_check is not None and not self.cross_check.agrees):
            return None
        return self.trace.fit.interval95


Interval = tuple[float, float]  # lower and upper end


@dataclass(frozen=True)
class Estimate:
    """Estimated quantity.

    Attributes:
        name: The field's standard term, e.g. "restitution".
        unit: "1" if it has none.
        value: One number, or one for each component.
        interval95: Lower and upper end of each number; None if no valid one exists.
    """

    name: str
    unit: str
    value: float | tuple[float, ...]
    interval95: Interval | tuple[Interval, ...] | None

    @property
    def components(self) -> tuple[Component, ...]:
        """Its scalars: `payload_com_x`, or `NAME_1` if they are no axes."""
        names = [self.name]
        values = self.value if isinstance(self.value, tuple) else (self.value,)
        if isinstance(self.value, tuple):
            axes = _AXES if len(values) == len(_AXES) else range(1, len(values) + 1)
            names = [f"{self.name}_{axis}" for axis in axes]
        intervals: list[Interval | None] = [None] * len(values)
        if self.interval95 is not None:
            ends = np.reshape(self.interval95, (-1, 2)).tolist()
            intervals = [(low, high) for low, high in ends]
        return tuple(map(Component, names, values, intervals))


@dataclass(frozen=True)
class Component:
    """Scalar of an estimate.

    Attributes:
        interval95: None if no valid one exists.
    """

    name: str
    value: float
    interval95: Interval | None


_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Rebound:
    """One impact of a ball, with its coefficient of restitution.

    Attributes:
        impact_s: Time of impact, on the log's clock [s].
        restitution: At this impact.
        interval95: Of the restitution; None if no valid one exists.
        impact_speed_m_s: None if the scale cannot be determined.
    """

    impact_s: float
    restitution: float
    interval95: Interval | None
    impact_speed_m_s: float | None


@dataclass(frozen=True, eq=False)
class Record:
    """Result of one tuning, without samples.

    Attributes:
        log: The file's name.
        task: Kind of experiment; None if the log could not be read.
        reason: Why the verdict is not "ok", with a remedy; None if it is.
        estimates: The task's parameters first; none for a rejected log.
        physical: Whether the values are the object's own, or numbers of one engine's settings.
        method: Estimation method; None if nothing was estimated.
        rollouts: All simulator runs.
        iterations: The task's parameters by name, for each iterate.
        is_fitted: Whether the last iterate is an exact fit's.
        simulator: "engine", "preset" and "step_hz"; None if nothing was simulated.
        weights: "preset" and "sha256" of the network that was used; None without one.
        ball: As it was named when recording.
        topic: Where the experiment was found.
        window: Times of its events by name [s since the log's first sample].
        seconds: Wall time by stage.
    """

    log: str
    task: str | None
    verdict: Verdict
    reason: str | None
    estimates: tuple[Estimate, ...] = ()
    physical: bool = True
    method: str | None = None
    rollouts: int = 0
    iterations: tuple[Mapping[str, float], ...] = ()
    is_fitted: bool = False
    rebounds: tuple[Rebound, ...] = ()
    cross_check: CrossCheck | None = None
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()
    simulator: Mapping[str, Any] | None = None
    weights: Mapping[str, str] | None = None
    ball: str | None = None
    topic: str | None = None
    window: Mapping[str, float] | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    provenance: Provenance | None = None
    motion: Motion = field(default_factory=Motion)

    def estimate(self, name: str) -> Estimate | None:
        """Return the quantity of that name, or None."""
        return next((known for known in self.estimates if known.name == name), None)

    def to_frame(self) -> pd.DataFrame:
        """Return the values as a table, one row per scalar, such as `payload_com_x`.

        Index `parameter`; columns `value`, `low`, `high` (ends of the 95 % interval; NaN without a
        valid one) and `unit`. No rows for a rejected log.
        """
        import pandas as pd

        rows = [
            (part.name, part.value, *(part.interval95 or (np.nan, np.nan)), known.unit)
            for known in self.estimates
            for part in known.components
        ]
        columns = ["parameter", "value", "low", "high", "unit"]
        return pd.DataFrame(rows, columns=columns).set_index("parameter")


def record_of(tuning: Tuning) -> Record:
    """Build the record of a tuning."""
    detection, trace, experiment = tuning.detection, tuning.trace, tuning.experiment
    intervals = tuning.interval95
    estimates: list[Estimate] = []
    if tuning.estimate is not None and experiment is not None:
        for index, parameter in enumerate(tuning.parameters):
            ends = None if intervals is None else tuple(intervals[index].tolist())
            value = float(tuning.estimate[index])
            estimates.append(Estimate(parameter.name, parameter.unit, value, ends))
        for extra in trace.fit.extra if trace and trace.fit else ():
            ends = None if intervals is None else tuple(map(tuple, extra.interval95.tolist()))
            estimates.append(Estimate(extra.name, extra.unit, tuple(extra.values.tolist()), ends))
    motion, rebounds, iterations = Motion(), (), ()
    if trace is not None and experiment is not None:
        names = [parameter.name for parameter in tuning.parameters]
        iterations = tuple(
            dict(zip(names, step.values.tolist(), strict=True)) for step in trace.steps
        )
        motion = experiment.motion(detection, trace) or Motion()
        estimates = [one for one in estimates if one.name not in motion.unknown]
        iterations = tuple(
            {name: value for name, value in step.items() if name not in motion.unknown}
            for step in iterations
        )
        if estimates and tuning.physical:
            rebounds = experiment.rebounds(detection, trace)
        if intervals is None:
            rebounds = tuple(
                Rebound(bounce.impact_s, bounce.restitution, None, bounce.impact_speed_m_s)
                for bounce in rebounds
            )
    window = None
    if detection is not None:
        window = {name: float(at_s) for name, at_s in detection.window.items()}
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
        window=window,
        seconds=tuning.seconds,
        provenance=tuning.provenance,
        motion=motion,
    )
