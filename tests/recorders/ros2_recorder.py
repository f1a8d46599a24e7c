"""`tunenet-record --joint-states` in a process of its own, and a domain that nobody else has."""

from __future__ import annotations

import itertools
import socket
import subprocess
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

from tests.conftest import BIN
from tests.recorders.live_wait import LAST_RESORT_S, ending

_numbers = itertools.cycle(range(1, 101))


@contextmanager
def free_domain() -> Iterator[int]:
    """A domain that nobody else on this machine has who asks here.

    Beside its UDP ports, TCP has the same numbers: whoever holds the first has the domain. Those of
    domains over 100 are given to anybody who connects.
    """
    for number in itertools.islice(_numbers, 100):
        with socket.socket() as claim, suppress(OSError):
            claim.bind(("127.0.0.1", 7400 + 250 * number))
            yield number
            return
    raise AssertionError("every domain is taken")


def recorder(
    domain: int, folder: Path, *options: object, stderr: int = subprocess.PIPE
) -> AbstractContextManager[subprocess.Popen[str]]:
    """The command in a process of its own, recording a.mcap on the loopback interface."""
    words = [BIN / "tunenet-record", "--loopback", "--domain", domain, "-o", "a.mcap"]
    words += ["--timeout", LAST_RESORT_S, *options]
    return ending(
        subprocess.Popen(
            [str(one) for one in words],
            cwd=folder, text=True, stdout=subprocess.PIPE, stderr=stderr,
        )
    )  # fmt: skip


def ended(process: subprocess.Popen[str], number: int = 0) -> tuple[str, str]:
    """What a recorder said, on stdout and stderr; sends it a signal before, if that is one."""
    if number:
        process.send_signal(number)
    said = process.communicate(timeout=LAST_RESORT_S)
    assert process.returncode == 0, said
    return said
