"""Record when each byte of a stream arrived, and let its first bytes be inspected."""

from __future__ import annotations

import time
from collections import deque
from typing import Protocol

from recorders.camera.first_bytes import MAX_BYTES, format_of
from recorders.deadline import Deadline
from tunenet_logs.errors import CameraError
from tunenet_logs.terminal import short_name

# Bytes from one picture to the next: a sender without an end must not fill the memory.
_MAX_WITHOUT_PICTURE = 64 * 1024 * 1024

_JPEG = b"\xff\xd8\xff"  # how one begins. Within a JPEG it stands in an embedded thumbnail alone.
_LOOK_BYTES = 64 * 1024
_MAX_SNAPSHOT = 16 * 1024 * 1024

_MAX_TIMES = 1 << 16  # of reads that are remembered: far more than a library reads ahead


class ByteFeed(Protocol):
    """Source of a stream's bytes."""

    def read(self, most: int) -> bytes:
        """Read up to `most` bytes as soon as there are any; b"" at the end.

        Raises:
            TimeoutError: none came in time.
            OSError: the connection broke.
            CameraError: the bytes are invalid.
        """
        ...

    def close(self) -> None:
        """Close it, but not while another thread reads: its deadline ends that."""
        ...


class TimedFeed:
    """A feed with arrival times, whose first bytes can be inspected.

    Args:
        feed: closed with this.
        deadline: of all that `feed` reads; renewed with each picture.
        timeout_s: the longest from one picture to the next.
    """

    def __init__(self, feed: ByteFeed, deadline: Deadline, timeout_s: float) -> None:
        self.deadline = deadline
        self.timeout_s = timeout_s
        self._feed = feed
        self._held = bytearray()
        self._at_end = False
        self._given = 0
        self._most = _MAX_WITHOUT_PICTURE
        self._times: deque[tuple[int, int]] = deque(maxlen=_MAX_TIMES)
        """Of each read, the position behind its last byte and when it was here [monotonic ns]."""

    def format(self) -> str:
        """Detect the stream's format by its first bytes, which stay to be read.

        Raises:
            CameraError: it is no video.
            OSError: see `ByteFeed.read`.
        """
        while True:
            is_all = self._at_end or len(self._held) >= MAX_BYTES
            found = format_of(bytes(self._held[:MAX_BYTES]), is_all=is_all)
            if found is not None:
                return found
            self._held += self._take(MAX_BYTES - len(self._held))

    def is_one_jpeg(self) -> bool:
        """Return whether a JPEG stream ends before a second JPEG; its bytes stay.

        Raises:
            OSError: see `ByteFeed.read`.
        """
        looked = len(_JPEG)
        while self._held.find(_JPEG, looked - len(_JPEG) + 1) < 0:
            if self._at_end or len(self._held) > _MAX_SNAPSHOT:
                return self._at_end
            looked = len(self._held)
            self._held += self._take(_LOOK_BYTES)
        return False

    def read(self, most: int) -> bytes:
        """Read as `ByteFeed.read` does.

        Raises:
            CameraError: far more came than a picture holds.
        """
        if self._given > self._most:
            raise CameraError(f"sends {_MAX_WITHOUT_PICTURE >> 20} MiB without a picture")
        data = bytes(self._held[:most]) or self._take(most)
        del self._held[: len(data)]
        self._given += len(data)
        return data

    def got_picture(self) -> None:
        """Renew the deadline after a picture."""
        self._most = self._given + _MAX_WITHOUT_PICTURE
        self.deadline.renew(self.timeout_s)

    def arrived_ns(self, position: int | None = None) -> int:
        """Return when a byte arrived [monotonic ns]: the last read, or at `position`, in order.

        Args:
            position: counted from the stream's first byte; None for the last that was read.
        """
        if position is None:
            position = self._given - 1
        while len(self._times) > 1 and self._times[0][0] <= position:
            self._times.popleft()
        return self._times[0][1] if self._times else time.monotonic_ns()

    def why_broken(self, error: OSError) -> str:
        """Describe why the stream broke."""
        if isinstance(error, TimeoutError):
            what = "no whole picture" if self.deadline.is_over else "no data"
            return f"{what} for {self.timeout_s:.1f} s"
        why = error.strerror or str(error) or type(error).__name__
        return f"the connection to the camera broke ({short_name(why)})"

    def close(self) -> None:
        """Close the feed."""
        self._feed.close()

    def _take(self, most: int) -> bytes:
        data = b"" if self._at_end else self._feed.read(most)
        self._at_end = not data
        if data:
            self._times.append((self._given + len(self._held) + len(data), time.monotonic_ns()))
        return data
