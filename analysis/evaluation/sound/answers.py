"""Collect the product's answers to a sound, alone or beside pictures."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from analysis.record import Record, Tuning, record_of
from analysis.selection import Options, Selection
from analysis.tuning import tune_episode
from recorders.simulators.balls import UNKNOWN_BALL, Ball
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode


@dataclass(frozen=True)
class SoundAnswer:
    """Answer of a tuning; NaN where there is none.

    Attributes:
        verdict: "ok", "suspect" or "rejected".
        reason: why it is not "ok"; "" where it is.
        value: restitution, at the first impact that the log determines.
        low: lower end of its 95 % interval.
        high: upper end.
        slope: of the restitution's fall with speed.
        rebounds: when each impact was, after the log's first sample, and its restitution.
        seconds: of the processor.
    """

    verdict: str
    reason: str
    value: float
    low: float
    high: float
    slope: float
    rebounds: tuple[tuple[float, float], ...]
    seconds: float

    @property
    def is_answered(self) -> bool:
        """Whether a user gets a value that counts: with its interval, or "ok"."""
        return bool(np.isfinite(self.value)) and (self.verdict == "ok" or np.isfinite(self.low))

    @property
    def width(self) -> float:
        """Width of the interval."""
        return self.high - self.low

    def covers(self, truth: float) -> bool:
        """Check whether the interval holds the truth."""
        return self.low <= truth <= self.high


def answer_to(episode: Episode, ball: Ball = UNKNOWN_BALL) -> tuple[SoundAnswer, Array]:
    """Tune an episode; return the answer, and the impact times heard [s], shape (N,)."""
    began_s = time.process_time()
    tuning = tune_episode(episode, Options(selection=Selection(ball=ball)))
    seconds = time.process_time() - began_s
    return answer_of(record_of(tuning), seconds), _heard_s(tuning)


def answer_of(record: Record, seconds: float) -> SoundAnswer:
    """Extract the answer from a record."""
    found = record.estimate("restitution")
    slope = record.estimate("restitution_slope")
    low, high = np.nan, np.nan
    if found is not None and found.interval95 is not None:
        low, high = np.ravel(found.interval95).tolist()[:2]
    return SoundAnswer(
        verdict=record.verdict,
        reason=record.reason or "",
        value=np.nan if found is None else float(np.ravel(found.value)[0]),
        low=low,
        high=high,
        slope=np.nan if slope is None else float(np.ravel(slope.value)[0]),
        rebounds=tuple((one.impact_s, one.restitution) for one in record.rebounds),
        seconds=seconds,
    )


def _heard_s(tuning: Tuning) -> Array:
    """Return the impact times that a sound alone was tuned by; none of a video."""
    times = getattr(tuning.detection, "times_s", None)
    return np.zeros(0) if times is None else np.asarray(times, dtype=np.float64)


def without_sound(episode: Episode) -> Episode:
    """Return the episode without sound."""
    channels = tuple(channel for channel in episode.channels if not channel.sounds)
    return replace(episode, channels=channels, open_sound=None)
