"""Tune every target of every source in every engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.drop.motion import matched
from analysis.estimators.base import Step
from analysis.evaluation.engines.exact_engine import EXACT, simulated_in
from analysis.evaluation.engines.motion import (
    RADIUS_M,
    apart_percent,
    fine_seconds,
    rebound_restitution,
    simulated_m,
    source_m,
)
from analysis.evaluation.engines.targets import RANGES, EngineTarget, Promise, drawn_targets
from analysis.evaluation.real_balls.physics import RealBall
from analysis.processes import Piece, parallel_map
from analysis.selection import Options
from analysis.tuning import tune_episode
from recorders.simulators.drop import TOPIC
from recorders.simulators.engines import ENGINES, engine
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import Progress

ROLLOUTS = 5  # of each tuning: `tunenet-tune --iterations 5`
# The network's steps alone, and the default, which goes on from there. One tuning has both.
METHODS = ("tunenet", "tunenet+refine")

NAMES = (*ENGINES, EXACT)  # sources, and engines that are tuned
_PORTION = 5  # targets in a portion: few, so that the processes end together
_TOPIC = "/vrpn/ball/pose"
_START_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class EngineOrder:
    """Settings of the experiment.

    Attributes:
        seeds: each draws its own targets.
        targets: of each range and seed.
        jobs: processes; None for all cores.
    """

    seeds: tuple[int, ...]
    targets: int
    jobs: int | None = None


@dataclass(frozen=True)
class EnginePortion:
    """Targets made by one engine and tuned in another: what one process does in one go."""

    source: str
    engine: str
    targets: tuple[EngineTarget, ...]


@dataclass(frozen=True)
class TunedTarget:
    """Result of one method on a target.

    Attributes:
        wanted: effective restitution of the target, by the height of its first rebound.
        found: of the tuned ball in the engine that was tuned, likewise.
        apart_percent: rms difference of the two motions over the bounces in view [% of the drop].
        is_ok: whether that is the tuning's verdict, and not "suspect".
    """

    wanted: float
    found: float
    apart_percent: float
    is_ok: bool

    @property
    def error(self) -> float:
        """Absolute error of the effective restitution."""
        return abs(self.found - self.wanted)


@dataclass(frozen=True)
class EngineLine:
    """Targets of one range from one source, tuned in one engine by one method.

    Attributes:
        engine: that is tuned.
        missing: which of the two engines is not installed; None where both are.
        targets: how many were posed.
        outcomes: of those that were answered: a ball that stays down has no restitution to tune.
    """

    source: str
    engine: str
    promise: Promise
    method: str
    missing: str | None
    targets: int
    outcomes: tuple[TunedTarget, ...]

    @property
    def ok_errors(self) -> tuple[float, ...]:
        """Errors of the effective restitution where the verdict is ok."""
        return tuple(one.error for one in self.outcomes if one.is_ok)

    @property
    def is_kept(self) -> bool | None:
        """Whether the promise is kept where the verdict is ok; None without either."""
        if self.promise.worst is None or self.method != METHODS[-1] or not self.ok_errors:
            return None
        return max(self.ok_errors) <= self.promise.worst


def missing_engine(*names: str) -> str | None:
    """Return the first of these that is not installed."""
    for name in names:
        try:
            if name != EXACT:
                engine(name)
        except UsageError:
            return name
    return None


def engine_lines(order: EngineOrder, progress: Progress) -> list[EngineLine]:
    """Tune every pair of source and engine, range by range; the same for any number of jobs."""
    pairs = [(source, tuned) for source in NAMES for tuned in NAMES]
    missing = {pair: missing_engine(*pair) for pair in pairs}
    cells: list[tuple[Promise, tuple[str, str], slice]] = []
    pieces: list[Piece[EnginePortion]] = []
    for promise in RANGES:
        drawn = [
            target
            for seed in order.seeds
            for target in drawn_targets(promise.name, order.targets, seed)
        ]
        for pair in pairs:
            start = len(pieces)
            for at in range(0, len(drawn) if missing[pair] is None else 0, _PORTION):
                portion = EnginePortion(*pair, tuple(drawn[at : at + _PORTION]))
                pieces.append(Piece(portion, len(portion.targets), " to ".join(pair)))
            cells.append((promise, pair, slice(start, len(pieces))))
    done = parallel_map(tuned_targets, pieces, order.jobs, progress, ("tuning", "target"))
    count = len(order.seeds) * order.targets
    return [
        EngineLine(*pair, promise, method, missing[pair], count, _answered(done[own], method))
        for promise, pair, own in cells
        for method in METHODS
    ]


def _answered(
    portions: Sequence[list[dict[str, TunedTarget]]], method: str
) -> tuple[TunedTarget, ...]:
    return tuple(one[method] for portion in portions for one in portion if method in one)


def tuned_targets(portion: EnginePortion) -> list[dict[str, TunedTarget]]:
    """Tune each target by each method; nothing where the tuning rejects it."""
    with simulated_in(portion.engine):
        return [_tuned(portion.source, portion.engine, target) for target in portion.targets]


def _tuned(source: str, tuned_engine: str, target: EngineTarget) -> dict[str, TunedTarget]:
    drop_m = target.ball.drop_m
    heights_m = source_m(source, target.ball, target.seconds)
    options = Options(task="drop", iterations=ROLLOUTS, initial=(target.initial,))
    tuning = tune_episode(_recorded(target.seconds, heights_m), options)
    trace = tuning.trace
    if trace is None:
        return {}
    last_of_network = trace.steps[-2] if trace.fit is not None else trace.steps[-1]
    fine_s = fine_seconds(drop_m)
    wanted = rebound_restitution(source_m(source, target.ball, fine_s))
    found: dict[str, TunedTarget] = {}
    for method, step in zip(METHODS, (last_of_network, trace.steps[-1]), strict=True):
        restitution, slope, drag_1_m = step.values.tolist()
        tuned = RealBall(restitution, slope, drag_1_m, drop_m)
        found[method] = TunedTarget(
            wanted,
            rebound_restitution(simulated_m(tuned_engine, tuned, fine_s)),
            apart_percent(heights_m, _rolled_out_m(step, target.seconds)),
            tuning.verdict == "ok",
        )
    return found


def _recorded(seconds: Array, heights_m: Array) -> Episode:
    """Build the log in memory: positions alone, nothing of ball, table or release."""
    stamps_ns = _START_NS + np.round(1e9 * seconds).astype(np.int64)
    positions_m = np.zeros((len(seconds), 3))
    positions_m[:, 2] = RADIUS_M + heights_m
    signal = Signal(_TOPIC, stamps_ns, positions_m, ("x", "y", "z"), "m")
    return Episode(EpisodeInfo(), {_TOPIC: signal})


def _rolled_out_m(step: Step, seconds: Array) -> Array:
    """Return the underside's heights in the tuning's own rollout at the log's stamps [m], (T,)."""
    assert step.evaluation is not None
    episode = step.evaluation.episode
    signal = episode.signals[TOPIC]
    at, rows = matched(seconds, (signal.stamps_ns - _START_NS).astype(np.float64) * 1e-9)
    heights_m = np.full(len(seconds), np.nan)
    heights_m[at] = signal.values[rows, 2] - episode.info.rig["ball_diameter_m"] / 2
    return heights_m
