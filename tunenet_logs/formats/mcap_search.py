"""Search a damaged MCAP file for the next chunk, and for the summary at the end."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode

from tunenet_logs.formats.compression import MAX_PART_BYTES

MAGIC = b"\x89MCAP0\r\n"  # an MCAP file begins and ends with it

# The structures of the MCAP specification, all little-endian.
HEAD = struct.Struct("<BQ")  # kind and length [bytes] of a record
# Of a chunk: first and last stamp [ns], size unpacked [bytes], checksum, length [bytes] of the
# compression's name.
CHUNK = struct.Struct("<QQQII")

# Of the footer: where summary and its offsets begin [bytes], checksum.
FOOTER = struct.Struct("<QQI")

_FIRST_BLOCK_BYTES = 4 * 1024  # looked through at first; what is looked for is near, mostly
_BLOCK_BYTES = 1024 * 1024  # looked through at a time later, after blocks that double
# A chunk's compression as it is stored: what to look for behind a damaged place.
_MARKS = (b"\x04\x00\x00\x00zstd", b"\x03\x00\x00\x00lz4")

# From a chunk's begin to its mark, whose first 4 bytes are the last field of `CHUNK`.
_LEAD_BYTES = HEAD.size + CHUNK.size - 4


def summary_records(file: BinaryIO, size: int) -> Iterator[tuple[int, memoryview]]:
    """Yield kind and body of each record of the summary at the end of a file of `size` bytes.

    Nothing where the footer is missing, the summary is too large, or its checksum is wrong.

    Raises:
        ValueError, struct.error, OSError: there is no footer at the end.
    """
    footer_at = size - len(MAGIC) - HEAD.size - FOOTER.size
    file.seek(footer_at)
    opcode, _ = HEAD.unpack(file.read(HEAD.size))
    start, _, crc = FOOTER.unpack(file.read(FOOTER.size))
    length = footer_at + HEAD.size + FOOTER.size - 4 - start
    if opcode != Opcode.FOOTER or not 0 < start < footer_at or length > MAX_PART_BYTES:
        return
    file.seek(start)
    summary = memoryview(file.read(length))
    if zlib.crc32(summary) != crc:
        return
    at = 0
    while at + HEAD.size < len(summary):
        opcode, length = HEAD.unpack_from(summary, at)
        at += HEAD.size
        yield opcode, summary[at : at + length]
        at += length


def next_chunk(file: BinaryIO, start: int, size: int) -> int | None:
    """Find the next compressed chunk from `start` on that fits the file of `size` bytes.

    Leaves the file's position as it was.
    """
    here, length = file.tell(), _FIRST_BLOCK_BYTES
    try:
        while start < size:
            file.seek(start)
            block = file.read(length + _LEAD_BYTES + 16)
            for begin in sorted(_begins(block)):
                opcode, claimed = HEAD.unpack_from(block, begin)
                if opcode == Opcode.CHUNK and start + begin + HEAD.size + claimed <= size:
                    return start + begin
            start += length
            length = min(2 * length, _BLOCK_BYTES)
        return None
    finally:
        file.seek(here)


def zeros_end(file: BinaryIO, at: int, crc: int) -> tuple[int, int]:
    """Find the end of a run of zeros, and extend the checksum of all data up to there.

    Leaves the file there.

    Args:
        file: open for reading.
        at: a place in it.
        crc: the checksum of all data before that.
    """
    file.seek(at)
    length = _FIRST_BLOCK_BYTES
    while block := file.read(length):
        zeros = zeros_end_in(block, 0)
        crc = zlib.crc32(block[:zeros], crc)
        at += zeros
        if zeros < len(block):
            break
        length = min(2 * length, _BLOCK_BYTES)
    file.seek(at)
    return at, crc


def zeros_end_in(data: bytes | memoryview, at: int) -> int:
    """Find the end of a run of zeros in memory."""
    length = _FIRST_BLOCK_BYTES
    while at < len(data):
        used = np.frombuffer(data[at : at + length], np.uint8) != 0
        first = int(used.argmax())
        if used[first]:
            return at + first
        at += length
        length = min(2 * length, _BLOCK_BYTES)
    return len(data)


def _begins(block: bytes) -> Iterator[int]:
    """Yield where chunks may begin in a block, by their marks."""
    for mark in _MARKS:
        found = block.find(mark, _LEAD_BYTES)
        while found >= 0:
            yield found - _LEAD_BYTES
            found = block.find(mark, found + 1)
