"""Serve a web page that this machine alone can open."""

from __future__ import annotations

import json
import math
import secrets
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from hmac import compare_digest
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Protocol

from recorders.deadline import Deadline, with_deadline

_MAX_BODY_BYTES = 1024  # of a request: the page sends a few numbers
# Of a body that is too long: with less taken, the sender might not hear the answer.
_DRAINED_BYTES = 64 * 1024

# For all of a request, and for a viewer to take what it is sent: beyond that, it is gone.
_REQUEST_SECONDS = 10.0

# At the same time; a page needs three. Others are turned away, so that no threads pile up.
_MAX_VIEWERS = 32

# In a page's address: other users of this machine can connect, but cannot guess it.
_SECRET_BYTES = 16

# Between two looks whether the server is to end: closing it waits for the next one.
_LOOK_SECONDS = 0.1

# Of every answer: nothing is kept, and no other page can show, load or feed this one.
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; img-src 'self'; connect-src 'self'; "
    "style-src 'unsafe-inline'; script-src 'unsafe-inline'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}


@dataclass(frozen=True)
class Answer:
    """A response to a request.

    Attributes:
        code: HTTP status.
        kind: content type; "" for an answer without a body.
        body: whole, or part after part for as long as the viewer stays.
        then: called once the answer is sent: an end of the process takes the page with it.
    """

    code: int = 204
    kind: str = ""
    body: bytes | Iterator[bytes] = b""
    then: Callable[[], object] | None = None


_NO_PAGE = Answer(404, "text/plain", b"no such page\n")


class Site(Protocol):
    """What a page shows and accepts; called from several threads at once."""

    def get(self, path: str) -> Answer | None:
        """Answer a GET; None where there is no such page."""
        ...

    def post(self, path: str, body: Mapping[str, Any]) -> Answer | None:
        """Answer a POST with a JSON object; None for an invalid request."""
        ...


class LoopbackPage:
    """A server of a site on 127.0.0.1 alone, at a free port, until `close`.

    Attributes:
        url: contains a secret that others on this machine cannot guess.
    """

    def __init__(self, site: Site) -> None:
        secret = secrets.token_urlsafe(_SECRET_BYTES)
        handler = type("_BoundHandler", (_Handler,), {"site": site, "secret": secret})
        self._server = _Server(("127.0.0.1", 0), handler)
        port = self._server.server_port
        self.url = f"http://127.0.0.1:{port}/{secret}/"
        handler.hosts = (f"127.0.0.1:{port}", f"localhost:{port}")
        serve = self._server.serve_forever
        threading.Thread(target=serve, args=(_LOOK_SECONDS,), daemon=True).start()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()


def as_json(value: object) -> Answer:
    """Answer with JSON."""
    return Answer(200, "application/json", json.dumps(value).encode())


def place_in(body: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return the finite numbers "x" and "y" of a body; None where one is missing."""
    with suppress(ValueError, KeyError, TypeError, OverflowError):
        x, y = float(body["x"]), float(body["y"])
        return (x, y) if math.isfinite(x) and math.isfinite(y) else None
    return None


class _Server(ThreadingHTTPServer):
    daemon_threads = True  # a viewer does not hold up the end of the command

    def __init__(self, place: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        super().__init__(place, handler)
        self._free = threading.BoundedSemaphore(_MAX_VIEWERS)

    def get_request(self) -> tuple[socket.socket, Any]:
        """Accept a connection, with a deadline for the whole request."""
        caller, place = super().get_request()
        kind = with_deadline(socket.socket, Deadline(_REQUEST_SECONDS, _REQUEST_SECONDS))
        return kind(fileno=caller.detach()), place

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread, unless there are too many."""
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, then free the thread's place."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print nothing: standard error is the command's, and a broken connection no error."""


class _Handler(BaseHTTPRequestHandler):
    site: Site
    secret: str
    hosts: tuple[str, ...]

    def log_message(self, format: str, *_words: object) -> None:  # noqa: A002
        """Print nothing: standard error is the command's."""

    def do_GET(self) -> None:
        """Answer a GET."""
        if (path := self._path()) is not None:
            self._send(self.site.get(path) or _NO_PAGE)

    def do_POST(self) -> None:
        """Answer a POST."""
        if (path := self._path()) is not None:
            nothing = Answer(400, "text/plain", b"that is nothing that can be done here\n")
            body = self._body()
            self._send((None if body is None else self.site.post(path, body)) or nothing)

    def _path(self) -> str | None:
        """Return the path after the secret; None for what was refused.

        Refused are requests from another site's page, be it under a host name of its own, and those
        without the secret.
        """
        origins = [f"http://{host}" for host in self.hosts]
        origin = self.headers.get("Origin")
        if self.headers.get("Host") in self.hosts and origin in (None, *origins):
            _, secret, rest = (*self.path.split("/", 2), "", "")[:3]
            if compare_digest(secret.encode(errors="replace"), self.secret.encode()):
                return f"/{rest}"
            self._send(_NO_PAGE)
            return None
        self._send(Answer(403, "text/plain", b"this page is for this machine alone\n"))
        return None

    def _body(self) -> dict[str, Any] | None:
        """Parse the JSON object sent, {} for nothing; None if it is anything else or too large."""
        length = self.headers.get("Content-Length", "0")
        if not (length.isascii() and length.isdecimal()):
            return None
        if int(length[:9]) > _MAX_BODY_BYTES or len(length) > 9:
            with suppress(OSError):
                self.rfile.read(min(int(length[:9]), _DRAINED_BYTES))
            return None
        with suppress(OSError, ValueError, RecursionError):
            data = self.rfile.read(int(length))
            body = json.loads(data) if data else {}
            return body if isinstance(body, dict) else None
        return None

    def _send(self, answer: Answer) -> None:
        with suppress(OSError):  # the viewer went away
            self.send_response(answer.code)
            for name, value in _HEADERS.items():
                self.send_header(name, value)
            if answer.kind:
                self.send_header("Content-Type", answer.kind)
            if isinstance(answer.body, bytes) and answer.kind:
                self.send_header("Content-Length", str(len(answer.body)))
            self.end_headers()
            for part in (answer.body,) if isinstance(answer.body, bytes) else answer.body:
                self.wfile.write(part)
        if answer.then is not None:
            answer.then()
