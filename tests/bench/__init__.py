"""Measurements behind the figures in the documents, and what holds versions against each other."""

from __future__ import annotations

import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

Figures = Iterator[tuple[str, float | str]]  # by what they are of, as they come
ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "sample_logs"
SHARED = ROOT.parent / "shared"  # recordings and cases of others, where they are there
REAL = SHARED / "real"
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


def kept_or_compared(
    parser: ArgumentParser,
    write: Callable[[Path, Namespace], object],
    compare: Callable[[Path, Namespace], bool],
) -> int:
    """Parse the arguments, and write a new folder or compare with one; 1 if anything changed."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--write", type=Path, metavar="DIR", help="a new folder, outside the tree")
    what.add_argument("--compare", type=Path, metavar="DIR", help="one that --write made")
    asked = parser.parse_args()
    if asked.write is None:
        return 0 if compare(asked.compare.resolve(), asked) else 1
    if asked.write.exists():
        parser.error(f"{asked.write} is there already; choose a new folder")
    write(asked.write.resolve(), asked)
    return 0
