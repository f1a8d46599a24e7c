"""Send RTSP requests and await replies (RFC 2326): CSeq, authentication, session."""

from __future__ import annotations

import socket

from recorders.camera.connection import PASSING, sent_on
from recorders.camera.login import Login
from recorders.camera.rtsp_wire import Reply, RtspWire
from tunenet_logs.errors import CameraAwayError, CameraError
from tunenet_logs.terminal import short_name

UNSUPPORTED_TRANSPORT = 461

_MAX_TRIES = 3  # for one reply: without login, with it, and with a fresh nonce


class RtspRequests:
    """Requests over one RTSP connection.

    Attributes:
        wire: reader of the connection.
        session: session identifier; "" before there is one.
    """

    def __init__(self, connected: socket.socket, login: Login) -> None:
        self.wire = RtspWire(connected)
        self.session = ""
        self._socket = connected
        self._login = login
        self._count = 0

    def send(self, method: str, place: str, headers: dict[str, str] | None = None) -> None:
        """Send a request without waiting for its reply."""
        self._count += 1
        lines = [f"{method} {place} RTSP/1.0", f"CSeq: {self._count}", "User-Agent: tunenet-record"]
        lines += [f"{name}: {value}" for name, value in (headers or {}).items()]
        if self.session:
            lines.append(f"Session: {self.session}")
        if login := self._login.header(method, place):
            lines.append(f"Authorization: {login}")
        self._socket.sendall("\r\n".join((*lines, "", "")).encode())

    def ask(
        self,
        method: str,
        place: str,
        headers: dict[str, str] | None = None,
        refusal: int | None = None,
    ) -> Reply:
        """Send a request; return its reply, with status 200 or `refusal`.

        Raises:
            CameraError: the reply has another status.
        """
        self.send(method, place, headers)
        reply = self.wire.reply()
        for _ in range(_MAX_TRIES - 1):
            if reply.status != 401:
                break
            self.log_in(reply)
            self.send(method, place, headers)
            reply = self.wire.reply()
        if reply.status in (200, refusal):
            return reply
        if 300 <= reply.status < 400:
            raise sent_on(reply.header("location"), ("rtsp", "rtsps"))
        remedy = "check the path" if reply.status == 404 else "check the address"
        said = f"{reply.status} {short_name(reply.reason)}"
        kind = CameraAwayError if reply.status in PASSING else CameraError
        raise kind(f"answers {said} to {method}; {remedy}")

    def log_in(self, reply: Reply) -> None:
        """Take the challenge of a 401 reply.

        Raises:
            CameraError: it cannot be answered.
        """
        self._login.take(reply.every("www-authenticate"))
