"""Read MCAP: bounded, CRC-checked, as far as the file is intact, and past damage.

The search for chunks behind damage and for the summary comes first, then the parsing of records
that describe channels, then the one pass over a file. After https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import struct
import zlib
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap import records as mcap_records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from numpy.typing import NDArray

from tunenet_logs.files import open_regular
from tunenet_logs.formats.base import (
    CHUNK_RECORDS,
    DAMAGE_RECORDS,
    DAMAGED,
    PART_RECORDS,
    Budget,
    Loss,
    OverBudgetError,
    RawAttachment,
    RawChannel,
    RawMessage,
    RawMessages,
    RawMetadata,
    Record,
    described,
    one_by_one,
)
from tunenet_logs.formats.compressed import (
    MAX_PART_BYTES,
    ZSTD_MAGIC,
    unpack,
    unpack_message,
    unpack_start,
)
from tunenet_logs.terminal import silent, teller

MAGIC = b"\x89MCAP0\r\n"  # an MCAP file begins and ends with it

# The structures of the MCAP specification, all little-endian.
HEAD = struct.Struct("<BQ")  # kind and length [bytes] of a record
# Of a chunk: first and last stamp [ns], size unpacked [bytes], checksum, length [bytes] of the
# compression's name.
CHUNK = struct.Struct("<QQQII")
FOOTER = struct.Struct("<QQI")  # where summary and its offsets begin [bytes], checksum

_FIRST_BLOCK_BYTES = 4 * 1024  # searched at first; what is searched for is near, mostly
_BLOCK_BYTES = 1024 * 1024  # searched at a time later, after blocks that double
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


# ---- Parse records, bounded by their own bytes and in their number of parts.
# Channels are those that the data describe, else those that the summary repeats.

# What parsing raises on damaged bytes, the mcap library's own errors too.
MCAP_DAMAGED = (*DAMAGED, McapError)

_MAX_PARTS = 20_000  # numbers and texts of one record: two for each word of its metadata
_MAX_REDEFINED = 10  # channel numbers used twice that are reported; each taints all samples


class _Exact(BytesIO):
    """Byte stream that refuses reads beyond its end; the library would take what there is."""

    parts = 0

    def read(self, size: int | None = -1) -> bytes:
        """Read `size` bytes; raise ValueError if there are fewer, or after too many reads."""
        data = super().read(size)
        self.parts += 1
        if size is not None and len(data) < size:
            raise ValueError(f"a part of it claims {size} bytes")
        if self.parts > _MAX_PARTS:
            raise ValueError(f"it has over {_MAX_PARTS} parts")
        return data


def part_stream(body: memoryview, budget: Budget) -> ReadDataStream:
    """Open a record's body for the mcap library, charging the budget.

    Raises:
        OverBudgetError: it exceeds the budget.
    """
    budget.spend_records(PART_RECORDS)
    return ReadDataStream(_Exact(body))


def channels_of_summary(file: BinaryIO, size: int, budget: Budget) -> dict[int, RawChannel]:
    """Read the channels of an intact summary at the end of the file, by number.

    Empty where the summary is missing or damaged.

    Raises:
        OverBudgetError: it has more records than a log of that size.
    """
    found: dict[int, RawChannel] = {}
    schemas: dict[int, mcap_records.Schema] = {}
    try:
        for opcode, body in summary_records(file, size):
            budget.spend_records()
            if opcode == Opcode.SCHEMA:
                schema = mcap_records.Schema.read(part_stream(body, budget))
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = mcap_records.Channel.read(part_stream(body, budget))
                found[channel.id] = _with_schema(channel, schemas)
    except (*MCAP_DAMAGED, OSError):
        return {}
    return found


def unpacked_chunk(body: memoryview, budget: Budget) -> tuple[memoryview, bool]:
    """Decompress a chunk; return its records, and whether it carries their checksum.

    Raises:
        ValueError, struct.error: it is damaged.
        OverBudgetError: it exceeds the budget.
    """
    budget.spend_records(CHUNK_RECORDS)
    _, _, stated, crc, length = CHUNK.unpack_from(body)
    at = CHUNK.size + length
    compression = bytes(body[CHUNK.size : at]).decode("ascii", "replace")
    (packed,) = struct.unpack_from("<Q", body, at)
    if packed > len(body) - at - 8:
        raise ValueError(f"it claims {packed} bytes")
    if stated <= MAX_PART_BYTES:
        budget.spend(stated)
    plain = memoryview(unpack(body[at + 8 : at + 8 + packed], compression, stated))
    if crc and zlib.crc32(plain) != crc:
        raise ValueError("its checksum is wrong")
    return plain, crc != 0


class KnownChannels:
    """Channels of a file by number, as described in its data, else in its summary.

    Attributes:
        redefined: numbers used for two channels, in words: messages of these are ambiguous.

    Args:
        file: open for reading; its position is left as it was.
        size: of the file [bytes].
        budget: for channels, and records of the summary.
    """

    def __init__(self, file: BinaryIO, size: int, budget: Budget) -> None:
        self._file, self._size, self._budget = file, size, budget
        self._schemas: dict[int, mcap_records.Schema] = {}
        self._channels: dict[int, RawChannel] = {}
        self._summary: dict[int, RawChannel] | None = None
        self._told: dict[int, mcap_records.Channel] = {}
        self.redefined: list[str] = []
        self.get = self._channels.get

    def told(self, opcode: int, body: memoryview) -> tuple[int, RawChannel] | None:
        """Register a schema or channel; return number and channel where that is new.

        Raises:
            MCAP_DAMAGED: it is malformed.
            OverBudgetError: it exceeds the budget.
        """
        stream = part_stream(body, self._budget)
        if opcode == Opcode.SCHEMA:
            schema = mcap_records.Schema.read(stream)
            if schema.id not in self._schemas:
                self._budget.spend_definition(len(schema.data))
                self._schemas[schema.id] = schema
            elif schema != self._schemas[schema.id]:
                self._say_redefined(f"schema {schema.id}", schema.name)
            return None
        channel = mcap_records.Channel.read(stream)
        if channel.id in self._channels:
            first = self._told.get(channel.id, channel)
            if replace(channel, metadata={}) != replace(first, metadata={}):
                self._say_redefined(f"channel {channel.id}, {first.topic},", channel.topic)
            return None
        self._told[channel.id] = channel
        self._budget.spend_channel()
        found = self._channels[channel.id] = _with_schema(channel, self._schemas)
        return channel.id, found

    def _say_redefined(self, what: str, name: str) -> None:
        if len(self.redefined) < _MAX_REDEFINED:
            said = f"{what} is defined again as {name}: which messages are whose is not known"
            self.redefined.append(said)

    def forget(self, number: int) -> None:
        """Drop a channel whose description is damaged."""
        del self._channels[number]
        self._told.pop(number, None)

    def of_summary(self, number: int) -> RawChannel | None:
        """Look up an undescribed channel in the summary; None where it is absent there too.

        Raises:
            OverBudgetError: the summary has more records than a log of that size.
        """
        if self._summary is None:
            here = self._file.tell()
            self._summary = channels_of_summary(self._file, self._size, self._budget)
            self._file.seek(here)
        found = self._summary.get(number)
        if found is not None:
            self._channels[number] = found
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


# ---- Read a file in one pass.

# Of a message: channel, sequence number, receipt and acquisition [ns].
_MESSAGE = np.dtype(
    [("number", "<u2"), ("sequence", "<u4"), ("log_ns", "<u8"), ("publish_ns", "<u8")]
)

_HEAD = struct.Struct("<HIQQ")  # the same, of one message
_MIN_ALIKE = 8  # messages of one size in a row, after which the next are located at once

# Kinds of records that are read, by where they stand.
_USED_IN_CHUNK = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))
_USED_IN_SUMMARY = frozenset((Opcode.STATISTICS, Opcode.FOOTER))
_USED = frozenset(
    (Opcode.CHUNK, Opcode.METADATA, Opcode.ATTACHMENT, Opcode.DATA_END, Opcode.FOOTER)
).union(_USED_IN_CHUNK)  # outside of chunks, before the summary

_ZEROS_BYTES = 64  # at the end of a cut chunk that was never written: a file system leaves them
# What a killed recorder leaves.
_NO_END = "the end of the file is missing (a recording that did not end?)"


def read_mcap(
    path: Path,
    losses: list[Loss],
    topics: Sequence[str] | None = None,
    budget: Budget | None = None,
) -> Iterator[Record]:
    """Yield the records of an MCAP file, checking every CRC that it carries; see `MessageFile`."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        yield from _McapReading(file, size, losses, topics, budget or Budget(size)).records()


