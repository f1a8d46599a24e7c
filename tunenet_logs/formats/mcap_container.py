"""MCAP: records bounded and checked, read as far as the file is whole, and past what is not."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap import records as mcap_records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from tunenet_logs.formats.base import (
    DAMAGED,
    Loss,
    RawAttachment,
    RawChannel,
    RawMessage,
    RawMetadata,
    Record,
    described,
)
from tunenet_logs.formats.compression import (
    MAX_PART_BYTES,
    ZSTD_MAGIC,
    Budget,
    unpack,
    unpack_message,
    unpack_start,
)
from tunenet_logs.formats.mcap_search import CHUNK, FOOTER, HEAD, MAGIC, next_chunk, summary_records

_DAMAGED = (*DAMAGED, McapError)
"""What parsing raises on damaged bytes, the mcap library's own errors too."""

_MESSAGE = struct.Struct("<HIQQ")
"""Of a message: channel, sequence number, receipt and acquisition [ns]."""

_BLOCK_BYTES = 1024 * 1024
"""Read at a time of a record that is skipped, for its share in the checksum of all data."""

# Which kinds of records say something that is read, by where they stand.
_USED_IN_CHUNK = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))
_USED_IN_SUMMARY = frozenset((Opcode.STATISTICS, Opcode.FOOTER))
_USED = frozenset(
    (Opcode.CHUNK, Opcode.METADATA, Opcode.ATTACHMENT, Opcode.DATA_END, Opcode.FOOTER)
).union(_USED_IN_CHUNK)  # outside of chunks, before the summary

_ZEROS_BYTES = 64
"""A cut chunk that ends in so many zeros was never written: a file system leaves them."""

_NO_END = "the end of the file is missing (a recording that did not end?)"
"""What a killed recorder leaves."""


def read_mcap(
    path: Path,
    losses: list[Loss],
    topics: Sequence[str] | None = None,
    budget: Budget | None = None,
) -> Iterator[Record]:
    """The records of an MCAP file; see `MessageFile`. Every CRC that it carries is checked."""
    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        yield from _McapReading(file, size, losses, topics, budget or Budget(size)).records()


class _Exact(BytesIO):
    """Bytes that refuse to be read beyond their end; the library would take what there is."""

    def read(self, size: int | None = -1) -> bytes:
        """Reads `size` bytes; raises ValueError if there are fewer."""
        data = super().read(size)
        if size is not None and len(data) < size:
            raise ValueError(f"a part of it claims {size} bytes")
        return data


def channels_of_summary(file: BinaryIO, size: int) -> dict[int, RawChannel]:
    """The channels as a whole summary at the end of the file repeats them, by number.

    Empty where the summary is missing or damaged.
    """
    found: dict[int, RawChannel] = {}
    schemas: dict[int, mcap_records.Schema] = {}
    try:
        for opcode, body in summary_records(file, size):
            stream = ReadDataStream(_Exact(body))
            if opcode == Opcode.SCHEMA:
                schema = mcap_records.Schema.read(stream)
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = mcap_records.Channel.read(stream)
                found[channel.id] = _with_schema(channel, schemas)
    except (*_DAMAGED, OSError):
        return {}
    return found


def _with_schema(
    channel: mcap_records.Channel, schemas: Mapping[int, mcap_records.Schema]
) -> RawChannel:
    schema = schemas.get(channel.schema_id)
    return RawChannel(
        topic=channel.topic,
        type_name=schema.name if schema else "",
        encoding=channel.message_encoding,
        schema_encoding=schema.encoding if schema else "",
        schema=schema.data if schema else b"",
        metadata=channel.metadata,
    )


