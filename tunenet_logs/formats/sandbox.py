"""Run functions on untrusted data in a child process, under limits of CPU time, memory and output.

A library that crashes on a damaged file, allocates what the file claims or never ends takes the
child with it, not the command: its caller gets one `SandboxError`. Words come back as JSON, arrays
as their bytes, with sizes checked before they are read; nothing is unpickled.

Such a function is a generator of a module that imports little, so that the child starts quickly; it
yields `words, arrays`, and raises `Refusal` of an intact file that it does not read.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
from contextlib import suppress
from math import prod

TYPE_CHECKING = False  # the child imports as little as it can
if TYPE_CHECKING:
    import subprocess
    from collections.abc import Callable, Iterator, Mapping
    from typing import IO, Any, Self

    from numpy.typing import NDArray

    Arrays = Mapping[str, NDArray[Any]]
    Answer = tuple[Any, dict[str, NDArray[Any]]]
    Function = Callable[..., Iterator[tuple[Any, Arrays]]]

MEMORY_BYTES = 450 * 1024**2  # beyond what the libraries themselves have
CPU_S = 9  # of one request
_WALL_S = 60.0  # of a child: it may wait for its disk
_OUTPUT_BYTES = 512 * 1024**2  # of one answer
_MAX_LINE = 128 * 1024**2  # bytes of an answer's words
# A child's libraries have one thread each, and load no plugins that are installed for HDF5.
_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MALLOC_ARENA_MAX": "2",
    "HDF5_PLUGIN_PRELOAD": "::",
    "MUJOCO_GL": "disable",  # nothing is drawn
}
# What the child runs: from the same folder as its parent, by compiled modules.
_IN_ROOT = "/tunenet_logs/formats/sandbox.py"
_SCRIPT = (
    "import sys; sys.path[:0] = {sys.argv[1]}.difference(sys.path); "
    f"from {__name__} import serve; serve()"
)


class Refusal(ValueError):  # noqa: N818 (no error of the program)
    """Why an intact file is not read, and a remedy if there is one."""


class SandboxError(ValueError):
    """Why a sandbox gave no answer, in words.

    `kind` is "refused" by the function, "damaged" by what a library raised (`said`, of type
    `raised`), "memory", "time" or "crash"; `code` that of the signal or exit of a child that ended.
    """

    def __init__(
        self, kind: str, said: str = "", raised: str = "", remedy: str = "", code: int = 0
    ) -> None:
        words = {
            "refused": said,
            "damaged": f"it is damaged ({' '.join(said.split())[:160] or raised})",
            "memory": "it claims more memory than any log needs",
        }
        ended = "it is damaged, or takes more memory or time than any log"
        super().__init__(words.get(kind, ended))
        self.kind, self.said, self.raised, self.remedy, self.code = kind, said, raised, remedy, code


class Sandbox:
    """A child process; it starts at the first request, and ends with this object or an error.

    It imports `libraries` before its memory is limited, beyond what these have; `cpu_s` is of each
    request, `wall_s` until it is killed; `environment` comes beside the command's own.
    """

    def __init__(
        self,
        *libraries: str,
        memory_bytes: int | None = MEMORY_BYTES,
        cpu_s: int | None = CPU_S,
        wall_s: float | None = _WALL_S,
        environment: Mapping[str, str] = _ENVIRONMENT,
        folder: str | None = None,
    ) -> None:
        self._request = {"libraries": libraries, "memory_bytes": memory_bytes, "cpu_s": cpu_s}
        self._wall_s = wall_s
        self._environment, self._folder = environment, folder
        self._child: subprocess.Popen[bytes] | None = None
        self._end: Callable[[], object] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def is_running(self) -> bool:
        """Whether the child still has what earlier requests left in it."""
        return self._child is not None

    def answers(
        self, function: Function, *arguments: Any, arrays: Arrays | None = None
    ) -> Iterator[Answer]:
        """Yield what a function of a module yields in the child, or raise SandboxError."""
        words = {**self._request, "module": function.__module__, "function": function.__name__}
        try:
            child = self._child or self._started()
            assert child.stdin is not None
            assert child.stdout is not None
            with suppress(BrokenPipeError):  # how it ended says why
                _send(child.stdin, {**words, "arguments": arguments}, arrays or {})
            while (answer := _received(child.stdout, _OUTPUT_BYTES)) is not None:
                found, made = answer
                if "error" in found:
                    raise SandboxError(**found["error"])
                if "end" in found:
                    return
                yield found["words"], made
            for stream in (child.stdin, child.stdout):  # it may still have much to say
                with suppress(BrokenPipeError):
                    stream.close()
            code = child.wait()
            is_slow = -code in (signal.SIGKILL, signal.SIGXCPU, signal.SIGPROF)
            raise SandboxError("time" if is_slow else "crash", code=code)
        except BaseException:  # Ctrl-C, too: what it works on is wanted no more
            self.close()
            raise

    def ask(self, function: Function, *arguments: Any, arrays: Arrays | None = None) -> Answer:
        """Return the one thing that a function yields; see `answers`."""
        (answer,) = self.answers(function, *arguments, arrays=arrays)
        return answer

    def close(self) -> None:
        """End the child; the next request starts another."""
        if self._end is not None:
            self._end()
        self._child = self._end = None

    def _started(self) -> subprocess.Popen[bytes]:
        import subprocess
        import weakref
        from threading import Timer

        from tunenet_logs.process import signals_held

        with signals_held():
            child = subprocess.Popen(  # noqa: S603 (our own script, without a shell)
                [sys.executable, "-P", "-c", _SCRIPT, __file__.removesuffix(_IN_ROOT)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                cwd=self._folder,
                env={**os.environ, **self._environment},
            )
        timer = Timer(self._wall_s or 0, child.kill)
        timer.daemon = True
        if self._wall_s is not None:
            timer.start()
        self._child, self._end = child, weakref.finalize(self, _ended, child, timer.cancel)
        return child


def _ended(child: subprocess.Popen[bytes], stop_timer: Callable[[], object]) -> None:
    from tunenet_logs.process import end_child

    stop_timer()
    end_child(child)


def _send(stream: IO[bytes], words: Mapping[str, Any], arrays: Arrays) -> None:
    heads = [(name, one.dtype.str, one.shape) for name, one in arrays.items()]
    stream.write(json.dumps({**words, "arrays": heads}).encode() + b"\n")
    for one in arrays.values():
        stream.write(one.tobytes())
    stream.flush()


def _received(stream: IO[bytes], most_bytes: int) -> Answer | None:
    """Read words and arrays; None where the other side ended, or says more than it may."""
    line = stream.readline(_MAX_LINE)
    if not line.endswith(b"\n"):
        return None
    try:
        words: Any = json.loads(line)
        arrays: dict[str, NDArray[Any]] = {}
        for name, kind, shape in words["arrays"]:
            import numpy as np

            dtype = np.dtype(kind)
            size = dtype.itemsize * prod(shape)
            if dtype.hasobject or min(shape, default=0) < 0 or size > most_bytes:
                return None
            most_bytes -= size
            arrays[name] = np.frombuffer(stream.read(size), dtype).reshape(shape)  # or it is cut
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    return words, arrays


# ---- In the child.


def limit(memory_bytes: int | None = None, cpu_s: int | None = None) -> None:
    """Limit this process, softly: memory beyond what is in use, and CPU time from now on."""
    if memory_bytes is not None:
        with suppress(OSError), open("/proc/self/statm") as file:
            used = int(file.read().split()[0]) * resource.getpagesize()
            with suppress(ValueError):  # a user's own limit is lower
                hard = resource.getrlimit(resource.RLIMIT_AS)[1]
                resource.setrlimit(resource.RLIMIT_AS, (used + memory_bytes, hard))
    if cpu_s is not None:
        # From now on: RLIMIT_CPU counts from the process's start by another clock (ticks) than any
        # that can be read, and the two drift apart by seconds in a minute on a shared machine.
        signal.setitimer(signal.ITIMER_PROF, cpu_s + 1)


def serve() -> None:
    """Serve one parent's requests; what libraries print goes nowhere."""
    from importlib import import_module

    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGPROF, signal.SIG_DFL)  # ends it
    while (request := _received(sys.stdin.buffer, sys.maxsize)) is not None:
        words, arrays = request
        try:
            function = getattr(import_module(words["module"]), words["function"])
            for library in words["libraries"]:
                import_module(library)
            limit(words["memory_bytes"], words["cpu_s"])
            given = {"arrays": arrays} if arrays else {}
            for found, made in function(*words["arguments"], **given):
                _send(answers, {"words": found}, made)
            said: dict[str, Any] = {"end": True}
        except BaseException as error:  # noqa: BLE001 (a panic of Rust is no Exception)
            kind = "damaged"
            if isinstance(error, MemoryError | Refusal):
                kind = "memory" if isinstance(error, MemoryError) else "refused"
            what, remedy = (*error.args, "", "")[:2] if kind == "refused" else (str(error), "")
            raised = type(error).__name__
            about = {"kind": kind, "said": what[:2000], "raised": raised, "remedy": remedy}
            said = {"error": about}
        _send(answers, said, {})
