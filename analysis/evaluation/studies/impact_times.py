"""Measure restitutions from impact times alone, and verdicts on balls and on what is no ball.

Errors stand beside the Cramér-Rao bound. The balls share nothing with the fit: flights in air in
closed form, restitution by a power of the speed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import get_args

import numpy as np

from tunenet_logs.analysis.checks import Verdict
from tunenet_logs.analysis.drop.times import readings
from tunenet_logs.analysis.drop.times.model import DropSetup, heard_ball
from tunenet_logs.analysis.evaluation.study import (
    Columns,
    Order,
    Part,
    Row,
    figure,
    scored,
    shown,
    table,
)
from tunenet_logs.analysis.evaluation.worlds.ball import fall_of, flight_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.terminal import Progress

# ---- Balls that are heard: their impact times, and the bound of what these tell.

_GRAVITY_M_S2 = 9.80665
# Of the balls: half normal, and log normal within `_DRAGS_1_M`.
_LOG_DRAG_SD = 1.0

_DRAGS_1_M = (0.002, 0.15)  # a steel ball's, and a little more than a table-tennis ball's
JITTERS_S = (0.0005, 0.001, 0.002)
_MIN_IMPACTS, _MAX_IMPACTS = 5, 12  # that are heard


@dataclass(frozen=True, eq=False)
class HeardSet:
    """Impact times of one ball."""

    times_s: Array  # as they were heard, shape (N,)
    restitution: float  # at the second impact
    bound: float  # least standard deviation of an estimate of it
    jitter_s: float  # of the times
    height_m: float  # of the drop
    first: float  # restitution at the first impact
    wrong: str  # "", "missed" or "noise"


def _impacts(unknowns: Array, count: int) -> Array:
    """Return times after the first impact [s] of at most `count` impacts."""
    speed, drag_1_m = float(np.exp(unknowns[0])), float(unknowns[3])
    times, second = [0.0], np.nan
    while len(times) < count:
        lasted, arrives = flight_of(speed, drag_1_m, _GRAVITY_M_S2)
        second = arrives if len(times) == 1 else second
        if arrives < 0.25:  # a slower impact is not heard
            break
        speed = unknowns[1] * (arrives / second) ** -unknowns[2] * arrives
        times.append(times[-1] + lasted)
    return np.array(times)


def _bound(unknowns: Array, count: int, jitter_s: float) -> float:
    """Return the Cramér-Rao bound on the restitution, all times right and the jitter known.

    The fit's priors of slope and log drag count as normal ones with their variances: a measure, not
    a proof.
    """
    columns = [np.ones(count)]
    for moved in 1e-4 * np.eye(4):
        ahead, behind = (_impacts(unknowns + sign * moved, count) for sign in (1, -1))
        if len(ahead) != len(behind) or len(ahead) != count:
            return float("nan")
        columns.append((ahead - behind) / 2e-4)
    jacobian = np.column_stack(columns)
    slope_sd, log_drag_sd = _prior_sds()
    prior = np.diag([0.0, 0.0, 0.0, slope_sd**-2, (log_drag_sd * unknowns[3]) ** -2])
    return float(np.sqrt(np.linalg.inv(jacobian.T @ jacobian / jitter_s**2 + prior)[2, 2]))


@cache
def _prior_sds() -> tuple[float, float]:
    """Return the prior standard deviations of slope and log drag, as the fit has them."""
    nodes = readings.nodes(readings.WHOLE_SLOPE, readings.WHOLE_LOG_DRAG, (200, 200), None)
    weights = np.exp(nodes.log_prior)
    slows = nodes.drags_1_m > 0
    logs = np.log(nodes.drags_1_m[slows])
    return _sd(nodes.slopes, weights), _sd(logs, weights[slows])


def _sd(values: Array, weights: Array) -> float:
    weights = weights / weights.sum()
    return float(np.sqrt(weights @ (values - weights @ values) ** 2))


def heard_set(rng: np.random.Generator, number: int) -> HeardSet:
    """Draw one ball's impact times; each fourth set has a missed impact or a noise.

    The jitter is normal.
    """
    while True:
        first, slope = float(rng.uniform(0.4, 0.9)), float(abs(rng.normal(0, 0.08)))
        drag_1_m = float(np.exp(rng.normal(np.log(0.03), _LOG_DRAG_SD)))
        height_m = float(rng.uniform(0.3, 2.0))
        jitter_s = float(rng.choice(JITTERS_S))
        most = int(rng.integers(_MIN_IMPACTS, _MAX_IMPACTS + 1))
        if not _DRAGS_1_M[0] < drag_1_m < _DRAGS_1_M[1]:
            continue
        _, arrives = fall_of(height_m, drag_1_m, _GRAVITY_M_S2)
        _, second = flight_of(first * arrives, drag_1_m, _GRAVITY_M_S2)
        at_second = first * (second / arrives) ** -slope
        if at_second > 0.97:
            continue
        unknowns = np.array([np.log(first * arrives), at_second, slope, drag_1_m])
        times = _impacts(unknowns, most)
        wrong = ("", "", "", ("missed", "noise")[number // 4 % 2])[number % 4]
        if len(times) < _MIN_IMPACTS + (wrong == "missed"):
            continue
        bound = _bound(unknowns, len(times), jitter_s)
        if np.isfinite(bound):
            break
    heard = np.sort(times + rng.uniform(0.2, 2.0) + rng.normal(0.0, jitter_s, len(times)))
    if wrong == "missed":
        heard = np.delete(heard, int(rng.integers(2, len(heard) - 1)))
    elif wrong:
        heard = np.sort(np.append(heard, rng.uniform(heard[0], heard[-1])))
    return HeardSet(heard, at_second, bound, jitter_s, height_m, first, wrong)


def scored_sets(case: tuple[int, int, bool]) -> list[Row]:
    """Fit so many balls of a seed, their drops' heights known or not."""
    seed, count, with_height = case
    rng = np.random.default_rng([seed, *b"impact times"])
    sets = [heard_set(rng, number) for number in range(count)]
    return [scored_set(one, rng, with_height=with_height) for one in sets]


