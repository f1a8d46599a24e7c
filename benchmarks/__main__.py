"""Speed: start-up, a whole tuning, training; each beside a bare cost of the same run."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks import training

BIN = Path(sys.executable).parent
COMMANDS = (
    "tunenet-logs",
    "tunenet-record",
    "tunenet-tune",
    "tunenet-review",
    "tunenet-train",
    "tunenet-eval",
)
SAMPLE = Path(__file__).resolve().parents[1] / "sample_logs" / "bouncy.mcap"


def seconds(*words: str | Path, best_of: int = 5) -> float:
    """Wall time of a whole process, the best of a few."""
    times = []
    for _ in range(best_of):
        start = time.perf_counter()
        subprocess.run([str(word) for word in words], check=True, capture_output=True)
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    bare = seconds(sys.executable, "-c", "pass")
    print(f"bare interpreter                 {bare:6.2f} s")
    for name in COMMANDS:
        took = seconds(BIN / name, "--help")
        print(
            f"{name + ' --help':32} {took:6.2f} s   {took / bare:5.1f} times the bare interpreter"
        )
    with tempfile.TemporaryDirectory() as folder:
        libraries = "import numpy, mcap, rosbags.typesys, pybullet, rerun"
        loading = seconds(sys.executable, "-c", libraries)
        tuning = seconds(BIN / "tunenet-tune", SAMPLE, "-o", folder)
        print(f"loading the libraries of a tuning {loading:5.2f} s")
        print(
            f"tunenet-tune of a sample         {tuning:6.2f} s   {tuning / loading:5.1f} times that"
        )
        weights = Path(folder) / "weights.safetensors"
        words = (BIN / "tunenet-train", "drop", "--preset", "paper-code", "-o", weights)
        print(f"tunenet-train, start-up and all  {seconds(*words, best_of=1):6.2f} s")
    training.main()


if __name__ == "__main__":
    main()
