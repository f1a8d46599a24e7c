"""Measure what many training rollouts cost, beside stepping the engine and nothing else.

`python -m tests.bench.rollouts --count 100000` makes rollouts of the preset `paper-code`, each of
them 400 steps of the engine, and of `default`, which flies in closed form between impacts; beside
each, as many bare drops of 400 steps in as many processes. Ours and the bare ones take turns in
three parts, so that both see the machine in the same state; starting processes is left out of both.
"""

from __future__ import annotations

import argparse
import json
import os
from functools import partial
from pathlib import Path
from typing import Any

from tests.bench.training import QUIET, bare_stepping_s, timed
from tunenet_logs.analysis.drop.presets import TRAININGS

MAX_RATIO = 1.3
_PARTS = 3
_MAX_OF_DEFAULT = 4096  # rollouts: however many pairs are wanted, they are drawn among these


def figures(count: int = 10_000) -> dict[str, Any]:
    """Measure seconds of `count` rollouts of each preset, bare and ours, and their ratio."""
    jobs = len(os.sched_getaffinity(0))
    found: dict[str, Any] = {"processes": jobs}
    for name, most, wanted in (
        ("paper-code", count, f"wanted: at most {MAX_RATIO}"),
        ("default", _MAX_OF_DEFAULT, ""),
    ):
        each = min(count // _PARTS, most)
        ours_s = bare_s = 0.0
        for part in range(_PARTS):
            starting_s, _ = timed(partial(_made, name, 2 * jobs, 0, jobs))
            whole_s, made = timed(partial(_made, name, each, part, jobs))
            ours_s += whole_s - starting_s
            bare_s += bare_stepping_s(jobs, made)
        total = _PARTS * each
        ratio, each_ms = ours_s / bare_s, 1e3 * ours_s / total
        print(
            f"{name:12} {total} rollouts in {ours_s:.2f} s, {each_ms:.2f} ms each: "
            f"{ratio:.2f} times stepping 400 times ({bare_s:.2f} s)   {wanted}"
        )
        found[name] = {
            "rollouts": total,
            "ms_each": round(each_ms, 3),
            "times_bare_stepping": round(ratio, 3),
        }
    return found


def _made(name: str, rollouts: int, seed: int, jobs: int) -> int:
    """Make rollouts, and return how many."""
    pairs = TRAININGS[name].make_pairs(rollouts // 2, seed, jobs, QUIET)
    return len(pairs.values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()
    found = figures(max(arguments.count, 100))
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
