"""Tune thrown and dribbled balls: bounces that do not begin at rest.

The balls fly by an integrator of this file's own (Runge and Kutta's, 20 kHz), in air, with a
restitution that may fall with speed; a hand moves them along quintics. Nothing is shared with the
fit or the simulator.

    python -m tests.bench.throws --seed 11 --count 400
"""

from __future__ import annotations

import argparse
import collections
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal

# How the ball comes to fly: thrown down and caught at last; by hand again and again; bouncing when
# the recording begins; rolled off an edge; tossed from hand to hand, which is no bounce.
KINDS = ("thrown", "dribbled", "bouncing", "edge", "tossed")

_RATES_HZ = (60.0, 120.0, 200.0, 360.0)
_STEP_S = 1 / 20_000
_GRAVITY_M_S2 = 9.81
_NEAR_S = 0.03  # of an impact: a bounce that is found farther from all is none


@dataclass(frozen=True)
class Hit:
    """Impact: when [s], its restitution, its speed [m/s]."""

    seconds: float
    restitution: float
    speed_m_s: float


@dataclass
class _World:
    """Ball in a hand, in the air and on the ground; times and heights as they come."""

    restitution: float
    slope: float
    drag_1_m: float
    height_m: float
    speed_m_s: float = 0.0
    seconds: float = 0.0
    hits: list[Hit] = field(default_factory=list)
    times: list[Array] = field(default_factory=list)
    heights: list[Array] = field(default_factory=list)

    def hold(self, seconds: float) -> None:
        """Hold the ball where it is."""
        self._moved(np.full(round(seconds / _STEP_S), self.height_m))
        self.speed_m_s = 0.0

    def carry(self, height_m: float, speed_m_s: float, seconds: float) -> None:
        """Carry the ball to a height and speed, along a quintic."""
        powers = np.array([3, 4, 5])
        ends = np.array([seconds**powers, powers * seconds ** (powers - 1)])
        ends = np.vstack([ends, powers * (powers - 1) * seconds ** (powers - 2)])
        gap = height_m - self.height_m - self.speed_m_s * seconds
        curve = np.linalg.solve(ends, [gap, speed_m_s - self.speed_m_s, 0.0])
        since = np.arange(1, round(seconds / _STEP_S) + 1) * _STEP_S
        rise = (since[:, None] ** powers) @ curve
        self._moved(self.height_m + self.speed_m_s * since + rise)
        self.height_m, self.speed_m_s = height_m, speed_m_s

    def fly(self, until: Callable[[float], bool] = lambda _: False) -> bool:
        """Fly to the ground, or until something ends it [s since]; return whether it hit."""
        path: list[float] = []
        while True:
            before_m, before_m_s = self.height_m, self.speed_m_s
            self._step()
            if self.height_m < 0 and self.speed_m_s < 0:
                part = before_m / (before_m - self.height_m)
                self._moved(np.array(path))
                at_s = self.seconds + part * _STEP_S
                self._hit(at_s, before_m_s + part * (self.speed_m_s - before_m_s))
                return True
            path.append(self.height_m)
            if until(len(path) * _STEP_S) or len(path) > 10 / _STEP_S:
                self._moved(np.array(path))
                return False

    def _step(self) -> None:
        def pull(speed: float) -> float:
            return -_GRAVITY_M_S2 - self.drag_1_m * speed * abs(speed)

        first = pull(self.speed_m_s)
        second = pull(self.speed_m_s + first * _STEP_S / 2)
        third = pull(self.speed_m_s + second * _STEP_S / 2)
        last = pull(self.speed_m_s + third * _STEP_S)
        self.height_m += self.speed_m_s * _STEP_S + _STEP_S**2 / 6 * (first + second + third)
        self.speed_m_s += _STEP_S / 6 * (first + 2 * second + 2 * third + last)

    def _hit(self, at_s: float, speed_m_s: float) -> None:
        first = self.hits[0].speed_m_s if self.hits else -speed_m_s
        kept = min(self.restitution * (-speed_m_s / first) ** -self.slope, 0.99)
        self.hits.append(Hit(at_s, kept, -speed_m_s))
        self.height_m, self.speed_m_s = 0.0, -kept * speed_m_s

    def _moved(self, heights: Array) -> None:
        since = np.arange(1, len(heights) + 1, dtype=np.float64) * _STEP_S
        self.times.append(self.seconds + since)
        self.heights.append(heights)
        self.seconds += _STEP_S * len(heights)


