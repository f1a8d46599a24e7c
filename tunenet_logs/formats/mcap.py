"""Read MCAP: bounded, CRC-checked, as far as the file is intact, and past damage.

The mcap library parses the records; one pass over the file does what it does not: it says where
bytes are lost, finds the next chunk where a length is destroyed, saves the messages of a cut last
chunk, and keeps within a `Budget`. Messages stay in the buffer of their chunk, or of a block of
the file where there are no chunks, and are located together: an object each, as the library makes
them, takes many times as long. After https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from array import array
from collections.abc import Iterable, Iterator, Sequence
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
from mcap.stream_reader import StreamReader
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
    Topics,
    block_sizes,
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
MCAP_DAMAGED = (*DAMAGED, McapError)  # what parsing raises on damaged bytes
# The structures of the MCAP specification, all little-endian.
_HEAD = struct.Struct("<BQ")  # kind and length [bytes] of a record
# Of a chunk: first and last stamp [ns], size unpacked [bytes], checksum, length [bytes] of the
# compression's name.
_CHUNK = struct.Struct("<QQQII")
_FOOTER = struct.Struct("<QQI")  # where summary and its offsets begin [bytes], checksum
# Of a message: channel, sequence number, receipt and acquisition [ns].
_MESSAGE = struct.Struct("<HIQQ")
_MESSAGES = np.dtype(
    [("number", "<u2"), ("sequence", "<u4"), ("log_ns", "<u8"), ("publish_ns", "<u8")]
)
_BLOCK_BYTES = 1024 * 1024  # read at a time of what is skipped
# A compressed chunk, to look for behind a damaged place: its kind, its length, its compression.
_CHUNK_BEGIN = re.compile(
    rb"\x06(?=(.{8}).{28}(?:\x04\x00\x00\x00zstd|\x03\x00\x00\x00lz4))", re.DOTALL
)
_ZEROS = re.compile(rb"\x00*")
# Messages of so few bytes, so many in a row, after which the next are located together, in windows
# that grow to `_BLOCK_BYTES`.
_SHORT_BYTES, _MIN_SHORT, _WINDOW_BYTES = 4096, 8, 64 * 1024
# Kinds of records that are read, by where they stand.
_USED_IN_CHUNK = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))
_USED = _USED_IN_CHUNK | {  # outside of chunks, before the summary
    Opcode.CHUNK,
    Opcode.METADATA,
    Opcode.ATTACHMENT,
    Opcode.DATA_END,
    Opcode.FOOTER,
}
_USED_IN_SUMMARY = frozenset((Opcode.STATISTICS, Opcode.FOOTER))
# What a killed recorder leaves.
_NO_END = "the end of the file is missing (a recording that did not end?)"


def read_mcap(
    path: Path, losses: list[Loss], topics: Topics = None, budget: Budget | None = None
) -> Iterator[Record]:
    """Yield the records of an MCAP file, checking every CRC that it carries; see `Container`."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        yield from _McapReading(file, size, losses, topics, budget or Budget(size)).records()


class _Exact(BytesIO):
    """Byte stream that refuses reads beyond its end; the library would take what there is."""

    def __init__(self, body: bytes | memoryview, most_parts: int = 20_000) -> None:
        super().__init__(body)  # of numbers and texts: two for each word of a record's metadata
        self._left = self._most = most_parts

    def read(self, size: int | None = -1) -> bytes:
        """Read `size` bytes; raise ValueError if there are fewer, or after too many reads."""
        data = super().read(size)
        self._left -= 1
        if size is not None and len(data) < size:
            raise ValueError(f"a part of it claims {size} bytes")
        if self._left < 0:
            raise ValueError(f"it has over {self._most} parts")
        return data


