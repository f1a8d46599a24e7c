"""A user's own simulator as an experiment, tuned from any log of what it simulates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.checks import Check, CrossCheck
from analysis.estimators.base import FitResult, Problem, Step, Trace
from analysis.experiment import Claim, Preset
from analysis.motion import Motion
from analysis.record import Rebound
from analysis.selection import Selection, Subject
from analysis.sysid.checks import fit_checks, match_check, recording_checks, whole_check
from analysis.sysid.problem import SimulatorProblem
from analysis.sysid.source import Connected, SimulatorSource, part_of
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.left_out import LeftOut

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from analysis.record import Tuning


@dataclass(frozen=True, eq=False)
class SimulatorDetection:
    """Log that shows what a simulator simulates; see `Detection`.

    Attributes:
        source: Of the simulator.
        connected: The simulator, driven as the log was.
        offset_s: From the log's first sample to the first that is compared.
        left_out: Samples missing from each compared signal.
    """

    source: SimulatorSource
    connected: Connected
    offset_s: float
    left_out: tuple[LeftOut, ...] = ()

    @property
    def topic(self) -> str:
        """First signal that is compared."""
        return self.connected.target.columns[0].signal

    @property
    def window(self) -> Mapping[str, float]:
        """Times at which the comparison begins and ends [s since the log's first sample]."""
        return {
            "start": self.offset_s,
            "end": self.offset_s + self.connected.target.end_s,
        }

    @property
    def extent(self) -> tuple[str, str]:
        """Duration of the comparison."""
        return "motion", f"{self.connected.target.end_s:.1f} s"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Signals that are not used, and those whose meaning is doubtful."""
        unused = (f"not used: {words}" for words in self.connected.unused)
        return (*unused, *self.connected.doubts)


@dataclass(frozen=True)
class SimulatorExperiment:
    """See `Experiment`.

    Attributes:
        source: of the simulator.
    """

    source: SimulatorSource

    name = "simulator"
    kind = "simulator"
    occasion = "run"
    observed = "what the simulator shows, too"
    takes: frozenset[Subject] = frozenset()

    @property
    def presets(self) -> Mapping[str, Preset]:
        """One: the simulator as given."""
        return {"default": Preset(True, self.source.parameters, "fit", starts_as_given=True)}

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """Claim every episode: the user named the simulator."""
        del episode, topic
        return Claim.PLAINLY

    def detect(self, episode: Episode, selection: Selection, preset: str) -> SimulatorDetection:
        """Match the log's signals with the simulator's; see `Experiment.detect`."""
        del preset
        part = part_of(episode, selection.start_s, selection.end_s)
        connected = self.source.connect(part)
        first_ns = min(int(one.stamps_ns[0]) for one in episode.signals.values())
        offset_s = (connected.target.start_ns - first_ns) * 1e-9
        names = {column.signal for column in connected.target.columns}
        lacking = tuple(LeftOut.of_signal(episode.signals[name]) for name in sorted(names))
        return SimulatorDetection(self.source, connected, offset_s, lacking)

    def problem(self, detection: SimulatorDetection, initial: Array) -> Problem:
        """Pose least squares by rollouts; see `Experiment.problem`."""
        return SimulatorProblem(detection.connected, initial, detection.source.digest)

    def checks(
        self, detection: SimulatorDetection, last: Step, fit: FitResult | None
    ) -> tuple[Check, ...]:
        """See `Experiment.checks`."""
        assert last.evaluation is not None
        target = detection.connected.target
        residuals = target.seen_in(last.evaluation.episode) - target.values
        whole = whole_check(last.evaluation.episode)
        checks = (*recording_checks(target), *([whole] if whole else []))
        checks = (*checks, match_check(target, residuals))
        return (*checks, *fit_checks(fit.detail)) if fit else checks

    def cross_check(self, detection: SimulatorDetection, estimate: Array) -> CrossCheck | None:
        """Return None: the hold-out is the check; see `Experiment.cross_check`."""
        del detection, estimate

    def motion(self, detection: SimulatorDetection, trace: Trace) -> Motion | None:
        """Return None: a simulator may show many signals, which are the review's."""
        del detection, trace

    def rebounds(self, detection: SimulatorDetection, trace: Trace) -> tuple[Rebound, ...]:
        """Return none; see `Experiment.rebounds`."""
        del detection, trace
        return ()

    def review(self, stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
        """See `Experiment.review`."""
        if tuning.detection is None:
            return None
        from analysis.sysid.review.views import log_simulator

        return log_simulator(stream, tuning)


def moments_of(detection: SimulatorDetection) -> Array:
    """Return all compared stamps since the log's first sample, shape (M,) [s]."""
    return np.unique(detection.connected.target.seconds) + detection.offset_s
