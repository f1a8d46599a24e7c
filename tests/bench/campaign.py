"""Measure time and size of `tunenet-review`: 60 attempts with six balls, every drop filmed.

`python -m tests.bench.campaign [FOLDER]` films one drop of each ball at 640 x 480 and 60 frames a
second, tunes it, copies log and tuning for ten attempts, of which every fourth has a rejected drop
before it and every twentieth no other, writes made-up outcomes, and reviews all of it in a process
of its own. FOLDER keeps the campaign; where it is there already, it is reviewed again.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tunenet_logs.outcomes import Outcome, write_outcome
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulated import DropOrder, FilmOrder, film_drop
from tunenet_logs.terminal import Progress

BIN = Path(sys.executable).parent
BALLS = {
    "squash ball": 0.55, "foam ball": 0.62, "tennis ball": 0.68,
    "red gel": 0.74, "racquetball": 0.79, "bouncy ball": 0.84,
}  # fmt: skip
ATTEMPTS = 10
START_NS = 1_800_000_000_000_000_000


def film(folder: Path) -> list[Path]:
    """Film and tune one log a ball."""
    logs: list[Path] = []
    for index, (ball, restitution) in enumerate(BALLS.items()):
        log = folder / f"{ball.replace(' ', '_')}.mcap"
        order = DropOrder(
            restitution=restitution,
            height_m=0.8,
            radius_m=0.03,
            seconds=3.0,
            hold_s=0.3,
            seed=index,
        )
        episode = film_drop(order, FilmOrder(size_px=(640, 480), exposure_s=0.004, noise=4.0))
        record_episode(episode, log, overwrite=False, progress=Progress(quiet=True))
        logs.append(log)
    run("tunenet_logs.analysis.cli.tune", *logs, "--quiet")
    return logs


def run(module: str, *words: object) -> str:
    """Return a command's output; it may call a log rejected."""
    told = [sys.executable, "-m", module, *(str(one) for one in words)]
    return subprocess.run(told, stdout=subprocess.PIPE, text=True, check=False).stdout


def fill(folder: Path) -> None:
    """Write the campaign."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as scratch:
        logs = film(Path(scratch))
        number = 0
        for attempt in range(1, ATTEMPTS + 1):
            for ball, log in zip(BALLS, logs, strict=True):
                number += 1
                name = f"drop_{number:02d}"
                told = json.loads(log.with_suffix(".json").read_text())
                if number % 4 == 0:
                    copy(log, folder / f"{name}a.mcap", told, rng, is_rejected=True)
                is_bad = number % 20 == 7
                copy(log, folder / f"{name}b.mcap", told, rng, is_rejected=is_bad)
                miss_m = float(rng.normal(0, 0.02))
                is_in = abs(miss_m) < 0.03 and not is_bad
                outcome = Outcome(
                    task="bounce-shot",
                    ball=ball,
                    attempt=attempt,
                    success=is_in,
                    stamp_ns=START_NS + number * 120_000_000_000,
                    shot_height_m=None if is_bad else float(rng.uniform(0.4, 0.8)),
                    miss_m=None if is_bad else miss_m,
                    drop_log=f"{name}b.mcap",
                    tuning=f"{name}b.json",
                    reason="no good drop" if is_bad else "" if is_in else "rim",
                )
                write_outcome(folder, outcome)


def copy(log: Path, to: Path, told: dict, rng: np.random.Generator, *, is_rejected: bool) -> None:
    """Copy a log and its tuning under another name, with a value as of a repeated drop."""
    shutil.copyfile(log, to)
    told = {**told, "log": to.name}
    if is_rejected:
        told |= {"verdict": "rejected", "reason": "ball stays in view: left", "parameters": None}
    elif told["parameters"]:
        off = float(rng.normal(0, 0.003))
        one = dict(told["parameters"]["restitution"])
        one["value"] += off
        one["interval95"] = one["interval95"] and [end + off for end in one["interval95"]]
        told["parameters"] = {"restitution": one}
    to.with_suffix(".json").write_text(json.dumps(told))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, help="where the campaign is kept")
    folder = parser.parse_args().folder
    with tempfile.TemporaryDirectory() as scratch:
        campaign = folder or Path(scratch) / "campaign"
        if not campaign.exists():
            fill(campaign)
        logs = sum(one.stat().st_size for one in campaign.glob("*.mcap"))
        review = Path(scratch) / "review.rrd"
        start = time.perf_counter()
        told = run("tunenet_logs.analysis.cli.review", campaign, "-o", review, "--quiet")
        took = time.perf_counter() - start
        print(told)
        size = review.stat().st_size
        count = ATTEMPTS * len(BALLS)
        print(f"{count} attempts, {logs / 1e6:.0f} MB of logs: {took:.1f} s, {size / 1e6:.1f} MB")
        verify = [str(BIN / "rerun"), "rrd", "verify", str(review)]
        print("rerun rrd verify:", subprocess.run(verify, check=False).returncode)
        if folder is not None:
            shutil.copyfile(review, folder.with_suffix(".rrd"))


if __name__ == "__main__":
    main()
