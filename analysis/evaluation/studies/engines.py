"""Tune balls that one engine drops in another: does a tuning mean the same everywhere?

Each engine, and an exact one beside them, is the source of targets (Easy, Hard and real balls in
air) and is tuned to those of every other. Compared is what is effective: the first rebound's height
and the motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from tunenet_logs.analysis.drop.motion import matched
from tunenet_logs.analysis.drop.presets import PAPER_RADIUS_M, PAPER_RATE_HZ, PAPER_SAMPLES
from tunenet_logs.analysis.estimators.base import Step
from tunenet_logs.analysis.evaluation.studies.drop_methods import EASY, HARD, draw_targets
from tunenet_logs.analysis.evaluation.study import Order, Part, Row, figure, scored, short, table
from tunenet_logs.analysis.evaluation.worlds import ball as balls
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators import ball as simulator
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

# By which the integrator's clock is slowed: its gravity is then the engines', while restitutions
# and drags, which no clock is in, stay as they are.
CLOCK = math.sqrt(balls.GRAVITY_M_S2 / GRAVITY_M_S2)


def integrated_m(ball: balls.RealBall, seconds: Array) -> Array:
    """Integrate the heights of the underside without an engine [m], shape (T,)."""
    own_s = seconds / CLOCK
    return balls.fallen(ball.values[None], float(own_s[-1])).at(own_s[None])[0]


def simulated_m(name: str, ball: balls.RealBall, seconds: Array) -> Array:
    """Simulate the same heights in an engine of this name, one of `ENGINES`."""
    rig = simulator.DropRig(gap_m=ball.drop_m, radius_m=RADIUS_M, times_s=tuple(seconds.tolist()))
    world = engine(name).ball_world(RADIUS_M, CALIBRATED)
    values = {
        simulator.RESTITUTION.name: ball.restitution,
        simulator.SLOPE.name: ball.slope,
        simulator.DRAG.name: ball.drag_1_m,
    }
    episode = simulator.DropSimulator(rig, CALIBRATED, world).rollout(values)
    return episode.signals[simulator.TOPIC].values[:, 2] - RADIUS_M


def source_m(name: str, ball: balls.RealBall, seconds: Array) -> Array:
    """Return the heights by a target's source: an engine, or the integrator for `EXACT`."""
    return integrated_m(ball, seconds) if name == EXACT else simulated_m(name, ball, seconds)


def fine_seconds(drop_m: float) -> Array:
    """Return times at which a drop's first rebound can be measured, shape (T,).

    The top of that of a ball that keeps its speed is at 2 fall times, in air a little later.
    """
    return np.arange(0.0, 2.4 * math.sqrt(2 * drop_m / GRAVITY_M_S2), 1 / 1920.0)


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
    last = int(np.flatnonzero(heights_m > balls.MIN_FALL * heights_m[0])[-1])
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

    ball: balls.RealBall  # given to the source
    initial: float  # the first guess of its restitution
    rate_hz: float  # of the samples
    samples: int  # how many, the first at the release

    @property
    def seconds(self) -> Array:
        """Times of the samples after the release, shape (T,)."""
        return np.arange(self.samples) / self.rate_hz


def drawn_targets(which: str, count: int, seed: int) -> list[EngineTarget]:
    """Draw `count` targets of a range; the same for every pair of engines, by the seed.

    Easy and Hard are those of `tunenet-eval drop`: 400 samples at 60 Hz from 3.5 to 4.5 m. Real
    balls are of the ranges of `tunenet-eval real-balls`.
    """
    if which != REAL:
        found = draw_targets({EASY.name: EASY, HARD.name: HARD}[which], count, seed)
        return [
            EngineTarget(
                balls.RealBall(one.truth, 0.0, 0.0, one.release_m - PAPER_RADIUS_M),
                *(one.initial, PAPER_RATE_HZ, PAPER_SAMPLES),
            )
            for one in found
        ]
    rng = np.random.default_rng([balls.TEST_SEEDS + seed, *REAL.encode()])
    targets: list[EngineTarget] = []
    for _ in range(count):
        ball, rate_hz = balls.drawn_ball(rng)
        first = rng.uniform(*HARD.initial)
        targets.append(EngineTarget(ball, first, rate_hz, round(balls.MAX_S * rate_hz)))
    return targets


