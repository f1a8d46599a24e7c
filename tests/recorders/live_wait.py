"""How a live test waits: for what it depends on, never for a time."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

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
