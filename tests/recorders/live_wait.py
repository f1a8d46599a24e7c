"""What live tests share: they wait for what they depend on, never for a time."""

from __future__ import annotations

import os
import pty
import re
import secrets
import select
import socket
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

LAST_RESORT_S = 120.0  # a test that waited so long fails: what it waits for will not come


def wait_until(is_so: Callable[[], object], what: str) -> None:
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


@contextmanager
def recorder(
    folder: Path, *words: object, before: tuple[str, ...] = (), **ends: object
) -> Iterator[subprocess.Popen[str]]:
    """`tunenet-record` in a process of its own, to a.mcap of a folder.

    Args:
        before: a command that runs it.
        ends: of the process; stdin, stdout and stderr where they are no pipes.
    """
    every = [*before, Path(sys.executable).with_name("tunenet-record"), *words, "-o", "a.mcap"]
    pipe = subprocess.PIPE
    kept: dict[str, Any] = {"stdin": pipe, "stdout": pipe, "stderr": pipe, **ends}
    with ending(subprocess.Popen([*map(str, every)], cwd=folder, text=True, **kept)) as process:
        yield process


def ended(process: subprocess.Popen[str], number: int = 0, code: int = 0) -> tuple[str, str]:
    """What a recorder said, on stdout and stderr, until it ended with that exit code.

    It is sent a signal before, if the number is one.
    """
    if number:
        process.send_signal(number)
    said = process.communicate(timeout=LAST_RESORT_S)
    assert process.returncode == code, (process.returncode, said)
    return said


def wait_for_pictures(folder: Path) -> None:
    """Until some twenty pictures more are in what is being recorded."""
    active = folder / "a.mcap.active"
    wait_until(active.exists, "a log")
    before = active.stat().st_size
    wait_until(lambda: active.stat().st_size > before + 300_000, "pictures")


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
        termios.tcsetwinsize(self.theirs, (30, 200))
        self._shown = ""

    def wait_for(self, pattern: str) -> None:
        while not re.search(pattern, self._shown):
            ready, _, _ = select.select([self._ours], [], [], LAST_RESORT_S)
            assert ready, f"waited in vain: {pattern}; shown was {self._shown!r}"
            self._shown += os.read(self._ours, 100_000).decode()

    def close(self) -> None:
        os.close(self.theirs)
        os.close(self._ours)
