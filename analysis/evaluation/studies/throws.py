"""Tune thrown and dribbled balls: bounces that do not begin at rest.

Between hand and ground the balls fly in closed form, in air, with a restitution that may fall with
speed; a hand moves them along quintics. Nothing is shared with the fit or the simulator.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.evaluation.study import Order, Part, Row, figure, listed, scored
from tunenet_logs.analysis.evaluation.worlds.ball import GRAVITY_M_S2
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.terminal import Progress

# ---- A ball in a hand, in the air and on the ground.

_STEP_S = 1 / 20_000  # of what is written down, and of what a hand does
_MIN_DRAG_1_M = 1e-7
_MAX_RESTITUTION = 0.99


# When a ball is caught: from times [s], heights and speeds of a flight, shape (T,) each.
Caught = Callable[[Array, Array, Array], NDArray[np.bool_]]


class Hit(NamedTuple):
    """Impact."""

    seconds: float
    restitution: float
    speed_m_s: float  # downward


@dataclass
class _World:
    """Ball, and what has become of it."""

    restitution: float  # at the first impact
    slope: float  # p of e_n = e_1 (v_n / v_1)^-p
    drag_1_m: float
    height_m: float
    speed_m_s: float = 0.0  # upward
    hits: list[Hit] = field(default_factory=list[Hit])
    heights: list[float] = field(default_factory=list[float])  # step by step

    def hold(self, seconds: float) -> None:
        """Hold the ball where it is."""
        self.heights += [self.height_m] * round(seconds / _STEP_S)
        self.speed_m_s = 0.0

    def carry(self, height_m: float, speed_m_s: float, seconds: float) -> None:
        """Carry the ball to a height and speed, along a quintic."""
        from scipy.interpolate import BPoly

        ends = [[self.height_m, self.speed_m_s, 0.0], [height_m, speed_m_s, 0.0]]
        since = np.arange(1, round(seconds / _STEP_S) + 1) * _STEP_S
        self.heights += BPoly.from_derivatives([0.0, seconds], ends)(since).tolist()
        self.height_m, self.speed_m_s = height_m, speed_m_s

    def fly(self, caught: Caught | None = None) -> None:
        """Fly to the ground, or until the ball is caught."""
        # no flight is as long
        since = np.arange(round(3.0 / _STEP_S), dtype=np.float64) * _STEP_S
        heights, speeds = flight(self.height_m, self.speed_m_s, self.drag_1_m, since)
        landed = (heights < 0) & (speeds < 0)
        ended = landed if caught is None else landed | caught(since, heights, speeds)
        end = 1 + int(np.argmax(ended[1:]))
        self.heights += heights[1 : end + (not landed[end])].tolist()
        self.height_m, self.speed_m_s = float(heights[end]), float(speeds[end])
        if landed[end]:
            part = heights[end - 1] / (heights[end - 1] - heights[end])
            hit = -float(speeds[end - 1] + part * (speeds[end] - speeds[end - 1]))
            first = self.hits[0].speed_m_s if self.hits else hit
            kept = min(self.restitution * (hit / first) ** -self.slope, _MAX_RESTITUTION)
            self.hits.append(Hit((len(self.heights) + part) * _STEP_S, kept, hit))
            self.height_m, self.speed_m_s = 0.0, kept * hit


def flight(height_m: float, speed_m_s: float, drag_1_m: float, since: Array) -> tuple[Array, Array]:
    """Return heights [m] and upward speeds [m/s] of a flight in air, shape (T,) each."""
    drag = max(drag_1_m, _MIN_DRAG_1_M)
    final = np.sqrt(GRAVITY_M_S2 / drag)
    up, down = max(speed_m_s, 0.0) / final, max(-speed_m_s, 0.0) / final
    phase = GRAVITY_M_S2 / final * since - np.arctan(up)  # before the apex below 0
    rising, falling = np.minimum(phase, 0.0), np.maximum(phase, 0.0) + np.arctanh(down)
    risen = np.log(np.cos(rising) * np.hypot(1.0, up)) / drag
    fallen = np.log(np.cosh(falling) * np.sqrt(1 - down**2)) / drag
    return height_m + risen - fallen, -final * (np.tan(rising) + np.tanh(falling))


# ---- How the ball comes to fly, drawn at random.


def _pushed(rng: np.random.Generator, world: _World, slowest: float, fastest: float) -> None:
    low = max(world.height_m - rng.uniform(0.1, 0.3), 0.1)
    world.carry(low, -rng.uniform(slowest, fastest), rng.uniform(0.15, 0.3))


def _thrown(rng: np.random.Generator, world: _World) -> None:
    world.hold(0.3)
    _pushed(rng, world, 1.5, 4.0)
    for _ in range(int(rng.integers(1, 5))):
        world.fly()
    caught_s = rng.uniform(0.2, 0.9) * 2 * world.speed_m_s / GRAVITY_M_S2
    world.fly(lambda since, _heights, _speeds: since >= caught_s)
    world.carry(max(world.height_m - 0.05, 0.05), 0.0, 0.25)
    world.hold(0.5)


def _dribbled(rng: np.random.Generator, world: _World) -> None:
    world.hold(0.2)
    _pushed(rng, world, 2.0, 4.0)
    for _ in range(4):
        world.fly()
        top_m = rng.uniform(0.55, 0.95) * world.speed_m_s**2 / (2 * GRAVITY_M_S2)
        world.fly(lambda _, heights, speeds, top_m=top_m: (heights > top_m) | (speeds < 0))
        low = max(world.height_m - 0.02, 0.1)
        world.carry(low, -rng.uniform(1.5, 3.5), rng.uniform(0.15, 0.3))
    world.fly()
    world.fly(lambda _since, _heights, speeds: speeds < 0.3)
    world.carry(world.height_m, 0.0, 0.2)
    world.hold(0.3)


def _bouncing(rng: np.random.Generator, world: _World) -> None:
    world.height_m, world.speed_m_s = rng.uniform(0.1, 0.8), rng.uniform(0.5, 3.0)
    _bounces(world, 6)


def _edge(rng: np.random.Generator, world: _World) -> None:
    world.hold(rng.uniform(0.1, 0.4))
    _bounces(world, 5)


def _bounces(world: _World, count: int) -> None:
    for _ in range(count):
        world.fly()
    world.fly(lambda _since, _heights, speeds: speeds < 0)


def _tossed(rng: np.random.Generator, world: _World) -> None:
    world.hold(0.3)
    for _ in range(4):
        low = world.height_m
        world.carry(low, rng.uniform(1.5, 3.5), rng.uniform(0.2, 0.35))
        world.fly(lambda _, heights, speeds, low=low: (heights < low) & (speeds < 0))
        world.carry(max(world.height_m - rng.uniform(0.05, 0.2), 0.3), 0.0, rng.uniform(0.1, 0.2))
    world.hold(0.3)


# Thrown down and caught at last; by hand again and again; bouncing when the recording begins;
# rolled off an edge; tossed from hand to hand, which is no bounce.
KINDS: Mapping[str, Callable[[np.random.Generator, _World], None]] = {
    "thrown": _thrown,
    "dribbled": _dribbled,
    "bouncing": _bouncing,
    "edge": _edge,
    "tossed": _tossed,
}


@dataclass(frozen=True, eq=False)
class Throw:
    """Recording and its truth."""

    kind: str  # of `KINDS`
    episode: Episode  # positions with noise, from 0 s on
    hits: tuple[Hit, ...]

    def hit_near(self, seconds: float) -> Hit:
        """Return the impact that is nearest in time."""
        return min(self.hits, key=lambda hit: abs(hit.seconds - seconds))


def throw(rng: np.random.Generator, kind: str, noise_m: float = 0.001) -> Throw:
    """Draw a recording of one of `KINDS`."""
    slope, drag = rng.uniform(0, 0.12), rng.uniform(0.003, 0.05)
    world = _World(
        rng.uniform(0.45, 0.92),
        float(slope * rng.integers(2)),
        float(drag * rng.integers(2)),
        rng.uniform(0.7, 1.5),
    )
    KINDS[kind](rng, world)
    rate_hz = float(rng.choice((60.0, 120.0, 200.0, 360.0)))
    times = np.arange(1, len(world.heights) + 1) * _STEP_S
    seconds = np.arange(times[0] + rng.random() / rate_hz, times[-1], 1 / rate_hz)
    aside = rng.uniform(-0.8, 0.8) if kind in ("edge", "thrown", "bouncing") else 0.05
    height = np.interp(seconds, times, world.heights)
    positions = np.column_stack([aside * seconds, 0 * seconds, height])
    positions += noise_m * rng.standard_normal(positions.shape)
    stamps_ns = np.round((seconds - seconds[0]) * 1e9).astype(np.int64)
    signal = Signal("/mocap/thing", stamps_ns, positions, ("x", "y", "z"), "m")
    hits = tuple(one._replace(seconds=one.seconds - seconds[0]) for one in world.hits)
    return Throw(kind, Episode(EpisodeInfo(), {signal.name: signal}), hits)


# ---- Run: throws of each kind in turn.

NOISES_M = {"usual": 0.001, "half": 0.0005, "twice": 0.002}  # of each coordinate, by the section


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Tune throws, a table for each noise."""
    for section in order.sections:
        noise_m = NOISES_M[section]
        cases = {"": order.pieces(10, noise_m)}
        found = scored(tuned_throws, cases, order, progress, ("tuning", "throw"))[""]
        kinds = {kind: [one for one in found if one["kind"] == kind] for kind in KINDS}
        rows = [line_of(kind, own) for kind, own in [*kinds.items(), ("all", found)]]
        title = (
            f"{order.seeds_in_words}, {order.targets} throws, noise of {1000 * noise_m:g} mm.\n"
            "mean, worst, held: of those that are ok; bounces: mean of all that are found.\n"
        )
        yield Part(section, listed(rows, title), rows)


