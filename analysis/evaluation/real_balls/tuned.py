"""Compare a tuning's parameters and motion with the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.evaluation.real_balls.drops import RecordedDrop
from analysis.record import Tuning, record_of
from recorders.simulators.drop import DropSimulator
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode

# By their names in a record; one that a tuning does not report is NaN.
PARAMETERS = ("restitution", "restitution_slope", "drag")

VERDICTS = ("ok", "suspect", "rejected")


@dataclass(frozen=True, eq=False)
class Found:
    """Result for one drop; NaN where there is none.

    Attributes:
        truth: restitution at the first impact, slope, drag [1/m], shape (3,).
        values: likewise.
        interval95: lower and upper ends, shape (3, 2).
        verdict: one of `VERDICTS`; "" for a fit that gives none.
        path: rms distance of its motion from the true one, from the release to the last bounce in
            view, over the drop.
    """

    truth: Array
    values: Array
    interval95: Array
    verdict: str
    path: float


def found_by(tuning: Tuning, drop: RecordedDrop) -> Found:
    """Return what a tuning on a drop found."""
    record = record_of(tuning)
    values, ends = np.full(3, np.nan), np.full((3, 2), np.nan)
    for at, name in enumerate(PARAMETERS):
        estimate = record.estimate(name)
        if estimate is None:
            continue
        values[at] = np.ravel(estimate.value)[0]
        if estimate.interval95 is not None:
            ends[at] = np.reshape(estimate.interval95, (-1, 2))[0]
    off = None if tuning.estimate is None else off_path(tuning, drop)
    path = np.nan if off is None else float(np.sqrt(np.mean(off**2)))
    return Found(drop.ball.values[:3], values, ends, tuning.verdict, path)


def off_path(tuning: Tuning, drop: RecordedDrop) -> Array | None:
    """Return the tuned simulator's position error over the drop, shape (T,).

    At the rollout's own samples, from the release to the last bounce in view. A film has no
    scale of its own: its rollout is in units of the drop that it simulates. None where nothing was
    simulated.
    """
    if tuning.trace is None:
        return None
    last = tuning.trace.steps[-1].evaluation
    assert last is not None
    return _off(tuning, last.episode, drop)


def off_motion(tuning: Tuning, drop: RecordedDrop) -> Array | None:
    """Return `off_path` with a rollout long enough for a drop that was seen in part.

    None for a rejected log, too.
    """
    if tuning.estimate is None or tuning.experiment is None:
        return None
    problem = tuning.experiment.problem(tuning.detection, tuning.estimate)
    simulator = problem.simulator
    assert isinstance(simulator, DropSimulator)
    rig = simulator.rig
    more = drop.last_bounce_s - drop.seconds_of(np.array([rig.start_ns]))[0]
    samples = max(rig.samples, int(np.ceil(more * rig.rate_hz)) + 2)
    names = [parameter.name for parameter in problem.parameters]
    values = dict(zip(names, map(float, tuning.estimate), strict=True))
    episode = simulator.with_rig(replace(rig, samples=samples)).rollout(values)
    return _off(tuning, episode, drop)


def _off(tuning: Tuning, episode: Episode, drop: RecordedDrop) -> Array:
    signal = next(iter(episode.signals.values()))
    rig = episode.info.rig
    heights = signal.values[:, 2] - rig["ball_diameter_m"] / 2
    is_film = tuning.detection is not None and tuning.detection.film is not None
    heights = heights / (rig["drop_height_m"] if is_film else drop.ball.drop_m)
    seconds = drop.seconds_of(signal.stamps_ns)
    shown = (seconds >= 0) & (seconds <= drop.last_bounce_s)
    return heights[shown] - drop.truth_m(seconds[shown]) / drop.ball.drop_m
