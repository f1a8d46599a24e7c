"""Refuse an MP4 that claims an absurd number of samples, before memory is allocated for them."""

from __future__ import annotations

import os
import re
from io import BufferedReader

from tunenet_logs.errors import LogError
from tunenet_logs.stopping import called_by_c, is_stopping

_TABLES = (b"stsz", b"stz2", b"trun")  # by which samples are claimed
# Where an MP4 says how many samples follow: a few bytes, for which FFmpeg makes a list.
_COUNTS = re.compile(
    rb"stsz\x00{4}.{4}(.{4})"  # of a film
    rb"|stz2\x00{7}.(.{4})"
    rb"|trun[\x00\x01]\x00[\x00-\x0f][\x00\x01\x04\x05](.{4})",  # of a fragment
    re.DOTALL,
)

_MAX_BYTES = 16  # of a match: what is kept of the bytes before, as one may be cut in two
_FREE = 5_000_000  # samples that may be claimed at once: 100 s of bare sound, days of pictures
_SAMPLES_A_BYTE = 1 / 16  # further ones, for each byte that came


class Mp4Claims:
    """Running count of the samples that an MP4 claims while it is read.

    Args:
        file_bytes: its size, where that is known; else each byte counts as it comes.
    """

    def __init__(self, file_bytes: int = 0) -> None:
        self._tail = b""
        self._claimed = 0
        self._counts_on = not file_bytes
        self._bytes = file_bytes

    def check(self, data: bytes) -> None:
        """Count the samples claimed in the next bytes.

        Raises:
            LogError: it claims more samples than bytes can hold.
        """
        seen = self._tail + data
        end = 0
        if any(name in seen for name in _TABLES):  # far quicker than the pattern
            for found in _COUNTS.finditer(seen):
                end = found.end()
                count = next(group for group in found.groups() if group is not None)
                self._claimed += int.from_bytes(count, "big")
        self._tail = seen[max(end, len(seen) - _MAX_BYTES + 1) :]
        if self._counts_on:
            self._bytes += len(data)
        if self._claimed > _FREE + _SAMPLES_A_BYTE * self._bytes:
            raise LogError(f"claims {self._claimed} samples in {self._bytes} bytes")

    def skip(self) -> None:
        """Note that the next bytes do not follow upon the last."""
        self._tail = b""


class CheckedFile:
    """File object for FFmpeg that ends where the file claims too much.

    An exception would be lost on its way through FFmpeg, or printed.

    Args:
        file: open; its name may tell FFmpeg its format.

    Attributes:
        refused: why it ended; None while it has not.
    """

    def __init__(self, file: BufferedReader) -> None:
        self.name = file.name
        self.refused: LogError | None = None
        self._file = file
        self._claims = Mp4Claims(os.fstat(file.fileno()).st_size)

    @called_by_c
    def read(self, most: int) -> bytes:
        """Read the next bytes; none once the file is refused."""
        if self.refused is None and not is_stopping():
            data = self._file.read(most)
            try:
                self._claims.check(data)
            except LogError as error:
                self.refused = error
            else:
                return data
        return b""

    @called_by_c
    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move to another position."""
        self._claims.skip()
        return self._file.seek(offset, whence)

    @called_by_c
    def tell(self) -> int:
        """Return the position of the next byte."""
        return self._file.tell()
