"""Start every command: from here on, all that it says is its own.

A signal ends it with one line, libraries say nothing, and no reader that goes away breaks off the
work. This imports next to nothing, so that these lines come as early as Python allows. The
command's own module, with NumPy and all else that it needs, is imported after them.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BufferedWriter, FileIO, TextIOWrapper
from types import FrameType

TYPE_CHECKING = False  # `typing` costs a tenth of the start
if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

# What a command says when the signal ended it; its exit code is then 128 and the signal's number.
#
# One that is ignored when the command starts stays so: by `nohup`, and by a shell's `&`.
WORDS: dict[int, str] = {
    signal.SIGINT: "interrupted",
    signal.SIGTERM: "terminated",
    signal.SIGHUP: "hung up",
}

_prog = "tunenet"  # the command's name
_spoken = 2  # the file descriptor of the standard error that this command was given


def start(prog: str, module: str) -> int:
    """Run the command `prog`, which is `main` of `module`, and return its exit code."""
    global _prog  # noqa: PLW0603 (a process is one command)
    _prog = prog
    for number in WORDS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, end_at_once)
    keep_streams()
    atexit.register(_ignore)  # the first one is called last: the work is done, and said
    if "--debug" not in sys.argv:
        silence_libraries()
    from importlib import import_module

    return import_module(module).main()


class _Lasting(FileIO):
    """Standard stream that accepts all that is written, even if nobody reads it.

    Attributes:
        failure: why something could not be written: a full disk; not a reader that went away, as
            `head` does: who closes a pipe wants no more of it.
    """

    failure: OSError | None = None

    def write(self, data: ReadableBuffer, /) -> int:
        """Write what can be written; the rest counts as written."""
        try:
            return super().write(data)
        except BrokenPipeError:
            pass
        except OSError as error:
            self.failure = self.failure or error
        return memoryview(data).nbytes


def keep_streams() -> None:
    """Let no closed pipe, full disk or missing stream (`>&-`) break off the work.

    A descriptor that is missing would be given to the first file that is opened.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    for name, descriptor in (("stdout", 1), ("stderr", 2)):
        stream = getattr(sys, name)
        unbuffered = descriptor == 2 or getattr(stream, "write_through", False)
        encoding = getattr(stream, "encoding", "utf-8")
        setattr(sys, name, _lasting(descriptor, encoding, unbuffered=unbuffered))


def lost_output() -> str:
    """Return why standard output is incomplete; "" where it is whole, or its reader left."""
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    failure = raw.failure if isinstance(raw, _Lasting) else None
    return "" if failure is None else failure.strerror or str(failure)


def _lasting(descriptor: int, encoding: str, *, unbuffered: bool) -> TextIOWrapper:
    raw = _Lasting(descriptor, "w", closefd=False)
    by_line = unbuffered or raw.isatty()
    return TextIOWrapper(BufferedWriter(raw), encoding, "backslashreplace", line_buffering=by_line)


def silence_libraries() -> None:
    """Silence native libraries: keep standard error for this process alone.

    libjpeg, libpng, FFmpeg, Bullet and others write to file descriptor 2 whatever they are told,
    hundreds of lines for a damaged video. Python's standard error gets a descriptor of its own, and
    theirs leads nowhere: set once, it costs nothing and no thread can meet it half done.
    """
    global _spoken  # noqa: PLW0603 (a process has one)
    if is_silent():
        return
    sys.stderr.flush()
    _spoken = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)
    sys.stderr = _lasting(_spoken, sys.stderr.encoding, unbuffered=True)
    if not sys.warnoptions:
        warnings.simplefilter("ignore")


def is_silent() -> bool:
    """Check whether `silence_libraries` was called."""
    return _spoken != 2


@contextmanager
def heard() -> Iterator[None]:
    """Open this command's standard error to what is started in the block."""
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
    """End the process from a signal handler, while it only imports or has done its work."""
    _ignore()
    with suppress(OSError):
        os.write(_spoken, f"{_prog}: {WORDS[number]}\n".encode())
    os._exit(128 + number)


def _ignore() -> None:
    for number in WORDS:
        signal.signal(number, signal.SIG_IGN)
