"""Collect verdicts on impact times: of balls, and of rhythms and noises that are no ball's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import get_args

import numpy as np

from analysis.checks import Verdict
from analysis.evaluation.drop.impact_times import heard_set
from analysis.selection import Options
from analysis.tuning import tune_episode
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, EpisodeInfo, Signal

_MIN_COUNT, _MAX = 5, 12  # times of a set
_SHARP_S = 0.001  # jitter of times that a machine might have made
_MANY = 6  # impacts from which on a ball should mostly be told


def _clapping(jitter_s: float) -> Callable[[np.random.Generator, int], Array]:
    def times(rng: np.random.Generator, count: int) -> Array:
        return np.cumsum(rng.uniform(0.25, 0.7) + rng.normal(0.0, jitter_s, count))

    return times


def _linear(rng: np.random.Generator, count: int) -> Array:
    shorter = rng.uniform(0.3, 0.9) * np.arange(count) / count
    return np.cumsum(rng.uniform(0.3, 0.9) * (1 - shorter)) + rng.normal(0.0, _SHARP_S, count)


def _poisson(rng: np.random.Generator, count: int) -> Array:
    return np.cumsum(rng.exponential(0.4, count))


def _uniform(rng: np.random.Generator, count: int) -> Array:
    return np.sort(rng.uniform(0.0, 0.4 * count, count))


def _increasing(rng: np.random.Generator, count: int) -> Array:
    times = np.cumsum(0.2 * rng.uniform(1.03, 1.2) ** np.arange(count))
    return times + rng.normal(0.0, _SHARP_S, count)


def _drum_roll(rng: np.random.Generator, count: int) -> Array:
    tempos_hz = np.linspace(1 / rng.uniform(0.4, 0.8), 1 / rng.uniform(0.1, 0.2), count)
    return np.cumsum((1 + rng.normal(0.0, 0.03, count)) / tempos_hz)


# Kinds of times that are no ball's: from random numbers and a count, times [s].
NO_BALLS: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "clapping, 2 ms": _clapping(0.002),
    "clapping, 5 ms": _clapping(0.005),
    "clapping, 20 ms": _clapping(0.02),
    "linearly shorter": _linear,
    "Poisson": _poisson,
    "uniform": _uniform,
    "longer and longer": _increasing,
    "drum roll": _drum_roll,
}


def heard_verdict(times_s: Array) -> Verdict:
    """Return the verdict of `tunenet-tune` on these times, shape (N,) [s]."""
    stamps_ns = np.round(times_s * 1e9).astype(np.int64)
    signal = Signal("impacts", stamps_ns, np.ones((len(stamps_ns), 1)), ("impact",), "1")
    return tune_episode(Episode(EpisodeInfo(), {"impacts": signal}), Options(), Path("a")).verdict


def _sets(seed: int, count: int, balls: int) -> Iterator[tuple[list[str], Array]]:
    """Yield the names of a set's kinds, and its times [s]."""
    rng = np.random.default_rng([seed, *b"no balls"])
    for name, made in NO_BALLS.items():
        for _ in range(count):
            yield [name], made(rng, int(rng.integers(_MIN_COUNT, _MAX + 1)))
    rng = np.random.default_rng([seed, *b"impact times"])  # the balls of the first table
    for number in range(balls):
        one = heard_set(rng, number)
        many = "6 or more" if len(one.times_s) >= _MANY else "fewer"
        part = [f"with a {one.wrong}" if one.wrong == "noise" else "with one missed"]
        yield [f"balls, {many}", *(part if one.wrong else [])], one.times_s


def verdicts(seed: int, count: int, balls: int) -> dict[str, Counter[Verdict]]:
    """Count how often each kind has each verdict, of `count` sets a kind, and of `balls`."""
    found: dict[str, Counter[Verdict]] = {}
    for names, times_s in _sets(seed, count, balls):
        verdict = heard_verdict(times_s)
        for name in names:
            found.setdefault(name, Counter())[verdict] += 1
    return found


def verdict_table(seed: int, count: int, balls: int) -> str:
    """Tabulate `verdicts`, one line a kind."""
    names = get_args(Verdict)
    lines = [f"{'verdicts':20}{'sets':>6}" + "".join(f"{name:>10}" for name in names)]
    for kind, each in verdicts(seed, count, balls).items():
        counts = "".join(f"{each[name]:10d}" for name in names)
        lines.append(f"{kind:20}{each.total():6d}{counts}")
    return "\n".join(lines)
