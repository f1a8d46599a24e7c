"""Tune simulated drops, recorded as positions: errors of their values, coverage of their intervals.

The engine simulates the balls, without air and with one restitution at every speed, and noise is
added: a self-test. Nothing of the rig is given to the tuning. Beside the result stand the network's
steps alone, and the speeds just after and before the first impact, which need no simulator.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.evaluation.study import (
    Order,
    Part,
    Row,
    figure,
    listed,
    scored,
    short,
    table,
)
from tunenet_logs.analysis.evaluation.worlds.ball import TEST_SEEDS
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tunenet.network import observe_all
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
from tunenet_logs.terminal import Progress

# ---- Positions: errors of the values, by the noise.

# Standard deviations of a coordinate [m], and how long the ball is held before it is let go [s].
NOISES = ((0.0, 0.0), (0.001, 0.5), (0.005, 0.5))


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Tune each seed's drops with each noise."""
    cases = {f"{1000 * noise[0]:g} mm": order.pieces(10, noise) for noise in NOISES}
    done = scored(tuned_drops, cases, order, progress, ("tuning", "drop"))
    rows = [accuracy_of(label, scores) for label, scores in done.items()]
    title = (
        "Restitution .1 to .95, falls of 0.3 to 5 m, radius 0.02 to 0.5 m, 60 to 240 Hz;\n"
        f"{order.seeds_in_words}, {order.targets} drops each. Absolute errors, over the seeds; "
        "held: of the intervals given.\n"
    )
    yield Part("", listed(rows, title), rows)


def _drops(seed: int, noise_m: float, hold_s: float) -> Iterator[DropOrder]:
    rng = np.random.default_rng(seed)
    while True:
        yield DropOrder(
            restitution=float(rng.uniform(0.1, 0.95)),
            height_m=float(rng.uniform(0.3, 5.0)),
            radius_m=float(rng.uniform(0.02, 0.5)),
            rate_hz=float(rng.uniform(60, 240)),
            hold_s=hold_s,
            noise_m=noise_m,
            seed=int(rng.integers(2**31)),
        )


def tuned_drops(case: tuple[tuple[float, float], int, range]) -> list[Row]:
    """Tune drops of a noise and a seed; NaN where there is no answer."""
    noise, seed, numbers = case
    rows: list[Row] = []
    for order in islice(_drops(seed, *noise), numbers.start, numbers.stop):
        tuning = tune_episode(simulate_drop(order), TuneOptions())
        truth, ends = float(order.restitution or 0.0), tuning.interval95
        value = tuning.cross_check.value if tuning.cross_check else None
        found = dict.fromkeys(("result", "network", "speeds", "held"), np.nan)
        if tuning.estimate is not None and tuning.trace is not None:
            found["result"] = abs(tuning.estimate[0] - truth)
            found["network"] = abs(tuning.trace.steps[-2].values[0] - truth)
            found["speeds"] = np.nan if value is None else abs(float(value) - truth)
            found["held"] = np.nan if ends is None else ends[0, 0] <= truth <= ends[0, 1]
        rows.append({"seed": seed, **found})
    return rows


def accuracy_of(label: str, scores: Sequence[Row]) -> Row:
    """Compute the figures of one noise: means over the seeds."""
    seeds = dict.fromkeys(one["seed"] for one in scores)

    def by_seed(name: str, of: Any = np.mean) -> list[float | None]:
        return [figure([o[name] for o in scores if o["seed"] == seed], of) for seed in seeds]

    means = np.array(by_seed("result"), float)
    held = [one["held"] for one in scores]
    return {
        "noise": label,
        "drops": len(scores),
        "answered": int(np.isfinite([one["result"] for one in scores]).sum()),
        "mean": figure(means),
        "lowest": figure(means, np.min),
        "highest": figure(means, np.max),
        "median": figure(np.array(by_seed("result", np.median), float)),
        "network": figure(np.array(by_seed("network"), float)),
        "speeds": figure(np.array(by_seed("speeds"), float)),  # of the cross-check
        "intervals": int(np.isfinite(held).sum()),
        "held": figure(held),
    }


# ---- Intervals: how often those of 95 % hold the truth, part of `drop` too.

DRAWN_RESTITUTION = (0.1, 0.95)  # drawn evenly: nearly all balls
# Standard deviation of a height, drawn evenly: up to twice that of the noisy cells of `drop`.
DRAWN_NOISE_M = (0.0, 0.02)


@dataclass(frozen=True)
class Recording:
    """Kind of recording."""

    label: str  # of its row; its recordings are drawn from it
    drop_heights_m: tuple[float, float]  # range of the fall
    rates_hz: tuple[float, ...]  # sampling rates, one of which is drawn
    hold_s: float  # how long the ball is held before it is let go


