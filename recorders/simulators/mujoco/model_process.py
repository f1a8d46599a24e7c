"""Run a model in a sandboxed process, and report MuJoCo's errors on one line."""

from __future__ import annotations

import json
import math
import os
import pickle
import re
import signal
import subprocess
import sys
import weakref
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from recorders.simulators.mujoco.library import mujoco
from recorders.simulators.mujoco.model_child import (
    COMPILING_S,
    MAX_ROLLOUT_S,
    MEMORY_BYTES,
    PIECE_S,
)
from tunenet_logs.arrays import Array
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.stopping import end_child, signals_held
from tunenet_logs.terminal import one_line, short_name

_CHILD = Path(__file__).with_name("model_child.py")

_MAX_ANSWER = 1_000_000  # of the line that comes first [bytes]
_MIN_STEP_S, _MAX_STEP_S = 1e-5, 0.1

_MAX_WORDS = 240  # characters of what MuJoCo says
# Of the text that MuJoCo was given, which is not the user's file; and numbers of elements.
_LINES = re.compile(r",? \(?line \d+\)?|, id \d+")

# Begins of lines that name nothing in the file.
_WORTHLESS = ("Element name ''", "The static bodies of the spec were fused")

# By what MuJoCo says.
_REMEDIES = {
    "mass and inertia": "give that body or link a mass and inertias",
    "inertia must": "correct its <inertia>; in a URDF, "
    '<mujoco><compiler balanceinertia="true"/></mujoco> raises what is too small',
    "global coordinates": "save it with MuJoCo 2.3.3 first",
}

_FEWER = (
    "take fewer copies (<replicate>, <flexcomp>), smaller meshes, height fields or textures, fewer "
    "<option iterations>"
)


@dataclass(frozen=True)
class ModelText:
    """A model as passed to MuJoCo, with all its files by name.

    Attributes:
        xml: the model's.
        models: XML of models that are attached.
        files: meshes and height fields.
    """

    xml: str
    models: dict[str, bytes] = field(default_factory=dict[str, bytes])
    files: dict[str, bytes] = field(default_factory=dict[str, bytes])


class ModelProcess:
    """A process, limited in memory and time, that compiles and runs a model.

    It is started when first asked, and ends with this object, an error, or a signal.

    Attributes:
        path: the model's file in errors.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._child: subprocess.Popen[bytes] | None = None
        self._end: Callable[[], object] | None = None
        self._loaded: Any = None

    def check_compiles(self, text: ModelText) -> None:
        """Compile a model, and step it once.

        Raises:
            UsageError: MuJoCo does not compile it within 10 s and 400 MB, more with large files, or
                it exceeds the size limits.
        """
        path, xml = self.path, text.xml.encode()
        found, _ = self._ask("compile", xml=xml, models=text.models, files=text.files)
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
        if not _MIN_STEP_S <= step_s <= _MAX_STEP_S:
            raise UsageError(
                f"{path}: has a timestep of {step_s:g} s",
                f"give one of {_MIN_STEP_S:g} to {_MAX_STEP_S:g} s in <option timestep=...>",
            )

    def run(self, model: Any, **wishes: Any) -> tuple[list[int], list[str], dict[str, Array]]:
        """Roll out a compiled model; see `model_child`.

        Returns:
            Of each rollout, the number of steps, and what stopped it early: "" or MuJoCo's name of
            it; and arrays of all.

        Raises:
            LogError: one of them takes too much time or memory, or crashes.
        """
        try:
            if self._loaded is not model or self._child is None:
                self._ask("load", model=model)
                self._loaded = model
            found, arrays = self._ask("run", **wishes)
        except UsageError as error:  # another log may be simulated well
            raise LogError(error.what, error.remedy) from error
        return found["kept"], found["why"], arrays

    def _ask(self, kind: str, **arguments: Any) -> tuple[dict[str, Any], dict[str, Array]]:
        """Send a request to the child; return its answer."""
        try:
            child = self._child or self._started()
            assert child.stdin is not None
            assert child.stdout is not None
            with suppress(BrokenPipeError):  # how it ended says why
                pickle.dump((kind, arguments), child.stdin, pickle.HIGHEST_PROTOCOL)
                child.stdin.flush()
            line = child.stdout.readline(_MAX_ANSWER)
            if not line.endswith(b"\n"):
                raise self._ended(child.wait())
            found, arrays = json.loads(line), {}
            for name, shape in found["arrays"].items():
                data = child.stdout.read(8 * math.prod(shape))
                if len(data) < 8 * math.prod(shape):
                    raise self._ended(child.wait())
                arrays[name] = np.frombuffer(data).reshape(shape)
        except BaseException:  # Ctrl-C, too: what it works on is wanted no more
            self.close()
            raise
        if "error" in found:
            self.close()
            raise _refused(self.path, found["error"])
        return found, arrays

    def _started(self) -> subprocess.Popen[bytes]:
        empty = TemporaryDirectory()  # where MuJoCo leaves its log of warnings
        with signals_held():
            child = subprocess.Popen(  # noqa: S603 (our own script, without a shell)
                [sys.executable, "-P", str(_CHILD)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                cwd=empty.name,
                env={**os.environ, "MALLOC_ARENA_MAX": "2"},
            )
        self._child, self._end = child, weakref.finalize(self, _end, child, empty)
        return child

    def close(self) -> None:
        """End the process; the next request starts another."""
        if self._end is not None:
            self._end()
        self._child = self._end = self._loaded = None

    def _ended(self, code: int) -> UsageError:
        """Make the error of a process that ended."""
        if -code in (signal.SIGKILL, signal.SIGXCPU):  # the limits
            limit = COMPILING_S if self._loaded is None else PIECE_S
            return UsageError(f"{self.path}: takes MuJoCo over {limit} s at once", _FEWER)
        return UsageError(
            f"{self.path}: MuJoCo {mujoco().__version__} crashes on it (code {code})",
            "take parts away until it runs, to find the one",
        )


def _end(child: subprocess.Popen[bytes], folder: TemporaryDirectory[str]) -> None:
    end_child(child)
    folder.cleanup()


def _refused(path: Path, said: str) -> UsageError:
    """Make the error for what MuJoCo says, on one line."""
    if "ould not allocate" in said or "unknown exception" in said:
        return UsageError(
            f"{path}: takes MuJoCo over {MEMORY_BYTES // 1_000_000} MB",
            _FEWER + ", less <size memory>",
        )
    if said.startswith("slow"):
        return UsageError(
            f"{path}: one rollout would take MuJoCo {said.removeprefix('slow: ')}, over the limit "
            f"of {MAX_ROLLOUT_S:g} s",
            "choose a part of the log with --start and --end, a longer <option timestep>, fewer "
            "<option iterations>, or touch less",
        )
    lines = [line.strip() for line in _LINES.sub("", said).splitlines()]
    kept = [line for line in lines if line and not line.startswith(_WORTHLESS)]
    why = "; ".join(kept).removeprefix("XML ").removeprefix("Error: ").rstrip(".")
    remedies = (remedy for words, remedy in _REMEDIES.items() if words in why)
    return UsageError(
        f"{path}: MuJoCo {mujoco().__version__} does not take it: "
        f"{short_name(one_line(why), _MAX_WORDS)}",
        next(remedies, "correct that in the file"),
    )