def scored_set(one: HeardSet, rng: np.random.Generator, *, with_height: bool) -> Row:
    """Fit a ball to its times; with its drop's height to .4 %, which gives the first impact's."""
    height_m = one.height_m * (1 + 0.004 * float(rng.normal())) if with_height else None
    ball = heard_ball(one.times_s, DropSetup(height_m=height_m))
    low, high = (np.nan, np.nan) if ball is None else ball.interval95[0].tolist()
    return {
        "jitter_s": one.jitter_s,
        "wrong": one.wrong,
        "truth": one.first if with_height else one.restitution,
        "value": np.nan if ball is None else float(ball.values[0]),
        "low": low,
        "high": high,
        "bound": one.bound,
    }


def figures_of(label: str, scores: list[Row]) -> Row:
    """Return the figures of sets of one kind."""
    told = [one for one in scores if np.isfinite(one["value"])]
    errors = [abs(one["value"] - one["truth"]) for one in told]
    return {
        "label": label,
        "sets": len(scores),
        "told": len(told),  # how many of them have a value
        "mae": figure(errors),
        # what the bound allows of it
        "bound": figure([one["bound"] * np.sqrt(2 / np.pi) for one in told]),
        "covered": figure([one["low"] <= one["truth"] <= one["high"] for one in told]),
        "width": figure([one["high"] - one["low"] for one in told], np.median),
    }


# ---- Verdicts on impact times: of balls, and of rhythms and noises that are no ball's.

_SHARP_S = 0.001  # jitter of times that a machine might have made


def _clapping(jitter_s: float) -> Callable[[np.random.Generator, int], Array]:
    return lambda rng, count: np.cumsum(rng.uniform(0.25, 0.7) + rng.normal(0.0, jitter_s, count))


def _linear(rng: np.random.Generator, count: int) -> Array:
    shorter = rng.uniform(0.3, 0.9) * np.arange(count) / count
    return np.cumsum(rng.uniform(0.3, 0.9) * (1 - shorter)) + rng.normal(0.0, _SHARP_S, count)


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
    "Poisson": lambda rng, count: np.cumsum(rng.exponential(0.4, count)),
    "uniform": lambda rng, count: np.sort(rng.uniform(0.0, 0.4 * count, count)),
    "longer and longer": _increasing,
    "drum roll": _drum_roll,
}


