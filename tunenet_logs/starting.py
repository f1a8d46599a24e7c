"""The first lines of every command: from here on, all that it says is its own.

A signal ends it with one line, and libraries say nothing. This imports next to nothing, so that
these lines come as early as Python allows. The command's own module, with NumPy and all else that
it needs, is imported after them.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

WORDS: dict[int, str] = {
    signal.SIGINT: "interrupted",
    signal.SIGTERM: "terminated",
    signal.SIGHUP: "hung up",
}
"""What a command says when the signal ended it; its exit code is then 128 and the signal's number.

One that is ignored when the command starts stays so: by `nohup`, and by a shell's `&`.
"""

_prog = "tunenet"
"""The command's name."""

_spoken = 2
"""The file descriptor of the standard error that this command was given."""


def start(prog: str, module: str) -> int:
    """Run the command `prog`, which is `main` of `module`; returns its exit code."""
    global _prog  # noqa: PLW0603 (a process is one command)
    _prog = prog
    for number in WORDS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, end_at_once)
    atexit.register(_ignore)  # the first one is called last: the work is done, and said
    if "--debug" not in sys.argv:
        silence_libraries()
    from importlib import import_module

    return import_module(module).main()


def silence_libraries() -> None:
    """Keep standard error for what this process says itself.

    libjpeg, libpng, FFmpeg, Bullet and others write to file descriptor 2 whatever they are told,
    hundreds of lines for a damaged film. Python's standard error gets a descriptor of its own, and
    theirs leads nowhere: set once, it costs nothing and no thread can meet it half done.
    """
    global _spoken  # noqa: PLW0603 (a process has one)
    if is_silent() or sys.stderr is None:
        return
    sys.stderr.flush()
    _spoken = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)
    sys.stderr = open(  # noqa: SIM115 (open as long as the process)
        _spoken, "w", buffering=1, encoding=sys.stderr.encoding, errors="backslashreplace",
        closefd=False,
    )  # fmt: skip
    if not sys.warnoptions:
        warnings.simplefilter("ignore")


def is_silent() -> bool:
    """Whether `silence_libraries` was called."""
    return _spoken != 2


@contextmanager
def heard() -> Iterator[None]:
    """Give what is started here the standard error of this command."""
    if not is_silent():
        yield
        return
    nowhere = os.dup(2)
    os.dup2(_spoken, 2)
    try:
        yield
    finally:
        os.dup2(nowhere, 2)
        os.close(nowhere)


def end_at_once(number: int, _frame: FrameType | None) -> None:
    """End the process: it only imports yet, or has done its work, and leaves nothing half done."""
    _ignore()
    os.write(_spoken, f"{_prog}: {WORDS[number]}\n".encode())
    os._exit(128 + number)


def _ignore() -> None:
    for number in WORDS:
        signal.signal(number, signal.SIG_IGN)
