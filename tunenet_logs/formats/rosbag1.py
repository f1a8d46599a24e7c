"""Read ROS 1 bags (v2.0) as a record stream, bounded and checked, past damage.

By the stream and not by the index at the end: a killed `rosbag record` leaves none (`.bag.active`).
Heads and fields of records come first, with the search for heads behind damage; then the one pass
over a file. After http://wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from tunenet_logs.errors import LogError
from tunenet_logs.files import open_regular
from tunenet_logs.formats.base import (
    CHUNK_RECORDS,
    DAMAGE_RECORDS,
    DAMAGED,
    PART_RECORDS,
    Budget,
    Loss,
    OverBudgetError,
    RawChannel,
    RawMessage,
    Record,
    Topics,
    block_sizes,
    described,
)
from tunenet_logs.formats.compressed import MAX_PART_BYTES, unpack, unpack_start
from tunenet_logs.terminal import silent, teller

# The kinds of records, by the byte that a head's field `op` holds; and which a chunk may hold.
MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)
_IN_CHUNKS = frozenset((MESSAGE, CONNECTION))
# A head names a topic at most; what a message is like lies in a record's data.
_MAX_HEAD_BYTES = 64 * 1024
# A length [bytes], little-endian, as it stands before every head, field and data.
_U32 = struct.Struct("<I")
# The fields that a head of each kind must have, to be taken for one behind damage.
_NEEDED = {
    MESSAGE: (b"conn", b"time"),
    INDEX: (b"conn", b"count"),
    CHUNK: (b"compression", b"size"),
    CHUNK_INFO: (b"chunk_pos", b"count"),
    CONNECTION: (b"conn", b"topic"),
}
# A head's field `op` as it is stored: its length (three letters and the value), and its name.
_MARK = b"\x04\x00\x00\x00op="
_OVERLAP_BYTES = 4 * 1024  # how long a head may be to be found; common to two blocks searched


@dataclass(frozen=True, slots=True)
class Head:
    """A record's head."""

    op: int
    fields: Mapping[bytes, bytes]
    data_at: int  # first byte of its data, in the buffer that it was read from
    data_bytes: int  # claimed length of its data, unchecked

    @property
    def end(self) -> int:
        """First byte of the next record."""
        return self.data_at + self.data_bytes

    def number(self, name: bytes, form: str = "<I") -> int:
        """Return a field as a number; raise KeyError, struct.error where it is none."""
        return struct.unpack(form, self.fields[name])[0]


def head_at(buffer: bytes | memoryview, at: int = 0) -> Head:
    """Parse the head of a record; raise ValueError, LookupError, struct.error for none."""
    (length,) = _U32.unpack_from(buffer, at)
    if length > _MAX_HEAD_BYTES:
        raise ValueError(f"a head claims {length} bytes")
    start = at + _U32.size
    (data_bytes,) = _U32.unpack_from(buffer, start + length)
    fields = fields_of(bytes(buffer[start : start + length]))
    (op,) = fields[b"op"]
    return Head(op, fields, start + length + _U32.size, data_bytes)


def fields_of(data: bytes) -> dict[bytes, bytes]:
    """Parse the name=value fields of a head, or of a connection's data; raises as `head_at`."""
    fields: dict[bytes, bytes] = {}
    at = 0
    while at < len(data):
        (length,) = _U32.unpack_from(data, at)
        at += _U32.size
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
        self._tries = 20_000  # places to examine: a file of nothing but marks must not take hours
        self.size = os.fstat(file.fileno()).st_size

    def block(self, at: int, length: int) -> bytes:
        """Read bytes at a place, fewer at the file's end."""
        self._file.seek(at)
        return self._file.read(length)

    def head(self, at: int) -> Head:
        """Parse the head of the record at a place in the file; raises as `head_at`."""
        block = self.block(at, 256)  # only a head with a long topic needs a second reading
        (length,) = _U32.unpack_from(block)
        if length + 2 * _U32.size > len(block):
            block = self.block(at, min(length, _MAX_HEAD_BYTES) + 2 * _U32.size)
        head = head_at(block)
        return Head(head.op, head.fields, at + head.data_at, head.data_bytes)

    def data(self, head: Head) -> bytes:
        """Read a record's data; raise ValueError if it is too large, or behind the file's end."""
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
        for length in block_sizes():
            if start >= self.size:
                break
            block = self.block(start, length + _OVERLAP_BYTES)
            found = self.find_in(block, 0)
            while found < len(block):
                head = self.head(start + found)
                # One that a chunk may hold, too, may be a fragment of an LZ4 chunk.
                if head.op not in _IN_CHUNKS or self.is_border(head.end):
                    return start + found
                found = self.find_in(block, found + 1)
            start += length
        return self.size

    def find_in(self, buffer: bytes, start: int) -> int:
        """Find the first record from `start` on, as far as its head is intact; else the end."""
        mark = buffer.find(_MARK, start)
        while mark >= 0 and self._tries > 0:
            self._tries -= 1
            for at in range(mark - 4, mark - 64, -1):  # others write little before that field
                if at >= start and _is_head(buffer, at, mark):
                    return at
            mark = buffer.find(_MARK, mark + 1)
        return len(buffer)


