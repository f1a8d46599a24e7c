"""Measure what a killed recording loses, and whether signals leave it whole.

`python -m tests.bench.durability` records a camera at 60 Hz (640 x 480 JPEG) and an arm at 1 kHz
(seven joints) in processes of their own, and ends them at random moments: 100 with SIGKILL, 60
each with SIGINT, SIGTERM and SIGHUP. Every file is read back, every message compared with what its
number says. Pictures fill chunks quickly; so 30 recordings of the arm alone are killed too.
`--kills`, `--signals` and `--seed` change that.
"""

from __future__ import annotations

import argparse
import random
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.recorders.live_recorder import (
    JOINTS,
    PICTURES,
    check_whole_file,
    missing_s,
    started,
)  # fmt: skip

_SECONDS = (0.3, 3.0)
_BOTH = (PICTURES, JOINTS)


def end_one(number: int, seconds: float, topics: Sequence[str]) -> float:
    """Record, send signal `number` after so long, check the log; return what is missing [s].

    It is 0 for a recording that was not killed.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        process = started(folder, topics)
        time.sleep(seconds)
        process.send_signal(number)
        said, _ = process.communicate(timeout=60)
        if number == signal.SIGKILL:
            return missing_s(folder, folder / "a.mcap.active")
        assert process.returncode == 0, f"exit code {process.returncode}"
        check_whole_file(folder / "a.mcap", said)
        return 0.0


def end_many(
    number: int, count: int, rng: random.Random, topics: Sequence[str] = _BOTH
) -> tuple[int, list[float]]:
    """End so many recordings; count bad files, and list the missing data of the others [s]."""
    bad, missing = 0, []
    for done in range(count):
        seconds = rng.uniform(*_SECONDS)
        try:
            missing.append(end_one(number, seconds, topics))
        except Exception as error:  # noqa: BLE001 (a bad file is what is counted here)
            bad += 1
            print(f"  after {seconds:.2f} s: {type(error).__name__}: {error}", file=sys.stderr)
        if sys.stderr.isatty():
            print(f"\r{done + 1} of {count}", end="\r", file=sys.stderr)
    return bad, missing


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument(
        "--signals", type=int, default=60, help="of SIGINT, SIGTERM and SIGHUP each"
    )
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    total_bad = 0
    for what, topics, count in (
        ("camera and arm", _BOTH, arguments.kills),
        ("arm alone", (JOINTS,), round(0.3 * arguments.kills)),
    ):
        bad, missing = end_many(signal.SIGKILL, count, rng, topics)
        total_bad += bad
        ms = np.array(missing or [np.nan]) * 1e3
        print(
            f"SIGKILL {count} times, {what}: {bad} bad files or wrong messages\n"
            f"  missing at the end: median {np.median(ms):.0f} ms, "
            f"95 % {np.quantile(ms, 0.95):.0f} ms, worst {ms.max():.0f} ms",
            flush=True,
        )
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        bad, _ = end_many(number, arguments.signals, rng)
        total_bad += bad
        print(f"{number.name} {arguments.signals} times: {bad} bad files", flush=True)
    return 1 if total_bad else 0


if __name__ == "__main__":
    sys.exit(main())
