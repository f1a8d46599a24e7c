"""Measure speed beside bare library work, and robustness; compare with an earlier run.

`python -m tests.bench` measures the ratios of docs/performance.md, `python -m tests.bench SECTION
...` others. `--json now.json` keeps the figures; `--compare before.json` prints what changed since.
A figure whose name begins with "bad" is to be 0; where one is not, this ends with 1.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Section:
    """Function of a module, by the section's name, which yields figures by what they are of."""

    module: str
    about: str
    full: Mapping[str, Any] = field(default_factory=dict)  # its options, as a measurement has them
    quick: Mapping[str, Any] = field(default_factory=dict)  # those that are smaller in a look

    def figures(self, name: str, options: Mapping[str, Any]) -> Iterator[tuple[str, float | str]]:
        return getattr(importlib.import_module(f"tests.bench.{self.module}"), name)(**options)


SECTIONS = {
    "start_up": Section("speed", "commands' start beside an interpreter's", {"best_of": 5},
                        {"best_of": 2}),
    "films": Section("speed", "tuning films beside decoding them once", {"drawn": 5},
                     {"drawn": 2}),
    "state_logs": Section("speed", "tuning positions beside reading, rollouts and fit",
                          {"count": 200, "late": 40}, {"count": 40}),
    "batches": Section("speed", "two processes and Ray against one; --kills: what is lost",
                       {"count": 2000, "kills": 0}, {"count": 400}),
    "rollouts": Section("speed", "training's rollouts beside bare stepping", {"count": 10_000},
                        {"count": 2000}),
    "training": Section("speed", "data and training beside bare engine and optimizer",
                        {"rounds": 3}, {"rounds": 1}),
    "reading": Section("recordings", "joint states beside rosbags' reader",
                       {"count": 60_000, "rounds": 5}, {"count": 5000, "rounds": 2}),
    "long_joints": Section("recordings", "an arm's hours at 1 kHz: CPU, memory, first line",
                           {"count": 7_200_000}, {"count": 60_000}),
    "writing": Section("recordings", "EpisodeWriter beside the bare mcap library",
                       {"count": 50_000, "rounds": 5}, {"count": 5000, "rounds": 2}),
    "remote": Section("speed", "bytes that a bucket sends beside those of its logs",
                      {"count": 100}, {"count": 10}),
    "memory": Section("speed", "memory for a clip, and for a longer one",
                      {"seconds": 5.0, "longer": 10}, {"longer": 3}),
    "arm": Section("speed", "an arm's rollout beside inverse dynamics", {"rounds": 30},
                   {"rounds": 3}),
    "circle": Section("speed", "the shipped circle beside one made anew, which --out keeps",
                      {"out": ""}),
    "campaign": Section("speed", "a review of 60 attempts; --out keeps the campaign",
                        {"out": "", "attempts": 10}, {"attempts": 1}),
    "recording": Section("recordings", "camera and joints in real time: drops, processor",
                         {"seconds": 60.0}, {"seconds": 3.0}),
    "live_joints": Section("recordings", "1 kHz over ROS 2, the recorder stopped twice: missing",
                           {"seconds": 60.0, "kept": 10, "buffer": 0, "best_effort": False},
                           {"seconds": 4.0}),
    "damage": Section("robustness", "single bits flipped and cuts: what was not said",
                      {"flips": 5000, "seed": 0}, {"flips": 100}),
    "hostile": Section("robustness", "CPU and memory of small files that claim much", {"only": ""},
                       {"only": "huge_length,nested_json"}),
    "durability": Section("robustness", "recordings killed and signalled: what is missing",
                          {"kills": 100, "signals": 60, "seed": 0}, {"kills": 4, "signals": 1}),
    "ownership": Section("robustness", "two writers to one name, and files taken away",
                         {"tries": 2000, "moments": 100, "seed": 0}, {"tries": 24, "moments": 5}),
    "comings": Section("robustness", "cameras that are late, cut off, frozen, killed",
                       {"runs": 30, "jobs": 4, "late_s": 5.0}, {"runs": 2, "late_s": 1.0}),
}  # fmt: skip
USUAL = ("start_up", "films", "state_logs", "batches", "rollouts", "training")
OPTIONS = {name: value for one in SECTIONS.values() for name, value in one.full.items()}


def print_changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Print each figure then and now; those that only one run has are left out."""
    print(f"\n{'':72} {'before':>10} {'now':>10} {'change':>8}")
    for section, figures in now.items():
        for name, value in figures.items():
            old = before.get(section, {}).get(name)
            if isinstance(old, int | float) and isinstance(value, int | float):
                change = f"{100 * (value / old - 1):+.0f} %" if old else ""
                print(f"{section + ', ' + name:72} {old:10.4g} {value:10.4g} {change:>8}")


def main(words: Sequence[str] | None = None) -> int:
    about = "\n".join(f"  {name:14} {one.about}" for name, one in SECTIONS.items())
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog=f"sections:\n{about}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("sections", nargs="*", metavar="SECTION", help=f"default: {', '.join(USUAL)}")
    add("--quick", action="store_true", help="smaller counts: a look, not a measurement")
    add("--json", type=Path, metavar="FILE", help="also write the figures to this file")
    add("--compare", type=Path, metavar="FILE", help="print the change since this file")
    for name, value in OPTIONS.items():
        kind: dict[str, Any] = {"action": "store_true"} if value is False else {"type": type(value)}
        of = ", ".join(f"{key} ({one.full[name]})" for key, one in SECTIONS.items()
                       if name in one.full)  # fmt: skip
        add(f"--{name.replace('_', '-')}", default=None, help=f"of {of}", **kind)
    asked = parser.parse_args(words)
    chosen = asked.sections or USUAL
    if unknown := set(chosen) - SECTIONS.keys():
        parser.error(f"no section {', '.join(sorted(unknown))}")
    told = {name: getattr(asked, name) for name in OPTIONS if getattr(asked, name) is not None}
    if idle := [name for name in told if not any(name in SECTIONS[one].full for one in chosen)]:
        parser.error(f"no section here has --{idle[0].replace('_', '-')}")
    before = json.loads(asked.compare.read_text()) if asked.compare else None
    load = os.getloadavg()[0]
    print(f"{len(os.sched_getaffinity(0))} cores, load {load:.1f}; a busy machine blurs all of it")
    found: dict[str, Any] = {"machine": {"processor": platform.machine(), "load": load}}
    for name in chosen:
        section = SECTIONS[name]
        options = {**section.full, **(section.quick if asked.quick else {}), **told}
        options = {one: options[one] for one in section.full}
        print(f"\n{name}: {section.about}", flush=True)
        figures = found[name] = {}
        for what, value in section.figures(name, options):
            figures[what] = value
            print(
                f"  {what:70} {value if isinstance(value, str) else f'{value:10.4g}'}", flush=True
            )
    if asked.json:
        asked.json.write_text(json.dumps(found, indent=1) + "\n")
    if before is not None:
        print_changes(before, found)
    names = [(name, value) for figures in found.values() for name, value in figures.items()]
    return int(any(name.startswith("bad") and value for name, value in names))


if __name__ == "__main__":
    sys.exit(main())
