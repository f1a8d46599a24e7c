"""Parse an RTSP connection: replies and interleaved packets (RFC 2326)."""

from __future__ import annotations

import re
import socket
from dataclasses import dataclass, replace

from tunenet_logs.errors import CameraAwayError, CameraError

# Several packets: one has 65,539 bytes at most, its length being stated in two.
_BUFFER_BYTES = 256 * 1024

_MAX_HEAD_BYTES = 16 * 1024
_MAX_BODY_BYTES = 64 * 1024  # of a reply: cameras send a hundredth
_VERSION = b"RTSP/1."
_BLANK_LINE = re.compile(rb"\r?\n\r?\n")

_DOLLAR = ord("$")  # what a packet begins with; after it one byte of channel and two of length


@dataclass(frozen=True)
class Reply:
    """A camera's reply.

    Attributes:
        headers: (name in lower case, value), each as often as it was sent.
    """

    status: int
    reason: str
    headers: tuple[tuple[str, str], ...]
    body: bytes

    def every(self, name: str) -> list[str]:
        """Return all values of a header that may be repeated."""
        return [value for known, value in self.headers if known == name]

    def header(self, name: str) -> str:
        """Return the value of a header; "" where it was not sent."""
        return next(iter(self.every(name)), "")


class RtspWire:
    """A reader of an RTSP connection.

    Args:
        connected: the connection; its reads raise when they take too long.

    Attributes:
        early: packets that came before an awaited reply.
    """

    def __init__(self, connected: socket.socket) -> None:
        self.early = bytearray()
        self._socket = connected
        self._buffer = bytearray(_BUFFER_BYTES)
        self._view = memoryview(self._buffer)
        self._used = self._filled = 0

    def reply(self) -> Reply:
        """Wait for the next reply.

        Raises:
            CameraError: what comes is none, or has no end.
        """
        while True:
            came = self.take(is_playing=False)
            if isinstance(came, Reply):
                return came
            if came is None:
                if not self.fill():
                    raise CameraAwayError("ends the connection without a reply; check the address")
                continue
            self.early += came
            if len(self.early) > _BUFFER_BYTES:
                raise CameraError("sends packets and no reply; check the address")

    def fill(self) -> int:
        """Read once; return the number of bytes, 0 at the end of the connection."""
        left = self._filled - self._used
        self._view[:left] = self._view[self._used : self._filled]
        self._used = 0
        self._filled = left + (count := self._socket.recv_into(self._view[left:]))
        return count

    def take(self, *, is_playing: bool) -> memoryview | Reply | None:
        """Return a run of whole packets, or a reply; None where more has to come.

        Packets are valid until the next `fill`.

        Args:
            is_playing: whether noise between packets is skipped; else it is an error.

        Raises:
            CameraError: what came is neither.
        """
        while self._used < self._filled and self._buffer[self._used] in b"\r\n":
            self._used += 1
        start = self._used
        if self._used == self._filled:
            return None
        if self._buffer[start] == _DOLLAR:
            self._used = self._end_of_packets()
            return self._view[start : self._used] if self._used > start else None
        try:
            return self._taken_reply()
        except ValueError as error:
            if not is_playing:
                raise CameraError("does not speak RTSP; check the address") from error
        found = self._buffer.find(_DOLLAR, start, self._filled)
        self._used = self._filled if found < 0 else found
        return self.take(is_playing=True) if found >= 0 else None

    def _end_of_packets(self) -> int:
        buffer, at, last = self._buffer, self._used, self._filled - 4
        while at <= last and buffer[at] == _DOLLAR:
            end = at + 4 + (buffer[at + 2] << 8 | buffer[at + 3])
            if end > self._filled:
                break
            at = end
        return at

    def _taken_reply(self) -> Reply | None:
        """Parse the reply that begins here; None where it is incomplete.

        Raises:
            ValueError: it is no reply.
        """
        head = bytes(self._view[self._used : self._filled][: _MAX_HEAD_BYTES + 4])
        if not head.startswith(_VERSION[: len(head)]):
            raise ValueError("no reply")
        if (found := _BLANK_LINE.search(head)) is None:
            if len(head) > _MAX_HEAD_BYTES:
                raise ValueError("a head without an end")
            return None
        status, *lines = head[: found.start()].decode("latin-1").splitlines()
        _, code, reason = (*status.split(" ", 2), "", "")[:3]
        named = (line.partition(":") for line in lines)
        headers = tuple((name.strip().lower(), value.strip()) for name, _, value in named)
        reply = Reply(int(code), reason, headers, b"")
        size = int(reply.header("content-length") or 0)
        if not 0 <= size <= _MAX_BODY_BYTES:
            raise ValueError("a body without an end")
        start = self._used + found.end()
        if start + size > self._filled:
            return None
        self._used = start + size
        return replace(reply, body=bytes(self._view[start : self._used]))
