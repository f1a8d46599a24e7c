"""Read video from standard input or a FIFO: any program that writes video is a camera."""

from __future__ import annotations

import os
import select
import socket
import stat
from dataclasses import dataclass

from recorders.deadline import Deadline
from tunenet_logs.errors import CameraError, UsageError

STANDARD_INPUT = "-"  # what stands for it on the command line


class PipeFeed:
    """The bytes that a program writes to a pipe.

    Args:
        descriptor: of the pipe; closed with the feed, but for standard input.
        deadline: of its reads.
    """

    def __init__(self, descriptor: int, deadline: Deadline) -> None:
        self._descriptor = descriptor
        self._deadline = deadline
        self._wakes, self._woken = socket.socketpair()
        deadline.watch(self._wakes)

    def read(self, most: int) -> bytes:
        """See `ByteFeed`."""
        waits_for = [self._descriptor, self._woken]
        ready, _, _ = select.select(waits_for, [], [], self._deadline.next_s())
        if self._woken in ready:
            return b""
        if not ready:
            raise TimeoutError("nothing was written")
        return os.read(self._descriptor, most)

    def close(self) -> None:
        """See `ByteFeed`."""
        self._wakes.close()
        self._woken.close()
        if self._descriptor != 0:
            os.close(self._descriptor)


@dataclass(frozen=True)
class Pipe:
    """An open pipe.

    Attributes:
        is_written_to: whether a program writes to it while it is read; else it is a file.
    """

    descriptor: int
    shown: str
    is_written_to: bool = True


def opened_pipe(text: str) -> Pipe:
    """Open standard input or a FIFO, without waiting for its writer.

    Raises:
        UsageError: nothing is piped into this command.
        CameraError: it cannot be opened.
    """
    if text == STANDARD_INPUT:
        return _standard_input()
    try:
        descriptor = os.open(text, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise CameraError(f"{text}: cannot be read ({error.strerror})") from error
    if not stat.S_ISFIFO(os.fstat(descriptor).st_mode):  # it was exchanged meanwhile
        os.close(descriptor)
        raise CameraError(f"{text}: is no pipe any more; try again")
    return Pipe(descriptor, text)


def _standard_input() -> Pipe:
    try:
        mode = os.fstat(0).st_mode
    except OSError as error:
        raise UsageError(
            "--camera -: standard input is closed; put the program that writes the video before it"
        ) from error
    if os.isatty(0):
        raise UsageError(
            "--camera -: reads a video from standard input, which is a terminal; put the program "
            "that writes it before: gst-launch-1.0 -q ... ! matroskamux ! fdsink | tunenet-record "
            "--camera -"
        )
    return Pipe(0, "standard input", is_written_to=not stat.S_ISREG(mode))
