"""Record joint states live from ROS 2: missing messages, and the share of a core.

`python -m tests.bench.live_joints` publishes JointState at 1 kHz for a minute from a process of its
own over loopback and DDS, and records it with `tunenet-record`, which is stopped (SIGSTOP) twice
for half a second. `--kept` is how many messages the publisher keeps to send again, ROS 2's usual 10
unless told; `--buffer` is how many bytes the operating system holds for the recorder, for which a
Linux as it is installed gives 212992; `--best-effort` publishes without sending again.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.recorders.ros2_publisher import NAMES, STATES, expect, publishing, values_of
from tunenet_logs.reader import read_episode

BIN = Path(sys.executable).parent
_RATE_HZ = 1000.0
_STOPPED_S = 0.5


def stopped_at(seconds: float) -> tuple[float, float]:
    """Return when the recorder is stopped, from the first message on [s]."""
    return 0.25 * seconds, 0.65 * seconds


def small_buffer(size: int) -> dict[str, str]:
    """Return the recorder's environment, with so many bytes for network receipt."""
    if not size:
        return dict(os.environ)
    text = f'<SocketReceiveBufferSize min="default" max="{size}B"/>'
    asked = f"<CycloneDDS><Domain><Internal>{text}</Internal></Domain></CycloneDDS>"
    return {**os.environ, "CYCLONEDDS_URI": asked}


def check(log: Path, first_ns: int, count: int) -> tuple[int, int]:
    """Count the messages that are not in the log, and the wrong ones."""
    signals = read_episode(log).signals
    parts = [signals[f"{STATES}.{label}"] for label in ("position", "velocity", "effort")]
    due_ns = first_ns + np.round(np.arange(count) * 1e9 / _RATE_HZ).astype(np.int64)
    numbers = np.searchsorted(due_ns, parts[0].stamps_ns).clip(0, count - 1)
    expected = np.array([values_of(int(number)) for number in numbers])
    values = np.stack([one.values for one in parts], axis=1)
    is_right = np.all(values == expected, axis=(1, 2)) & (due_ns[numbers] == parts[0].stamps_ns)
    is_right &= np.array([one.columns == NAMES for one in parts]).all()
    return count - len(np.unique(numbers[is_right])), int(np.count_nonzero(~is_right))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--kept", type=int, default=10)
    parser.add_argument("--buffer", type=int, default=0, help="bytes (default: as it comes)")
    parser.add_argument("--best-effort", action="store_true")
    parser.add_argument("--domain", type=int, default=77)
    asked = parser.parse_args()
    count = round(asked.seconds * _RATE_HZ)
    plan = {
        "topics": {STATES: "states"},
        "messages": count,
        "rate_hz": _RATE_HZ,
        "kept": asked.kept,
        "reliable": not asked.best_effort,
        "longest_s": asked.seconds + 60,
    }
    with tempfile.TemporaryDirectory() as folder, publishing(asked.domain, **plan) as publisher:
        log = Path(folder) / "a.mcap"
        words = [BIN / "tunenet-record", "--joint-states", STATES, "--loopback"]
        words += ["--domain", asked.domain, "-o", log]
        start_s = time.perf_counter()
        process = subprocess.Popen([str(word) for word in words], env=small_buffer(asked.buffer))
        expect(publisher, "matched")
        first_s = time.perf_counter()
        for at_s in stopped_at(asked.seconds):
            time.sleep(first_s + at_s - time.perf_counter())
            process.send_signal(signal.SIGSTOP)
            time.sleep(_STOPPED_S)
            process.send_signal(signal.SIGCONT)
        first_ns, publisher_s = expect(publisher, "sent")
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        _, _, usage = os.wait4(process.pid, 0)
        wall_s = time.perf_counter() - start_s
        cpu_s = usage.ru_utime + usage.ru_stime
        missing, wrong = check(log, int(first_ns), count)
        size = log.stat().st_size
    print(f"sent {count}, missing {missing}, wrong {wrong}; {size / 1e6:.1f} MB")
    print(f"  {wall_s:.1f} s, {cpu_s:.1f} s of processor: {100 * cpu_s / wall_s:.1f} % of a core")
    print(
        f"  the publisher: {float(publisher_s):.1f} s; {usage.ru_maxrss / 1024:.0f} MiB of memory"
    )


if __name__ == "__main__":
    main()