def tuned_throws(case: tuple[float, int, range]) -> list[Row]:
    """Tune throws of a noise and a seed; NaN where nothing is told."""
    noise_m, seed, numbers = case
    kinds = list(KINDS)
    return [
        _tuned(throw(np.random.default_rng([seed, number]), kinds[number % len(kinds)], noise_m))
        for number in numbers
    ]


def _tuned(made: Throw) -> Row:
    tuning = tune_episode(made.episode, TuneOptions())
    row: Row = {"kind": made.kind, "verdict": tuning.verdict, "off": np.nan, "held": np.nan}
    found = record_of(tuning).rebounds
    near = [(one, made.hit_near(one.impact_s)) for one in found if made.hits]
    row["bounces"] = [abs(one.restitution - hit.restitution) for one, hit in near]
    # a bounce that is found farther from all impacts is none
    right = sum(abs(hit.seconds - one.impact_s) <= 0.03 for one, hit in near)
    row["false"] = len(found) - right
    if tuning.verdict == "ok" and made.hits and tuning.interval95 is not None:
        truth = made.hit_near(tuning.detection.drop.impact_s).restitution
        low, high = tuning.interval95[0]
        row["held"] = bool(low <= truth <= high)
        row["off"] = abs(float(tuning.trace.estimate[0]) - truth) if tuning.trace else np.nan
    return row


def line_of(kind: str, scores: Sequence[Row]) -> Row:
    """Compute the figures of throws of a kind."""
    counts = Counter(one["verdict"] for one in scores)
    errors = [one["off"] for one in scores]
    return {
        "kind": kind,
        **{verdict: counts[verdict] for verdict in ("ok", "suspect", "rejected")},
        "mean": figure(errors),
        "worst": figure(errors, np.max),
        "held": figure([one["held"] for one in scores]),
        "bounces": figure([off for one in scores for off in one["bounces"]]),
        "no_impact": sum(one["false"] for one in scores),  # bounces that are none
    }
