"""Parse ROS 1 bag records: checked heads and fields, and search for heads behind damage."""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import BinaryIO

from tunenet_logs.formats.compression import MAX_PART_BYTES

# The kinds of records, by the byte that a head's field `op` holds.
MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)

IN_CHUNKS = frozenset((MESSAGE, CONNECTION))  # the kinds of records that a chunk may hold
# A head names a topic at most; what a message is like lies in a record's data.
MAX_HEAD_BYTES = 64 * 1024

# A length [bytes], little-endian, as it stands before every head, field and data.
U32 = struct.Struct("<I")

_FORMATS = {1: "<B", 4: "<I", 8: "<Q"}  # of an unsigned field, by its size [bytes]
# The fields that a head of each kind must have, to be taken for one behind damage.
_NEEDED = {
    MESSAGE: (b"conn", b"time"),
    INDEX: (b"conn", b"count"),
    CHUNK: (b"compression", b"size"),
    CHUNK_INFO: (b"chunk_pos", b"count"),
    CONNECTION: (b"conn", b"topic"),
}

# Read at first for a head; only one with a long topic needs a second reading.
_TYPICAL_HEAD_BYTES = 256

_FIRST_BLOCK_BYTES = 16 * 1024  # searched at first behind damage; a head is near, mostly
_BLOCK_BYTES = 1024 * 1024  # searched at a time later, after blocks that double
# A head's field `op` as it is stored: its length (three letters and the value), and its name.
_MARK = b"\x04\x00\x00\x00op="

# How far before its field `op` a head may begin; others write little before it.
_LEADS = range(4, 64)


@dataclass(frozen=True, slots=True)
class Head:
    """A record's head.

    Attributes:
        data_at: first byte of its data, in the buffer that it was read from.
        data_bytes: claimed length of its data, unchecked.
    """

    op: int
    fields: Mapping[bytes, bytes]
    data_at: int
    data_bytes: int

    @property
    def end(self) -> int:
        """First byte of the next record."""
        return self.data_at + self.data_bytes

    def number(self, name: bytes, size: int = 4) -> int:
        """Return an unsigned field of `size` bytes.

        Raises:
            ValueError, KeyError, struct.error: it is missing, or of another size.
        """
        return struct.unpack(_FORMATS[size], self.fields[name])[0]

    def time_ns(self) -> int:
        """Return a message's time of receipt [ns].

        Raises:
            KeyError, struct.error: the field is missing or of another size.
        """
        seconds, nanoseconds = struct.unpack("<II", self.fields[b"time"])
        return seconds * 1_000_000_000 + nanoseconds


def head_at(buffer: bytes | memoryview, at: int = 0) -> Head:
    """Parse the head of the record at a place in a buffer.

    Raises:
        ValueError, LookupError, struct.error: there is no valid head.
    """
    (length,) = U32.unpack_from(buffer, at)
    if length > MAX_HEAD_BYTES:
        raise ValueError(f"a head claims {length} bytes")
    start = at + U32.size
    (data_bytes,) = U32.unpack_from(buffer, start + length)
    fields = fields_of(bytes(buffer[start : start + length]))
    (op,) = fields[b"op"]
    return Head(op, fields, start + length + U32.size, data_bytes)


def fields_of(data: bytes) -> dict[bytes, bytes]:
    """Parse the name=value fields of a head, or of a connection's data.

    Raises:
        ValueError, struct.error: a field is malformed.
    """
    fields: dict[bytes, bytes] = {}
    at = 0
    while at < len(data):
        (length,) = U32.unpack_from(data, at)
        at += U32.size
        name, sign, value = data[at : at + length].partition(b"=")
        if not sign or length > len(data) - at:
            raise ValueError(f"a field claims {length} bytes")
        fields[name] = value
        at += length
    return fields


class RecordFile:
    """A file of records, any part of which may be damaged."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._search = RecordSearch()
        self.size = os.fstat(file.fileno()).st_size

    def block(self, at: int, length: int) -> bytes:
        """Read bytes at a place, fewer at the file's end."""
        self._file.seek(at)
        return self._file.read(length)

    def head(self, at: int) -> Head:
        """Parse the head of the record at a place in the file.

        Raises:
            ValueError, LookupError, struct.error: there is no valid head.
        """
        block = self.block(at, _TYPICAL_HEAD_BYTES)
        (length,) = U32.unpack_from(block)
        if length + 2 * U32.size > len(block):
            block = self.block(at, min(length, MAX_HEAD_BYTES) + 2 * U32.size)
        head = head_at(block)
        return Head(head.op, head.fields, at + head.data_at, head.data_bytes)

    def data(self, head: Head) -> bytes:
        """Read a record's data.

        Raises:
            ValueError: it is too large, or behind the file's end.
        """
        if head.data_bytes > MAX_PART_BYTES or head.end > self.size:
            raise ValueError(f"a record claims {head.data_bytes} bytes")
        return self.block(head.data_at, head.data_bytes)

    def is_border(self, at: int) -> bool:
        """Return whether a record begins there, or the file ends."""
        try:
            self.head(at)
        except (ValueError, LookupError, struct.error):
            return at == self.size
        return True

    def find(self, start: int) -> int:
        """Find the next record from `start` on; the file's end if there is none."""
        length = _FIRST_BLOCK_BYTES
        while start < self.size:
            block = self.block(start, length + RecordSearch.overlap)
            found = self._search.find(block, 0)
            while found is not None:
                if self._is_whole(start + found):
                    return start + found
                found = self._search.find(block, found + 1)
            start += length
            length = min(2 * length, _BLOCK_BYTES)
        return self.size

    def _is_whole(self, at: int) -> bool:
        """Return whether a head is a record's, not a fragment of one in an LZ4 chunk."""
        head = self.head(at)
        return head.op not in IN_CHUNKS or self.is_border(head.end)

    def find_in(self, plain: bytes, start: int) -> int:
        """Find the next record in a decompressed part of the file."""
        found = self._search.find(plain, start)
        return len(plain) if found is None else found


class RecordSearch:
    """Search for the next record behind a damaged one.

    Args:
        tries: places to examine in all; a file of nothing but marks must not take hours.
    """

    overlap = 4 * 1024
    """How long a head may be to be found; what two blocks that are searched have in common."""

    def __init__(self, tries: int = 20_000) -> None:
        self._tries = tries

    def find(self, buffer: bytes, start: int) -> int | None:
        """Find the first record from `start` on, as far as its head is intact."""
        mark = buffer.find(_MARK, start)
        while mark >= 0 and self._tries > 0:
            self._tries -= 1
            for lead in _LEADS:
                if mark - lead >= start and _is_head(buffer, mark - lead, mark):
                    return mark - lead
            mark = buffer.find(_MARK, mark + 1)
        return None


def _is_head(buffer: bytes, at: int, mark: int) -> bool:
    (length,) = U32.unpack_from(buffer, at)
    if not mark + len(_MARK) < at + U32.size + length <= at + RecordSearch.overlap:
        return False
    try:
        head = head_at(buffer, at)
    except (ValueError, LookupError, struct.error):
        return False
    return all(name in head.fields for name in _NEEDED.get(head.op, (b"",)))
