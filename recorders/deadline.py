"""A time by which the other side of a connection has delivered, however many bytes drip."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from typing import Any


class Deadline:
    """When what is asked of the other side must be there.

    Args:
        silence_s: the longest to wait for the next byte.
        whole_s: the longest to wait for all of it.
    """

    def __init__(self, silence_s: float, whole_s: float) -> None:
        self.silence_s = silence_s
        self._sockets: list[socket.socket] = []
        self._lock = threading.Lock()
        self._broken_off = threading.Event()
        self.renew(whole_s)

    def renew(self, whole_s: float) -> None:
        """Begin to wait anew."""
        self.whole_s = whole_s
        self._end = time.monotonic() + whole_s

    @property
    def is_over(self) -> bool:
        """Whether all of it should be there by now."""
        return time.monotonic() >= self._end

    def next_s(self) -> float:
        """How long the next read may take [s].

        Raises:
            TimeoutError: it is too late for one.
        """
        if self.is_over:
            raise TimeoutError("too late")
        return max(1e-3, min(self.silence_s, self._end - time.monotonic()))

    def pause(self, seconds: float) -> bool:
        """Wait so long; False where it was broken off.

        Raises:
            TimeoutError: it is too late.
        """
        return not self._broken_off.wait(min(seconds, self.next_s()))

    def watch(self, connected: socket.socket) -> None:
        """Let `break_off` end what waits for this socket, until it is closed."""
        with self._lock:
            self._sockets = [one for one in self._sockets if one.fileno() >= 0]
            self._sockets.append(connected)
            if self._broken_off.is_set():
                _shut(connected)

    def break_off(self) -> None:
        """End running reads, from any thread."""
        with self._lock:
            self._broken_off.set()
            for connected in self._sockets:
                _shut(connected)


def with_deadline(kind: type[socket.socket], deadline: Deadline) -> type[socket.socket]:
    """A kind of socket that reads until then: its own time-out is for each of its reads alone."""

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