RECORDINGS = (
    Recording("falls of 3.5 to 4.5 m, 60 Hz", (3.5, 4.5), (60.0,), 0.0),
    Recording("falls of 0.3 to 5 m, 60 to 240 Hz", (0.3, 5.0), (60.0, 120.0, 240.0), 0.5),
)


def intervals(order: Order, progress: Progress) -> Iterator[Part]:
    """Measure two recordings of each kind for each target and seed."""
    rows: list[Row] = []
    for recording in RECORDINGS:
        drops = [one for seed in order.seeds for one in _orders(recording, 2 * order.targets, seed)]
        rows.append(coverage_of(recording.label, observe_all(_tuned, drops, order.jobs, progress)))
    yield Part("", coverage_table(rows), rows)


def _orders(recording: Recording, count: int, seed: int) -> list[DropOrder]:
    rng = np.random.default_rng([TEST_SEEDS + seed, *recording.label.encode()])
    return [
        DropOrder(
            restitution=float(rng.uniform(*DRAWN_RESTITUTION)),
            height_m=float(rng.uniform(*recording.drop_heights_m)),
            rate_hz=float(rng.choice(recording.rates_hz)),
            hold_s=recording.hold_s,
            noise_m=float(rng.uniform(*DRAWN_NOISE_M)),
            seed=int(rng.integers(2**31)),
        )
        for _ in range(count)
    ]


def _tuned(orders: Sequence[DropOrder]) -> Array:
    """Return the rows of `coverage_of`, shape (N, 6)."""
    rows = np.full((len(orders), 6), np.nan)
    for row, order in zip(rows, orders, strict=True):
        tuning = tune_episode(simulate_drop(order), TuneOptions())
        if tuning.estimate is None or tuning.trace is None or tuning.trace.fit is None:
            continue
        ends = tuning.trace.fit.interval95[0]
        network = tuning.trace.steps[-2].values[0]
        row[:] = [order.restitution, tuning.estimate[0], *ends, network, tuning.verdict == "ok"]
    return rows


def coverage_of(label: str, rows: Array) -> Row:
    """Compute figures of rows (truth, value, interval, network's value, is ok), shape (N, 6)."""
    fitted = rows[np.isfinite(rows[:, 0])]
    truth, value, low, high, network, ok = fitted.T
    covered, is_ok = (low <= truth) & (truth <= high), ok > 0
    return {
        "label": label,
        "targets": len(rows),
        "fitted": len(fitted),  # not rejected; what follows is of these, for any verdict
        "covered": figure(covered),
        "covered_se": fraction_error(covered),
        "ok": float(is_ok.sum() / len(rows)),  # of all
        "ok_covered": figure(covered[is_ok]),
        "ok_covered_se": fraction_error(covered[is_ok]),
        "width": figure(high - low, np.median),
        "mae": figure(np.abs(value - truth)),
        "network_mae": figure(np.abs(network - truth)),  # of its steps alone
    }


def fraction_error(hits: NDArray[np.bool_]) -> float | None:
    """Return the standard error of a fraction by Agresti and Coull (1998): never 0.

    Two hits and two misses are added, so that it is defined for any; `hits` has shape (N,).
    """
    if not len(hits):
        return None
    fraction = (hits.sum() + 2) / (len(hits) + 4)
    return float(np.sqrt(fraction * (1 - fraction) / (len(hits) + 4)))


def coverage_table(rows: Sequence[Row]) -> str:
    """Tabulate the coverage of recorded drops' intervals, and the errors of their values."""
    low, high = DRAWN_RESTITUTION
    lines = [["recordings", "drops", "answered", "held", "ok", "held", "width"]]
    for row in rows:
        cells = [row["label"], str(row["targets"]), str(row["fitted"])]
        cells += [with_error(row["covered"], row["covered_se"]), f"{100 * row['ok']:.1f} %"]
        cells += [with_error(row["ok_covered"], row["ok_covered_se"]), short(row["width"])]
        lines.append(cells)
        mean, network = short(row["mae"]), short(row["network_mae"])
        lines.append([f"  mean error {mean}; the network's alone {network}"])
    return table(
        lines,
        f"95 % intervals, restitution {low:g} to {high:g}, noise of 0 to "
        f"{100 * DRAWN_NOISE_M[1]:g} cm",
    )


def with_error(fraction: float | None, error: float | None) -> str:
    """Format a fraction in percent with its standard error."""
    if fraction is None or error is None:
        return "-"
    return f"{100 * fraction:.1f} ± {100 * error:.1f} %"