def heard_verdict(times_s: Array) -> Verdict:
    """Return the verdict of `tunenet-tune` on these times, shape (N,) [s]."""
    stamps_ns = np.round(times_s * 1e9).astype(np.int64)
    signal = Signal("impacts", stamps_ns, np.ones((len(stamps_ns), 1)), ("impact",), "1")
    episode = Episode(EpisodeInfo(), {"impacts": signal})
    return tune_episode(episode, TuneOptions(), Path("a")).verdict


def _sets(seed: int, count: int, balls: int) -> Iterator[tuple[list[str], Array]]:
    """Yield the names of a set's kinds, and its times [s]."""
    rng = np.random.default_rng([seed, *b"no balls"])
    for name, made in NO_BALLS.items():
        for _ in range(count):
            yield [name], made(rng, int(rng.integers(_MIN_IMPACTS, _MAX_IMPACTS + 1)))
    rng = np.random.default_rng([seed, *b"impact times"])  # the balls of the first table
    for number in range(balls):
        one = heard_set(rng, number)
        many = "6 or more" if len(one.times_s) >= 6 else "fewer"
        part = [f"with a {one.wrong}" if one.wrong == "noise" else "with one missed"]
        yield [f"balls, {many}", *(part if one.wrong else [])], one.times_s


# ---- Run: errors of all sets, of those with each jitter and each wrong time; then verdicts.

_SHOWN: Columns = (
    ("impact times", lambda row: row["label"]),
    ("sets", lambda row: str(row["sets"])),
    ("told", lambda row: str(row["told"])),
    ("MAE", lambda row: f"{row['mae']:.5f}"),
    ("bound", lambda row: f"{row['bound']:.5f}"),
    ("ratio", lambda row: f"{row['mae'] / row['bound']:.2f}"),
    ("covered", lambda row: f"{100 * row['covered']:.1f}%"),
    ("width", lambda row: f"{row['width']:.4f}"),
)


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Measure so many balls of each seed, and of no ball 2 in 15 as many sets of each kind."""
    for section in order.sections:
        if section == "verdicts":
            # the balls are those of the section "times"
            count = max(1, 2 * order.targets // 15)
            cases = [Piece((seed, count, order.targets)) for seed in order.seeds]
            found = scored(counted_verdicts, {"": cases}, order, progress, (section, "seed"))[""]
            names = ("sets", *get_args(Verdict))
            totals: dict[str, Counter[str]] = {}
            for row in found:
                totals.setdefault(row["label"], Counter()).update({one: row[one] for one in names})
            rows = [
                {"label": kind, **{one: some[one] for one in names}}
                for kind, some in totals.items()
            ]
            lines = [["verdicts", *names], *([str(one) for one in row.values()] for row in rows)]
            yield Part(section, table(lines), rows)
            continue
        cases = [Piece((seed, order.targets, section == "height")) for seed in order.seeds]
        scores = scored(scored_sets, {"": cases}, order, progress, (section, "seed"))[""]
        kinds = {"all": scores}
        for jitter_s in JITTERS_S:
            own = [one for one in scores if one["jitter_s"] == jitter_s]
            kinds[f"jitter {1000 * jitter_s:g} ms"] = own
        for wrong, label in (("", "all right"), ("missed", "one missed"), ("noise", "one noise")):
            kinds[label] = [one for one in scores if one["wrong"] == wrong]
        rows = [figures_of(label, own) for label, own in kinds.items() if own]
        yield Part(section, table(shown(_SHOWN, rows)), rows)


def counted_verdicts(case: tuple[int, int, int]) -> list[Row]:
    """Count how often each kind of a seed has each verdict, of so many sets a kind, and balls."""
    found: dict[str, Counter[Verdict]] = {}
    for names, times_s in _sets(*case):
        verdict = heard_verdict(times_s)
        for name in names:
            found.setdefault(name, Counter())[verdict] += 1
    return [
        {"label": name, "sets": each.total(), **{one: each[one] for one in get_args(Verdict)}}
        for name, each in found.items()
    ]