def channels_of_summary(file: BinaryIO, size: int, budget: Budget) -> dict[int, RawChannel]:
    """Read the channels of an intact summary, by number; leave the file's position as it was."""
    found: dict[int, RawChannel] = {}
    schemas: dict[int, mcap_records.Schema] = {}
    here = file.tell()
    try:
        footer_at = size - len(MAGIC) - _HEAD.size - _FOOTER.size
        file.seek(footer_at + _HEAD.size)
        start, _, crc = _FOOTER.unpack(file.read(_FOOTER.size))
        if not 0 < start < footer_at or size - start > MAX_PART_BYTES:
            return {}
        file.seek(start)
        body = file.read(size - start)
        if zlib.crc32(body[: -len(MAGIC) - 4]) != crc:
            return {}
        for record in StreamReader(_Exact(body, len(body)), skip_magic=True).records:
            budget.spend(records=1)
            if isinstance(record, mcap_records.Schema):
                schemas[record.id] = record
            elif isinstance(record, mcap_records.Channel):
                budget.spend(records=PART_RECORDS)
                found[record.id] = _raw(record, schemas.get(record.schema_id))
    except (*MCAP_DAMAGED, OSError):
        return {}
    finally:
        file.seek(here)
    return found


def _raw(channel: mcap_records.Channel, schema: mcap_records.Schema | None) -> RawChannel:
    return RawChannel(
        topic=channel.topic,
        type_name=schema.name if schema else "",
        encoding=channel.message_encoding,
        schema_encoding=schema.encoding if schema else "",
        schema=schema.data if schema else b"",
        metadata=channel.metadata,
    )


class _Inside:
    """Content of a decompressed chunk: new channels, and the places of its messages."""

    def __init__(self, plain: memoryview) -> None:
        self.plain = plain
        self.channels: dict[int, RawChannel] = {}
        self.begins, self.ends = array("q"), array("q")
        self._short = 0  # messages in a row that are short
        self._window = _WINDOW_BYTES

    def add(self, at: int, length: int) -> tuple[int, int]:
        """Add a message; return how many that follow were added with it, and where all end."""
        self.begins.append(at)
        self.ends.append(at + length)
        end = at + length
        self._short = self._short + 1 if length <= _SHORT_BYTES else 0
        if self._short < _MIN_SHORT:
            return 0, end
        self._short = 0
        begins, ends = _messages_from(self.plain, end, self._window)
        self._window = min(4 * self._window, _BLOCK_BYTES)
        self.begins.frombytes(begins.tobytes())
        self.ends.frombytes(ends.tobytes())
        return len(begins), int(ends[-1]) if len(ends) else end


