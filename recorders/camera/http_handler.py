"""HTTP and HTTPS for a camera, with a deadline for every byte of its answer."""

from __future__ import annotations

import socket
import ssl
from functools import partial
from http.client import HTTPConnection, HTTPResponse, HTTPSConnection
from typing import Any
from urllib import request

from recorders.deadline import Deadline, with_deadline


class DeadlineHandler(request.HTTPHandler, request.HTTPSHandler):
    """Asks over HTTP and HTTPS with a deadline that holds for every byte of the answer."""

    def __init__(self, deadline: Deadline) -> None:
        request.HTTPHandler.__init__(self)
        self._deadline = deadline
        self._tls = ssl.create_default_context()
        self._tls.sslsocket_class = with_deadline(ssl.SSLSocket, deadline)  # type: ignore[assignment]

    def http_open(self, req: request.Request) -> HTTPResponse:
        """Ask without encryption."""
        return self.do_open(partial(_PlainConnection, deadline=self._deadline), req)

    def https_open(self, req: request.Request) -> HTTPResponse:
        """Ask with encryption."""
        return self.do_open(
            partial(_SecureConnection, context=self._tls, deadline=self._deadline), req
        )


class _PlainConnection(HTTPConnection):
    def __init__(self, host: str, *, deadline: Deadline, **words: Any) -> None:
        super().__init__(host, **words)
        self._deadline = deadline

    def connect(self) -> None:
        super().connect()
        kind = with_deadline(socket.socket, self._deadline)
        self.sock = kind(fileno=self.sock.detach())
        self._deadline.watch(self.sock)


class _SecureConnection(HTTPSConnection):
    def __init__(self, host: str, *, deadline: Deadline, **words: Any) -> None:
        super().__init__(host, **words)
        self._deadline = deadline

    def connect(self) -> None:
        super().connect()
        self._deadline.watch(self.sock)