@dataclass(frozen=True, eq=False)
class Throw:
    """Recording: times [s], positions [m] with noise, shape (T, 3), and its impacts."""

    kind: str
    seconds: Array
    positions_m: Array
    hits: tuple[Hit, ...]

    def episode(self) -> Episode:
        """Return the recording as a log has it."""
        stamps_ns = np.round(self.seconds * 1e9).astype(np.int64)
        signal = Signal("/mocap/thing", stamps_ns, self.positions_m, ("x", "y", "z"), "m")
        return Episode(EpisodeInfo(), {signal.name: signal})


def throw(rng: np.random.Generator, kind: str, noise_m: float = 0.001) -> Throw:
    """Draw a recording of one of `KINDS`."""
    slope, drag = rng.uniform(0, 0.12), rng.uniform(0.003, 0.05)
    world = _World(
        rng.uniform(0.45, 0.92),
        float(slope * rng.integers(2)),
        float(drag * rng.integers(2)),
        rng.uniform(0.7, 1.5),
    )
    {
        "thrown": _thrown,
        "dribbled": _dribbled,
        "bouncing": _bouncing,
        "edge": _edge,
        "tossed": _tossed,
    }[kind](rng, world)
    rate_hz = float(rng.choice(_RATES_HZ))
    times, heights = np.concatenate(world.times), np.concatenate(world.heights)
    seconds = np.arange(times[0] + rng.random() / rate_hz, times[-1], 1 / rate_hz)
    aside = rng.uniform(-0.8, 0.8) if kind in ("edge", "thrown", "bouncing") else 0.05
    height = np.interp(seconds, times, heights)
    positions = np.column_stack([aside * seconds, 0 * seconds, height])
    positions += noise_m * rng.standard_normal(positions.shape)
    start = seconds[0]
    hits = tuple(Hit(one.seconds - start, one.restitution, one.speed_m_s) for one in world.hits)
    return Throw(kind, seconds - start, positions, hits)


def _push(rng: np.random.Generator, world: _World, slowest: float, fastest: float) -> None:
    low = max(world.height_m - rng.uniform(0.1, 0.3), 0.1)
    world.carry(low, -rng.uniform(slowest, fastest), rng.uniform(0.15, 0.3))


def _thrown(rng: np.random.Generator, world: _World) -> None:
    world.hold(0.3)
    _push(rng, world, 1.5, 4.0)
    for _ in range(int(rng.integers(1, 5))):
        world.fly()
    caught_s = rng.uniform(0.2, 0.9) * 2 * world.speed_m_s / _GRAVITY_M_S2
    world.fly(lambda since: since >= caught_s)
    world.carry(max(world.height_m - 0.05, 0.05), 0.0, 0.25)
    world.hold(0.5)


def _dribbled(rng: np.random.Generator, world: _World) -> None:
    world.hold(0.2)
    _push(rng, world, 2.0, 4.0)
    for _ in range(4):
        world.fly()
        top_m = rng.uniform(0.55, 0.95) * world.speed_m_s**2 / (2 * _GRAVITY_M_S2)
        world.fly(lambda _, top_m=top_m: world.height_m > top_m or world.speed_m_s < 0)
        low = max(world.height_m - 0.02, 0.1)
        world.carry(low, -rng.uniform(1.5, 3.5), rng.uniform(0.15, 0.3))
    world.fly()
    world.fly(lambda _: world.speed_m_s < 0.3)
    world.carry(world.height_m, 0.0, 0.2)
    world.hold(0.3)