def _is_head(buffer: bytes, at: int, mark: int) -> bool:
    (length,) = _U32.unpack_from(buffer, at)
    if not mark + len(_MARK) < at + _U32.size + length <= at + _OVERLAP_BYTES:
        return False
    try:
        head = head_at(buffer, at)
    except (ValueError, LookupError, struct.error):
        return False
    return all(name in head.fields for name in _NEEDED.get(head.op, (b"",)))


# ---- Read a bag in one pass.

MAGIC = b"#ROSBAG V"  # begins a bag, before its version
_VERSION = b"2.0\n"  # the only version that is read; `rosbag filter` rewrites older ones
_COUNTED = {INDEX: 12, CHUNK_INFO: 8}  # bytes of each entry that such a record counts


def read_bag(
    path: Path, losses: list[Loss], topics: Topics = None, budget: Budget | None = None
) -> Iterator[Record]:
    """Yield the records of a ROS 1 bag, closed or not; see `Container`."""
    with open_regular(path) as file:
        version = file.read(len(MAGIC) + len(_VERSION))[len(MAGIC) :]
        if version != _VERSION:
            shown = version.split(b"\n")[0].decode("ascii", "replace")
            raise LogError(
                f"{path}: is a ROS bag of version {shown!r}, only 2.0 is read; "
                "rewrite it with `rosbag filter OLD.bag NEW.bag True`"
            )
        records = RecordFile(file)
        budget = budget or Budget(records.size)
        yield from _BagReading(path, records, losses, topics, budget).records()


