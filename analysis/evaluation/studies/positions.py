"""Measure the accuracy of drops recorded as positions, clean and noisy: a self-test.

The engine simulates the balls, without air and with one restitution at every speed. Beside the
result stand the network's steps alone, and the speeds just after and before the first impact, which
need no simulator.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any

import numpy as np

from tunenet_logs.analysis.evaluation.study import Order, Part, Row, figure, listed, scored
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
from tunenet_logs.terminal import Progress

# Standard deviations of a coordinate [m], and how long the ball is held before it is let go [s].
NOISES = ((0.0, 0.0), (0.001, 0.5), (0.005, 0.5))


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Tune each seed's drops with each noise."""
    cases = {
        f"{1000 * noise[0]:g} mm": [Piece((noise, *one), len(one[1])) for one in order.portions(10)]
        for noise in NOISES
    }
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
