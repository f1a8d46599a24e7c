"""Tune balls that one engine drops in another: does a tuning mean the same everywhere?

Each engine, and an exact one beside them, is the source of targets (Easy, Hard and real balls in
air) and is tuned to those of every other. Compared is what is effective: the first rebound's height
and the motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tunenet_logs.analysis.drop.motion import matched
from tunenet_logs.analysis.drop.presets import PAPER_RADIUS_M, PAPER_RATE_HZ, PAPER_SAMPLES
from tunenet_logs.analysis.estimators.base import Step
from tunenet_logs.analysis.evaluation.studies.drop_methods import EASY, HARD, draw_targets
from tunenet_logs.analysis.evaluation.study import (
    csv_text,
    json_text,
    seeds_in_words,
    short,
    short_or_dash,
    table_line,
)
from tunenet_logs.analysis.evaluation.worlds import ball as physics
from tunenet_logs.analysis.evaluation.worlds.ball import (
    DRAGS_1_M,
    DROPS_M,
    MAX_S,
    MIN_FALL,
    RATES_HZ,
    RESTITUTIONS,
    SLOPES,
    TEST_SEEDS,
    RealBall,
    fallen,
)
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece, parallel_map
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.ball import (
    DRAG,
    RESTITUTION,
    SLOPE,
    TOPIC,
    DropRig,
    DropSimulator,
)
from tunenet_logs.recorders.simulators.base import CALIBRATED, GRAVITY_M_S2, ContactSettings
from tunenet_logs.recorders.simulators.known import ENGINES, engine, simulated_by
from tunenet_logs.terminal import Progress

# ---- Exact engine: a ball that touches the plane leaves it with the restitution that is set.
# This module has the names of `recorders.simulators.base.Engine` that a drop needs.


EXACT = "exact"

name = f"{EXACT} 1.0"


class ExactBallWorld:
    """Speed and height alone, reflected on contact; see `BallWorld`."""

    engine = name

    def __init__(self, radius_m: float, contact: ContactSettings) -> None:
        self.radius_m, self.contact = radius_m, contact
        self.place(0.0, 0.0)

    def place(self, gap_m: float, restitution: float) -> None:
        """See `BallWorld`."""
        self._height_m, self._speed_m_s = self.radius_m + gap_m, 0.0
        self._restitution = restitution

    def set_restitution(self, restitution: float) -> None:
        """See `BallWorld`."""
        self._restitution = restitution

    def set_speed(self, speed_m_s: float) -> None:
        """See `BallWorld`."""
        self._speed_m_s = speed_m_s

    def step(self, period_s: float) -> tuple[float, float]:
        """See `BallWorld`."""
        self._speed_m_s -= self.contact.gravity_m_s2 * period_s
        if self._height_m <= self.radius_m and self._speed_m_s < 0:
            self._speed_m_s *= -self._restitution
        self._height_m += self._speed_m_s * period_s
        return self._height_m, self._speed_m_s


ball_world = ExactBallWorld


@contextmanager
def simulated_in(engine: str) -> Iterator[None]:
    """Simulate with one of `ENGINES` or with the exact one in a block.

    Raises:
        UsageError: it is not installed.
    """
    ENGINES[EXACT] = __name__
    try:
        with simulated_by(engine):
            yield
    finally:
        del ENGINES[EXACT]


# ---- The motion of a ball in each engine, and what is measured of it.


RADIUS_M = 0.05  # of the balls that engines drop
# Samples by which a rebound's height is measured, and until when [fall times without air]: the top
# of the first rebound of a ball that keeps its speed is at 2, in air a little later.
_FINE_HZ, _FINE_FALLS = 1920.0, 2.4

# By which the integrator's clock is slowed: its gravity is then the engines', while restitutions
# and drags, which no clock is in, stay as they are.
CLOCK = math.sqrt(physics.GRAVITY_M_S2 / GRAVITY_M_S2)


def integrated_m(ball: RealBall, seconds: Array) -> Array:
    """Integrate the heights of the underside without an engine [m], shape (T,)."""
    own_s = seconds / CLOCK
    return fallen(ball.values[None], float(own_s[-1])).at(own_s[None])[0]


def simulated_m(name: str, ball: RealBall, seconds: Array) -> Array:
    """Simulate the same heights in an engine of this name, one of `ENGINES`."""
    rig = DropRig(gap_m=ball.drop_m, radius_m=RADIUS_M, times_s=tuple(seconds.tolist()))
    world = engine(name).ball_world(RADIUS_M, CALIBRATED)
    values = {
        RESTITUTION.name: ball.restitution,
        SLOPE.name: ball.slope,
        DRAG.name: ball.drag_1_m,
    }
    episode = DropSimulator(rig, CALIBRATED, world).rollout(values)
    return episode.signals[TOPIC].values[:, 2] - RADIUS_M


def source_m(name: str, ball: RealBall, seconds: Array) -> Array:
    """Return the heights by a target's source: an engine, or the integrator for `EXACT`."""
    return integrated_m(ball, seconds) if name == EXACT else simulated_m(name, ball, seconds)


