"""Cameras that mean harm, over real sockets: what they send has no end, or drips."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

_DRIP_S = 0.05  # between two pieces: far less than any silence that would end the waiting
OK = b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n"
CONTINUE = b"HTTP/1.1 100 Continue\r\n\r\n"
MOVED = b"HTTP/1.1 302 Found\r\nLocation: /again\r\n\r\n"


@contextmanager
def serving_each(answer: Callable[[socket.socket, threading.Event], None]) -> Iterator[str]:
    """A server; its address without a scheme.

    Args:
        answer: to each caller, until the event; in a thread of its own.
    """
    ended = threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))

    def serve_one(caller: socket.socket) -> None:
        with caller, suppress(OSError):
            answer(caller, ended)

    def serve() -> None:
        with suppress(OSError):
            while True:
                caller, _ = listener.accept()
                threading.Thread(target=serve_one, args=(caller,), daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield f"127.0.0.1:{listener.getsockname()[1]}"
    finally:
        ended.set()
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()


def send_on(caller: socket.socket, again: bytes, ended: threading.Event, *, drips: bool) -> None:
    """Send the same without end; nothing if it is empty."""
    while again and not ended.wait(_DRIP_S if drips else 0):
        caller.sendall(again)


@contextmanager
def sending(head: bytes, again: bytes, *, drips: bool = False) -> Iterator[str]:
    """A camera that answers all its callers with `head`, and then with `again` without end.

    Args:
        head: at once.
        again: what comes again and again; nothing more comes if it is empty.
        drips: whether there is a moment before each.
    """

    def answer(caller: socket.socket, ended: threading.Event) -> None:
        caller.recv(65536)
        caller.sendall(head)
        send_on(caller, again, ended, drips=drips)

    with serving_each(answer) as place:
        yield f"http://{place}/video"
