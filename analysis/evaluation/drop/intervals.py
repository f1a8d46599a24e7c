"""Measure the empirical coverage of the 95 % interval of a recorded drop.

Recordings are simulated by the engine, noise is added, and they go the whole way of `tunenet-tune`:
nothing of the rig is given. The fit and its interval are in closed form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.evaluation.drop.targets import TEST_SEEDS
from analysis.selection import Options
from analysis.tunenet.pairs import observe_all
from analysis.tuning import tune_episode
from recorders.simulated_drop import DropOrder, simulate_drop
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress

RESTITUTION = (0.1, 0.95)  # drawn evenly: nearly all balls
# Standard deviation of a height, drawn evenly: up to twice that of the noisy cells.
NOISE_M = (0.0, 0.02)

PER_TARGET = 2  # recordings of each kind for each target of the experiment


@dataclass(frozen=True)
class Recording:
    """Kind of recording.

    Attributes:
        label: of its row; its recordings are drawn from it.
        drop_heights_m: range of the fall.
        rates_hz: sampling rates, one of which is drawn.
        hold_s: how long the ball is held before it is let go.
    """

    label: str
    drop_heights_m: tuple[float, float]
    rates_hz: tuple[float, ...]
    hold_s: float


RECORDINGS = (
    Recording("falls of 3.5 to 4.5 m, 60 Hz", (3.5, 4.5), (60.0,), 0.0),
    Recording("falls of 0.3 to 5 m, 60 to 240 Hz", (0.3, 5.0), (60.0, 120.0, 240.0), 0.5),
)


@dataclass(frozen=True)
class Coverage:
    """Interval coverage for one kind of recording.

    Attributes:
        targets: how many were recorded.
        fitted: how many of them were not rejected.
        covered: fraction of the fitted whose interval contains the truth, for any verdict.
        covered_se: its standard error.
        ok: fraction of all with the verdict "ok", which show their interval.
        ok_covered: fraction of those whose interval contains the truth.
        ok_covered_se: its standard error.
        width: median of the intervals' widths.
        mae: mean absolute error of the fitted.
        network_mae: that of the network's steps alone.

    A figure over no recordings is None.
    """

    label: str
    targets: int
    fitted: int
    covered: float | None
    covered_se: float | None
    ok: float
    ok_covered: float | None
    ok_covered_se: float | None
    width: float | None
    mae: float | None
    network_mae: float | None


def interval_coverages(
    seeds: tuple[int, ...], targets: int, jobs: int | None, progress: Progress
) -> tuple[Coverage, ...]:
    """Measure every kind of recording, `PER_TARGET * targets` for each seed."""
    count = PER_TARGET * targets
    return tuple(interval_coverage(one, seeds, count, jobs, progress) for one in RECORDINGS)


def interval_coverage(
    recording: Recording,
    seeds: tuple[int, ...],
    count: int,
    jobs: int | None,
    progress: Progress,
) -> Coverage:
    """Measure `count` recordings for each seed, of uniform noise and restitution."""
    orders = [order for seed in seeds for order in _orders(recording, count, seed)]
    return coverage_of(recording.label, observe_all(_tuned, orders, jobs, progress))


def coverage_of(label: str, rows: Array) -> Coverage:
    """Compute figures of rows (truth, value, interval, network's value, is ok), shape (N, 6)."""
    fitted = rows[np.isfinite(rows[:, 0])]
    truth, value, low, high, network, ok = fitted.T
    covered, is_ok = (low <= truth) & (truth <= high), ok > 0
    return Coverage(
        label=label,
        targets=len(rows),
        fitted=len(fitted),
        covered=_mean(covered),
        covered_se=fraction_error(covered),
        ok=float(is_ok.sum() / len(rows)),
        ok_covered=_mean(covered[is_ok]),
        ok_covered_se=fraction_error(covered[is_ok]),
        width=float(np.median(high - low)) if len(fitted) else None,
        mae=_mean(np.abs(value - truth)),
        network_mae=_mean(np.abs(network - truth)),
    )


def _mean(values: NDArray[Any]) -> float | None:
    return float(values.mean()) if len(values) else None


def fraction_error(hits: NDArray[np.bool_]) -> float | None:
    """Return the standard error of a fraction by Agresti and Coull (1998): never 0.

    Two hits and two misses are added, so that it is defined for any; `hits` has shape (N,).
    """
    if not len(hits):
        return None
    fraction = (hits.sum() + 2) / (len(hits) + 4)
    return float(np.sqrt(fraction * (1 - fraction) / (len(hits) + 4)))


def _orders(recording: Recording, count: int, seed: int) -> list[DropOrder]:
    rng = np.random.default_rng([TEST_SEEDS + seed, *recording.label.encode()])
    return [
        DropOrder(
            restitution=float(rng.uniform(*RESTITUTION)),
            height_m=float(rng.uniform(*recording.drop_heights_m)),
            rate_hz=float(rng.choice(recording.rates_hz)),
            hold_s=recording.hold_s,
            noise_m=float(rng.uniform(*NOISE_M)),
            seed=int(rng.integers(2**31)),
        )
        for _ in range(count)
    ]


def _tuned(orders: Sequence[DropOrder]) -> Array:
    """Return the rows of `coverage_of`, shape (N, 6)."""
    rows = np.full((len(orders), 6), np.nan)
    for row, order in zip(rows, orders, strict=True):
        tuning = tune_episode(simulate_drop(order), Options())
        if tuning.estimate is None or tuning.trace is None or tuning.trace.fit is None:
            continue
        ends = tuning.trace.fit.interval95[0]
        network = tuning.trace.steps[-2].values[0]
        row[:] = [order.restitution, tuning.estimate[0], *ends, network, tuning.verdict == "ok"]
    return rows
