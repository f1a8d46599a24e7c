"""Servers that send given bytes over HTTP and TCP, on the loopback."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from tests.recorders.server_thread import beside


@dataclass(frozen=True)
class Answer:
    """What is sent at a path.

    Attributes:
        kind: its Content-Type; "" for none.
        has_length: whether its length is stated.
    """

    body: bytes = b""
    kind: str = ""
    has_length: bool = False


@contextmanager
def serving(answers: Mapping[str, Answer]) -> Iterator[str]:
    """An HTTP server; its address, without "http://" and without a path."""

    class Handler(BaseHTTPRequestHandler):
        def log_message(self, format: str, *_words: object) -> None:  # noqa: A002
            pass

        def do_GET(self) -> None:
            answer = answers.get(self.path)
            if answer is None:
                self.send_error(404)
                return
            self.send_response(200)
            if answer.kind:
                self.send_header("Content-Type", answer.kind)
            if answer.has_length:
                self.send_header("Content-Length", str(len(answer.body)))
            self.end_headers()
            with suppress(OSError):
                self.wfile.write(answer.body)

    class Server(ThreadingHTTPServer):
        daemon_threads = True

    with beside(Server(("127.0.0.1", 0), Handler)) as place:
        yield place


@contextmanager
def sending_bytes(data: bytes) -> Iterator[str]:
    """A TCP server that sends this to its first caller, then hangs up; its host and port."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with suppress(OSError):
            caller, _ = listener.accept()
            with caller:
                caller.sendall(data)

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield f"127.0.0.1:{listener.getsockname()[1]}"
    finally:
        listener.close()
