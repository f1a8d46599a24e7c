"""Test whether a recording's file is its own: two writers to one name, and files taken away.

`python -m tests.bench.ownership` has two processes begin to record to one name at one moment 2,000
times, half of them with `overwrite`, over nothing, a log, or what a killed recorder left. Then
it records 100 times and, at a random moment, removes, moves, replaces or links the file that is
being written, or its folder. `--tries`, `--moments` and `--seed` change that.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
from collections import Counter
from pathlib import Path

from tests.recorders.contender import contend, contenders
from tests.recorders.lost_file import ATTACKS, attack

# Whether with `overwrite`, and what lies there.
_WAYS = ((False, ""), (True, ""), (False, ""), (True, "log"), (False, ""), (True, "active"))


def contend_often(tries: int, rng: random.Random) -> int:
    """Run two writers, so many times; count how often it went wrong."""
    bad = 0
    with tempfile.TemporaryDirectory() as name, contenders(2) as both:
        for number in range(tries):
            overwrite, left = _WAYS[number % len(_WAYS)]
            try:
                contend(both, Path(name), rng, overwrite=overwrite, left=left)
            except AssertionError as error:
                bad += 1
                print(f"  {overwrite=} {left=}: {error}", file=sys.stderr)
                for one in Path(name).iterdir():
                    one.unlink()
    return bad


def attack_often(moments: int, rng: random.Random) -> tuple[int, Counter[str]]:
    """Take the file away, so many times; count lost messages, and each kind."""
    bad, kinds = 0, Counter[str]()
    for number in range(moments):
        how = list(ATTACKS)[number % len(ATTACKS)]
        kinds[how] += 1
        with tempfile.TemporaryDirectory() as name:
            try:
                attack(Path(name), how, rng.uniform(0.05, 2.5), ends=rng.random() < 0.5)
            except Exception as error:  # noqa: BLE001 (what is lost is counted here)
                bad += 1
                print(f"  {how}: {type(error).__name__}: {error}", file=sys.stderr)
    return bad, kinds


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tries", type=int, default=2000)
    parser.add_argument("--moments", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    bad = contend_often(arguments.tries, rng)
    print(f"two writers to one name, {arguments.tries} tries: {bad} without one whole log by one")
    lost, kinds = attack_often(arguments.moments, rng)
    words = ", ".join(f"{how} {count}" for how, count in kinds.items())
    print(f"file taken away, {arguments.moments} times ({words}): {lost} with anything lost")
    return 1 if bad or lost else 0


if __name__ == "__main__":
    sys.exit(main())
