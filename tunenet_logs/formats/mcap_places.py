"""Where things are in an MCAP file that is damaged: the next chunk, the summary at the end."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from io import BytesIO
from typing import BinaryIO

from mcap import records as mcap_records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from tunenet_logs.formats.base import DAMAGED, RawChannel
from tunenet_logs.formats.compression import MAX_PART_BYTES

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""Kind and length of a record."""

CHUNK = struct.Struct("<QQQII")
"""Of a chunk: first and last stamp, size unpacked, checksum, length of the compression's name."""

FOOTER = struct.Struct("<QQI")
"""Of the footer: where summary and its offsets begin, checksum."""

_BLOCK_BYTES = 1024 * 1024
_MARKS = (b"\x04\x00\x00\x00zstd", b"\x03\x00\x00\x00lz4")
"""A chunk's compression as it is stored: what to look for behind a damaged place."""

_LEAD = HEAD.size + CHUNK.size - 4


class Exact(BytesIO):
    """Bytes that refuse to be read beyond their end; the library would take what there is."""

    def read(self, size: int | None = -1) -> bytes:
        """So many bytes, or ValueError."""
        data = super().read(size)
        if size is not None and len(data) < size:
            raise ValueError(f"a part of it claims {size} bytes")
        return data


def described_channel(
    channel: mcap_records.Channel, schemas: Mapping[int, mcap_records.Schema]
) -> RawChannel:
    """A channel with its schema."""
    schema = schemas.get(channel.schema_id)
    return RawChannel(
        topic=channel.topic,
        type_name=schema.name if schema else "",
        encoding=channel.message_encoding,
        schema_encoding=schema.encoding if schema else "",
        schema=schema.data if schema else b"",
        metadata=channel.metadata,
    )


def channels_of_summary(file: BinaryIO, size: int) -> dict[int, RawChannel]:
    """The channels as a whole summary at the end of the file repeats them, by number."""
    try:
        return _read_summary(file, size)
    except (*DAMAGED, McapError, OSError):
        return {}


def _read_summary(file: BinaryIO, size: int) -> dict[int, RawChannel]:
    footer_at = size - len(MAGIC) - HEAD.size - FOOTER.size
    file.seek(footer_at)
    opcode, _ = HEAD.unpack(file.read(HEAD.size))
    start, _, crc = FOOTER.unpack(file.read(FOOTER.size))
    length = footer_at + HEAD.size + FOOTER.size - 4 - start
    if opcode != Opcode.FOOTER or not 0 < start < footer_at or length > MAX_PART_BYTES:
        return {}
    file.seek(start)
    summary = memoryview(file.read(length))
    if zlib.crc32(summary) != crc:
        return {}
    found: dict[int, RawChannel] = {}
    schemas: dict[int, mcap_records.Schema] = {}
    at = 0
    while at + HEAD.size < len(summary):
        opcode, length = HEAD.unpack_from(summary, at)
        at += HEAD.size
        stream = ReadDataStream(Exact(summary[at : at + length]))
        if opcode == Opcode.SCHEMA:
            schema = mcap_records.Schema.read(stream)
            schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = mcap_records.Channel.read(stream)
            found[channel.id] = described_channel(channel, schemas)
        at += length
    return found


def next_chunk(file: BinaryIO, start: int, size: int) -> int | None:
    """Where, from `start` on, the next packed chunk begins that fits the file of `size` bytes."""
    while start < size:
        file.seek(start)
        block = file.read(_BLOCK_BYTES + _LEAD + 16)
        for place in sorted(_places(block)):
            opcode, length = HEAD.unpack_from(block, place)
            if opcode == Opcode.CHUNK and start + place + HEAD.size + length <= size:
                return start + place
        start += _BLOCK_BYTES
    return None


def _places(block: bytes) -> Iterator[int]:
    for mark in _MARKS:
        found = block.find(mark, _LEAD)
        while found >= 0:
            yield found - _LEAD
            found = block.find(mark, found + 1)
