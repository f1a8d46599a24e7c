"""Refuses an MP4 that claims pictures without end, before room is made for each of them."""

from __future__ import annotations

import re

from tunenet_logs.errors import CameraError

_COUNTS = re.compile(
    rb"stsz\x00{4}.{4}(.{4})"  # of a film
    rb"|stz2\x00{7}.(.{4})"
    rb"|trun[\x00\x01]\x00[\x00-\x0f][\x00\x01\x04\x05](.{4})",  # of a fragment
    re.DOTALL,
)
"""Where an MP4 says how many samples follow: a few bytes, for which FFmpeg makes a list."""

_LONGEST_BYTES = 16
"""Of a match: what is kept of the bytes before, as one may be cut in two."""

_FREE = 5_000_000
"""Samples that may be claimed at once: 100 s of bare sound, days of pictures."""

_SAMPLES_A_BYTE = 1 / 16
"""Further ones, for each byte that came."""


class Mp4Claims:
    """Adds up what an MP4 claims while it is read."""

    def __init__(self) -> None:
        self._tail = b""
        self._claimed = 0
        self._came_bytes = 0

    def check(self, data: bytes) -> None:
        """Look at the next bytes.

        Raises:
            CameraError: it claims more samples than bytes can hold.
        """
        seen = self._tail + data
        end = 0
        for found in _COUNTS.finditer(seen):
            end = found.end()
            count = next(group for group in found.groups() if group is not None)
            self._claimed += int.from_bytes(count, "big")
        self._tail = seen[max(end, len(seen) - _LONGEST_BYTES + 1) :]
        self._came_bytes += len(data)
        if self._claimed > _FREE + _SAMPLES_A_BYTE * self._came_bytes:
            raise CameraError(f"claims {self._claimed} samples in {self._came_bytes} bytes")
