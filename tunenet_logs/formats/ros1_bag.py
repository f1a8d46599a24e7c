"""Read ROS 1 bags (v2.0) as a record stream, bounded and checked, past damage.

By the stream and not by the index at the end: a killed `rosbag record` leaves none (`.bag.active`).
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from tunenet_logs.errors import LogError
from tunenet_logs.formats.base import (
    DAMAGED,
    Loss,
    RawChannel,
    RawMessage,
    Record,
    described,
)
from tunenet_logs.formats.budget import (
    CHUNK_RECORDS,
    DAMAGE_RECORDS,
    PART_RECORDS,
    Budget,
    OverBudgetError,
)
from tunenet_logs.formats.compression import MAX_PART_BYTES, unpack, unpack_start
from tunenet_logs.formats.ros1_records import (
    BAG,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    IN_CHUNKS,
    INDEX,
    Head,
    RecordFile,
    fields_of,
    head_at,
)
from tunenet_logs.progress import silent, teller
from tunenet_logs.regular_file import open_regular

# How a ROS bag begins, before its version.
MAGIC = b"#ROSBAG V"

_VERSION = b"2.0\n"  # the only version that is read; `rosbag filter` rewrites older ones
# What a record inside a chunk counts as: its head is a list of names, and each has 46 bytes.
_RECORD = 2

_COUNTED = {INDEX: 12, CHUNK_INFO: 8}  # bytes of each entry that such a record counts


def read_bag(
    path: Path,
    losses: list[Loss],
    topics: Sequence[str] | None = None,
    budget: Budget | None = None,
) -> Iterator[Record]:
    """Yield the records of a ROS 1 bag, closed or not; see `MessageFile`."""
    with open_regular(path) as file:
        version = file.read(len(MAGIC) + len(_VERSION))[len(MAGIC) :]
        if version != _VERSION:
            shown = version.split(b"\n")[0].decode("ascii", "replace")
            raise LogError(
                f"{path}: is a ROS bag of version {shown!r}, only 2.0 is read; "
                "rewrite it with `rosbag filter OLD.bag NEW.bag True`"
            )
        yield from _BagReading(path, file, losses, topics, budget).records()


class _BagReading:
    """One pass over a file."""

    def __init__(
        self,
        path: Path,
        file: BinaryIO,
        losses: list[Loss],
        topics: Sequence[str] | None,
        budget: Budget | None,
    ) -> None:
        self.path = path
        self.file = RecordFile(file)
        self.losses = losses
        self.topics = topics
        self.budget = budget or Budget(self.file.size)
        self.channels: dict[int, RawChannel] = {}
        self.index: dict[int, RawChannel] | None = None
        self.index_at = 0
        self.at = 0  # where the record begins that is read
        self.has_index = False
        self.chunks_stated = 0
        self.infos = 0
        self.stated = {INDEX: 0, CHUNK_INFO: 0}  # messages, as either counts them
        self.messages = 0  # of all topics, as far as they were read
        self.unknown = 0  # of them, those whose connection nothing describes

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
            self.budget.spend_records()
            try:
                head = self.file.head(at)
                if head.op == CHUNK:
                    at = yield from self._chunk(head, at)
                    continue
                if head.end > self.file.size:
                    raise ValueError(f"a record claims {head.data_bytes} bytes")
            except DAMAGED as error:
                at = self._past(at, described(error))
                continue
            yield from self._record(head, at)
            at = head.end
        return at

    def _record(self, head: Head, at: int) -> Sequence[Record]:
        try:
            if head.op in IN_CHUNKS:
                return self._parse(head, self.file.data(head))
            self._note(head)
        except DAMAGED as error:
            what = f"a damaged record was left out: {described(error)}"
            self._lose(what, at, head.end - at)
        return ()

    def _chunk(self, head: Head, at: int) -> Generator[Record, None, int]:
        """Yield a chunk's records and return where to go on.

        Raises:
            DAMAGED: its head is malformed, or it is one chunk too many.
        """
        self.budget.spend_records(CHUNK_RECORDS)
        stated = head.number(b"size")
        compression = head.fields[b"compression"].decode("ascii", "replace")
        if compression in ("", "none"):
            # Its records follow as any others do, so that a wrong size of it loses none of them.
            if stated != head.data_bytes:
                what = f"a chunk claims {stated} bytes and {head.data_bytes}"
                self.budget.spend_records(DAMAGE_RECORDS)
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
            self.budget.spend_records(_RECORD)
            try:
                head = head_at(plain, at)
                if head.end > len(plain) or head.op not in IN_CHUNKS:
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
            return self._connection(number, _described(head, bytes(data)))
        log_ns = head.time_ns()
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

    def _connection(self, number: int, channel: RawChannel) -> Sequence[Record]:
        known = self.channels.setdefault(number, channel)
        if known is channel:
            self.budget.spend_channel()
            self.budget.spend_definition(len(channel.schema))
            return (channel,)
        self.budget.spend_records(PART_RECORDS)
        if (known.topic, known.type_name, known.schema) != (
            channel.topic,
            channel.type_name,
            channel.schema,
        ):
            self._lose(f"connection {number} ({known.topic}) is described in two ways")
        return ()

    def _index(self) -> dict[int, RawChannel]:
        """Return the connections of the index at the file's end; empty where it is missing."""
        if self.index is None:
            self.index = {}
            at = self.index_at
            try:
                while 0 < at < self.file.size and (head := self.file.head(at)).op == CONNECTION:
                    self.budget.spend_records(PART_RECORDS)
                    channel = _described(head, self.file.data(head))
                    self.index.setdefault(head.number(b"conn"), channel)
                    at = head.end
            except DAMAGED:
                pass  # it is met again at its place, and reported there
        return self.index

    def _note(self, head: Head) -> None:
        """Register a bag header or index record.

        Raises:
            LogError: the bag is encrypted.
            DAMAGED: the record is malformed.
        """
        if head.op in _COUNTED:
            count = head.number(b"count")
            if count * _COUNTED[head.op] != head.data_bytes:
                raise ValueError(f"it counts {count} entries")
            if head.op == CHUNK_INFO:
                pairs = memoryview(self.file.data(head)).cast("I")
                count = sum(pairs[1::2])
                self.infos += 1
            self.stated[head.op] += count
        elif head.op == BAG:
            if head.fields.get(b"encryptor"):
                raise LogError(f"{self.path}: is encrypted; decrypt it first with `rosbag decrypt`")
            self.index_at = head.number(b"index_pos", 8)
            self.chunks_stated = head.number(b"chunk_count")
        else:
            raise ValueError(f"there is no record of kind {head.op}")

    def _past(self, at: int, why: str) -> int:
        """Return where the next record begins behind damage, else the file's end."""
        behind = self.file.find(at + 1)
        if behind < self.file.size:
            what = f"{why}; what follows was found again"
        else:
            what = "its last record is cut (a recording that did not end?)"
        self._lose(what, at, behind - at)
        return behind

    def _lose(self, what: str, at: int | None = None, size: int = 0) -> None:
        with suppress(OverBudgetError):  # what is lost is said in any case
            self.budget.spend_records(DAMAGE_RECORDS)
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
