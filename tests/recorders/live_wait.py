"""What live tests share: they wait for what they depend on, never for a time."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import secrets
import select
import socket
import struct
import subprocess
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

LAST_RESORT_S = 120.0  # a test that waited so long fails: what it waits for will not come


def wait_until(is_so: Callable[[], object], what: str) -> None:
    """Look again and again until it is so."""
    until = time.monotonic() + LAST_RESORT_S
    while not is_so():
        assert time.monotonic() < until, f"waited in vain: {what}"
        time.sleep(0.005)


@contextmanager
def ending(process: subprocess.Popen[str]) -> Iterator[subprocess.Popen[str]]:
    """See to it that a process is gone afterwards, whatever becomes of the test."""
    with process:
        try:
            yield process
        finally:
            process.kill()


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """A port on which nobody listens now, for a program that wants to be told one.

    It is below those that callers are given, which may take it while its server is away.
    """
    while True:
        port = 20_000 + secrets.randbelow(12_000)
        with suppress(OSError), socket.socket(socket.AF_INET, kind) as one:
            one.bind(("127.0.0.1", port))
            return port


class Terminal:
    """A terminal of 200 columns.

    Attributes:
        theirs: what a process is given to write to.
    """

    def __init__(self) -> None:
        self._ours, self.theirs = pty.openpty()
        fcntl.ioctl(self.theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 200, 0, 0))
        self._shown = ""

    def wait_for(self, pattern: str) -> None:
        """Read what a process shows until that is in it."""
        while not re.search(pattern, self._shown):
            ready, _, _ = select.select([self._ours], [], [], LAST_RESORT_S)
            assert ready, f"waited in vain: {pattern}; shown was {self._shown!r}"
            self._shown += os.read(self._ours, 100_000).decode()

    def close(self) -> None:
        """Take the terminal away."""
        os.close(self.theirs)
        os.close(self._ours)
