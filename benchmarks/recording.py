"""Recording a network camera in real time: frames dropped, and the share of a core it takes.

`python -m benchmarks.recording` plays 640 x 480 at 60 Hz for a minute from a loopback camera in a
process of its own, to `tunenet-record` in another.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.recorders.mjpeg_camera import playing
from tunenet_logs.reader import read_episode

BIN = Path(sys.executable).parent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=60.0)
    arguments = parser.parse_args()
    frames = round(arguments.seconds * arguments.rate)
    plan = {"frames": frames, "rate_hz": arguments.rate, "size": (640, 480), "distinct": 120}
    with playing(**plan) as address, tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "a.mcap"
        words = [BIN / "tunenet-record", "--camera", f"http://{address}", "-o", log]
        start = time.perf_counter()
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        wall_s = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        counts = read_episode(log).info.counts
        size = log.stat().st_size
    cpu_s = usage.ru_utime + usage.ru_stime
    print(f"sent {frames}, " + ", ".join(f"{name} {count}" for name, count in counts.items()))
    print(f"lost {frames - counts['written']} frames; {size / frames / 1000:.1f} kB a frame")
    print(f"{wall_s:.1f} s, {cpu_s:.1f} s of processor: {100 * cpu_s / wall_s:.1f} % of a core")
    print(f"{usage.ru_maxrss / 1024:.0f} MiB of memory at most; exit code {process.returncode}")


if __name__ == "__main__":
    main()
