"""Measure how often the 95 % intervals of recorded drops hold the truth.

The engine simulates the recordings and noise is added; nothing of the rig is given to the tuning.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.evaluation.study import Order, Part, Row, figure, short, table
from tunenet_logs.analysis.evaluation.worlds.ball import TEST_SEEDS
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tunenet.network import observe_all
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
from tunenet_logs.terminal import Progress

DRAWN_RESTITUTION = (0.1, 0.95)  # drawn evenly: nearly all balls
# Standard deviation of a height, drawn evenly: up to twice that of the noisy cells of `drop`.
DRAWN_NOISE_M = (0.0, 0.02)

PER_TARGET = 2  # recordings of each kind for each target of the experiment


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


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Measure `PER_TARGET` recordings of each kind for each target and seed."""
    rows: list[Row] = []
    for recording in RECORDINGS:
        drops = [
            one
            for seed in order.seeds
            for one in _orders(recording, PER_TARGET * order.targets, seed)
        ]
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