def fine_seconds(drop_m: float) -> Array:
    """Return times at which a drop's first rebound can be measured, shape (T,)."""
    span_s = _FINE_FALLS * math.sqrt(2 * drop_m / GRAVITY_M_S2)
    return np.arange(0.0, span_s, 1 / _FINE_HZ)


def rebound_restitution(heights_m: Array) -> float:
    """Return the root of the first rebound's height over the drop's; 0 without a rebound."""
    rises = np.diff(heights_m) > 0
    lowest = int(np.argmax(rises))
    falls = np.flatnonzero(~rises[lowest:])
    if not rises.any() or not len(falls):
        return 0.0
    before, top, after = heights_m[lowest + falls[0] - 1 : lowest + falls[0] + 2].tolist()
    bend = before - 2 * top + after  # of the parabola through the three highest
    if bend:
        top -= (after - before) ** 2 / (8 * bend)
    return math.sqrt(max(top, 0.0) / float(heights_m[0]))


def apart_percent(heights_m: Array, others_m: Array) -> float:
    """Return the RMS difference of two motions over the bounces in view [% of the drop]."""
    last = int(np.flatnonzero(heights_m > MIN_FALL * heights_m[0])[-1])
    off_m = (heights_m - others_m)[: last + 1]
    return 100 * float(np.sqrt(np.mean(off_m**2)) / heights_m[0])


# ---- Targets: the paper's Easy and Hard ranges, and real balls in air.


REAL = "Real balls"


@dataclass(frozen=True)
class Promise:
    """Range of targets, and how well they are to be tuned."""

    name: str  # as tables and files have it
    # largest error of the effective restitution that the default method may make; None where
    # nothing is promised
    worst: float | None


RANGES = (Promise(EASY.name, 0.003), Promise(HARD.name, 0.005), Promise(REAL, None))


@dataclass(frozen=True)
class EngineTarget:
    """Ball to be dropped by one engine and tuned in another."""

    ball: RealBall  # given to the source
    initial: float  # the first guess of its restitution
    rate_hz: float  # of the samples
    samples: int  # how many, the first at the release

    @property
    def seconds(self) -> Array:
        """Times of the samples after the release, shape (T,)."""
        return np.arange(self.samples) / self.rate_hz


def drawn_targets(which: str, count: int, seed: int) -> list[EngineTarget]:
    """Draw `count` targets of a range; the same for every pair of engines, by the seed.

    Easy and Hard are those of `tunenet-eval drop`: 400 samples at 60 Hz from 3.5 to 4.5 m.
    """
    if which == REAL:
        rng = np.random.default_rng([TEST_SEEDS + seed, *REAL.encode()])
        return [_real_ball(rng) for _ in range(count)]
    found = draw_targets({EASY.name: EASY, HARD.name: HARD}[which], count, seed)
    return [
        EngineTarget(
            RealBall(one.truth, 0.0, 0.0, one.release_m - PAPER_RADIUS_M),
            *(one.initial, PAPER_RATE_HZ, PAPER_SAMPLES),
        )
        for one in found
    ]


def _real_ball(rng: np.random.Generator) -> EngineTarget:
    """Draw a ball of the ranges of `tunenet-eval real-balls`."""
    low, high = np.log(DRAGS_1_M)
    ball = RealBall(
        rng.uniform(*RESTITUTIONS),
        rng.uniform(*SLOPES),
        float(np.exp(rng.uniform(low, high))),
        rng.uniform(*DROPS_M),
    )
    rate_hz = RATES_HZ[int(rng.integers(len(RATES_HZ)))]
    return EngineTarget(ball, rng.uniform(*HARD.initial), rate_hz, round(MAX_S * rate_hz))


# ---- Run: every target of every source, tuned in every engine.


ROLLOUTS = 5  # of each tuning: `tunenet-tune --iterations 5`
# The network's steps alone, and the default, which goes on from there. One tuning has both.
METHODS = ("tunenet", "tunenet+refine")

NAMES = (*ENGINES, EXACT)  # sources, and engines that are tuned
_PORTION = 5  # targets in a portion: few, so that the processes end together
_TOPIC = "/vrpn/ball/pose"
_START_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class EngineOrder:
    """Settings of the experiment."""

    seeds: tuple[int, ...]  # each draws its own targets
    targets: int  # of each range and seed
    jobs: int | None = None  # processes; None for all cores


@dataclass(frozen=True)
class EnginePortion:
    """Targets made by one engine and tuned in another: what one process does in one go."""

    source: str
    engine: str
    targets: tuple[EngineTarget, ...]


@dataclass(frozen=True)
class TunedTarget:
    """Result of one method on a target."""

    wanted: float  # effective restitution of the target, by the height of its first rebound
    found: float  # of the tuned ball in the engine that was tuned, likewise
    # rms difference of the two motions over the bounces in view [% of the drop]
    apart_percent: float
    is_ok: bool  # whether that is the tuning's verdict, and not "suspect"

    @property
    def error(self) -> float:
        """Absolute error of the effective restitution."""
        return abs(self.found - self.wanted)


