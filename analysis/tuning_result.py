"""What came out for one log, with all that a review draws; `record_of` has what is kept of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from analysis.checks import Check, CrossCheck, Verdict
from analysis.estimators.base import ExtraEstimate, Trace
from analysis.experiment import Experiment
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode


@dataclass(frozen=True, eq=False)
class Tuning:
    """What came out for one log.

    Attributes:
        reason: why the verdict is not "ok"; None if it is.
        experiment: None where the log could not be read.
        episode: the log as it was read; None if it could not be.
        detection: what the experiment found in it, a `Detection`; None if nothing.
        trace: the iterates, each with its rollout; None where there are none.
        rollouts: all simulator runs, those that check the answer too.
        simulator: "engine", "preset", "step_hz"; None where nothing was simulated.
        digest: SHA-256 of the weights; "" without.
        seconds: wall time of "read", "observe", "tune", "total".
    """

    log: Path
    task: str | None
    preset: str
    verdict: Verdict
    reason: str | None
    experiment: Experiment | None = None
    episode: Episode | None = None
    detection: Any = None
    trace: Trace | None = None
    rollouts: int = 0
    cross_check: CrossCheck | None = None
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()
    simulator: Mapping[str, Any] | None = None
    method: str | None = None
    digest: str = ""
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def physical(self) -> bool:
        """Whether the values are the object's own, or numbers of one engine's settings."""
        return self.experiment is None or self.experiment.presets[self.preset].physical

    @property
    def estimate(self) -> Array | None:
        """The tuned values, shape (P,); None for a rejected log."""
        if self.trace is None or self.verdict == "rejected":
            return None
        return self.trace.estimate

    @property
    def extra(self) -> tuple[ExtraEstimate, ...]:
        """What was found beside the tuned values; nothing for a rejected log."""
        if self.estimate is None or self.trace is None or self.trace.fit is None:
            return ()
        return self.trace.fit.extra

    @property
    def interval95(self) -> Array | None:
        """Of the tuned values, shape (P, 2); None where none is honest.

        An interval reflects noise. Where a check doubts the model behind it, it would only look
        certain.
        """
        if self.estimate is None or self.trace is None or self.trace.fit is None:
            return None
        doubts = [check for check in self.checks if check.doubts_model and not check.passed]
        if doubts or (self.cross_check is not None and not self.cross_check.agrees):
            return None
        return self.trace.fit.interval95

    @property
    def iterations(self) -> tuple[dict[str, float], ...]:
        """Each iterate, the experiment's parameters by name."""
        if self.trace is None or self.experiment is None:
            return ()
        names = [parameter.name for parameter in self.experiment.parameters]
        return tuple(
            dict(zip(names, step.values.tolist(), strict=True)) for step in self.trace.steps
        )
