"""A model compiled once where it can do no harm, and what MuJoCo says of it as one line."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from recorders.simulators.mujoco.library import mujoco
from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import one_line, short_name

_CHILD = Path(__file__).with_name("model_child.py")

_LONGEST_S = 60.0
"""What the process may last, its start and its waiting counted."""

_LEAST_STEP_S, _MOST_STEP_S = 1e-5, 0.1

_MOST_WORDS = 240
"""Characters of what MuJoCo says."""

_LINES = re.compile(r",? \(?line \d+\)?|, id \d+")
"""Of the text that MuJoCo was given, which is not the user's file; and numbers of elements."""

_WORTHLESS = ("Element name ''", "The static bodies of the spec were fused")
"""Begins of lines that name nothing in the file."""

_REMEDIES = {
    "mass and inertia": "give that body or link a mass and inertias",
    "inertia must": "correct its <inertia>; in a URDF, "
    '<mujoco><compiler balanceinertia="true"/></mujoco> raises what is too small',
    "global coordinates": "save it with MuJoCo 2.3.3 first",
}
"""By what MuJoCo says."""

_FEWER = "take fewer copies (<replicate>, <flexcomp>), smaller meshes or height fields"


@dataclass(frozen=True)
class ModelText:
    """A model as MuJoCo is given it: all its files beside it, by the names in it.

    Attributes:
        xml: the model's.
        models: XML of models that are attached.
        files: meshes and height fields.
    """

    xml: str
    models: dict[str, bytes] = field(default_factory=dict[str, bytes])
    files: dict[str, bytes] = field(default_factory=dict[str, bytes])


def check_compiles(text: ModelText, path: Path) -> None:
    """Compile a model, and step it once, in a process of its own.

    Args:
        text: the model.
        path: its file in errors.

    Raises:
        UsageError: MuJoCo does not compile it within 20 s and 3 GB, or it is beyond what is
            simulated.
    """
    found = _compiled(text, path)
    if "error" in found:
        raise _refused(path, found["error"])
    if found["beyond"]:
        raise UsageError(
            f"{path}: has {found['beyond'][0]}", "keep what moved, and remove the rest"
        )
    if found["infinite"]:
        what = ", ".join(found["infinite"][:4])
        raise UsageError(
            f"{path}: compiles to values that are not finite ({what})",
            "look for sizes and masses that are too large for it",
        )
    step_s = found["timestep_s"]
    if not _LEAST_STEP_S <= step_s <= _MOST_STEP_S:
        raise UsageError(
            f"{path}: has a timestep of {step_s:g} s",
            f"give one of {_LEAST_STEP_S:g} to {_MOST_STEP_S:g} s in <option timestep=...>",
        )


def _compiled(text: ModelText, path: Path) -> Mapping[str, Any]:
    """What the child says."""
    xml = text.xml.encode()
    groups = [{"model": xml}, text.models, text.files]
    lengths = [[(name, len(data)) for name, data in group.items()] for group in groups]
    parts = [data for group in groups for data in group.values()]
    with TemporaryDirectory() as empty:
        try:
            done = subprocess.run(  # noqa: S603 (our own script, without a shell)
                [sys.executable, "-P", str(_CHILD)],
                input=b"".join([json.dumps(lengths).encode(), b"\n", *parts]),
                capture_output=True,
                cwd=empty,  # where MuJoCo leaves its log of warnings
                env={**os.environ, "MALLOC_ARENA_MAX": "2"},
                timeout=_LONGEST_S,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise UsageError(f"{path}: takes MuJoCo over {_LONGEST_S:g} s", _FEWER) from error
    last = done.stdout.decode(errors="replace").rstrip().rpartition("\n")[2]
    if done.returncode == 0 and last.startswith("{"):
        return json.loads(last)
    if -done.returncode in (9, 24):  # SIGKILL, SIGXCPU: the limits
        raise UsageError(f"{path}: takes MuJoCo over 20 s or 3 GB", _FEWER)
    raise UsageError(
        f"{path}: MuJoCo {mujoco().__version__} crashes on it (code {done.returncode})",
        "take parts away until it compiles, to find the one",
    )


def _refused(path: Path, said: str) -> UsageError:
    """The error for what MuJoCo says, its lines made one."""
    if "ould not allocate" in said or "unknown exception" in said:
        return UsageError(f"{path}: takes MuJoCo over 3 GB", _FEWER + ", less <size memory>")
    lines = [line.strip() for line in _LINES.sub("", said).splitlines()]
    kept = [line for line in lines if line and not line.startswith(_WORTHLESS)]
    why = "; ".join(kept).removeprefix("XML ").removeprefix("Error: ").rstrip(".")
    remedies = (remedy for words, remedy in _REMEDIES.items() if words in why)
    return UsageError(
        f"{path}: MuJoCo {mujoco().__version__} does not take it: "
        f"{short_name(one_line(why), _MOST_WORDS)}",
        next(remedies, "correct that in the file"),
    )
