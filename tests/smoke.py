"""The built wheel in a fresh environment of every other supported Python: install, record, tune.

`python -m tests.smoke`, or `make smoke`. A Python that is not on this machine is named, and so is
one whose packages cannot be fetched; neither is a failure. No compiler is ever used.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from pathlib import Path

from tests.wheel import ROOT, built_wheel

PYTHONS = ("3.11", "3.12", "3.13")
RESTITUTION = 0.72
TOLERANCE = 0.002
# What pip says where no index answers.
NO_NETWORK = ("connection broken by", "Failed to establish a new connection", "Could not fetch URL")
# Run one after the other in an empty folder.
COMMANDS = (
    f"tunenet-record --simulate drop --restitution {RESTITUTION} --height 1.1 -o drop.mcap",
    "tunenet-tune drop.mcap",
    "tunenet-review . -o all.rrd",
    "tunenet-export drop.json --to mujoco -o ball.xml",
    "tunenet-compare drop.json --csv all.csv",
)
WRITTEN = ("drop.mcap", "drop.json", "drop.rrd", "all.rrd", "ball.xml", "all.csv", "all_pairs.csv")
VERSIONS = """
import platform
from importlib.metadata import version
from importlib.util import find_spec
assert find_spec("torch") is None, "the base brings PyTorch"
names = ("tunenet-logs", "numpy", "scipy", "rerun-sdk")
print(f"Python {platform.python_version()}, " + ", ".join(f"{one} {version(one)}" for one in names))
"""


class StepError(Exception):
    """A step that did not do what it should; with all that it said."""


def run(*words: str | Path, folder: Path) -> str:
    """What a program prints, in a folder and without this tree on its path.

    Raises:
        StepError: it ended with another code than 0.
    """
    own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [str(word) for word in words],
        cwd=folder,
        env=own,
        capture_output=True,
        text=True,
        timeout=900,
    )
    if done.returncode:
        raise StepError(f"{' '.join(map(str, words))}\n{done.stdout}{done.stderr}")
    return done.stdout


def interpreter(version: str) -> Path | None:
    """A Python of this version that starts, on the PATH or of pyenv; None where there is none."""
    on_path = shutil.which(f"python{version}")
    of_pyenv = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
    for found in (*([Path(on_path)] if on_path else ()), *of_pyenv):
        try:
            said = run(found, "-c", "import sys; print(*sys.version_info[:2])", folder=ROOT)
        except StepError:  # pyenv's stand-ins for versions that are not active
            continue
        if said.split() == version.split("."):
            return found
    return None


def tried(python: Path, wheel: Path, folder: Path) -> str:
    """Install the wheel for this Python and tune a simulated drop with it; what was found.

    Raises:
        StepError: at the first step that fails.
    """
    start = time.perf_counter()
    run(python, "-m", "venv", folder / "venv", folder=folder)
    programs = folder / "venv" / "bin"
    run(
        *(programs / "python", "-m", "pip", "install", "--only-binary=:all:", "--no-compile"),
        *("--retries=1", "--constraint", ROOT / "constraints.txt", wheel),
        folder=folder,
    )
    installed = time.perf_counter()
    work = folder / "work"
    work.mkdir()
    for line in COMMANDS:
        name, *words = line.split()
        run(programs / name, *words, folder=work)
    missing = [name for name in WRITTEN if not (work / name).is_file()]
    if missing:
        raise StepError(f"not written: {', '.join(missing)}")
    tuning = json.loads((work / "drop.json").read_text())
    found = tuning["parameters"]["restitution"]["value"]
    if tuning["verdict"] != "ok" or abs(found - RESTITUTION) > TOLERANCE:
        raise StepError(f"{tuning['verdict']}, restitution {found} instead of {RESTITUTION}")
    versions = run(programs / "python", "-c", VERSIONS, folder=work).strip()
    return (
        f"OK, {versions}, {tuning['provenance']['engine']}: restitution {found:.4f}; "
        f"installed in {installed - start:.0f} s, ran in {time.perf_counter() - installed:.0f} s"
    )


def outcome(version: str, wheel: Path, folder: Path) -> tuple[bool, str]:
    """Whether nothing failed with this Python, and what is to be said of it."""
    python = interpreter(version)
    if python is None:
        return True, f"skipped, no python{version} on this machine"
    try:
        return True, tried(python, wheel, folder)
    except StepError as error:
        if any(words in str(error) for words in NO_NETWORK):
            return True, "skipped, its packages cannot be fetched (no network?)"
        return False, f"FAILED: {error}"


def main() -> int:
    """Try every other Python, all at once; 1 where one fails."""
    own = "{}.{}".format(*sys.version_info)
    versions = [version for version in PYTHONS if version != own]
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor() as pool:
        wheel = built_wheel(Path(name))
        folders = [Path(name) / version for version in versions]
        for folder in folders:
            folder.mkdir()
        outcomes = pool.map(outcome, versions, repeat(wheel), folders)
        passed = []
        for version, (good, said) in zip(versions, outcomes, strict=True):
            print(f"smoke {version}: {said}", flush=True)
            passed.append(good)
    return 0 if all(passed) else 1


if __name__ == "__main__":
    sys.exit(main())