def _messages_from(
    plain: memoryview, at: int, window: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Locate the messages that follow each other from `at` on and begin in the next `window` bytes.

    Returns where the bodies begin and end. Those of one length lie at even steps. Of others, all
    places that look like a message's head are found together, and then followed from the first: one
    body's end is the next head.
    """
    last = min(at + window, len(plain) - _HEAD.size - _MESSAGE.size + 1)
    nothing = np.empty(0, np.int64)
    if last <= at:
        return nothing, nothing
    # First those that are as long as the first.
    opcode, length = _HEAD.unpack_from(plain, at)
    size = _HEAD.size + length
    if opcode == Opcode.MESSAGE and _MESSAGE.size <= length <= _SHORT_BYTES:
        count = min(1 + (last - at - 1) // size, (len(plain) - at) // size)
        opcodes = np.ndarray(count, np.uint8, plain, at, (size,))
        lengths = np.ndarray(count, "<u8", plain, at + 1, (size,))
        others = np.flatnonzero((opcodes != Opcode.MESSAGE) | (lengths != length))
        count = int(others[0]) if len(others) else count
        if count >= _MIN_SHORT:
            heads = at + size * np.arange(count)
            return heads + _HEAD.size, heads + size
    heads = at + np.flatnonzero(np.frombuffer(plain, np.uint8)[at:last] == Opcode.MESSAGE)
    stated = np.ndarray(len(plain) - _HEAD.size + 1, "<u8", plain, 1, (1,))[heads]
    is_one = (stated >= _MESSAGE.size) & (stated <= len(plain))
    heads = heads[is_one]
    ends = heads + _HEAD.size + stated[is_one].astype(np.int64)
    within = ends <= len(plain)
    heads, ends = heads[within], ends[within]
    if not len(heads) or heads[0] != at:
        return nothing, nothing
    after = np.searchsorted(heads, ends)
    follows = np.append(heads, -1)[after] == ends
    if not np.array_equal(after[:-1], np.arange(1, len(heads))) or not follows[:-1].all():
        chain, place = [0], 0
        goes_on, following = follows.tolist(), after.tolist()
        while goes_on[place]:
            place = following[place]
            chain.append(place)
        heads, ends = heads[chain], ends[chain]
    return heads + _HEAD.size, ends


@dataclass(eq=False)
class _McapReading:
    """One pass over a file of `size` bytes."""

    file: BinaryIO
    size: int
    losses: list[Loss]
    topics: Topics
    budget: Budget
    at: int = 0  # where the record begins that is read
    crc: int = 0  # of all data before, later of the summary
    messages: int = 0  # of all topics, as far as they were read
    unknown: int = 0  # of them, those whose channel nothing describes
    stated: int | None = None  # messages, as the summary counts them
    is_protected: bool = False
    unprotected: bool = False  # whether a message came without a checksum of its chunk
    in_summary: bool = False
    ended: bool = False
    schemas: dict[int, mcap_records.Schema] = field(default_factory=dict)
    told: dict[int, mcap_records.Channel] = field(default_factory=dict)
    channels: dict[int, RawChannel] = field(default_factory=dict)
    of_summary: dict[int, RawChannel] | None = None
    redefined: list[str] = field(default_factory=list)  # numbers used for two channels, in words

    def records(self) -> Iterator[Record]:
        """Yield the records, and add what was lost behind them."""
        try:
            yield from self._until_the_end()
        except OverBudgetError as error:
            rest = self.size - self.at
            self._lose(f"reading stopped, as {error}; what follows was left out", self.at, rest)
            return
        if self.ended and not self.is_protected:
            what = "the log carries no data checksum, so its integrity cannot be vouched for"
            self.losses.append(Loss(what, harmless=True))
        for what in self.redefined[:10]:  # each taints all samples: more say nothing new
            self.losses.append(Loss(f"{what}: which messages are whose is not known", taints=True))
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
        short = 0  # messages outside of chunks in a row that are short
        while not self.ended:
            at = self.at
            tell(self.budget.share(at))
            head = self.file.read(_HEAD.size)
            if len(head) < _HEAD.size:
                self._lose(_NO_END, at)
                return
            self.budget.spend(records=1)
            opcode, length = _HEAD.unpack(head)
            behind = at + _HEAD.size + length
            if not opcode:
                self.file.seek(at)
                for block in self._blocks():
                    zeros = _ZEROS.match(block).end()  # type: ignore[union-attr]
                    self.crc = zlib.crc32(block[:zeros], self.crc)
                    self.at += zeros
                    if zeros < len(block):
                        break
                self.file.seek(self.at)
                self._lose("zeros, where a record should begin", at, self.at - at)
            elif behind <= self.size:
                yield from self._record(opcode, length, head, at)
                self.at = behind
                is_short = opcode == Opcode.MESSAGE and length <= _SHORT_BYTES
                short = short + 1 if is_short else 0
                if short >= _MIN_SHORT:
                    short = 0
                    yield from self._messages_outside()
            else:
                found = self._next_chunk(at + 1)
                if found is None:
                    yield from self._cut_record(opcode, at)
                    return
                what = f"a record claims {length} bytes; what follows was found again"
                self._lose(what, at, found - at)
                self.at = found
                self.file.seek(found)

    def _messages_outside(self) -> Iterator[Record]:
        """Yield the messages outside of chunks that come next, as many as a block holds."""
        block = self.file.read(_BLOCK_BYTES)
        inside = _Inside(memoryview(block))
        begins, ends = _messages_from(inside.plain, 0, len(block))
        size = int(ends[-1]) if len(ends) else 0
        self.file.seek(self.at + size)
        if size:
            inside.begins.frombytes(begins.tobytes())
            inside.ends.frombytes(ends.tobytes())
            self.budget.spend(records=len(begins))
            self.crc = zlib.crc32(inside.plain[:size], self.crc)
            self.unprotected = True
            self.at += size
            yield from self._all_of(inside)

    def _blocks(self) -> Iterator[bytes]:
        """Read on in blocks that double."""
        for length in block_sizes():
            if not (block := self.file.read(length)):
                return
            yield block

    def _next_chunk(self, start: int) -> int | None:
        """Find the next compressed chunk; leave the file behind the head at `self.at`."""
        self.file.seek(start)
        kept = b""  # the end of the block before, where a chunk may begin
        try:
            for more in self._blocks():
                block, start = kept + more, start - len(kept)
                for match in _CHUNK_BEGIN.finditer(block):
                    begin = start + match.start()
                    (claimed,) = struct.unpack("<Q", match[1])
                    if begin + _HEAD.size + claimed <= self.size:
                        return begin
                start += len(block)
                kept = block[-44:]  # a begin of 45 bytes may lie across two blocks
            return None
        finally:
            self.file.seek(self.at + _HEAD.size)

    def _cut_record(self, opcode: int, at: int) -> Sequence[Record]:
        """Salvage what a truncated last record holds: the first messages of a chunk."""
        body = memoryview(self.file.read(min(self.size - at, MAX_PART_BYTES)))
        found: list[Record] = []
        # Of a chunk that was never written, a file system leaves zeros.
        if opcode == Opcode.CHUNK and any(body[-64:]):
            with suppress(*MCAP_DAMAGED):
                stated, _, compression, _, packed = _parts_of_chunk(body)
                most = min(stated, MAX_PART_BYTES)
                self.budget.spend(most)
                inside = _Inside(memoryview(unpack_start(packed, compression, most)))
                with suppress(*MCAP_DAMAGED):
                    self._look_through(inside)
                found = list(one_by_one(self._all_of(inside)))
        saved = sum(isinstance(record, RawMessage) for record in found)
        what = f"{_NO_END}; its last record is cut"
        if saved:
            what += f" ({saved} messages of it are read, which no checksum covers)"
        self.losses.append(Loss(what, at_byte=at, size=self.size - at, taints=bool(saved)))
        return found

    def _read(self, length: int) -> bytes:
        data = self.file.read(length)
        self.crc = zlib.crc32(data, self.crc)
        return data

    def _record(self, opcode: int, length: int, head: bytes, at: int) -> Iterable[Record]:
        before = self.crc
        self.crc = zlib.crc32(head, before)
        used = _USED_IN_SUMMARY if self.in_summary else _USED
        if opcode not in used or length > MAX_PART_BYTES:
            rest = length
            while rest > 0:  # until the file ends
                rest -= len(self._read(min(rest, 1024 * 1024))) or rest
            if opcode in used:
                self._lose("a record is too large to be read", at, length)
            return ()
        body = self._read(length)
        try:
            if opcode == Opcode.DATA_END:
                (stated,) = struct.unpack_from("<I", body)
                self.is_protected = stated != 0
                if stated and stated != before:
                    what = "the checksum of all data is wrong: something before its end was changed"
                    self.losses.append(Loss(what, taints=self.unprotected))
                self.crc = 0  # from here on, that of the summary
                self.in_summary = True
            elif opcode == Opcode.FOOTER:
                self.ended = True
                _, _, stated = _FOOTER.unpack_from(body)
                crc = zlib.crc32(body[:-4], zlib.crc32(head, before))
                if not self.in_summary:
                    self._lose("the end of the data is not marked")
                elif (stated and stated != crc) or self.file.read(len(MAGIC)) != MAGIC:
                    why = "the index at the end is damaged"
                    self._lose(f"{why} (`tunenet-logs recover` writes it anew)")
                if (end := self.file.tell()) < self.size:
                    is_log = self.file.read(len(MAGIC)) == MAGIC
                    what = "another log follows" if is_log else "bytes follow"
                    self._lose(f"{what} behind the end, which are not read", end, self.size - end)
            else:
                return self._parse(opcode, memoryview(body))
        except MCAP_DAMAGED as error:
            part = "chunk" if opcode == Opcode.CHUNK else "record"
            self._lose(f"a damaged {part} was left out: {described(error)}", at, length + 9)
        return ()

    def _parse(self, opcode: int, body: memoryview) -> Iterable[Record]:
        """Parse a record outside of chunks; raise MCAP_DAMAGED, or OverBudgetError."""
        if opcode == Opcode.MESSAGE:
            if len(body) < _MESSAGE.size:
                raise ValueError(f"a message of {len(body)} bytes")
            self.unprotected = True
            return self._message(body)
        if opcode == Opcode.CHUNK:  # all of its records, or none
            self.budget.spend(records=CHUNK_RECORDS)
            stated, crc, compression, claimed, packed = _parts_of_chunk(body)
            if claimed > len(packed):
                raise ValueError(f"it claims {claimed} bytes")
            if stated <= MAX_PART_BYTES:
                self.budget.spend(stated)
            plain = memoryview(unpack(packed, compression, stated))
            if crc and zlib.crc32(plain) != crc:
                raise ValueError("its checksum is wrong")
            self.unprotected |= not crc
            inside = _Inside(plain)
            try:
                self._look_through(inside)
            except MCAP_DAMAGED:  # as if it had not been
                for number in inside.channels:
                    del self.channels[number]
                    self.told.pop(number, None)
                raise
            return self._all_of(inside)
        if opcode == Opcode.STATISTICS:
            (self.stated,) = struct.unpack_from("<Q", body)
            return ()
        if opcode in _USED_IN_CHUNK:
            found = self._described(opcode, body)
            return found[1:] if found else ()
        self.budget.spend(records=PART_RECORDS)
        stream = ReadDataStream(_Exact(body))
        if opcode == Opcode.METADATA:
            metadata = mcap_records.Metadata.read(stream)
            return (RawMetadata(metadata.name, metadata.metadata),)
        file = mcap_records.Attachment.read(stream)
        log_ns, create_ns = file.log_time, file.create_time
        return (RawAttachment(file.name, file.media_type, file.data, log_ns, create_ns),)

    def _look_through(self, inside: _Inside) -> None:
        """Index a chunk: its channels, and the places of its messages, as far as it is whole."""
        plain, at, count = inside.plain, 0, 0
        most = self.budget.left_records
        while at < len(plain):
            opcode, length = _HEAD.unpack_from(plain, at)
            count += 1
            if count > most or not opcode:
                self.budget.spend(records=count)
                count, most = 0, self.budget.left_records
            if not opcode:
                end = _ZEROS.match(plain, at).end()  # type: ignore[union-attr]
                self._lose(f"{end - at} bytes of a chunk are zeros", self.at)
                at = end
                continue
            at += _HEAD.size
            end = at + length
            if end > len(plain):
                raise ValueError(f"a record inside claims {length} bytes")
            if opcode == Opcode.MESSAGE:
                if length < _MESSAGE.size:
                    raise ValueError(f"a message of {length} bytes")
                more, end = inside.add(at, length)
                count += more
            elif opcode in _USED_IN_CHUNK:
                if found := self._described(opcode, plain[at:end]):
                    inside.channels[found[0]] = found[1]
            elif opcode in _USED:
                raise ValueError(f"it holds a record of kind {opcode}, which belongs outside")
            at = end
        self.budget.spend(records=count)

    def _described(self, opcode: int, body: memoryview) -> tuple[int, RawChannel] | None:
        """Register a schema or channel; return number and channel where that is new."""
        self.budget.spend(records=PART_RECORDS)
        stream = ReadDataStream(_Exact(body))
        if opcode == Opcode.SCHEMA:
            schema = mcap_records.Schema.read(stream)
            if schema.id not in self.schemas:
                self.budget.spend(definition=schema.data)
            if schema != self.schemas.setdefault(schema.id, schema):
                self.redefined.append(f"schema {schema.id} is defined again as {schema.name}")
            return None
        channel = mcap_records.Channel.read(stream)
        if channel.id in self.channels:
            first = self.told.get(channel.id, channel)
            if replace(channel, metadata={}) != replace(first, metadata={}):
                again = f"channel {channel.id}, {first.topic}, is defined again as {channel.topic}"
                self.redefined.append(again)
            return None
        self.told[channel.id] = channel
        self.budget.spend(records=PART_RECORDS, channels=1)
        found = _raw(channel, self.schemas.get(channel.schema_id))
        self.channels[channel.id] = found
        return channel.id, found

    def _channel(self, number: int) -> tuple[RawChannel | None, bool]:
        """Return a message's channel, and whether it is news: its chunk was damaged perhaps."""
        if known := self.channels.get(number):
            return known, False
        if self.of_summary is None:
            self.of_summary = channels_of_summary(self.file, self.size, self.budget)
        if found := self.of_summary.get(number):
            self.channels[number] = found
        return found, found is not None

    def _message(self, body: memoryview) -> Iterator[Record]:
        """Yield a message outside of chunks; `_all_of` is slow for a single one."""
        number, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(body)
        channel, is_new = self._channel(number)
        if channel is None:
            self.unknown += 1
            return
        if is_new:
            yield channel
        self.messages += 1
        if self.topics is None or channel.topic in self.topics:
            data = body[_MESSAGE.size :]
            yield self._unpacked(RawMessage(channel, log_ns, data, publish_ns, sequence))

    def _all_of(self, inside: _Inside) -> Iterator[Record]:
        """Yield a chunk's channels, then those that nothing described before, then messages."""
        yield from inside.channels.values()
        # First and end byte of each message, shape (N,).
        plain = inside.plain
        begins, ends = np.array(inside.begins, np.int64), np.array(inside.ends, np.int64)
        if not len(begins):
            return
        heads = np.ndarray(len(plain) - _MESSAGE.size + 1, _MESSAGES, plain, strides=(1,))[begins]
        channels: dict[int, RawChannel] = {}
        numbers, counts = np.unique(heads["number"], return_counts=True)
        for number, count in zip(numbers.tolist(), counts.tolist(), strict=True):
            channel, is_new = self._channel(number)
            if channel is None:
                self.unknown += count
                continue
            if is_new:
                yield channel
            self.messages += count
            if self.topics is None or channel.topic in self.topics:
                channels[number] = channel
        if len(channels) < len(numbers):
            rows = np.isin(heads["number"], list(channels))
            heads, begins, ends = heads[rows], begins[rows], ends[rows]
        begins = begins + _MESSAGE.size
        found = RawMessages(plain, channels, heads, begins, ends)
        long = begins[ends - begins >= len(ZSTD_MAGIC)]
        starts = np.ndarray(max(0, len(plain) - 3), "<u4", plain, strides=(1,))[long]
        if np.any(starts == np.frombuffer(ZSTD_MAGIC, "<u4")):  # a recorder compressed it by itself
            yield from map(self._unpacked, found)
        else:
            yield found

    def _unpacked(self, message: RawMessage) -> RawMessage:
        if message.channel.encoding == "cdr" and message.data[:4] == ZSTD_MAGIC:
            with suppress(ValueError):  # a damaged one is that message's matter
                message.data = unpack_message(message.data, self.budget)
        return message

    def _lose(self, what: str, at: int | None = None, size: int = 0) -> None:
        self.budget.spent_records += DAMAGE_RECORDS  # reported in any case
        self.losses.append(Loss(what, at_byte=at, size=size))


def _parts_of_chunk(body: memoryview) -> tuple[int, int, str, int, memoryview]:
    """Return size and checksum of a chunk's records, compression, claimed size, packed bytes."""
    _, _, stated, crc, length = _CHUNK.unpack_from(body)
    at = _CHUNK.size + length
    compression = bytes(body[_CHUNK.size : at]).decode("ascii", "replace")
    (claimed,) = struct.unpack_from("<Q", body, at)
    return stated, crc, compression, claimed, body[at + 8 : at + 8 + claimed]
