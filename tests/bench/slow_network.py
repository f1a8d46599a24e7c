"""Delay what is sent between a camera and a recorder, and lose nothing.

`python -m tests.bench.slow_network PORT HOW` passes one connection on to a port of this machine,
and says in a line at which port of its own. What the server sends is held back:

- `jitter`: each piece by up to 40 ms;
- `bursts`: until the next tenth of a second;
- `stall`: for 2 s, once 2 s of it have passed.
"""

from __future__ import annotations

import math
import queue
import random
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

_JITTER_S, _BURST_S = 0.04, 0.1
_STALLS_AT_S, _STALL_S = 2.0, 2.0

# When a piece is passed on that came so long after the first [s].
HOW: dict[str, Callable[[float], float]] = {
    "jitter": lambda since_s: since_s + random.uniform(0, _JITTER_S),
    "bursts": lambda since_s: math.ceil(since_s / _BURST_S) * _BURST_S,
    "stall": lambda since_s: (
        max(since_s, _STALLS_AT_S + _STALL_S) if since_s > _STALLS_AT_S else since_s
    ),
}


@contextmanager
def slowed(address: str, how: str) -> Iterator[str]:
    """Open the same address by way of such a network; as it is where `how` is ""."""
    if not how:
        yield address
        return
    host, _, path = address.partition("/")
    words = [sys.executable, "-m", "tests.bench.slow_network", host.rpartition(":")[2], how]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield f"127.0.0.1:{int(process.stdout.readline())}/{path}"
    finally:
        process.kill()
        process.communicate()


def main() -> None:
    port, how = int(sys.argv[1]), HOW[sys.argv[2]]
    with socket.create_server(("127.0.0.1", 0)) as listener:
        print(listener.getsockname()[1], flush=True)
        caller, _ = listener.accept()
    server = socket.create_connection(("127.0.0.1", port))
    for one in (caller, server):
        one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    threading.Thread(target=_pass_on_at_once, args=(caller, server), daemon=True).start()
    held: queue.SimpleQueue[tuple[float, bytes]] = queue.SimpleQueue()
    threading.Thread(target=_hold_back, args=(server, held, how), daemon=True).start()
    with suppress(OSError):
        while piece := held.get():
            due_s, data = piece
            time.sleep(max(0.0, due_s - time.monotonic()))
            if not data:
                break
            caller.sendall(data)
    caller.close()


def _pass_on_at_once(caller: socket.socket, server: socket.socket) -> None:
    with suppress(OSError):
        while data := caller.recv(65536):
            server.sendall(data)
        server.shutdown(socket.SHUT_WR)


def _hold_back(
    server: socket.socket,
    held: queue.SimpleQueue[tuple[float, bytes]],
    how: Callable[[float], float],
) -> None:
    """Queue what the server sends with its due time; nothing in the end."""
    start_s = time.monotonic()
    data = b"any"
    while data:
        try:
            data = server.recv(65536)
        except OSError:
            data = b""
        held.put((start_s + how(time.monotonic() - start_s), data))


if __name__ == "__main__":
    main()
