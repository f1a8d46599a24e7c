"""Write MCAP that can be ended whole at any moment, even after a write that failed.

The bytes are those of `mcap.writer.Writer` with the same options, but for chunks that cannot be
packed, which are left so with less effort. That writer counts a message, a chunk or a channel when
it is handed over, so its end speaks of what a full disk never took; here everything is counted when
it has reached the file.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from contextlib import suppress

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
)

from tunenet_logs.output.mcap_summary import MAGIC, McapSummary, bare_ending, bytes_of
from tunenet_logs.output.whole_file import WholeFile

# Before packing; few enough that a killed recorder loses little, many enough to pack well.
_CHUNK_BYTES = 64 * 1024

# Of a chunk, packed to see whether it can be: films and pictures are packed already.
_SAMPLE_BYTES, _SAMPLES = 2048, 4

_MIN_GAIN = 0.03  # of the samples, for which a chunk is worth the usual effort
# A level that takes a fifth of the time, and leaves what does not pack as it is.
_LITTLE_EFFORT = -1

# A message's record up to its data: kind, length, channel, sequence number, two stamps [ns].
_MESSAGE = struct.Struct("<BQHIQQ")

# Of that, what the record's length counts: all but kind and length.
_MESSAGE_HEAD_BYTES = _MESSAGE.size - 9

# A chunk's index of one channel, up to its entries: kind, length, channel, size [bytes].
_INDEX = struct.Struct("<BQHI")


class McapOutput:
    """MCAP file in the making: zstd chunks, CRCs of chunks and of the whole.

    Args:
        file: empty.
        profile: of the log, as in the MCAP registry.
        library: what writes it.

    Attributes:
        is_ended: whether the log has its end.

    Raises:
        OSError: not even the beginning can be written.
    """

    def __init__(self, file: WholeFile, profile: str, library: str) -> None:
        self.is_ended = False
        self._file = file
        self._compressor = zstandard.ZstdCompressor()
        self._quick_compressor = zstandard.ZstdCompressor(_LITTLE_EFFORT)
        self._summary = McapSummary()
        self._open_chunk()
        file.append(MAGIC + bytes_of(Header(profile, library)))

    def _open_chunk(self) -> None:
        self._new: list[Schema | Channel] = []
        self._pieces: list[bytes] = []
        self._offset = 0
        self._entries: dict[int, list[int]] = {}

    def add_schema(self, name: str, encoding: str, text: str) -> int:
        """Announce a type of messages, and return its id."""
        known = len(self._summary.schemas) + sum(isinstance(record, Schema) for record in self._new)
        schema = Schema(id=known + 1, name=name, encoding=encoding, data=text.encode())
        self._announce(schema)
        return schema.id

    def add_channel(self, topic: str, encoding: str, schema_id: int) -> int:
        """Announce a topic, and return its id."""
        known = len(self._summary.channels) + sum(
            isinstance(record, Channel) for record in self._new
        )
        channel = Channel(
            id=known + 1, topic=topic, message_encoding=encoding, metadata={}, schema_id=schema_id
        )
        self._announce(channel)
        return channel.id

    def add_message(
        self, channel_id: int, sequence: int, log_ns: int, publish_ns: int, data: bytes
    ) -> None:
        """Add a message to the open chunk, and write that if it is full.

        Raises:
            OSError: the chunk does not fit; the file is as it was before it.
        """
        offset = self._offset
        entries = self._entries.get(channel_id)
        if entries is None:
            entries = self._entries[channel_id] = []
        entries += (log_ns, offset)
        length = _MESSAGE_HEAD_BYTES + len(data)
        self._pieces += (_MESSAGE.pack(5, length, channel_id, sequence, log_ns, publish_ns), data)
        self._offset = offset = offset + 9 + length
        if offset > _CHUNK_BYTES:
            self.close_chunk()

    def close_chunk(self) -> None:
        """Write the open chunk, if it holds messages.

        Raises:
            OSError: it does not fit; the file is as it was before it, the chunk is lost.
        """
        if not self._entries:
            return
        entries, new, data = self._entries, self._new, b"".join(self._pieces)
        self._open_chunk()
        compressed = self._packed(data)
        chunk = Chunk(
            compression="zstd",
            data=compressed,
            message_start_time=min(min(pairs[::2]) for pairs in entries.values()),
            message_end_time=max(max(pairs[::2]) for pairs in entries.values()),
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        start = self._file.size_bytes
        builder = RecordBuilder()
        chunk.write(builder)
        length = builder.count
        tail, offsets = _message_indexes(entries, start + length)
        builder.write(tail)
        self._file.append(builder.end())
        index = ChunkIndex(
            message_start_time=chunk.message_start_time,
            message_end_time=chunk.message_end_time,
            chunk_start_offset=start,
            chunk_length=length,
            message_index_offsets=offsets,
            message_index_length=len(tail),
            compression=chunk.compression,
            compressed_size=len(compressed),
            uncompressed_size=len(data),
        )
        counts = {channel_id: len(pairs) // 2 for channel_id, pairs in entries.items()}
        self._summary.add_chunk(index, counts, new)

    def _packed(self, data: bytes) -> bytes:
        step = len(data) // _SAMPLES
        if step > _SAMPLE_BYTES:
            starts = range(0, _SAMPLES * step, step)
            sample = b"".join(data[at : at + _SAMPLE_BYTES] for at in starts)
            if len(self._compressor.compress(sample)) > (1 - _MIN_GAIN) * len(sample):
                return self._quick_compressor.compress(data)
        return self._compressor.compress(data)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record at once.

        Raises:
            OSError: it does not fit; the file is as it was before it.
        """
        record, index = self._metadata(name, values)
        self._file.append(record)
        self._summary.add_metadata(index)

    def end(self, name: str, values: Mapping[str, str]) -> None:
        """Write a last metadata record and the end of the log. The open chunk is left out.

        Raises:
            OSError: it does not fit; the file is as it was before it.
        """
        record, index = self._metadata(name, values)
        at, crc32 = self._after(record)
        self._file.append(record + self._summary.ending(at, crc32, index))
        self.is_ended = True

    def end_as_fits(self, name: str, values: Mapping[str, str]) -> bool:
        """End the log on a full disk with as much as fits; return False if nothing does.

        What is given up, in this order: the index of the chunks, so that readers go through the
        log from its beginning; the rest of the summary; the metadata record.
        """
        record, index = self._metadata(name, values)
        at, crc32 = self._after(record)
        ending = self._summary.ending
        for piece in (
            record + ending(at, crc32, index),
            record + ending(at, crc32, index, has_chunk_index=False),
            record + bare_ending(crc32),
            bare_ending(self._file.crc32),
        ):
            with suppress(OSError):
                self._file.append(piece)
                self.is_ended = True
                break
        return self.is_ended

    @property
    def message_count(self) -> int:
        """Number of messages in the file, those in the open chunk not counted."""
        return self._summary.message_count

    def _announce(self, record: Schema | Channel) -> None:
        self._new.append(record)
        piece = bytes_of(record)
        self._pieces.append(piece)
        self._offset += len(piece)

    def _metadata(self, name: str, values: Mapping[str, str]) -> tuple[bytes, MetadataIndex]:
        record = bytes_of(Metadata(name=name, metadata=dict(values)))
        return record, MetadataIndex(self._file.size_bytes, len(record), name)

    def _after(self, piece: bytes) -> tuple[int, int]:
        """Return size and CRC of the file when `piece` will have been added."""
        return self._file.size_bytes + len(piece), zlib.crc32(piece, self._file.crc32)


def _message_indexes(entries: Mapping[int, list[int]], at: int) -> tuple[bytes, dict[int, int]]:
    """Build the index records of a chunk, from offset `at` on, and the offset of each channel's."""
    pieces: list[bytes] = []
    offsets: dict[int, int] = {}
    for channel_id, pairs in entries.items():
        offsets[channel_id] = at
        size = 8 * len(pairs)
        piece = _INDEX.pack(7, 6 + size, channel_id, size) + struct.pack(f"<{len(pairs)}Q", *pairs)
        pieces.append(piece)
        at += len(piece)
    return b"".join(pieces), offsets
