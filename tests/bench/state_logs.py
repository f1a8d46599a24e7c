"""Measure how fast small logs of positions are tuned, against what none can do without.

`python -m tests.bench.state_logs` makes logs of 1 to 3 s at 60 to 240 Hz, of ideal balls and of
ones with air and slope, 1 mm of noise, and tunes each from reading to JSON, without the review.
Printed, of one process after its start: logs a CPU second; CPU time over that of bare reading by
the mcap library, K + 2 rollouts and the fit alone; resident memory after N / 4, N / 2 and N logs.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader

from tests import strangers
from tunenet_logs.analysis.drop.bounce_posterior import drop_posterior
from tunenet_logs.analysis.drop.motion import rig_like
from tunenet_logs.analysis.evaluation.worlds.ball import DroppedBall, drop_ball
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import to_json
from tunenet_logs.analysis.result_files import log_sha256
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.recorders.simulators.ball import DropSimulator

_SEED, _START_NS, _NOISE_M = 24, 1_700_000_000_000_000_000, 0.001
_STARTING = 6  # logs that are tuned before the clock runs: libraries load, engines start


def write_log(path: Path, index: int) -> None:
    """Write one drop; balls with air and slope take turns with ideal ones."""
    rng = np.random.default_rng([_SEED, index])
    restitution, gap_m = float(rng.uniform(0.3, 0.92)), float(rng.uniform(0.3, 1.6))
    rate_hz, lasts_s, hold_s = (
        float(rng.uniform(*ends)) for ends in ((60.0, 240.0), (1.3, 3.0), (0.1, 0.3))
    )
    seconds = np.arange(int(lasts_s * rate_hz)) / rate_hz - hold_s
    if index % 2:
        slope, drag_1_m = float(rng.uniform(0.0, 0.12)), float(np.exp(rng.uniform(-5.8, -1.7)))
        heights_m = drop_ball(DroppedBall(gap_m, restitution, slope, drag_1_m), seconds).heights_m
    else:
        heights_m = strangers.bounce_heights(restitution, gap_m, seconds)
    positions_m = np.column_stack([np.zeros((len(seconds), 2)), heights_m])
    positions_m += rng.normal(0.0, _NOISE_M, positions_m.shape)
    stamps_ns = _START_NS + np.round((seconds + hold_s) * 1e9).astype(np.int64)
    strangers.write_poses(path, stamps_ns, positions_m)


def tuned(path: Path) -> Tuning:
    """Tune a log as `tunenet-tune` does, and make its JSON."""
    log_sha256(path)
    tuning = tune_log(path, TuneOptions())
    to_json(record_of(tuning))
    return tuning


def least_s(path: Path, tuning: Tuning) -> float:
    """Return the CPU time [s] of bare reading, K + 2 rollouts and the fit alone."""
    detection, trace = tuning.detection, tuning.trace
    if detection is None or trace is None:
        return _cpu_s(lambda: _read(path))
    simulator = DropSimulator(*rig_like(detection))
    names = [parameter.name for parameter in tuning.parameters]
    settings = [dict(zip(names, map(float, step.values), strict=True)) for step in trace.steps]

    def work() -> None:
        _read(path)
        for values in settings:
            simulator.rollout(values)
        drop_posterior.__wrapped__(detection.found, detection.ball.drag_1_m)

    return _cpu_s(work)


def _read(path: Path) -> None:
    with path.open("rb") as file:
        for _ in make_reader(file).iter_messages():
            pass


def _cpu_s(work: Callable[[], object]) -> float:
    start_s = time.process_time()
    work()
    return time.process_time() - start_s


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def figures(count: int = 200) -> dict[str, Any]:
    """Measure logs a CPU second, their cost over the least, and the memory of one process."""
    count = max(count, 4)
    with tempfile.TemporaryDirectory() as folder:
        logs = [Path(folder) / f"{index:05}.mcap" for index in range(count)]
        for index, log in enumerate(logs):
            write_log(log, index)
        for log in logs[:_STARTING]:
            tuned(log)
        spent_s, floor_s, memory_mb = 0.0, 0.0, {}
        for done, log in enumerate(logs, start=1):
            start_s = time.process_time()
            tuning = tuned(log)
            spent_s += time.process_time() - start_s
            floor_s += least_s(log, tuning)
            if done in (count // 4, count // 2, count):
                memory_mb[str(done)] = round(_resident_mb(), 1)
    found = {
        "logs": count,
        "logs_a_cpu_second": round(count / spent_s, 1),
        "times_the_least": round(spent_s / floor_s, 2),
        "resident_mb": memory_mb,
    }
    print(f"{found['logs_a_cpu_second']} logs a CPU second ({1e3 * spent_s / count:.1f} ms each)")
    print(f"{found['times_the_least']} times bare reading, K + 2 rollouts and the fit alone")
    print("resident memory:", ", ".join(f"{mb} MB after {n}" for n, mb in memory_mb.items()))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()
    found = figures(arguments.count)
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
