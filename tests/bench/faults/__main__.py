"""Test the test suite by mutation: does it catch deliberate faults (`tests/bench/faults/`)?

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
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from tests.bench.faults.fault import Fault
from tests.bench.faults.first import FIRST
from tests.bench.faults.second import SECOND
from tests.bench.faults.third import THIRD

ROOT = Path(__file__).resolve().parents[3]
# Recordings of others, which tests use where they are there: beside the tree.
SHARED = ROOT.parent / "shared"

_NOT_COPIED = shutil.ignore_patterns(
    *(".git", ".venv", "__pycache__", ".*_cache", ".hypothesis", "*.egg-info"),
    *("demo", "build", "dist"),
)
_SUITE = ("-m", "not slow")
_ALL_CORES = ("-n", "auto", "--dist", "loadfile")
_PASSED, _FAILED, _BROKEN_OFF, _NO_TESTS = 0, 1, 2, 5  # what pytest ends with
_LIKELY_S, _SUITE_S = 1200, 5400  # after which a run of the likely tests, or of all, hangs
SETS = {"first": FIRST, "second": SECOND, "third": THIRD}
_MISSED_OF = 20  # of so many faults, one may be missed


@dataclass(frozen=True)
class Run:
    """Result of one run of pytest."""

    # The first test that failed, or the file that could not be imported; "" if none.
    failed: str = ""
    hangs: bool = False
    trouble: str = ""  # why the run says nothing of the tests; "" if it does

    @property
    def is_quiet(self) -> bool:
        """Whether every test passed."""
        return not (self.failed or self.hangs or self.trouble)


@dataclass(frozen=True)
class Outcome:
    """Result for one fault, in words."""

    is_caught: bool
    words: str


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
    """Copy the tree to a folder, with the recordings of others beside it as they are here."""
    tree = folder / ROOT.name
    shutil.copytree(ROOT, tree, symlinks=True, ignore=_NOT_COPIED)
    if SHARED.is_dir():
        (folder / SHARED.name).symlink_to(SHARED)
    _check_imports(tree, folder)
    return tree


def put_in(fault: Fault, tree: Path) -> str:
    """Put a fault into a copy; return the text of the file before."""
    file = tree / fault.file
    before = file.read_text()
    file.write_text(before.replace(fault.old, fault.new))
    return before


def _environment(tree: Path) -> dict[str, str]:
    """Return an environment in which every process imports the copy."""
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return {**os.environ, **threads, "PYTHONPATH": str(tree)}


def _check_imports(tree: Path, elsewhere: Path) -> None:
    """Raise RuntimeError if the copy is not what is imported: no fault would be tested."""
    code = "import tunenet_logs as logs; from tunenet_logs import analysis, recorders; "
    code += "print(*(one.__file__ for one in (analysis, recorders, logs)), sep='\\n')"
    words = [sys.executable, "-c", code]
    environment = _environment(tree)
    told = subprocess.run(
        words, cwd=elsewhere, env=environment, check=True, capture_output=True, text=True
    )
    if not all(Path(one).is_relative_to(tree) for one in told.stdout.splitlines()):
        raise RuntimeError(f"what is imported is not the copy in {tree}:\n{told.stdout}")


def tested(tree: Path, *words: str, limit_s: float) -> Run:
    """Run pytest in a copy, up to the first failure; after `limit_s` kill it and its children."""
    pytest = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", "-p", "no:cacheprovider"]
    process = subprocess.Popen(
        [*pytest, f"--basetemp={tree.parent / 'made'}", *words],
        cwd=tree,
        env=_environment(tree),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        output, _ = process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        return Run(hangs=True)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    return _read(process.returncode, output)


def _read(code: int, output: str) -> Run:
    if code in (_PASSED, _NO_TESTS):
        return Run()
    lines = output.splitlines()
    for line in lines:
        kind, _, rest = line.partition(" ")
        if code in (_FAILED, _BROKEN_OFF) and kind in ("FAILED", "ERROR") and rest[:6] == "tests/":
            return Run(failed=rest.split(" - ")[0])
    last = next((line for line in reversed(lines) if line.strip()), "no output")
    return Run(trouble=f"pytest ended with {code}: {last.strip()}")


def _runs(fault: Fault, tree: Path, *, likely_only: bool) -> Iterator[Run]:
    """Yield the run of the likely tests, then of all others."""
    yield tested(tree, *_SUITE, *fault.likely, limit_s=_LIKELY_S)
    if not likely_only:
        yield tested(tree, *_SUITE, *_ALL_CORES, limit_s=_SUITE_S)


def tried(fault: Fault, *, likely_only: bool) -> Outcome:
    """Put one fault into a copy, and check whether a test fails that passes without it."""
    with tempfile.TemporaryDirectory() as name:
        tree = copy_tree(Path(name))
        before = put_in(fault, tree)
        begin = time.perf_counter()
        runs = _runs(fault, tree, likely_only=likely_only)
        run = next((one for one in runs if not one.is_quiet), Run())
        took = f"({time.perf_counter() - begin:.0f} s)"
        if run.trouble:
            return Outcome(False, f"NOT CAUGHT: {run.trouble} {took}")
        if run.hangs:
            return Outcome(True, f"caught by a run that hangs {took}")
        if not run.failed:
            suite = "its likely tests pass" if likely_only else "all tests pass"
            return Outcome(False, f"NOT CAUGHT: {suite} {took}")
        (tree / fault.file).write_text(before)
        if not tested(tree, run.failed, limit_s=_LIKELY_S).is_quiet:
            return Outcome(False, f"NOT CAUGHT: {run.failed} fails without the fault too {took}")
        what = "" if "::" in run.failed else "an import that fails, "
        return Outcome(True, f"caught by {what}{run.failed} {took}")


def _shown(fault: Fault) -> str:
    return "\n    ".join((fault.name, fault.file, *fault.likely))


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
        print(*map(_shown, faults), sep="\n")
        return 0
    if wrong := misplaced(faults):
        print(*wrong, sep="\n", file=sys.stderr)
        return 2
    caught = 0
    for fault in faults:
        outcome = tried(fault, likely_only=arguments.likely)
        caught += outcome.is_caught
        print(f"{fault.name}: {outcome.words}", flush=True)
    print(f"{caught} of {len(faults)} caught")
    missed = len(faults) - caught
    return 0 if missed <= len(faults) // _MISSED_OF else 1


if __name__ == "__main__":
    sys.exit(main())
