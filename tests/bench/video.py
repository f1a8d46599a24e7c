"""Measure the accuracy of `tunenet-tune` on filmed drops: rendered, recorded, read back.

`python -m tests.bench.video` prints for each seed how many of its drops were answered, the mean and
median absolute error of the answers, and how many were called suspect. Cameras are the paper's, in
drop heights, 320 x 240; balls of 0.02 to 0.06 m radius from 0.4 to 2 m, .1 to .95, 60 to 120 Hz,
shutter open for 0 to 8 ms, pixel noise 0 to 4 of 255, up to 3 % of the frames lost.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulated import DropOrder, FilmOrder, film_drop
from tunenet_logs.terminal import Progress

COUNT = 60
SEEDS = (1, 2, 3)


def tuned(seed: int, index: int) -> tuple[float, float | None, str, float]:
    """Return truth, estimate, verdict and cross-check of one fresh drop."""
    rng = np.random.default_rng([seed, index])
    order = DropOrder(
        restitution=float(rng.uniform(0.1, 0.95)),
        radius_m=float(rng.uniform(0.02, 0.06)),
        rate_hz=float(rng.choice([60, 90, 120])),
        seconds=float(rng.uniform(2.5, 4.5)),
        hold_s=float(rng.uniform(0, 0.8)),
        seed=int(rng.integers(2**31)),
    )
    film = FilmOrder(
        exposure_s=float(rng.choice([0, 0.002, 0.008])),
        noise=float(rng.uniform(0, 4)),
        lost_share=float(rng.choice([0, 0, 0.03])),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drop.mcap"
        quiet = Progress(quiet=True)
        record_episode(film_drop(order, film), path, overwrite=False, progress=quiet)
        tuning = tune_log(path, TuneOptions())
    estimate = None if tuning.estimate is None else float(tuning.estimate[0])
    check = tuning.cross_check.value if tuning.cross_check else float("nan")
    words = tuning.verdict if tuning.reason is None else f"{tuning.verdict}: {tuning.reason}"
    return order.restitution or 0.0, estimate, words, check


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--verbose", action="store_true", help="one line a drop")
    arguments = parser.parse_args()
    pool = ProcessPoolExecutor(len(os.sched_getaffinity(0)), mp_context=get_context("spawn"))
    with pool:
        for seed in arguments.seeds:
            results = list(pool.map(tuned, [seed] * arguments.count, range(arguments.count)))
            if arguments.verbose:
                for index, (truth, estimate, words, check) in enumerate(results):
                    shown = "-" if estimate is None else f"{estimate:.4f}"
                    print(f"{seed} {index}: truth {truth:.4f}, {shown}, {check:.4f}, {words}")
            answered = np.array([(one[0], one[1]) for one in results if one[1] is not None])
            off = np.abs(answered[:, 1] - answered[:, 0])
            suspect = sum(one[2].startswith("suspect") for one in results)
            print(
                f"seed {seed}: {len(answered)} of {len(results)} answered, {suspect} suspect; "
                f"absolute error: mean {off.mean():.5f}, median {np.median(off):.5f}, "
                f"worst {off.max():.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