@dataclass(eq=False)
class _McapReading:
    """One pass over a file of `size` bytes."""

    file: BinaryIO
    size: int
    losses: list[Loss]
    topics: Sequence[str] | None
    budget: Budget
    schemas: dict[int, mcap_records.Schema] = field(default_factory=dict)
    channels: dict[int, RawChannel] = field(default_factory=dict)
    summary: dict[int, RawChannel] | None = None
    crc: int = 0
    messages: int = 0  # of all topics, as far as they were read
    unknown: int = 0  # of them, those whose channel nothing describes
    stated: int | None = None  # messages, as the summary counts them
    is_protected: bool = False
    unprotected: bool = False  # whether a message came without a checksum of its chunk
    in_summary: bool = False
    ended: bool = False

    def records(self) -> Iterator[Record]:
        at = len(self._read(len(MAGIC)))
        while not self.ended:
            head = self.file.read(HEAD.size)
            if len(head) < HEAD.size:
                self._lose(_NO_END, at)
                break
            opcode, length = HEAD.unpack(head)
            behind = at + HEAD.size + length
            if behind > self.size:
                found = next_chunk(self.file, at + 1, self.size)
                if found is None:
                    yield from self._cut_record(opcode, at)
                    break
                what = f"a record claims {length} bytes; what follows was found again"
                self._lose(what, at, found - at)
                at = found
                self.file.seek(at)
                continue
            yield from self._record(opcode, length, head, at)
            at = behind
        if self.ended and not self.is_protected:
            what = "the log carries no data checksum, so its integrity cannot be vouched for"
            self.losses.append(Loss(what, harmless=True))
        if self.unknown:
            self._lose(f"{self.unknown} messages belong to channels that nothing describes")
        if self.stated is not None and self.stated > self.messages + self.unknown:
            missing = self.stated - self.messages - self.unknown
            self._lose(f"{missing} of {self.stated} messages are missing")

    def _cut_record(self, opcode: int, at: int) -> Sequence[Record]:
        """What can be had of a record that the file ends in: the first messages of a chunk."""
        body = memoryview(self.file.read(min(self.size - at, MAX_PART_BYTES)))
        found: list[Record] = []
        if opcode == Opcode.CHUNK and any(body[-_ZEROS_BYTES:]):  # a file system may leave zeros
            with suppress(*_DAMAGED):
                _, _, stated, _, length = CHUNK.unpack_from(body)
                start = CHUNK.size + length
                compression = bytes(body[CHUNK.size : start]).decode("ascii", "replace")
                most = min(stated, MAX_PART_BYTES)
                self.budget.spend(most)
                plain = unpack_start(body[start + 8 :], compression, most)
                self._walk(memoryview(plain), found)
        saved = sum(isinstance(record, RawMessage) for record in found)
        what = f"{_NO_END}; its last record is cut"
        if saved:
            what += f" ({saved} messages of it are read, which no checksum covers)"
        self.losses.append(Loss(what, at_byte=at, size=self.size - at, taints=bool(saved)))
        return found

    def _record(self, opcode: int, length: int, head: bytes, at: int) -> Sequence[Record]:
        before = self.crc
        self.crc = zlib.crc32(head, before)
        used = _USED_IN_SUMMARY if self.in_summary else _USED
        if opcode not in used or length > MAX_PART_BYTES:
            rest = length
            while rest > 0:  # until the file ends
                rest -= len(self._read(min(rest, _BLOCK_BYTES))) or rest
            if opcode in used:
                self._lose("a record is too large to be read", at, length)
            return ()
        body = self._read(length)
        try:
            if opcode == Opcode.CHUNK:
                return self._chunk(memoryview(body))
            if opcode == Opcode.DATA_END:
                (stated,) = struct.unpack_from("<I", body)
                self.is_protected = stated != 0
                if stated and stated != before:
                    what = "the checksum of all data is wrong: something before its end was changed"
                    self.losses.append(Loss(what, taints=self.unprotected))
                self.crc = 0  # from here on, that of the summary
                self.in_summary = True
            elif opcode == Opcode.FOOTER:
                self._check_end(body, zlib.crc32(body[:-4], zlib.crc32(head, before)))
            else:
                return self._parse(opcode, memoryview(body))
        except _DAMAGED as error:
            part = "chunk" if opcode == Opcode.CHUNK else "record"
            self._lose(f"a damaged {part} was left out: {described(error)}", at, length + 9)
        return ()

    def _read(self, length: int) -> bytes:
        data = self.file.read(length)
        self.crc = zlib.crc32(data, self.crc)
        return data

    def _chunk(self, body: memoryview) -> Sequence[Record]:
        """All records of a chunk; none of one that is damaged.

        Raises:
            ValueError: it is damaged.
        """
        _, _, stated, crc, length = CHUNK.unpack_from(body)
        at = CHUNK.size + length
        compression = bytes(body[CHUNK.size : at]).decode("ascii", "replace")
        (packed,) = struct.unpack_from("<Q", body, at)
        if packed > len(body) - at - 8:
            raise ValueError(f"it claims {packed} bytes")
        if stated <= MAX_PART_BYTES:
            self.budget.spend(stated)
        plain = memoryview(unpack(body[at + 8 : at + 8 + packed], compression, stated))
        if crc and zlib.crc32(plain) != crc:
            raise ValueError("its checksum is wrong")
        self.unprotected |= not crc
        known, read = dict(self.channels), self.messages
        found: list[Record] = []
        try:
            self._walk(plain, found)
        except _DAMAGED:  # as if it had not been
            self.channels, self.messages = known, read
            raise
        return found

    def _walk(self, plain: memoryview, found: list[Record]) -> None:
        """Put the records of an unpacked chunk into `found`.

        Raises:
            ValueError, struct.error: what follows those is damaged.
        """
        at = 0
        while at < len(plain):
            opcode, length = HEAD.unpack_from(plain, at)
            at += HEAD.size
            if length > len(plain) - at:
                raise ValueError(f"a record inside claims {length} bytes")
            if opcode == Opcode.MESSAGE:
                self._message(plain[at : at + length], found)
            elif opcode in _USED_IN_CHUNK:
                found += self._parse(opcode, plain[at : at + length])
            elif opcode in _USED:
                raise ValueError(f"it holds a record of kind {opcode}, which belongs outside")
            at += length

    def _parse(self, opcode: int, body: memoryview) -> Sequence[Record]:
        if opcode == Opcode.MESSAGE:  # outside a chunk
            found: list[Record] = []
            self._message(body, found)
            self.unprotected = True
            return found
        stream = ReadDataStream(_Exact(body))
        if opcode == Opcode.SCHEMA:
            schema = mcap_records.Schema.read(stream)
            self.schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            channel = mcap_records.Channel.read(stream)
            if channel.id not in self.channels:
                self.channels[channel.id] = _with_schema(channel, self.schemas)
                return (self.channels[channel.id],)
        elif opcode == Opcode.METADATA:
            metadata = mcap_records.Metadata.read(stream)
            return (RawMetadata(metadata.name, metadata.metadata),)
        elif opcode == Opcode.STATISTICS:
            self.stated = mcap_records.Statistics.read(stream).message_count
        elif opcode == Opcode.ATTACHMENT:
            file = mcap_records.Attachment.read(stream)
            log_ns, create_ns = file.log_time, file.create_time
            return (RawAttachment(file.name, file.media_type, file.data, log_ns, create_ns),)
        return ()

    def _message(self, body: memoryview, found: list[Record]) -> None:
        number, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(body)
        channel = self.channels.get(number)
        if channel is None:  # its description was in a damaged chunk perhaps
            if self.summary is None:
                here = self.file.tell()
                self.summary = channels_of_summary(self.file, self.size)
                self.file.seek(here)
            channel = self.summary.get(number)
            if channel is None:
                self.unknown += 1
                return
            self.channels[number] = channel
            found.append(channel)
        self.messages += 1
        if self.topics is not None and channel.topic not in self.topics:
            return
        data: bytes | memoryview = body[_MESSAGE.size :]
        if channel.encoding == "cdr" and data[:4] == ZSTD_MAGIC:
            with suppress(ValueError):  # a damaged one is that message's matter, not the chunk's
                data = unpack_message(data, self.budget)
        found.append(RawMessage(channel, log_ns, data, publish_ns, sequence))

    def _check_end(self, body: bytes, crc: int) -> None:
        self.ended = True
        _, _, stated = FOOTER.unpack_from(body)
        if not self.in_summary:
            self._lose("the end of the data is not marked")
        elif (stated and stated != crc) or self.file.read(len(MAGIC)) != MAGIC:
            self._lose("the index at the end is damaged (`tunenet-logs recover` writes it anew)")
        end = self.file.tell()
        if end < self.size:
            what = "another log follows" if self.file.read(len(MAGIC)) == MAGIC else "bytes follow"
            self._lose(f"{what} behind the end, which are not read", end, self.size - end)

    def _lose(self, what: str, at: int | None = None, size: int = 0) -> None:
        self.losses.append(Loss(what, at_byte=at, size=size))