class _Inside:
    """Content of a decompressed chunk: new channels, and the places of its messages.

    Messages are made one at a time: a chunk may hold millions.
    """

    def __init__(self, plain: memoryview) -> None:
        self.plain = plain
        self.channels: dict[int, RawChannel] = {}
        self._begins, self._ends = array("I"), array("I")
        self._length = self._alike = 0  # of the last message, and how many had that in a row

    def add(self, at: int, length: int) -> int:
        """Add a message; return how many equally long ones that follow were added with it."""
        self._begins.append(at)
        self._ends.append(at + length)
        self._alike = self._alike + 1 if length == self._length else 1
        self._length = length
        if self._alike < _MIN_ALIKE:
            return 0
        self._alike = 0
        size = HEAD.size + length
        more = _alike(self.plain, at + length, length)
        begins = at + size * np.arange(1, more + 1)
        self._begins.frombytes(begins.astype(np.uint32).tobytes())
        self._ends.frombytes((begins + length).astype(np.uint32).tobytes())
        return more

    @property
    def places(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First and end byte of each message, shape (N,)."""
        begins, ends = (np.array(at, np.int64) for at in (self._begins, self._ends))
        return begins, ends


@dataclass(eq=False)
class _McapReading:
    """One pass over a file of `size` bytes."""

    file: BinaryIO
    size: int
    losses: list[Loss]
    topics: Sequence[str] | None
    budget: Budget
    channels: KnownChannels = field(init=False)
    at: int = 0  # where the record begins that is read
    crc: int = 0
    messages: int = 0  # of all topics, as far as they were read
    unknown: int = 0  # of them, those whose channel nothing describes
    stated: int | None = None  # messages, as the summary counts them
    is_protected: bool = False
    unprotected: bool = False  # whether a message came without a checksum of its chunk
    in_summary: bool = False
    ended: bool = False

    def __post_init__(self) -> None:
        self.channels = KnownChannels(self.file, self.size, self.budget)

    def records(self) -> Iterator[Record]:
        try:
            yield from self._until_the_end()
        except OverBudgetError as error:
            rest = self.size - self.at
            self._lose(f"reading stopped, as {error}; what follows was left out", self.at, rest)
            return
        if self.ended and not self.is_protected:
            what = "the log carries no data checksum, so its integrity cannot be vouched for"
            self.losses.append(Loss(what, harmless=True))
        self.losses += [Loss(what, taints=True) for what in self.channels.redefined]
        if self.unknown:
            self._lose(f"{self.unknown} messages belong to channels that nothing describes")
        if self.stated is not None:  # then it is known how many are missing, whatever is damaged
            missing = max(0, self.stated - self.messages - self.unknown)
            self.losses[:] = [replace(loss, messages=0) for loss in self.losses]
            if missing:
                what = f"{missing} of {self.stated} messages are missing"
                self.losses.append(Loss(what, messages=missing))

    def _until_the_end(self) -> Iterator[Record]:
        """Yield the records in file order; raise OverBudgetError if there are too many."""
        self.at = len(self._read(len(MAGIC)))
        tell = teller("reading") if self.topics is None else silent
        while not self.ended:
            at = self.at
            tell(self.budget.share(at))
            head = self.file.read(HEAD.size)
            if len(head) < HEAD.size:
                self._lose(_NO_END, at)
                return
            self.budget.spend_records()
            opcode, length = HEAD.unpack(head)
            behind = at + HEAD.size + length
            if not opcode:
                self.at, self.crc = zeros_end(self.file, at, self.crc)
                self._lose("zeros, where a record should begin", at, self.at - at)
            elif behind <= self.size:
                yield from self._record(opcode, length, head, at)
                self.at = behind
            else:
                found = next_chunk(self.file, at + 1, self.size)
                if found is None:
                    yield from self._cut_record(opcode, at)
                    return
                what = f"a record claims {length} bytes; what follows was found again"
                self._lose(what, at, found - at)
                self.at = found
                self.file.seek(found)

    def _cut_record(self, opcode: int, at: int) -> Sequence[Record]:
        """Salvage what a truncated last record holds: the first messages of a chunk."""
        body = memoryview(self.file.read(min(self.size - at, MAX_PART_BYTES)))
        found: list[Record] = []
        if opcode == Opcode.CHUNK and any(body[-_ZEROS_BYTES:]):  # a file system may leave zeros
            with suppress(*MCAP_DAMAGED):
                _, _, stated, _, length = CHUNK.unpack_from(body)
                start = CHUNK.size + length
                compression = bytes(body[CHUNK.size : start]).decode("ascii", "replace")
                most = min(stated, MAX_PART_BYTES)
                self.budget.spend(most)
                inside = _Inside(memoryview(unpack_start(body[start + 8 :], compression, most)))
                with suppress(*MCAP_DAMAGED):
                    self._look_through(inside)
                found = list(one_by_one(self._all_of(inside)))
        saved = sum(isinstance(record, RawMessage) for record in found)
        what = f"{_NO_END}; its last record is cut"
        if saved:
            what += f" ({saved} messages of it are read, which no checksum covers)"
        self.losses.append(Loss(what, at_byte=at, size=self.size - at, taints=bool(saved)))
        return found

    def _record(self, opcode: int, length: int, head: bytes, at: int) -> Iterable[Record]:
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
            if opcode == Opcode.DATA_END:
                self._check_data(body, before)
            elif opcode == Opcode.FOOTER:
                self._check_end(body, zlib.crc32(body[:-4], zlib.crc32(head, before)))
            elif opcode == Opcode.STATISTICS:
                (self.stated,) = struct.unpack_from("<Q", body)
            else:
                return self._parse(opcode, memoryview(body))
        except MCAP_DAMAGED as error:
            part = "chunk" if opcode == Opcode.CHUNK else "record"
            self._lose(f"a damaged {part} was left out: {described(error)}", at, length + 9)
        return ()

    def _read(self, length: int) -> bytes:
        data = self.file.read(length)
        self.crc = zlib.crc32(data, self.crc)
        return data

    def _chunk(self, body: memoryview) -> Iterable[Record]:
        """Return all records of a chunk, or raise without keeping any.

        Raises:
            ValueError: it is damaged.
            OverBudgetError: it exceeds the budget.
        """
        plain, is_checked = unpacked_chunk(body, self.budget)
        self.unprotected |= not is_checked
        inside = _Inside(plain)
        try:
            self._look_through(inside)
        except MCAP_DAMAGED:  # as if it had not been
            for number in inside.channels:
                self.channels.forget(number)
            raise
        return self._all_of(inside)

    def _all_of(self, inside: _Inside) -> Iterator[Record]:
        yield from inside.channels.values()
        yield from self._messages(inside.plain, *inside.places)

    def _look_through(self, inside: _Inside) -> None:
        """Index a decompressed chunk: its channels, and the places of its messages.

        Raises:
            ValueError, struct.error: it is damaged behind what was indexed.
            OverBudgetError: there are too many.
        """
        plain, at, count = inside.plain, 0, 0
        most = self.budget.left_records
        while at < len(plain):
            opcode, length = HEAD.unpack_from(plain, at)
            count += 1
            if count > most or not opcode:
                self.budget.spend_records(count)
                count, most = 0, self.budget.left_records
            if not opcode:
                end = zeros_end_in(plain, at)
                self._lose(f"{end - at} bytes of a chunk are zeros", self.at)
                at = end
                continue
            at += HEAD.size
            end = at + length
            if end > len(plain):
                raise ValueError(f"a record inside claims {length} bytes")
            if opcode == Opcode.MESSAGE:
                if length < _MESSAGE.itemsize:
                    raise ValueError(f"a message of {length} bytes")
                more = inside.add(at, length)
                count += more
                end += more * (HEAD.size + length)
            elif opcode in _USED_IN_CHUNK:
                if found := self.channels.told(opcode, plain[at:end]):
                    inside.channels[found[0]] = found[1]
            elif opcode in _USED:
                raise ValueError(f"it holds a record of kind {opcode}, which belongs outside")
            at = end
        self.budget.spend_records(count)

    def _parse(self, opcode: int, body: memoryview) -> Iterable[Record]:
        """Parse a record outside of chunks.

        Raises:
            MCAP_DAMAGED: it is malformed.
            OverBudgetError: it exceeds the budget.
        """
        if opcode == Opcode.CHUNK:
            return self._chunk(body)
        if opcode == Opcode.MESSAGE:
            if len(body) < _HEAD.size:
                raise ValueError(f"a message of {len(body)} bytes")
            self.unprotected = True
            return self._message(body)
        if opcode in _USED_IN_CHUNK:
            found = self.channels.told(opcode, body)
            return found[1:] if found else ()
        stream = part_stream(body, self.budget)
        if opcode == Opcode.METADATA:
            metadata = mcap_records.Metadata.read(stream)
            return (RawMetadata(metadata.name, metadata.metadata),)
        file = mcap_records.Attachment.read(stream)
        log_ns, create_ns = file.log_time, file.create_time
        return (RawAttachment(file.name, file.media_type, file.data, log_ns, create_ns),)

    def _message(self, body: memoryview) -> Iterator[Record]:
        """Yield a message outside of chunks; `_messages` is slow for a single one."""
        number, sequence, log_ns, publish_ns = _HEAD.unpack_from(body)
        channel = self.channels.get(number)
        if channel is None:
            channel = self.channels.of_summary(number)
            if channel is None:
                self.unknown += 1
                return
            yield channel
        self.messages += 1
        if self.topics is None or channel.topic in self.topics:
            data = body[_HEAD.size :]
            yield self._unpacked(RawMessage(channel, log_ns, data, publish_ns, sequence))

    def _messages(
        self, plain: memoryview, begins: NDArray[np.int64], ends: NDArray[np.int64]
    ) -> Iterator[Record]:
        """Yield the messages between places, after channels that nothing described before."""
        if not len(begins):
            return
        heads = np.ndarray(len(plain) - _MESSAGE.itemsize + 1, _MESSAGE, plain, strides=(1,))
        heads = heads[begins]
        channels: dict[int, RawChannel] = {}
        numbers, counts = np.unique(heads["number"], return_counts=True)
        for number, count in zip(numbers.tolist(), counts.tolist(), strict=True):
            channel = self.channels.get(number)
            if channel is None:  # its description was in a damaged chunk perhaps
                channel = self.channels.of_summary(number)
                if channel is None:
                    self.unknown += count
                    continue
                yield channel
            self.messages += count
            if self.topics is None or channel.topic in self.topics:
                channels[number] = channel
        if len(channels) < len(numbers):
            rows = np.isin(heads["number"], list(channels))
            heads, begins, ends = heads[rows], begins[rows], ends[rows]
        found = RawMessages(plain, channels, heads, begins + _MESSAGE.itemsize, ends)
        if _are_packed(found):
            yield from map(self._unpacked, found)
        else:
            yield found

    def _unpacked(self, message: RawMessage) -> RawMessage:
        if message.channel.encoding == "cdr" and message.data[:4] == ZSTD_MAGIC:
            with suppress(ValueError):  # a damaged one is that message's matter
                message.data = unpack_message(message.data, self.budget)
        return message

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
        with suppress(OverBudgetError):  # what is lost is said in any case
            self.budget.spend_records(DAMAGE_RECORDS)
        self.losses.append(Loss(what, at_byte=at, size=size))


def _alike(plain: memoryview, at: int, length: int) -> int:
    """Count the messages of `length` bytes that follow each other from `at` on."""
    size = HEAD.size + length
    most = (len(plain) - at) // size
    count, block = 0, _MIN_ALIKE
    while count < most:
        block = min(4 * block, most - count)
        start = at + count * size
        opcodes = np.ndarray(block, np.uint8, plain, start, (size,))
        lengths = np.ndarray(block, "<u8", plain, start + 1, (size,))
        others = np.flatnonzero((opcodes != Opcode.MESSAGE) | (lengths != length))
        if len(others):
            return count + int(others[0])
        count += block
    return count


def _are_packed(messages: RawMessages) -> bool:
    """Return whether a recorder compressed one of the messages by itself."""
    begins = messages.begins[messages.ends - messages.begins >= len(ZSTD_MAGIC)]
    if not len(begins):
        return False
    magic = np.frombuffer(ZSTD_MAGIC, "<u4")
    starts = np.ndarray(len(messages.plain) - 3, "<u4", messages.plain, strides=(1,))
    return bool(np.any(starts[begins] == magic))
