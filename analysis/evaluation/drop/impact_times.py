"""Restitution from impact times alone: errors and intervals on balls whose truth is known.

    python -m analysis.evaluation.drop.impact_times --seed 11 --count 600 --verdicts 40

The balls share no code with the fit: flights in air by Runge and Kutta's method, restitution by a
power of the speed. They are heard with a normal jitter of .5, 1 or 2 ms; in one set of four an
impact is missed or a noise is heard. The bound is Cramer and Rao's at the ball itself, where all
times are right and the jitter is known, with what the fit's priors say of slope and log drag, as if
these were normal with the priors' variances: a measure, not a proof.

A second table counts verdicts: of the first of these balls, and of rhythms and noises that are no
ball's.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import cache

import numpy as np

from analysis.drop.times import impact_prior as priors
from analysis.drop.times.fit import Rig
from analysis.drop.times.posterior import heard_ball
from tunenet_logs.arrays import Array

_GRAVITY_M_S2 = 9.80665
_STEP_S = 0.002
_SOFTEST_M_S = 0.25  # a slower impact is not heard
# Of the balls: half normal, and log normal within `_DRAGS_1_M`.
_SLOPE_SD, _LOG_DRAG_SD, _TYPICAL_DRAG_1_M = 0.08, 1.0, 0.03

_DRAGS_1_M = (0.002, 0.15)  # a steel ball's, and a little more than a table-tennis ball's
JITTERS_S = (0.0005, 0.001, 0.002)
_MIN_COUNT, _MAX = 5, 12  # impacts that are heard


@dataclass(frozen=True, eq=False)
class HeardSet:
    """Impact times of one ball.

    Attributes:
        times_s: as they were heard, shape (N,).
        restitution: at the second impact.
        bound: least standard deviation of an estimate of it.
        jitter_s: of the times.
        height_m: of the drop.
        first: restitution at the first impact.
        wrong: "", "missed" or "noise".
    """

    times_s: Array
    restitution: float
    bound: float
    jitter_s: float
    height_m: float
    first: float
    wrong: str


def _landing(speed_m_s: float, drag_1_m: float, height_m: float = 0.0) -> tuple[float, float]:
    """Integrate a flight that begins upward (RK4): duration [s] and final speed [m/s]."""

    def change(state: Array) -> Array:
        return np.array([state[1], -_GRAVITY_M_S2 - drag_1_m * state[1] * abs(state[1])])

    def stepped(state: Array, step_s: float) -> Array:
        one = change(state)
        two = change(state + step_s / 2 * one)
        three = change(state + step_s / 2 * two)
        four = change(state + step_s * three)
        return state + step_s / 6 * (one + 2 * two + 2 * three + four)

    state, elapsed_s = np.array([height_m, speed_m_s]), 0.0
    while True:
        after = stepped(state, _STEP_S)
        if after[0] < 0:
            break
        state, elapsed_s = after, elapsed_s + _STEP_S
    rest_s = _STEP_S / 2
    for _ in range(30):  # Newton's method for the moment of the landing
        landed = stepped(state, rest_s)
        rest_s -= landed[0] / landed[1]
        if abs(landed[0]) < 1e-13:
            break
    return elapsed_s + rest_s, -float(stepped(state, rest_s)[1])


def _impacts(unknowns: Array, count: int, arrives_m_s: float) -> tuple[Array, Array]:
    """Return times after the first impact [s], and restitutions, of `count` impacts."""
    speed, drag_1_m = float(np.exp(unknowns[0])), float(unknowns[3])
    times, kept, second = [0.0], [speed / arrives_m_s], np.nan
    while len(times) < count:
        lasted, arrives = _landing(speed, drag_1_m)
        second = arrives if len(times) == 1 else second
        if arrives < _SOFTEST_M_S:
            break
        kept.append(unknowns[1] * (arrives / second) ** -unknowns[2])
        speed = kept[-1] * arrives
        times.append(times[-1] + lasted)
    return np.array(times), np.array(kept)


def _bound(unknowns: Array, count: int, jitter_s: float) -> float:
    """Return the Cramér-Rao bound on the restitution, with the priors of slope and log drag."""
    columns = [np.ones(count)]
    for index in range(4):
        moved = [unknowns.copy(), unknowns.copy()]
        moved[0][index] += 1e-4
        moved[1][index] -= 1e-4
        ahead, behind = (_impacts(one, count, 1.0)[0] for one in moved)
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
    nodes = priors.nodes(priors.WHOLE_SLOPE, priors.WHOLE_LOG_DRAG, (200, 200), None)
    weights = np.exp(nodes.log_prior)
    slows = nodes.drags_1_m > 0
    logs = np.log(nodes.drags_1_m[slows])
    return _sd(nodes.slopes, weights), _sd(logs, weights[slows])


def _sd(values: Array, weights: Array) -> float:
    weights = weights / weights.sum()
    return float(np.sqrt(weights @ (values - weights @ values) ** 2))


def heard_set(rng: np.random.Generator, number: int) -> HeardSet:
    """Draw one ball's impact times; each fourth set has a missed impact or a noise."""
    while True:
        first, slope = float(rng.uniform(0.4, 0.9)), float(abs(rng.normal(0, _SLOPE_SD)))
        drag_1_m = float(np.exp(rng.normal(np.log(_TYPICAL_DRAG_1_M), _LOG_DRAG_SD)))
        height_m = float(rng.uniform(0.3, 2.0))
        jitter_s = float(rng.choice(JITTERS_S))
        most = int(rng.integers(_MIN_COUNT, _MAX + 1))
        if not _DRAGS_1_M[0] < drag_1_m < _DRAGS_1_M[1]:
            continue
        _, arrives = _landing(0.0, drag_1_m, height_m)
        _, second = _landing(first * arrives, drag_1_m)
        at_second = first * (second / arrives) ** -slope
        if at_second > 0.97:
            continue
        unknowns = np.array([np.log(first * arrives), at_second, slope, drag_1_m])
        times, _ = _impacts(unknowns, most, arrives)
        wrong = ("", "", "", ("missed", "noise")[number // 4 % 2])[number % 4]
        if len(times) < _MIN_COUNT + (wrong == "missed"):
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


@dataclass(frozen=True)
class TimesFigures:
    """Figures of sets of one kind.

    Attributes:
        label: of the kind.
        sets: how many.
        told: how many of them have a value.
        mae: mean absolute error.
        bound: what the bound allows of it.
        covered: fraction of the intervals that hold the truth.
        width: median width of them.
    """

    label: str
    sets: int
    told: int
    mae: float
    bound: float
    covered: float
    width: float


def times_figures(seed: int, count: int, *, with_height: bool = False) -> list[TimesFigures]:
    """Return the figures of all sets, and of those with each jitter and each wrong time."""
    rng = np.random.default_rng([seed, *b"impact times"])
    sets = [heard_set(rng, number) for number in range(count)]
    rows = np.array([_row(one, rng, with_height=with_height) for one in sets])
    kinds = {"all": np.ones(count, dtype=bool)}
    for jitter_s in JITTERS_S:
        kinds[f"jitter {1000 * jitter_s:g} ms"] = np.array([s.jitter_s == jitter_s for s in sets])
    for wrong, label in (("", "all right"), ("missed", "one missed"), ("noise", "one noise")):
        kinds[label] = np.array([one.wrong == wrong for one in sets])
    return [_figures(label, rows[chosen]) for label, chosen in kinds.items() if chosen.any()]


def _row(one: HeardSet, rng: np.random.Generator, *, with_height: bool) -> tuple[float, ...]:
    height_m = one.height_m * (1 + 0.004 * float(rng.normal())) if with_height else None
    ball = heard_ball(one.times_s, Rig(height_m=height_m))
    truth = one.first if with_height else one.restitution
    if ball is None:
        return truth, np.nan, np.nan, np.nan, one.bound
    return truth, float(ball.values[0]), *ball.interval95[0].tolist(), one.bound


def _figures(label: str, rows: Array) -> TimesFigures:
    truth, value, low, high, bound = rows[np.isfinite(rows[:, 1])].T
    return TimesFigures(
        label,
        len(rows),
        len(truth),
        float(np.mean(np.abs(value - truth))),
        float(np.mean(bound)) * float(np.sqrt(2 / np.pi)),
        float(np.mean((low <= truth) & (truth <= high))),
        float(np.median(high - low)),
    )


def times_table(figures: list[TimesFigures]) -> str:
    """Tabulate the figures, one line a kind."""
    head = f"{'impact times':16}{'sets':>6}{'told':>6}{'MAE':>9}{'bound':>9}{'ratio':>7}"
    lines = [head + f"{'covered':>9}{'width':>8}"]
    lines += [
        f"{one.label:16}{one.sets:6d}{one.told:6d}{one.mae:9.5f}{one.bound:9.5f}"
        f"{one.mae / one.bound:7.2f}{100 * one.covered:8.1f}%{one.width:8.4f}"
        for one in figures
    ]
    return "\n".join(lines)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=600)
    parser.add_argument("--height", action="store_true", help="the drop's height is given")
    parser.add_argument("--verdicts", type=int, default=40, help="sets of each kind of no ball")
    arguments = parser.parse_args()
    print(times_table(times_figures(arguments.seed, arguments.count, with_height=arguments.height)))
    if arguments.verdicts:
        from analysis.evaluation.drop.times_verdicts import verdict_table

        print(verdict_table(arguments.seed, arguments.verdicts, arguments.count))


if __name__ == "__main__":
    main()
