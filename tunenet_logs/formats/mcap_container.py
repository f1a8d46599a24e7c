"""MCAP: records bounded and checked, read as far as the file is whole, and past what is not."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
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
    Budget,
    is_packed,
    unpack,
    unpack_message,
    unpack_start,
)
from tunenet_logs.formats.mcap_places import (
    CHUNK,
    FOOTER,
    HEAD,
    MAGIC,
    Exact,
    channels_of_summary,
    described_channel,
    next_chunk,
)

_DAMAGED = (*DAMAGED, McapError)
_MESSAGE = struct.Struct("<HIQQ")
_BLOCK_BYTES = 1024 * 1024
_USED_IN_CHUNK = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))
_USED_IN_SUMMARY = frozenset((Opcode.STATISTICS, Opcode.FOOTER))
_USED = frozenset(
    (Opcode.CHUNK, Opcode.METADATA, Opcode.ATTACHMENT, Opcode.DATA_END, Opcode.FOOTER)
).union(_USED_IN_CHUNK)
_ZEROS = 64
_NO_END = "the end of the file is missing (a recording that did not end?)"


def read_mcap(
    path: Path, losses: list[Loss], topics: Sequence[str] | None = None
) -> Iterator[Record]:
    """The records of an MCAP file; see `Container`. Every CRC that the file carries is checked."""
    with open(path, "rb") as file:
        yield from _Reading(file, losses, topics).records()


class _Reading:
    """One pass over a file."""

    def __init__(self, file: BinaryIO, losses: list[Loss], topics: Sequence[str] | None) -> None:
        self.file = file
        self.size = os.fstat(file.fileno()).st_size
        self.losses = losses
        self.topics = topics
        self.budget = Budget(self.size)
        self.schemas: dict[int, mcap_records.Schema] = {}
        self.channels: dict[int, RawChannel] = {}
        self.summary: dict[int, RawChannel] | None = None
        self.crc = 0
        self.messages = 0  # of all topics, as far as they were read
        self.unknown = 0  # of them, those whose channel nothing describes
        self.told: int | None = None
        self.is_protected = False
        self.unprotected = False  # whether a message came without a checksum of its chunk
        self.in_summary = False
        self.ended = False

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
                found = self._next_chunk(at + 1)
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
        self._close()

    def _cut_record(self, opcode: int, at: int) -> Sequence[Record]:
        """What can be had of a record that the file ends in: the first messages of a chunk."""
        body = memoryview(self.file.read(min(self.size - at, MAX_PART_BYTES)))
        found: list[Record] = []
        if opcode == Opcode.CHUNK and any(body[-_ZEROS:]):  # a file system may leave zeros
            with suppress(*_DAMAGED):
                _, _, stated, _, length = CHUNK.unpack_from(body)
                start = CHUNK.size + length
                compression = bytes(body[CHUNK.size : start]).decode("ascii", "replace")
                most = min(stated, MAX_PART_BYTES)
                self.budget.spend(most)
                plain = unpack_start(body[start + 8 :], compression, most)
                self._walk(memoryview(plain), found)
        saved = sum(isinstance(one, RawMessage) for one in found)
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
            self._skip(length)
            if opcode in used:
                self._lose("a record is too large to be read", at, length)
            return ()
        body = self._read(length)
        try:
            if opcode == Opcode.CHUNK:
                return self._chunk(memoryview(body))
            if opcode == Opcode.DATA_END:
                self._check_data(body, before)
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

    def _skip(self, length: int) -> None:
        while length > 0:
            length -= len(self._read(min(length, _BLOCK_BYTES))) or length

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
        stream = ReadDataStream(Exact(body))
        if opcode == Opcode.SCHEMA:
            schema = mcap_records.Schema.read(stream)
            self.schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            channel = mcap_records.Channel.read(stream)
            if channel.id not in self.channels:
                self.channels[channel.id] = described_channel(channel, self.schemas)
                return (self.channels[channel.id],)
        elif opcode == Opcode.METADATA:
            metadata = mcap_records.Metadata.read(stream)
            return (RawMetadata(metadata.name, metadata.metadata),)
        elif opcode == Opcode.STATISTICS:
            self.told = mcap_records.Statistics.read(stream).message_count
        elif opcode == Opcode.ATTACHMENT:
            one = mcap_records.Attachment.read(stream)
            log_ns, create_ns = one.log_time, one.create_time
            return (RawAttachment(one.name, one.media_type, one.data, log_ns, create_ns),)
        return ()

    def _message(self, body: memoryview, found: list[Record]) -> None:
        number, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(body)
        channel = self.channels.get(number) or self._adopted(number, found)
        if channel is None:
            self.unknown += 1
            return
        self.messages += 1
        if self.topics is not None and channel.topic not in self.topics:
            return
        data: bytes | memoryview = body[_MESSAGE.size :]
        if channel.encoding == "cdr" and is_packed(data):
            with suppress(ValueError):  # a damaged one is that message's matter, not the chunk's
                data = unpack_message(data, self.budget)
        found.append(RawMessage(channel, log_ns, data, publish_ns, sequence))

    def _adopted(self, number: int, found: list[Record]) -> RawChannel | None:
        """A channel whose description was in a damaged chunk perhaps."""
        channel = self._channels_of_summary().get(number)
        if channel is not None:
            self.channels[number] = channel
            found.append(channel)
        return channel

    def _channels_of_summary(self) -> dict[int, RawChannel]:
        """The channels as the end of the file repeats them; none where that is missing."""
        if self.summary is None:
            here = self.file.tell()
            self.summary = channels_of_summary(self.file, self.size)
            self.file.seek(here)
        return self.summary

    def _check_data(self, body: bytes, crc: int) -> None:
        (stated,) = struct.unpack_from("<I", body)
        self.is_protected = stated != 0
        if stated and stated != crc:
            what = "the checksum of all data is wrong: something before its end was changed"
            self.losses.append(Loss(what, taints=self.unprotected))
        self.crc = 0  # from here on, that of the summary
        self.in_summary = True

    def _check_end(self, body: bytes, crc: int) -> None:
        self.ended = True
        stated = FOOTER.unpack_from(body)[2]
        if not self.in_summary:
            self._lose("the end of the data is not marked")
        elif (stated and stated != crc) or self.file.read(len(MAGIC)) != MAGIC:
            self._lose("the index at the end is damaged (`tunenet-logs recover` writes it anew)")
        end = self.file.tell()
        if end < self.size:
            what = "another log follows" if self.file.read(len(MAGIC)) == MAGIC else "bytes follow"
            self._lose(f"{what} behind the end, which are not read", end, self.size - end)

    def _close(self) -> None:
        if self.ended and not self.is_protected:
            what = "the log carries no data checksum, so its integrity cannot be vouched for"
            self.losses.append(Loss(what, harmless=True))
        if self.unknown:
            self._lose(f"{self.unknown} messages belong to channels that nothing describes")
        if self.told is not None and self.told > self.messages + self.unknown:
            missing = self.told - self.messages - self.unknown
            self._lose(f"{missing} of {self.told} messages are missing")

    def _next_chunk(self, start: int) -> int | None:
        """Where the next chunk begins that looks whole; leaves the file's place as it was."""
        here = self.file.tell()
        try:
            return next_chunk(self.file, start, self.size)
        finally:
            self.file.seek(here)

    def _lose(self, what: str, at: int | None = None, size: int = 0) -> None:
        self.losses.append(Loss(what, at_byte=at, size=size))