@dataclass(frozen=True)
class EngineLine:
    """Targets of one range from one source, tuned in one engine by one method."""

    source: str
    engine: str  # that is tuned
    promise: Promise
    method: str
    missing: str | None  # which of the two engines is not installed; None where both are
    targets: int  # how many were posed
    # of those that were answered: a ball that stays down has no restitution to tune
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
    options = TuneOptions(task="drop", iterations=ROLLOUTS, initial=(target.initial,))
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


# ---- JSON and CSV: one row for each range, pair of engines and method.


# Of the CSV.
COLUMNS = (
    "set",
    "source",
    "engine",
    "method",
    "missing",
    "targets",
    "answered",
    "ok",
    "mean",
    "worst",
    "worst_ok",
    "promised",
    "is_kept",
    "motion_mean_percent",
    "motion_worst_percent",
)


def engines_json(lines: Sequence[EngineLine], order: EngineOrder) -> str:
    """Serialise every figure, and every target behind it."""
    rows = [{**_record(line), "outcomes": [asdict(one) for one in line.outcomes]} for line in lines]
    head = {"experiment": "engines", "seeds": list(order.seeds), "targets": order.targets}
    return json_text({**head, "rollouts": ROLLOUTS, "rows": rows})


def engines_csv(lines: Sequence[EngineLine]) -> str:
    """Format the figures alone; an empty field where there is none."""
    return csv_text(COLUMNS, [_record(line) for line in lines])


def _record(line: EngineLine) -> dict[str, Any]:
    errors = [one.error for one in line.outcomes]
    apart = [one.apart_percent for one in line.outcomes]
    figures = (
        line.promise.name,
        line.source,
        line.engine,
        line.method,
        line.missing,
        line.targets,
        len(line.outcomes),
        len(line.ok_errors),
        float(np.mean(errors)) if errors else None,
        max(errors, default=None),
        max(line.ok_errors, default=None),
        line.promise.worst,
        line.is_kept,
        float(np.mean(apart)) if apart else None,
        max(apart, default=None),
    )
    return dict(zip(COLUMNS, figures, strict=True))


# ---- Tables for a terminal.


_WIDTHS = (10, 10, 7, 12, 8, 8, 10, 8, 8, 10, 10, 0)


def engine_tables(lines: Sequence[EngineLine], order: EngineOrder) -> str:
    """Tabulate all pairs for each range, each with the network alone and with the default."""
    head = [
        f"Made in one engine, tuned in another; {seeds_in_words(order.seeds)}, {order.targets} "
        f"targets each, {ROLLOUTS} rollouts.",
        "mean, worst: error of the effective restitution (the root of the first rebound's height",
        "over the drop's), by the source's motion and the tuned simulator's, of all answered.",
        "motion: rms difference of the two over the bounces in view, mean [% of the drop height].",
        "worst ok: of those whose verdict is ok, not suspect; a promise is for them.",
    ]
    return "\n".join(head) + "".join(f"\n\n{_table(one, lines)}" for one in RANGES)


def _table(promise: Promise, lines: Sequence[EngineLine]) -> str:
    own = [line for line in lines if line.promise == promise]
    network, default = ([line for line in own if line.method == name] for name in METHODS)
    methods = table_line(("", "", "", "", METHODS[0], "", "", METHODS[1]), _WIDTHS)
    columns = ("mean", "worst", "motion")
    rows = [
        methods,
        table_line(
            ("source", "tuned in", "ok", "answered", *columns, *columns, "worst ok"), _WIDTHS
        ),
        *(_row(*pair) for pair in zip(network, default, strict=True)),
    ]
    return "\n".join([f"{promise.name}{_promised(promise, default)}", *rows])


def _promised(promise: Promise, lines: Sequence[EngineLine]) -> str:
    if promise.worst is None:
        return " (slope and drag; nothing is promised)"
    verdicts = [line.is_kept for line in lines if line.is_kept is not None]
    kept = f"kept by {sum(verdicts)} of {len(verdicts)} pairs"
    return f" (promised of {METHODS[-1]}: worst within {short(promise.worst)}; {kept})"


def _row(network: EngineLine, default: EngineLine) -> str:
    if default.missing is not None:
        why = f"not run: {default.missing} is not installed"
        return table_line((default.source, default.engine, why), _WIDTHS)
    ok, answered = len(default.ok_errors), f"{len(default.outcomes)} of {default.targets}"
    cells = [default.source, default.engine, str(ok), answered]
    cells += [
        *_figures(network),
        *_figures(default),
        short_or_dash(max(default.ok_errors, default=None)),
    ]
    missed = "missed" if default.is_kept is False else ""
    return table_line((*cells, missed), _WIDTHS)


def _figures(line: EngineLine) -> tuple[str, str, str]:
    if not line.outcomes:
        return "-", "-", "-"
    motion = float(np.mean([one.apart_percent for one in line.outcomes]))
    errors = [one.error for one in line.outcomes]
    return short(float(np.mean(errors))), short(max(errors)), f"{short(motion)} %"
