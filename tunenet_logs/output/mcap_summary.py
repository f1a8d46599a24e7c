"""Build the end of an MCAP file from the messages that are really in it."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"  # an MCAP file begins and ends with it


class McapSummary:
    """Counts and indexes of what has reached a file.

    Attributes:
        message_count: messages in its chunks.
    """

    def __init__(self) -> None:
        self.message_count = 0
        self.schemas: list[Schema] = []
        self.channels: list[Channel] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._chunk_indexes = bytearray()  # as bytes: hours of recording make many
        self._chunk_count = 0
        self._counts: dict[int, int] = {}
        self._span_ns: tuple[int, int] | None = None

    def add_chunk(
        self, index: ChunkIndex, counts: Mapping[int, int], announced: Sequence[Schema | Channel]
    ) -> None:
        """Count a chunk that is in the file.

        Args:
            index: of the chunk.
            counts: messages in it, by channel.
            announced: the schemas and channels that are in it.
        """
        self._chunk_indexes += bytes_of(index)
        self._chunk_count += 1
        for record in announced:
            if isinstance(record, Schema):
                self.schemas.append(record)
            else:
                self.channels.append(record)
        for channel_id, count in counts.items():
            self._counts[channel_id] = self._counts.get(channel_id, 0) + count
            self.message_count += count
        start_ns, end_ns = index.message_start_time, index.message_end_time
        first_ns, last_ns = self._span_ns or (start_ns, end_ns)
        self._span_ns = min(first_ns, start_ns), max(last_ns, end_ns)

    def add_metadata(self, index: MetadataIndex) -> None:
        """Count a metadata record that is in the file."""
        self._metadata_indexes.append(index)

    def ending(
        self, at: int, data_crc32: int, last: MetadataIndex, *, has_chunk_index: bool = True
    ) -> bytes:
        """Encode data end, summary and footer.

        Args:
            at: where they begin in the file.
            data_crc32: of all before that.
            last: a metadata record that comes just before, and is not counted yet.
            has_chunk_index: whether readers may jump; without, they go through from the beginning.
        """
        data_end = bytes_of(DataEnd(data_crc32))
        start = at + len(data_end)
        summary, offsets = bytearray(), bytearray()
        for opcode, group in self._groups([*self._metadata_indexes, last]):
            kept = group if has_chunk_index or opcode != Opcode.CHUNK_INDEX else b""
            offsets += bytes_of(SummaryOffset(opcode, start + len(summary), len(kept)))
            summary += kept
        offset_start = start + len(summary)
        summary += offsets
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        crc32 = zlib.crc32(head, zlib.crc32(summary))
        return data_end + bytes(summary) + bytes_of(Footer(start, offset_start, crc32)) + MAGIC

    def _groups(self, metadata_indexes: Sequence[MetadataIndex]) -> Iterator[tuple[Opcode, bytes]]:
        """Yield the records of the summary in its order."""
        first_ns, last_ns = self._span_ns or (0, 0)
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self.channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunk_count,
            message_count=self.message_count,
            metadata_count=len(metadata_indexes),
            message_start_time=first_ns,
            message_end_time=last_ns,
            schema_count=len(self.schemas),
        )
        yield Opcode.SCHEMA, b"".join(map(bytes_of, self.schemas))
        yield Opcode.CHANNEL, b"".join(map(bytes_of, self.channels))
        yield Opcode.STATISTICS, bytes_of(statistics)
        yield Opcode.CHUNK_INDEX, bytes(self._chunk_indexes)
        yield Opcode.ATTACHMENT_INDEX, b""
        yield Opcode.METADATA_INDEX, b"".join(map(bytes_of, metadata_indexes))


def bare_ending(data_crc32: int) -> bytes:
    """Encode the shortest end that readers take: no summary."""
    return bytes_of(DataEnd(data_crc32)) + bytes_of(Footer(0, 0, 0)) + MAGIC


def bytes_of(record: McapRecord) -> bytes:
    """Serialise a record."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
