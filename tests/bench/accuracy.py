"""Measure the accuracy of `tunenet-tune`, K = 5, on fresh drops, clean and noisy.

`python -m tests.bench.accuracy` prints mean and median absolute errors; beside those of the result,
the network's alone, and those of the speeds just after and before the first impact, which need no
simulator; and how many of the intervals that were given hold the truth.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
from tunenet_logs.terminal import Progress

COUNT = 200
SEEDS = (1, 2, 3)


def errors(noise_m: float, hold_s: float, seed: int) -> np.ndarray:
    """Return errors of result, network and cross-check, and coverage, shape (answered, 4)."""
    rng = np.random.default_rng(seed)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for index in range(COUNT):
            truth = float(rng.uniform(0.1, 0.95))
            order = DropOrder(
                restitution=truth,
                height_m=float(rng.uniform(0.3, 5.0)),
                radius_m=float(rng.uniform(0.02, 0.5)),
                rate_hz=float(rng.uniform(60, 240)),
                hold_s=hold_s,
                noise_m=noise_m,
                seed=int(rng.integers(2**31)),
            )
            path = Path(folder) / f"{index}.mcap"
            quiet = Progress(quiet=True)
            record_episode(simulate_drop(order), path, overwrite=False, progress=quiet)
            tuning = tune_log(path, TuneOptions())
            if tuning.estimate is not None and tuning.trace is not None:
                network = tuning.trace.steps[-2].values[0]
                check = tuning.cross_check.value if tuning.cross_check else np.nan
                off = [tuning.estimate[0] - truth, network - truth, check - truth]
                rows.append([*np.abs(off), held(tuning.interval95, truth)])
    return np.array(rows)


def held(interval95: np.ndarray | None, truth: float) -> float:
    return np.nan if interval95 is None else float(interval95[0, 0] <= truth <= interval95[0, 1])


def main() -> None:
    print("restitution .1 to .95, falls of 0.3 to 5 m, radius 0.02 to 0.5 m, 60 to 240 Hz")
    print(f"{len(SEEDS)} seeds of {COUNT} drops; mean over seeds (lowest to highest)")
    for noise_m, hold_s in ((0.0, 0.0), (0.001, 0.5), (0.005, 0.5)):
        runs = [errors(noise_m, hold_s, seed) for seed in SEEDS]
        means = [run[:, 0].mean() for run in runs]
        medians = [np.median(run[:, 0]) for run in runs]
        networks, speeds = ([np.nanmean(run[:, at]) for run in runs] for at in (1, 2))
        intervals = np.concatenate([run[:, 3] for run in runs])
        print(
            f"noise {1000 * noise_m:g} mm, {sum(map(len, runs))} answered: "
            f"mean {np.mean(means):.6f} ({min(means):.6f} to {max(means):.6f}), "
            f"median {np.mean(medians):.6f}; network alone: mean {np.mean(networks):.6f}; "
            f"speeds alone: mean {np.mean(speeds):.6f}; "
            f"{np.isfinite(intervals).sum()} intervals hold {100 * np.nanmean(intervals):.1f} %"
        )


if __name__ == "__main__":
    main()
