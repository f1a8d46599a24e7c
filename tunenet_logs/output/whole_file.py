"""Append whole pieces to a file: one that does not fit leaves no trace."""

from __future__ import annotations

import errno
import os
import zlib
from contextlib import suppress
from pathlib import Path


class WholeFile:
    """Open file, written without a buffer: what `append` returned from is in the file.

    In the file means that it survives this process being killed; `sync` makes it survive the
    machine. Where a piece does not fit, the file is cut back to the last whole one.

    Args:
        descriptor: of the file, which is empty and opened for appending; it is not closed here.

    Attributes:
        size_bytes: of the whole pieces.
        crc32: of the whole pieces.
    """

    def __init__(self, descriptor: int) -> None:
        self.size_bytes = 0
        self.crc32 = 0
        self._is_torn = False
        self._descriptor = descriptor

    def append(self, piece: bytes) -> None:
        """Write all of `piece`, or nothing.

        Raises:
            OSError: it did not fit, or the disk failed.
        """
        if self._is_torn:
            raise OSError(errno.EIO, "cannot be cut back after a write that failed")
        rest = memoryview(piece)
        try:
            while rest:
                rest = rest[os.write(self._descriptor, rest) :]
        except OSError:
            self._cut_back()
            raise
        self.size_bytes += len(piece)
        self.crc32 = zlib.crc32(piece, self.crc32)

    def sync(self) -> None:
        """Sync the contents to disk.

        Raises:
            OSError: it cannot.
        """
        os.fdatasync(self._descriptor)

    def is_changed(self) -> bool:
        """Check whether another process has cut the file, or written to it."""
        return os.fstat(self._descriptor).st_size != self.size_bytes

    def free_bytes(self) -> int:
        """Return the bytes that an ordinary user may still write to this disk."""
        return free_bytes(self._descriptor)

    def _cut_back(self) -> None:
        self._is_torn = True  # what follows half a piece could not be read
        with suppress(OSError):
            os.ftruncate(self._descriptor, self.size_bytes)
            os.lseek(self._descriptor, self.size_bytes, os.SEEK_SET)
            self._is_torn = False


def free_bytes(place: Path | int) -> int:
    """Return the bytes that an ordinary user may still write to a folder's or open file's disk.

    Raises:
        OSError: there is no such folder.
    """
    disk = os.statvfs(place)
    return disk.f_bavail * disk.f_frsize