@dataclass(eq=False)
class _BagReading:
    """One pass over a file."""

    path: Path
    file: RecordFile
    losses: list[Loss]
    topics: Topics
    budget: Budget
    channels: dict[int, RawChannel] = field(default_factory=dict)
    index: dict[int, RawChannel] | None = None
    index_at: int = 0
    at: int = 0  # where the record begins that is read
    has_index: bool = False
    chunks_stated: int = 0
    infos: int = 0
    # Messages, as either kind of records counts them.
    stated: dict[int, int] = field(default_factory=lambda: {INDEX: 0, CHUNK_INFO: 0})
    messages: int = 0  # of all topics, as far as they were read
    unknown: int = 0  # of them, those whose connection nothing describes

    def records(self) -> Iterator[Record]:
        try:
            at = yield from self._until_the_end()
        except OverBudgetError as error:
            what = f"reading stopped, as {error}; what follows was left out"
            self._lose(what, self.at, self.file.size - self.at)
            return
        self.has_index |= at == self.index_at
        if not self.has_index or self.infos < self.chunks_stated:
            self._lose("the index at the end is missing (a recording that did not end?)")
        what = "a ROS 1 bag carries no checksum, so its integrity cannot be vouched for"
        self.losses.append(Loss(what, harmless=True))
        if self.unknown:
            self._lose(f"{self.unknown} messages belong to connections that nothing describes")
        stated = self.stated[CHUNK_INFO] or self.stated[INDEX]
        missing = stated - self.messages - self.unknown
        if missing > 0:
            self._lose(f"{missing} of {stated} messages are missing")

    def _until_the_end(self) -> Generator[Record, None, int]:
        """Yield the records in file order and return their end; raise OverBudgetError."""
        at = len(MAGIC) + len(_VERSION)
        tell = teller("reading") if self.topics is None else silent
        while at < self.file.size:
            self.at = at
            tell(self.budget.share(at))
            self.has_index |= at == self.index_at
            self.budget.spend(records=1)
            try:
                head = self.file.head(at)
                if head.op == CHUNK:
                    at = yield from self._chunk(head, at)
                    continue
                if head.end > self.file.size:
                    raise ValueError(f"a record claims {head.data_bytes} bytes")
            except DAMAGED as error:
                behind = self.file.find(at + 1)
                what = f"{described(error)}; what follows was found again"
                if behind == self.file.size:
                    what = "its last record is cut (a recording that did not end?)"
                self._lose(what, at, behind - at)
                at = behind
                continue
            yield from self._record(head, at)
            at = head.end
        return at

    def _record(self, head: Head, at: int) -> Sequence[Record]:
        try:
            if head.op in _IN_CHUNKS:
                return self._parse(head, self.file.data(head))
            # A bag header or an index record.
            if head.op in _COUNTED:
                count = head.number(b"count")
                if count * _COUNTED[head.op] != head.data_bytes:
                    raise ValueError(f"it counts {count} entries")
                if head.op == CHUNK_INFO:
                    count = sum(memoryview(self.file.data(head)).cast("I")[1::2])
                    self.infos += 1
                self.stated[head.op] += count
            elif head.op != BAG:
                raise ValueError(f"there is no record of kind {head.op}")
            elif head.fields.get(b"encryptor"):
                raise LogError(f"{self.path}: is encrypted; decrypt it first with `rosbag decrypt`")
            else:
                self.index_at = head.number(b"index_pos", "<Q")
                self.chunks_stated = head.number(b"chunk_count")
        except DAMAGED as error:
            what = f"a damaged record was left out: {described(error)}"
            self._lose(what, at, head.end - at)
        return ()

    def _chunk(self, head: Head, at: int) -> Generator[Record, None, int]:
        """Yield a chunk's records and return where to go on; raise DAMAGED for a malformed head."""
        self.budget.spend(records=CHUNK_RECORDS)
        stated = head.number(b"size")
        compression = head.fields[b"compression"].decode("ascii", "replace")
        if compression in ("", "none"):
            # Its records follow as any others do, so that a wrong size of it loses none of them.
            if stated != head.data_bytes:
                what = f"a chunk claims {stated} bytes and {head.data_bytes}"
                self.budget.spent_records += DAMAGE_RECORDS  # reported in any case
                self.losses.append(Loss(what, at_byte=at, harmless=True))
            return head.data_at
        if head.end > self.file.size or not head.data_bytes:  # cut, or never closed
            end = self.file.find(head.data_at)
            data = self.file.block(head.data_at, min(end - head.data_at, MAX_PART_BYTES))
            plain = unpack_start(data, compression, MAX_PART_BYTES)
            self.budget.spend(len(plain))
            self._lose("a chunk is cut; it was read as far as it goes", at, end - at)
            yield from self._inside(plain)
            return end
        try:
            if stated <= MAX_PART_BYTES:
                self.budget.spend(stated)
            plain = bytes(unpack(self.file.data(head), compression, stated))
        except DAMAGED as error:
            end = head.end if self.file.is_border(head.end) else self.file.find(head.data_at)
            self._lose(f"a damaged chunk was left out: {described(error)}", at, end - at)
            return end
        lost = yield from self._inside(plain)
        if lost:
            self._lose(f"{lost} bytes of an unpacked chunk are damaged", at, head.end - at)
        return head.end

    def _inside(self, plain: bytes) -> Generator[Record, None, int]:
        """Yield the records of a decompressed chunk and return its number of damaged bytes."""
        at = lost = 0
        while at < len(plain):
            self.budget.spend(records=2)  # its head is a list of names, and each has 46 bytes
            try:
                head = head_at(plain, at)
                if head.end > len(plain) or head.op not in _IN_CHUNKS:
                    raise ValueError("no such record can be in a chunk")
                found = self._parse(head, memoryview(plain)[head.data_at : head.end])
            except DAMAGED:
                behind = self.file.find_in(plain, at + 1)
                lost += behind - at
                at = behind
                continue
            yield from found
            at = head.end
        return lost

    def _parse(self, head: Head, data: bytes | memoryview) -> Sequence[Record]:
        number = head.number(b"conn")
        if head.op == CONNECTION:
            channel = _described(head, bytes(data))
            known = self.channels.setdefault(number, channel)
            if known is channel:
                self.budget.spend(records=PART_RECORDS, channels=1, definition=channel.schema)
                return (channel,)
            self.budget.spend(records=PART_RECORDS)
            said = {(one.topic, one.type_name, one.schema) for one in (known, channel)}
            if len(said) > 1:
                self._lose(f"connection {number} ({known.topic}) is described in two ways")
            return ()
        seconds, nanoseconds = struct.unpack("<II", head.fields[b"time"])
        log_ns = seconds * 1_000_000_000 + nanoseconds
        found: list[Record] = []
        channel = self.channels.get(number)
        if channel is None:
            channel = self._index().get(number)
            if channel is None:
                self.unknown += 1
                return ()
            self.channels[number] = channel
            found.append(channel)
        self.messages += 1
        if self.topics is None or channel.topic in self.topics:
            found.append(RawMessage(channel, log_ns, data, log_ns))
        return found

    def _index(self) -> dict[int, RawChannel]:
        """Return the connections of the index at the file's end; empty where it is missing."""
        if self.index is None:
            self.index = {}
            at = self.index_at
            try:
                while 0 < at < self.file.size and (head := self.file.head(at)).op == CONNECTION:
                    self.budget.spend(records=PART_RECORDS)
                    channel = _described(head, self.file.data(head))
                    self.index.setdefault(head.number(b"conn"), channel)
                    at = head.end
            except DAMAGED:
                pass  # it is met again at its place, and reported there
        return self.index

    def _lose(self, what: str, at: int | None = None, size: int = 0) -> None:
        self.budget.spent_records += DAMAGE_RECORDS  # reported in any case
        self.losses.append(Loss(what, at_byte=at, size=size))


def _described(head: Head, data: bytes) -> RawChannel:
    fields = fields_of(data)
    extra = {
        name.decode("ascii", "replace"): value.decode("utf-8", "replace")
        for name, value in fields.items()
        if name not in (b"topic", b"type", b"message_definition")
    }
    return RawChannel(
        topic=head.fields[b"topic"].decode(),
        type_name=fields[b"type"].decode(),
        encoding="ros1",
        schema_encoding="ros1msg",
        schema=fields[b"message_definition"],
        metadata=extra,
    )
