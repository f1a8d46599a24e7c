"""Record what the commands promise beside their tunings, to hold later versions against.

    python -m tests.bench.promises --write DIR     make the inputs, keep them and all answers in DIR
    python -m tests.bench.promises --compare DIR   answer the same inputs again: what has moved?

Each part is a function from the folder of its inputs, `DIR/inputs`, which it makes only if they are
not there yet, to texts by name; what it said is kept as `DIR/PART.json`. `--compare` ends with 1 if
anything moved. What `tunenet-tune` finds is held by `tests.bench.answers`, with more logs.
"""

from __future__ import annotations

import argparse
import difflib
import hashlib
import json
import os
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from importlib.util import find_spec
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[2]
# Recordings and cases of others, where they are there.
SHARED = next(
    (one / "shared" for one in ROOT.parents if (one / "shared" / "real").is_dir()), ROOT / "shared"
)

INPUTS = "inputs"

Texts = dict[str, str]
Part = Callable[[Path], Texts]  # from `DIR/inputs` to what is promised, by name: a digest or a text
# Each has `PARTS` of its own, by the name of the file that keeps what they say.
MODULES = (
    "tests.bench.promises_logs",
    "tests.bench.promises_results",
    "tests.bench.promises_commands",
)

JOBS = 2  # at a time
# Of what is started.
SETTINGS = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "COLUMNS": "200",
    "TZ": "UTC",
    "PYTHONHASHSEED": "0",  # the order of some warnings is that of a set
}

_PRELOADED = ["numpy", "tqdm", "tunenet_logs.reader"]  # once for all fresh processes
_MAX_S = 600  # that one job may take
_MAX_LINES = 12  # of a difference, that are shown


def all_parts() -> dict[str, Part]:
    """Collect the parts of all modules that are there."""
    found = [import_module(name).PARTS for name in MODULES if find_spec(name)]
    return {name: part for parts in found for name, part in parts.items()}


def together(jobs: Mapping[str, Callable[[], Texts]], what: str) -> Texts:
    """Do all jobs, `JOBS` at a time, and join what they say."""
    with ThreadPoolExecutor(JOBS) as pool:
        said = pool.map(lambda job: job(), jobs.values())
        said = list(tqdm(said, what, len(jobs), disable=None))
    return {name: text for texts in said for name, text in texts.items()}


def apart(name: str, work: Callable[..., Texts], *arguments: object) -> Texts:
    """Work in a fresh process, whose end is an answer, too."""
    context = get_context("forkserver")
    context.set_forkserver_preload(_PRELOADED)
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(theirs, work, arguments))
    process.start()
    theirs.close()
    try:
        return ours.recv() if ours.poll(_MAX_S) else {name: f"took over {_MAX_S} s"}
    except EOFError:
        process.join()
        return {name: f"ended by {process.exitcode}"}
    finally:
        process.kill()
        process.join()


def _send(pipe: Connection, work: Callable[..., Texts], arguments: Sequence[object]) -> None:
    pipe.send(work(*arguments))
    pipe.close()


def once(folder: Path, make: Callable[[Path], object]) -> Path:
    """Make a folder of inputs unless it is there."""
    if not folder.exists():
        unfinished = folder.with_name(f"{folder.name}.partial")
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        make(unfinished)
        unfinished.rename(folder)
    return folder


def digest(data: bytes | ArrayLike) -> str:
    """Shorten bytes, or the bytes of an array, to 16 digits of their SHA-256."""
    kept = data if isinstance(data, bytes) else np.asarray(data).tobytes()
    return hashlib.sha256(kept).hexdigest()[:16]


def write(folder: Path, parts: Mapping[str, Part]) -> None:
    """Make the inputs and keep what is said of them."""
    (folder / INPUTS).mkdir(parents=True, exist_ok=True)
    for name, part in parts.items():
        said = part(folder / INPUTS)
        text = json.dumps(said, indent=1, ensure_ascii=False, sort_keys=True)
        (folder / f"{name}.json").write_text(text + "\n", "utf-8", errors="backslashreplace")
        print(f"{len(said)} {name} in {folder / name}.json")


def compare(folder: Path, parts: Mapping[str, Part]) -> bool:
    """Ask again, and print what has moved; return whether nothing has."""
    moved = 0
    for name, part in parts.items():
        if not (file := folder / f"{name}.json").exists():
            print(f"{name}: was not written; left out")
            continue
        before: Texts = json.loads(file.read_text("utf-8"))
        after = part(folder / INPUTS)
        for key in sorted(before.keys() | after.keys()):
            if before.get(key) != after.get(key):
                moved += 1
                print(f"{name}: {key!a}: {_difference(before.get(key), after.get(key))}")
    print(f"{moved} moved" if moved else "no change")
    return not moved


def _difference(before: str | None, after: str | None) -> str:
    """Show lines that were and lines that are, the first ones, not too long."""
    if before is None or after is None:
        return "is new" if before is None else "is gone"
    both = difflib.unified_diff(before.splitlines(), after.splitlines(), n=0, lineterm="")
    lines = [line[:200] for line in list(both)[2:] if not line.startswith("@@")]
    rest = len(lines) - _MAX_LINES
    more = [f"... {rest} more lines"] if rest > 0 else []
    text = "\n    ".join(["", *lines[:_MAX_LINES], *more])
    return text.encode("utf-8", "backslashreplace").decode()


def main(parts: Mapping[str, Part] | None = None) -> int:
    """Write or compare `parts`; all that there are if None."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--write", type=Path, metavar="DIR", help="a new folder, outside the tree")
    what.add_argument("--compare", type=Path, metavar="DIR", help="one that --write made")
    parser.add_argument("--part", action="append", help="one alone; may be said again")
    arguments = parser.parse_args()
    parts = all_parts() if parts is None else parts
    chosen = {name: parts[name] for name in arguments.part or parts}
    os.environ.update(SETTINGS)
    if arguments.write is None:
        return 0 if compare(arguments.compare.resolve(), chosen) else 1
    if arguments.write.exists():
        parser.error(f"{arguments.write} is there already; choose a new folder")
    write(arguments.write.resolve(), chosen)
    return 0


if __name__ == "__main__":
    sys.exit(main())
