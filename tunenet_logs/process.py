"""Start a command, keep its streams, and stop it by a signal.

`start` is the first of every command: from here on, all that it says is its own. A signal ends it
with one line, libraries say nothing, and no reader that goes away breaks off the work. This imports
the standard library alone, to come early; the command's module, with NumPy and all else, follows.
At work (`stoppable`), a signal raises `Stopped`, which unwinds as Ctrl-C does.
"""

from __future__ import annotations

import atexit
import math
import os
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import BufferedWriter, FileIO, TextIOWrapper
from types import CodeType, FrameType

TYPE_CHECKING = False  # `typing` costs a tenth of the start
if TYPE_CHECKING:
    import subprocess
    from typing import Any, TypeVar

    from _typeshed import ReadableBuffer

    F = TypeVar("F", bound=Callable[..., Any])

# What a command says when the signal ended it; its exit code is then 128 and the signal's number.
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
    # No closed pipe, full disk or missing stream (`>&-`) breaks off the work: a descriptor that is
    # missing would be given to the first file that is opened.
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
    atexit.register(_ignore)  # the first one is called last: the work is done, and said
    if "--debug" not in sys.argv:
        silence_libraries()
    from importlib import import_module

    return import_module(module).main()


class _Lasting(FileIO):
    """Standard stream that accepts all that is written, even if nobody reads it."""

    # why something could not be written: a full disk; not a reader that went away, as `head` does:
    # who closes a pipe wants no more of it
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


# ---- Stopping: SIGINT, SIGTERM and SIGHUP raise an exception that unwinds the command

_AGAIN_S = 0.02  # until a signal that came at a bad moment is tried again
# Callbacks of libraries, which would print what is raised there, and go on.
_called_by_c: set[CodeType] = set()


def heard_wait(wait: Callable[[float], object], seconds: float = math.inf) -> bool:
    """Wait by `wait(seconds)` until that is true, at most so long; return whether it was.

    In short pieces: a signal that comes right before a wait begins is heard only when it ends.
    """
    until = time.monotonic() + seconds
    while not wait(max(0.0, min(0.5, until - time.monotonic()))):
        if time.monotonic() >= until:
            return False
    return True


def end_child(child: subprocess.Popen[bytes]) -> None:
    """Kill a child process, close its pipes and reap it."""
    child.kill()
    for stream in (child.stdin, child.stdout):
        if stream is not None:
            with suppress(OSError):
                stream.close()
    child.wait()


def called_by_c(function: F) -> F:
    """Mark a callback of C: a signal waits for it, and it is to return where `is_stopping()`."""
    _called_by_c.add(function.__code__)
    return function


def is_stopping() -> bool:
    """Check whether a deferred signal is pending."""
    return bool(_stops.waits)


def stop_now() -> None:
    """Raise the pending signal, if any: what its library gave back may not be whole."""
    if _stops.waits:
        _stops.stop(_stops.waits, sys._getframe())


class Stopped(KeyboardInterrupt):
    """Signal, by its number, that unwinds as Ctrl-C does: nothing half written is left."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


class _Stops:
    """State of signals in this process: they reach its main thread, one at a time."""

    def __init__(self) -> None:
        self.held = 0
        self.first = 0
        self.waits = 0

    def stop(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        if self.first and number != signal.SIGINT:
            return  # a second one must not break off what the first one cleans up
        where = _holds(frame)
        if self.held or where:
            self.try_again(number, where or _AGAIN_S)
            return
        import threading

        self.first, self.waits = number, 0
        threading.excepthook = lambda _: None  # a pool's, whose workers are gone
        # Terminate pool workers, which would else do all the work that waits before the end.
        pool = sys.modules.get("multiprocessing")
        for worker in pool.active_children() if pool else ():
            worker.terminate()
        raise Stopped(number)

    def try_again(self, number: int, after_s: float = _AGAIN_S) -> None:
        """Retry in a moment by an alarm; a thread to wait in could need a lock that is held."""
        self.waits = number
        signal.signal(signal.SIGALRM, lambda _, frame: self.stop(number, frame))
        signal.setitimer(signal.ITIMER_REAL, after_s)


_stops = _Stops()


@contextmanager
def stoppable() -> Iterator[None]:
    """Let signals raise `Stopped` where they would kill; another's handler stays."""
    import threading

    usual = (signal.SIG_DFL, signal.default_int_handler, end_at_once)
    before = {number: signal.getsignal(number) for number in WORDS}
    ours = [number for number, handler in before.items() if handler in usual]
    if threading.current_thread() is not threading.main_thread() or not ours:
        yield
        return
    hooks, alarm = (threading.excepthook, sys.unraisablehook), signal.getsignal(signal.SIGALRM)

    def unraisable(told: sys.UnraisableHookArgs) -> None:
        # Raised in a destructor or in a callback from C, it would end there, printed.
        if isinstance(told.exc_value, Stopped):
            _stops.first = 0
            _stops.try_again(told.exc_value.number)
        else:
            hooks[1](told)

    _stops.first = _stops.waits = 0
    sys.unraisablehook = unraisable
    for number in ours:
        signal.signal(number, _stops.stop)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, before[number])
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, alarm)
        threading.excepthook, sys.unraisablehook = hooks


@contextmanager
def signals_held() -> Iterator[None]:
    """Hold signals until what is started in the block has started.

    A process that was half started when its parent let go of it would say so in many lines. What
    starts here never sees Ctrl-C or the end of its terminal: this process does, and ends it.
    """
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    _stops.held += 1
    try:
        yield
    finally:
        _stops.held -= 1
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


def _holds(frame: FrameType | None) -> float:
    """Return the seconds for which a signal has to wait; 0 if it may be raised now.

    Where a module is being imported C code prints exceptions, or takes them for others; nothing is
    half written by an import, and none takes long. What a library calls is the same. Cython runs
    code of a dotted name to add its own place to a traceback, and loses what is raised there.
    """
    while frame is not None:
        if frame.f_code in _called_by_c or "." in frame.f_code.co_name:
            return 0.001  # such a callback is to return at once
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return _AGAIN_S
        frame = frame.f_back
    return 0.0
