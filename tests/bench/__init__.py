"""Measurements behind the figures in the documents, and what holds versions against each other."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

Figures = Iterator[tuple[str, float | str]]  # by what they are of, as they come
ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "sample_logs"
REAL = ROOT.parent / "shared" / "real"  # recordings of others, where they are there
BIN = Path(sys.executable).parent


def spent(work: Callable[[], Any]) -> tuple[float, float, Any]:
    """Work, and return the wall time, this process's CPU time [s], and the result."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    result = work()
    return time.perf_counter() - wall_s, time.process_time() - cpu_s, result


def best_s(works: Sequence[Callable[[], object]], rounds: int) -> list[float]:
    """Return the best wall time of each [s], in turns."""
    took = [[spent(work)[0] for work in works] for _ in range(rounds)]
    return [min(column) for column in zip(*took, strict=True)]
