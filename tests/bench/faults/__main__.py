"""Test the test suite by mutation: does it catch deliberate faults (`tests/bench/faults/table.py`)?

    python -m tests.bench.faults                  all of them
    python -m tests.bench.faults --list           their names, files and likely tests
    python -m tests.bench.faults --set second     those of one set
    python -m tests.bench.faults --only WORDS     those whose names hold the words
    python -m tests.bench.faults --likely         run no more than the likely tests

Each fault is put into a copy of the tree, and `pytest` runs there: the tests that are most likely
to notice, and, if those pass, the whole suite but what is `slow`. A test that fails has caught the
fault only if it passes once the fault is taken out again. An import that fails, and a run that
never ends, count too, and are said to be that. One of twenty may be missed, else this ends with 1.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from tests.bench import ROOT, SHARED
from tests.bench.faults.table import SETS, Fault

_NOT_COPIED = shutil.ignore_patterns(
    *(".git", ".venv", "__pycache__", ".*_cache", ".hypothesis", "*.egg-info"),
    *("demo", "build", "dist"),
)
_SUITE = ("-m", "not slow")
_ALL_CORES = ("-n", "auto", "--dist", "loadfile")
_PASSED, _FAILED = (0, 5), (1, 2)  # what pytest ends with; 5 where no test was selected
_LIKELY_S, _SUITE_S = 1200, 5400  # after which a run of the likely tests, or of all, hangs
_MISSED_OF = 20  # of so many faults, one may be missed


class Run(NamedTuple):
    """Result of one run of pytest; nothing in it where every test passed."""

    failed: str = ""  # the first test that failed, or the file that could not be imported
    trouble: str = ""  # why the run says nothing of the tests
    hangs: bool = False


def misplaced(faults: Sequence[Fault]) -> list[str]:
    """List the faults that no longer fit the code or its tests, and why."""
    wrong: list[str] = []
    for fault in faults:
        file = ROOT / fault.file
        count = file.read_text().count(fault.old) if file.is_file() else 0
        if count != 1:
            wrong.append(f"{fault.name}: its text is in {fault.file} {count} times, wanted: once")
        wrong += [
            f"{fault.name}: there is no {one}" for one in fault.likely if not (ROOT / one).is_file()
        ]
    return wrong


def copy_tree(folder: Path) -> Path:
    """Copy the tree to a folder, with the recordings of others beside it as they are here.

    Raises:
        RuntimeError: the copy is not what is imported: no fault would be tested.
    """
    tree = folder / ROOT.name
    shutil.copytree(ROOT, tree, symlinks=True, ignore=_NOT_COPIED)
    if SHARED.is_dir():
        (folder / SHARED.name).symlink_to(SHARED)
    code = "import tunenet_logs as logs; from tunenet_logs import analysis, recorders; "
    code += "print(*(one.__file__ for one in (analysis, recorders, logs)), sep='\\n')"
    told = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=_environment(tree),
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    if not all(Path(one).is_relative_to(tree) for one in told.stdout.splitlines()):
        raise RuntimeError(f"what is imported is not the copy in {tree}:\n{told.stdout}")
    return tree


def _environment(tree: Path) -> dict[str, str]:
    """Return an environment in which every process imports the copy."""
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return {**os.environ, **threads, "PYTHONPATH": str(tree)}


def tested(tree: Path, *words: str, limit_s: float) -> Run:
    """Run pytest in a copy, up to the first failure; after `limit_s` kill it and its children."""
    pytest = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", "-p", "no:cacheprovider"]
    process = subprocess.Popen(
        [*pytest, f"--basetemp={tree.parent / 'made'}", *words], cwd=tree, env=_environment(tree),
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        output, _ = process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        return Run(hangs=True)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    if process.returncode in _PASSED:
        return Run()
    failed = re.search(r"^(?:FAILED|ERROR) (tests/.*?)(?: - .*)?$", output, re.MULTILINE)
    if process.returncode in _FAILED and failed:
        return Run(failed[1])
    last = output.strip().rpartition("\n")[2].strip() or "no output"
    return Run(trouble=f"pytest ended with {process.returncode}: {last}")


def tried(fault: Fault, *, likely_only: bool) -> tuple[bool, str]:
    """Put a fault into a copy; say whether a test catches it, which passes without it, and how."""
    with tempfile.TemporaryDirectory() as name:
        tree = copy_tree(Path(name))
        file = tree / fault.file
        before = file.read_text()
        file.write_text(before.replace(fault.old, fault.new))
        begin = time.perf_counter()
        run = tested(tree, *_SUITE, *fault.likely, limit_s=_LIKELY_S)
        if run == Run() and not likely_only:
            run = tested(tree, *_SUITE, *_ALL_CORES, limit_s=_SUITE_S)
        took = f"({time.perf_counter() - begin:.0f} s)"
        if run.trouble:
            return False, f"NOT CAUGHT: {run.trouble} {took}"
        if run.hangs:
            return True, f"caught by a run that hangs {took}"
        if not run.failed:
            suite = "its likely tests pass" if likely_only else "all tests pass"
            return False, f"NOT CAUGHT: {suite} {took}"
        file.write_text(before)
        if tested(tree, run.failed, limit_s=_LIKELY_S) != Run():
            return False, f"NOT CAUGHT: {run.failed} fails without the fault too {took}"
        what = "" if "::" in run.failed else "an import that fails, "
        return True, f"caught by {what}{run.failed} {took}"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--list", action="store_true", help="show the faults and run nothing")
    parser.add_argument("--set", choices=SETS, help="of faults (default: all sets)")
    parser.add_argument("--only", nargs="+", metavar="WORDS", help="of a fault's name")
    parser.add_argument("--likely", action="store_true", help="leave the rest of the suite out")
    arguments = parser.parse_args()
    wanted = arguments.only or [""]
    of_sets = SETS[arguments.set] if arguments.set else chain(*SETS.values())
    faults = [one for one in of_sets if any(words in one.name for words in wanted)]
    if not faults:
        parser.error("no fault has such a name; see --list")
    if arguments.list:
        for one in faults:
            print(one.name, one.file, *one.likely, sep="\n    ")
        return 0
    if wrong := misplaced(faults):
        print(*wrong, sep="\n", file=sys.stderr)
        return 2
    caught = 0
    for fault in faults:
        is_caught, words = tried(fault, likely_only=arguments.likely)
        caught += is_caught
        print(f"{fault.name}: {words}", flush=True)
    print(f"{caught} of {len(faults)} caught")
    missed = len(faults) - caught
    return 0 if missed <= len(faults) // _MISSED_OF else 1


if __name__ == "__main__":
    sys.exit(main())
