"""Run the commands, each in a process of its own, for `tests.bench.promises`.

They are those of `pyproject.toml`, so that nothing here depends on how the inside is cut.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.clips import clicks, write_clip
from tests.recorders.films import film

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS: dict[str, str] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
JOBS = 2  # commands at a time
_START = "import sys; sys.argv[0] = {name!r}; from {module} import {call}; sys.exit({call}())"
_TOLD = {
    "PYTHONPATH": str(ROOT), "COLUMNS": "100", "LC_ALL": "C.UTF-8", "TZ": "UTC",
    "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
}  # fmt: skip
_MAX_S = 120


@dataclass(frozen=True)
class Ran:
    """What a command did in a folder."""

    code: int  # its exit code
    out: str  # what it said, the folder called DIR
    err: str  # likewise


def ran(words: Sequence[str], folder: Path, stdin: bytes = b"") -> Ran:
    """Run a command by its name, in a process of its own."""
    module, call = SCRIPTS[words[0]].split(":")
    code = _START.format(name=words[0], module=module, call=call)
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, *words[1:]], cwd=folder, env={**os.environ, **_TOLD},
        input=stdin, capture_output=True, timeout=_MAX_S, check=False,
    )  # fmt: skip
    out, err = (one.decode().replace(str(folder), "DIR") for one in (done.stdout, done.stderr))
    return Ran(done.returncode, out, err)


def digest(data: bytes) -> str:
    """Return the SHA-256."""
    return hashlib.sha256(data).hexdigest()


def make_clips(folder: Path) -> None:
    """Write a film with sound, one without, one for a pipe, a sound, and silence."""
    write_clip(folder / "clip.mp4", clicks([0.2, 0.9]), "aac", film="libx264", pictures=60)
    write_clip(folder / "clicks.wav", clicks([0.2, 0.9, 1.6]), "pcm_s16le")
    write_clip(folder / "silent.wav", np.zeros(48_000, np.float32), "pcm_s16le")
    for name, kind in (("film.mp4", "mp4"), ("film.mkv", "matroska")):
        (folder / name).write_bytes(film(kind))
