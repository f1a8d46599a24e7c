"""Parse a multipart stream of pictures, tolerating sloppy senders."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from recorders.camera.delimiters import TAIL_BYTES, Delimiters
from tunenet_logs.errors import CameraError

# Of one picture: several times a large JPEG; a stream without an end must not fill the memory.
MAX_PART_BYTES = 32 * 1024 * 1024

_MAX_HEADER_BYTES = 16 * 1024  # of the headers of one part: a camera sends about 100
_READ_BYTES = 256 * 1024  # the most that one read takes: a few pictures
# Headers in which servers tell a picture's time [s], that of its taking before that of sending.
_TIMES = (
    b"x-ustreamer-grab-begin-time",
    b"x-ustreamer-grab-time",
    b"x-ustreamer-grab-timestamp",
    b"x-timestamp",
    b"timestamp",
)

# A time that tells more than whole seconds, which are no help.
_SECONDS = re.compile(rb"(\d{1,11})\.(\d{1,9})\d*")


@dataclass(frozen=True)
class Part:
    """One part of the stream.

    Attributes:
        arrived_ns: monotonic time at which its first byte arrived.
        told_ns: the time in its headers, of an unknown clock; None where they have none.
    """

    arrived_ns: int
    data: bytes
    told_ns: int | None = None


class MultipartParser:
    """Splits a byte stream into parts.

    A part ends after its Content-Length where it states one, else at the next delimiter. Senders
    differ in whether the boundary they announce has its two leading dashes already: both are
    accepted, and so is a stream that announces none.

    Args:
        read: up to so many bytes, as soon as there are any; b"" at the end.
        boundary: as announced, or "".
        clock_ns: monotonic time.

    Attributes:
        is_closed: whether the last delimiter ended the stream.
    """

    def __init__(
        self, read: Callable[[int], bytes], boundary: str, clock_ns: Callable[[], int]
    ) -> None:
        self._delimiters = Delimiters(boundary.lstrip("-").encode("latin-1", "replace"))
        self._read = read
        self._clock_ns = clock_ns
        self._buffer = bytearray()
        self._arrived_ns = 0
        self._at_end = False
        self.is_closed = False

    def parts(self) -> Iterator[Part]:
        """Yield the parts in order; one that is cut short is delivered as it is.

        Raises:
            CameraError: it is no multipart stream, or a part has no end.
        """
        while self._skip_delimiter():
            headers = self._headers()
            if not self._buffer and not self._fill():
                return
            arrived_ns = self._arrived_ns
            length = _content_length(headers)
            data = self._until_delimiter() if length is None else self._take(length)
            yield Part(arrived_ns, data, _told_ns(headers))

    def _fill(self) -> bool:
        data = b"" if self._at_end else self._read(_READ_BYTES)
        self._arrived_ns = self._clock_ns()
        self._at_end = not data
        self._buffer += data
        return bool(data)

    def _skip_delimiter(self) -> bool:
        """Skip past the next delimiter; False at the end of the stream."""
        skipped = looked = 0
        while True:
            found, looked = self._delimiters.line(self._buffer, looked)
            if found is not None:
                del self._buffer[: found.end]
                self.is_closed = found.closes
                return not found.closes
            surplus = max(0, looked - TAIL_BYTES)
            del self._buffer[:surplus]
            looked -= surplus
            skipped += surplus
            if max(skipped, len(self._buffer)) > MAX_PART_BYTES:
                raise CameraError("sends no part of a multipart stream; is it a camera's stream?")
            if not self._fill():
                return False

    def _headers(self) -> dict[bytes, bytes]:
        """Read a part's headers, by their names in lower case."""
        headers: dict[bytes, bytes] = {}
        used = 0
        while True:
            while (end := self._buffer.find(b"\n")) < 0:
                if len(self._buffer) > _MAX_HEADER_BYTES:
                    raise CameraError("sends a part whose headers have no end")
                if not self._fill():
                    return headers
            line = bytes(self._buffer[:end]).strip()
            del self._buffer[: end + 1]
            used += end
            if used > _MAX_HEADER_BYTES:
                raise CameraError("sends a part whose headers have no end")
            if not line:
                return headers
            name, _, value = line.partition(b":")
            headers[name.strip().lower()] = value.strip()

    def _take(self, length: int) -> bytes:
        while len(self._buffer) < length and self._fill():
            pass
        body = bytes(self._buffer[:length])
        cut = None
        if not body.rstrip(b"\0 \t\r\n").endswith(b"\xff\xd9"):  # less came than was stated?
            cut, _ = self._delimiters.end_of_body(body, 0, is_all=True)
        used = len(body) if cut is None else cut
        del self._buffer[:used]
        return body[:used]

    def _until_delimiter(self) -> bytes:
        looked = 0
        while True:
            end, looked = self._delimiters.end_of_body(self._buffer, looked, is_all=self._at_end)
            if end is not None or self._at_end:
                break
            if len(self._buffer) > MAX_PART_BYTES:
                raise CameraError(f"sends a part of more than {MAX_PART_BYTES} bytes")
            self._fill()
        body = bytes(self._buffer[:end])
        del self._buffer[: len(body)]
        return body.removesuffix(b"\r\n") if end is None else body


def _content_length(headers: dict[bytes, bytes]) -> int | None:
    text = headers.get(b"content-length", b"")
    stated = int(text[:18]) if text.isdigit() else 0
    return stated if 0 < stated <= MAX_PART_BYTES else None


def _told_ns(headers: dict[bytes, bytes]) -> int | None:
    for name in _TIMES:
        if found := _SECONDS.fullmatch(headers.get(name, b"")):
            return int(found[1]) * 1_000_000_000 + int(found[2].ljust(9, b"0"))
    return None