# ---- Run: every target of every source, tuned in every engine.

ROLLOUTS = 5  # of each tuning: `tunenet-tune --iterations 5`
# The network's steps alone, and the default, which goes on from there. One tuning has both.
METHODS = ("tunenet", "tunenet+refine")

NAMES = (*ENGINES, EXACT)  # sources, and engines that are tuned


@dataclass(frozen=True)
class Portion:
    """Targets made by one engine and tuned in another."""

    source: str
    engine: str
    targets: tuple[EngineTarget, ...]


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Tune every pair of source and engine, range by range."""
    cells = [(one, source, tuned) for one in RANGES for source in NAMES for tuned in NAMES]
    cases: dict[tuple[Promise, str, str], list[Piece[Portion]]] = {}
    for promise, source, tuned in cells:
        if missing_engine(source, tuned) is not None:
            continue
        targets = [
            target
            for seed in order.seeds
            for target in drawn_targets(promise.name, order.targets, seed)
        ]
        portions = [tuple(targets[at : at + 5]) for at in range(0, len(targets), 5)]
        cases[promise, source, tuned] = [
            Piece(Portion(source, tuned, some), len(some), f"{source} to {tuned}")
            for some in portions
        ]
    done = scored(tuned_targets, cases, order, progress, ("tuning", "target"))
    count = len(order.seeds) * order.targets
    rows = [
        line_of(*cell, method, count, done.get(cell, [])) for cell in cells for method in METHODS
    ]
    yield Part("", engine_tables(rows, order), rows)


def missing_engine(*names: str) -> str | None:
    """Return the first of these that is not installed."""
    for name in names:
        try:
            if name != EXACT:
                engine(name)
        except UsageError:
            return name
    return None


def tuned_targets(portion: Portion) -> list[Row]:
    """Tune each target; a row for each method, none where the tuning rejects it."""
    with simulated_in(portion.engine):
        return [
            row
            for target in portion.targets
            for row in _tuned(portion.source, portion.engine, target)
        ]


def _tuned(source: str, tuned_engine: str, target: EngineTarget) -> Iterator[Row]:
    drop_m = target.ball.drop_m
    heights_m = source_m(source, target.ball, target.seconds)
    positions_m = np.zeros((len(heights_m), 3))
    positions_m[:, 2] = RADIUS_M + heights_m
    options = TuneOptions(task="drop", iterations=ROLLOUTS, initial=(target.initial,))
    tuning = tune_episode(balls.ball_log(target.seconds, positions_m), options)
    trace = tuning.trace
    if trace is None:
        return
    last_of_network = trace.steps[-2] if trace.fit is not None else trace.steps[-1]
    fine_s = fine_seconds(drop_m)
    wanted = rebound_restitution(source_m(source, target.ball, fine_s))
    for method, step in zip(METHODS, (last_of_network, trace.steps[-1]), strict=True):
        restitution, slope, drag_1_m = step.values.tolist()
        tuned = balls.RealBall(restitution, slope, drag_1_m, drop_m)
        found = rebound_restitution(simulated_m(tuned_engine, tuned, fine_s))
        yield {
            "method": method,
            "wanted": wanted,  # effective restitution, by the height of the first rebound
            "found": found,  # of the tuned ball in the engine that was tuned, likewise
            "error": abs(found - wanted),
            # rms difference of the two motions over the bounces in view [% of the drop]
            "apart_percent": apart_percent(heights_m, _rolled_out_m(step, target.seconds)),
            "is_ok": tuning.verdict == "ok",
        }


def _rolled_out_m(step: Step, seconds: Array) -> Array:
    """Return the underside's heights in the tuning's own rollout at the log's stamps [m], (T,)."""
    assert step.evaluation is not None
    episode = step.evaluation.episode
    signal = episode.signals[simulator.TOPIC]
    at, rows = matched(seconds, (signal.stamps_ns - balls.START_NS).astype(np.float64) * 1e-9)
    heights_m = np.full(len(seconds), np.nan)
    heights_m[at] = signal.values[rows, 2] - episode.info.rig["ball_diameter_m"] / 2
    return heights_m