def _bouncing(rng: np.random.Generator, world: _World) -> None:
    world.height_m, world.speed_m_s = rng.uniform(0.1, 0.8), rng.uniform(0.5, 3.0)
    for _ in range(6):
        world.fly()
    world.fly(lambda _: world.speed_m_s < 0)


def _edge(rng: np.random.Generator, world: _World) -> None:
    world.hold(rng.uniform(0.1, 0.4))
    for _ in range(5):
        world.fly()
    world.fly(lambda _: world.speed_m_s < 0)


def _tossed(rng: np.random.Generator, world: _World) -> None:
    world.hold(0.3)
    for _ in range(4):
        low = world.height_m
        world.carry(low, rng.uniform(1.5, 3.5), rng.uniform(0.2, 0.35))
        world.fly(lambda _, low=low: world.height_m < low and world.speed_m_s < 0)
        world.carry(max(world.height_m - rng.uniform(0.05, 0.2), 0.3), 0.0, rng.uniform(0.1, 0.2))
    world.hold(0.3)


@dataclass
class _Line:
    """Results of one kind."""

    errors: list[float] = field(default_factory=list)
    held: list[bool] = field(default_factory=list)
    verdicts: collections.Counter[str] = field(default_factory=collections.Counter)
    false: int = 0
    bounces: list[float] = field(default_factory=list)

    def add(self, made: Throw) -> None:
        """Tune one recording."""
        tuning = tune_episode(made.episode(), TuneOptions())
        self.verdicts[tuning.verdict] += 1
        found = record_of(tuning).rebounds
        near = (
            [min(made.hits, key=lambda hit: abs(hit.seconds - one.impact_s)) for one in found]
            if made.hits
            else []
        )
        wrong = [
            abs(hit.seconds - one.impact_s) > _NEAR_S for hit, one in zip(near, found, strict=False)
        ]
        self.false += sum(wrong) + (len(found) if not made.hits else 0)
        self.bounces += [
            abs(one.restitution - hit.restitution) for hit, one in zip(near, found, strict=False)
        ]
        if tuning.verdict != "ok" or not made.hits or tuning.interval95 is None:
            return
        at_s = tuning.detection.drop.impact_s
        truth = min(made.hits, key=lambda hit: abs(hit.seconds - at_s)).restitution
        low, high = tuning.interval95[0]
        self.errors.append(abs(float(tuning.trace.estimate[0]) - truth) if tuning.trace else np.nan)
        self.held.append(bool(low <= truth <= high))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--count", type=int, default=400)
    parser.add_argument("--noise-mm", type=float, default=1.0)
    arguments = parser.parse_args()
    lines = {kind: _Line() for kind in KINDS}
    for number in range(arguments.count):
        rng = np.random.default_rng([arguments.seed, number])
        kind = KINDS[number % len(KINDS)]
        lines[kind].add(throw(rng, kind, arguments.noise_mm / 1000))
    whole = _Line(
        [error for line in lines.values() for error in line.errors],
        [one for line in lines.values() for one in line.held],
        sum((line.verdicts for line in lines.values()), collections.Counter()),
        sum(line.false for line in lines.values()),
        [one for line in lines.values() for one in line.bounces],
    )
    print("kind       ok  suspect  rejected  MAE of ok  worst   held    all bounces  no impact")
    for kind, line in {**lines, "all": whole}.items():
        mean, worst = (np.mean(line.errors), np.max(line.errors)) if line.errors else (0.0, 0.0)
        held = 100 * np.mean(line.held) if line.held else np.nan
        each = np.mean(line.bounces) if line.bounces else np.nan
        counts = [line.verdicts[name] for name in ("ok", "suspect", "rejected")]
        print(
            f"{kind:9s}{counts[0]:4d}{counts[1]:9d}{counts[2]:10d}{mean:11.5f}{worst:8.4f}"
            f"{held:7.1f} %{each:12.5f}{line.false:11d}"
        )


if __name__ == "__main__":
    main()
