"""Measure every ratio of this project's speed in one run, to compare with an earlier one.

`python -m tests.bench --json now.json` keeps the figures; `--compare before.json` prints what
changed since. docs/performance.md says what each of them means.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Section:
    """Module of `tests.bench` whose `figures(**counts)` prints its lines and returns figures."""

    module: str
    counts: Mapping[str, Any] = field(default_factory=dict)  # of the whole run
    quick: Mapping[str, Any] = field(default_factory=dict)  # of the quick one


SECTIONS = {
    "start-up": Section("start_up", {"best_of": 5}, {"best_of": 2}),
    "films": Section("films", {"drawn": 5}, {"drawn": 2}),
    "state logs": Section("state_logs", {"count": 200}, {"count": 40}),
    "batches": Section("batches", {"count": 2000}, {"count": 400}),
    "rollouts": Section("rollouts", {"count": 10_000}, {"count": 2000}),
    "training": Section("training", {"rounds": 3}, {"rounds": 1}),
}


def flat(figures: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, float]]:
    """Yield all numbers of a nested mapping, by their names joined with dots."""
    for name, value in figures.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{before}{name}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield f"{before}{name}", float(value)


def print_changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Print each figure then and now; those that only one run has are left out."""
    old, width = dict(flat(before)), 64
    print(f"\n{'':{width}} {'before':>10} {'now':>10} {'change':>8}")
    for name, value in flat(now):
        if name in old:
            change = f"{100 * (value / old[name] - 1):+.0f} %" if old[name] else ""
            print(f"{name:{width}} {old[name]:10.3g} {value:10.3g} {change:>8}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("sections", nargs="*", metavar="SECTION", help=f"of {', '.join(SECTIONS)} (default: all)")
    add("--quick", action="store_true", help="smaller counts: a look, not a measurement")
    add("--json", type=Path, metavar="FILE", help="also write the figures to this file")
    add("--compare", type=Path, metavar="FILE", help="print the change since this file")
    arguments = parser.parse_args()
    if unknown := set(arguments.sections) - SECTIONS.keys():
        parser.error(f"no section {', '.join(sorted(unknown))}")
    before = json.loads(arguments.compare.read_text()) if arguments.compare else None
    load = os.getloadavg()[0]
    print(f"{len(os.sched_getaffinity(0))} cores, load {load:.1f}; a busy machine blurs all of it")
    figures: dict[str, Any] = {"machine": {"processor": platform.machine(), "load": load}}
    for name in arguments.sections or SECTIONS:
        section = SECTIONS[name]
        print(f"\n{name}")
        module = importlib.import_module(f"tests.bench.{section.module}")
        figures[name] = module.figures(**(section.quick if arguments.quick else section.counts))
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")
    if before is not None:
        print_changes(before, figures)


if __name__ == "__main__":
    main()