# ---- Figures and tables.


def line_of(
    promise: Promise, source: str, tuned: str, method: str, targets: int, scores: Sequence[Row]
) -> Row:
    """Return the figures of one range from one source, tuned in one engine by one method."""
    own = [one for one in scores if one["method"] == method]
    errors, ok_errors = (
        [one["error"] for one in own if one["is_ok"] or not only_ok] for only_ok in (False, True)
    )
    apart = [one["apart_percent"] for one in own]
    is_promised = promise.worst is not None and method == METHODS[-1] and bool(ok_errors)
    return {
        "set": promise.name,
        "source": source,
        "engine": tuned,
        "method": method,
        "missing": missing_engine(source, tuned),  # which of the two is not installed
        "targets": targets,
        # a ball that stays down has no restitution to tune
        "answered": len(own),
        "ok": len(ok_errors),
        "mean": figure(errors),
        "worst": figure(errors, np.max),
        "worst_ok": figure(ok_errors, np.max),
        "promised": promise.worst,
        "is_kept": max(ok_errors) <= (promise.worst or 0) if is_promised else None,
        "motion_mean_percent": figure(apart),
        "motion_worst_percent": figure(apart, np.max),
        "outcomes": [dict(one) for one in own],
    }


def engine_tables(rows: Sequence[Row], order: Order) -> str:
    """Tabulate all pairs for each range, each with the network alone and with the default."""
    tables = [
        f"Made in one engine, tuned in another; {order.seeds_in_words}, {order.targets} "
        f"targets each, {ROLLOUTS} rollouts.\n"
        "mean, worst: error of the effective restitution (the root of the first rebound's height\n"
        "over the drop's), by the source's motion and the tuned simulator's, of all answered.\n"
        "motion: rms difference of the two over the bounces in view, mean [% of the drop height].\n"
        "worst ok: of those whose verdict is ok, not suspect; a promise is for them."
    ]
    for promise in RANGES:
        network, default = (
            [one for one in rows if one["set"] == promise.name and one["method"] == name]
            for name in METHODS
        )
        title = f"{promise.name} (slope and drag; nothing is promised)"
        if promise.worst is not None:
            kept = [one["is_kept"] for one in default if one["is_kept"] is not None]
            title = (
                f"{promise.name} (promised of {METHODS[-1]}: worst within {short(promise.worst)}; "
                f"kept by {sum(kept)} of {len(kept)} pairs)"
            )
        lines = [
            ["", "", "", "", METHODS[0], "", "", METHODS[1]],
            ["source", "tuned in", "ok", "answered", *2 * ("mean", "worst", "motion"), "worst ok"],
        ]
        for one, full in zip(network, default, strict=True):
            cells = [full["source"], full["engine"]]
            if full["missing"] is not None:
                lines.append([*cells, f"not run: {full['missing']} is not installed"])
                continue
            cells += [str(full["ok"]), f"{full['answered']} of {full['targets']}"]
            for each in (one, full):
                motion = each["motion_mean_percent"]
                cells += [short(each["mean"]), short(each["worst"])]
                cells.append("-" if motion is None else f"{short(motion)} %")
            missed = "missed" if full["is_kept"] is False else ""
            lines.append([*cells, short(full["worst_ok"]), missed])
        tables.append(table(lines, title))
    return "\n\n".join(tables)
