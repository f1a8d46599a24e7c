"""Stop a command on SIGINT, SIGTERM or SIGHUP by an exception that unwinds it."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import CodeType, FrameType
from typing import TYPE_CHECKING, Any, TypeVar

from tunenet_logs.starting import WORDS, end_at_once

if TYPE_CHECKING:
    import subprocess

# Until a signal that came at a bad moment is tried again; and in what a library calls, which is to
# return at once.
_AGAIN_S, _CALLED_AGAIN_S = 0.02, 0.001

# Functions that libraries call, which would print what is raised there, and go on.
_called_by_c: set[CodeType] = set()

F = TypeVar("F", bound=Callable[..., Any])


def end_child(child: subprocess.Popen[bytes]) -> None:
    """Kill a child process, close its pipes and reap it."""
    child.kill()
    for stream in (child.stdin, child.stdout):
        if stream is not None:
            with suppress(OSError):
                stream.close()
    child.wait()


def called_by_c(function: F) -> F:
    """Mark a callback of a C library: a signal in it waits until the library returns.

    Where `is_stopping()`, it is to return what ends the library's work.
    """
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
    """Signal that unwinds as Ctrl-C does, so that nothing half written is left.

    Attributes:
        number: of the signal.
    """

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
        self.first, self.waits = number, 0
        threading.excepthook = lambda _: None  # a pool's, whose workers are gone
        _end_workers()
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
    half written by an import, and none takes long. What a library calls is the same.
    """
    while frame is not None:
        if frame.f_code in _called_by_c:
            return _CALLED_AGAIN_S
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return _AGAIN_S
        frame = frame.f_back
    return 0.0


def _end_workers() -> None:
    """Terminate pool workers, which would else do all the work that waits before the end."""
    pool = sys.modules.get("multiprocessing")
    for worker in pool.active_children() if pool else ():
        worker.terminate()
