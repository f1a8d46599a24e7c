"""Trace a tuning: the files and functions of ours that one passes.

    python -m tests.bench.road            counts for a log of positions, a film, a payload
    python -m tests.bench.road --list     and the files, with the functions of each

A tuning is `tunenet-tune` with its JSON and its review, in this process. A function counts once
however often it is called. What runs when a module is imported does not count, nor do
comprehensions and lambdas, which belong to the function around them.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
import tempfile
from collections import defaultdict
from types import FrameType

from tests.bench import ROOT, SAMPLES
from tunenet_logs.analysis.cli.tune import main as tune

LOGS = {
    "positions": ("noisy.mcap",),
    "film": ("filmed.mcap",),
    "payload": ("payload.mcap", "--tare", "payload_empty.mcap"),
}

Road = dict[str, set[str]]  # functions by file, both as they are called


def road_of(*words: str) -> Road:
    """Trace what `tunenet-tune` passes with these words, files of the samples among them."""
    inside = f"{ROOT / 'tunenet_logs'}/"
    passed: Road = defaultdict(set)

    def seen(frame: FrameType, event: str, _argument: object) -> None:
        code = frame.f_code
        if event != "call" or not code.co_filename.startswith(inside) or code.co_name[0] == "<":
            return
        file = code.co_filename.removeprefix(f"{ROOT}/")
        if code.co_qualname not in passed.get(file, ()) and not _is_importing(frame):
            passed[file].add(code.co_qualname)

    samples = [str(SAMPLES / word) if word.endswith(".mcap") else word for word in words]
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        sys.setprofile(seen)
        try:
            code = tune([*samples, "-o", folder, "--jobs", "1", "--quiet"])
        finally:
            sys.setprofile(None)
    if code != 0:
        raise RuntimeError(f"tunenet-tune ended with {code}")
    return passed


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--list", action="store_true", help="name the files and their functions")
    arguments = parser.parse_args()
    for name, words in LOGS.items():
        passed = road_of(*words)
        count = sum(map(len, passed.values()))
        print(f"{name:10} {len(passed):4} files {count:5} functions")
        if arguments.list:
            for file, functions in sorted(passed.items()):
                print(f"    {file}: {', '.join(sorted(functions))}")


if __name__ == "__main__":
    main()
