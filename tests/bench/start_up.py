"""Measure how long commands take to start, and one tuning, beside their libraries alone.

`python -m tests.bench start-up` prints it.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

BIN = Path(sys.executable).parent
COMMANDS = (
    "tunenet-logs",
    "tunenet-record",
    "tunenet-tune",
    "tunenet-review",
    "tunenet-train",
    "tunenet-eval",
)
SAMPLE = Path(__file__).resolve().parents[2] / "sample_logs" / "bouncy.mcap"


def seconds(*words: str | Path, best_of: int) -> float:
    """Return the wall time of a whole process, the best of a few [s]."""
    times = []
    for _ in range(best_of):
        start = time.perf_counter()
        subprocess.run([str(word) for word in words], check=True, capture_output=True)
        times.append(time.perf_counter() - start)
    return min(times)


def figures(best_of: int = 5) -> dict[str, Any]:
    """Measure each command's help over a bare interpreter; a tuning over loading its libraries."""
    bare = seconds(sys.executable, "-c", "pass", best_of=best_of)
    print(f"bare interpreter                 {bare:6.2f} s")
    found: dict[str, Any] = {"bare_interpreter_s": round(bare, 3)}
    for name in COMMANDS:
        took = seconds(BIN / name, "--help", best_of=best_of)
        print(
            f"{name + ' --help':32} {took:6.2f} s   {took / bare:5.1f} times the bare interpreter"
        )
        found[f"{name}_help_times_bare"] = round(took / bare, 2)
    with tempfile.TemporaryDirectory() as folder:
        libraries = "import numpy, mcap, rosbags.typesys, pybullet, rerun"
        loading = seconds(sys.executable, "-c", libraries, best_of=best_of)
        tuning = seconds(BIN / "tunenet-tune", SAMPLE, "-o", folder, best_of=best_of)
        print(f"loading the libraries of a tuning {loading:5.2f} s")
        print(
            f"tunenet-tune of a sample         {tuning:6.2f} s   {tuning / loading:5.1f} times that"
        )
        weights = Path(folder) / "weights.safetensors"
        words = (BIN / "tunenet-train", "drop", "--preset", "paper-code", "-o", weights)
        whole = seconds(*words, best_of=1)
        print(f"tunenet-train, start-up and all  {whole:6.2f} s")
    return found | {
        "libraries_s": round(loading, 3),
        "tune_times_libraries": round(tuning / loading, 2),
        "train_whole_s": round(whole, 2),
    }
