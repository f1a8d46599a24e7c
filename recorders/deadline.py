"""A deadline for a whole exchange over sockets, however slowly bytes trickle in."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from typing import Any


class Deadline:
    """A time by which the other side must have answered.

    Args:
        silence_s: the longest to wait for the next byte.
        whole_s: the longest to wait for all of it.
    """

    def __init__(self, silence_s: float, whole_s: float) -> None:
        self.silence_s = silence_s
        self._sockets: list[socket.socket] = []
        self._lock = threading.Lock()
        self._is_broken_off = False
        self.renew(whole_s)

    def renew(self, whole_s: float) -> None:
        """Restart the wait."""
        self.whole_s = whole_s
        self._end = time.monotonic() + whole_s

    @property
    def is_over(self) -> bool:
        """Whether the deadline has passed."""
        return time.monotonic() >= self._end

    def next_s(self) -> float:
        """Return how long the next read may take [s].

        Raises:
            TimeoutError: the deadline has passed.
        """
        if self.is_over:
            raise TimeoutError("too late")
        return max(1e-3, min(self.silence_s, self._end - time.monotonic()))

    def watch(self, connected: socket.socket) -> None:
        """Let `break_off` shut this socket down, until it is closed."""
        with self._lock:
            self._sockets = [one for one in self._sockets if one.fileno() >= 0]
            self._sockets.append(connected)
            if self._is_broken_off:
                _shut(connected)

    def break_off(self) -> None:
        """End running reads, from any thread."""
        with self._lock:
            self._is_broken_off = True
            for connected in self._sockets:
                _shut(connected)


def with_deadline(kind: type[socket.socket], deadline: Deadline) -> type[socket.socket]:
    """Make a socket class whose reads share a deadline: a socket's own time-out is per read."""

    class Limited(kind):
        def recv_into(self, *words: Any, **more: Any) -> int:
            self.settimeout(deadline.next_s())
            return super().recv_into(*words, **more)

        def sendall(self, *words: Any, **more: Any) -> None:
            self.settimeout(deadline.silence_s)  # of which all of the call must end
            return super().sendall(*words, **more)

    return Limited


def _shut(connected: socket.socket) -> None:
    with suppress(OSError):  # it is closed already
        socket.socket.shutdown(connected, socket.SHUT_RDWR)  # not TLS's, which is not for threads
