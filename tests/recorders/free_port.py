"""A port for a server that is started later, by a program that wants to be told one."""

from __future__ import annotations

import secrets
import socket
from contextlib import suppress


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """One on which nobody listens now.

    It is below those that callers are given, which may take it while its server is away.
    """
    while True:
        port = 20_000 + secrets.randbelow(12_000)
        with suppress(OSError), socket.socket(socket.AF_INET, kind) as one:
            one.bind(("127.0.0.1", port))
            return port
