"""Cameras that mean harm, over real sockets: what they send has no end, or drips."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_DRIP_S = 0.05
"""Between two pieces: far less than any silence that would end the waiting."""

OK = b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n"
UNANNOUNCED = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace\r\n\r\n"
CONTINUE = b"HTTP/1.1 100 Continue\r\n\r\n"
MOVED = b"HTTP/1.1 302 Found\r\nLocation: /again\r\n\r\n"


@contextmanager
def sending(head: bytes, again: bytes, *, drips: bool = False) -> Iterator[str]:
    """A camera that answers all its callers with `head`, and then with `again` without end.

    Args:
        head: at once.
        again: what comes again and again; nothing more comes if it is empty.
        drips: whether there is a moment before each.
    """
    ended = threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))

    def answer(caller: socket.socket) -> None:
        with caller, suppress(OSError):
            caller.recv(65536)
            caller.sendall(head)
            while again and not ended.wait(_DRIP_S if drips else 0):
                caller.sendall(again)

    def serve() -> None:
        with suppress(OSError):
            while True:
                caller, _ = listener.accept()
                threading.Thread(target=answer, args=(caller,), daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}/video"
    finally:
        ended.set()
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()
