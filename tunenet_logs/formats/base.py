"""Records, losses, limits and message structure that all containers and encodings share.

A `Container` takes a file apart into `Record`s, within a `Budget`; what it cannot read becomes a
`Loss`. A `Decode` turns a message's bytes into an object, and `Structure` describes its type.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

# What parsers raise on bytes that are not what they say they are, found by fuzzing them.
DAMAGED = (
    struct.error,
    ValueError,  # UnicodeDecodeError and binascii.Error too
    TypeError,
    AttributeError,
    LookupError,
    OverflowError,
    MemoryError,
    RecursionError,
    EOFError,
)


class BeyondLimitError(ValueError):
    """A message that may be intact, but is larger than the limit."""


class UnusableError(Exception):
    """The messages of a channel cannot be used, and why; shown by `tunenet-logs info`."""


class MessageError(Exception):
    """One message cannot be used; such messages are counted."""


# From a message's bytes to an object with its fields. Raises MessageError.
Decode = Callable[[bytes | memoryview], Any]


@dataclass(frozen=True, eq=False)
class RawChannel:
    """A channel as its container describes it; compared by identity.

    Attributes:
        type_name: as written in the container ("sensor_msgs/JointState" in ROS 1).
        encoding: of the messages: "cdr", "ros1", "protobuf", "json", ...
        schema_encoding: of `schema`: "ros2msg", "ros2idl", "ros1msg", "protobuf", ... "" where the
            container holds none.
        metadata: other key-value pairs of the channel, kept for a copy.
    """

    topic: str
    type_name: str
    encoding: str
    schema_encoding: str = ""
    schema: bytes = b""
    metadata: Mapping[str, str] = field(default_factory=dict)


@dataclass(slots=True)
class RawMessage:
    """One undecoded message; times in ns, of any size until they are checked."""

    channel: RawChannel
    log_ns: int
    data: bytes | memoryview
    publish_ns: int = 0
    sequence: int = 0


@dataclass(eq=False)
class RawMessages:
    """Undecoded messages in one contiguous buffer, in file order.

    Attributes:
        plain: the buffer.
        channels: by number.
        heads: channel number, sequence, log_ns and publish_ns of each message, shape (N,).
        begins: first byte of each message in `plain`, shape (N,).
        ends: end byte of each message, shape (N,).
    """

    plain: memoryview
    channels: Mapping[int, RawChannel]
    heads: NDArray[np.void]
    begins: NDArray[np.int64]
    ends: NDArray[np.int64]

    def __iter__(self) -> Iterator[RawMessage]:
        """Yield the messages one by one."""
        places = zip(self.heads.tolist(), self.begins.tolist(), self.ends.tolist(), strict=True)
        for (number, sequence, log_ns, publish_ns), begin, end in places:
            data = self.plain[begin:end]
            yield RawMessage(self.channels[number], log_ns, data, publish_ns, sequence)

    def rows(self, places: NDArray[np.intp], size: int) -> NDArray[np.uint8]:
        """Gather the bytes of the messages at `places`, all of `size` bytes, shape (R, size)."""
        starts = np.ndarray(
            len(self.plain) - size + 1, np.dtype((np.void, size)), self.plain, strides=(1,)
        )
        return starts[self.begins[places]].view(np.uint8).reshape(len(places), size)

    def by_channel(self) -> Iterator[tuple[RawChannel, RawMessages]]:
        """Yield each channel with its own messages, in file order."""
        numbers = np.unique(self.heads["number"]).tolist()
        for number in numbers:
            own = self
            if len(numbers) > 1:
                rows = self.heads["number"] == number
                parts = (self.heads[rows], self.begins[rows], self.ends[rows])
                own = RawMessages(self.plain, self.channels, *parts)
            yield self.channels[number], own


@dataclass(frozen=True)
class RawMetadata:
    """A named set of key-value pairs of the whole log."""

    name: str
    values: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class RawAttachment:
    """A file embedded in the log. Its name is a plain name, never a path."""

    name: str
    media_type: str
    data: bytes
    log_ns: int
    create_ns: int


# What a container is taken apart into.
Record = RawChannel | RawMessage | RawMessages | RawMetadata | RawAttachment


def one_by_one(records: Iterable[Record]) -> Iterator[Record]:
    """Yield the records with batches of messages split into single ones."""
    for record in records:
        if isinstance(record, RawMessages):
            yield from record
        else:
            yield record


@dataclass(frozen=True)
class Loss:
    """Data of a log that is missing, unreadable, or of unverified integrity.

    Attributes:
        what: description, without the place.
        file: name of the file, where the log has several; else "".
        at_byte: where it begins; None for the whole file.
        size: bytes concerned.
        messages: number of messages lost; None where only the size is known.
        harmless: whether all messages were read nevertheless.
        taints: whether messages that were read may have been changed.
    """

    what: str
    file: str = ""
    at_byte: int | None = None
    size: int = 0
    messages: int | None = None
    harmless: bool = False
    taints: bool = False

    def __str__(self) -> str:
        """Format the loss with its place."""
        text = f"{self.file}: {self.what}" if self.file else self.what
        if self.at_byte is None:
            return text
        if not self.size:
            return f"{text} (at byte {self.at_byte})"
        return f"{text} (bytes {self.at_byte} to {self.at_byte + self.size})"


def lost_share(losses: Iterable[Loss], read: int, size: int) -> float:
    """Return the lost fraction of a log, by messages where they are counted, else by bytes.

    Args:
        losses: all of them.
        read: messages that were read.
        size: of the file [bytes].
    """
    harm = [loss for loss in losses if not loss.harmless]
    known = [loss.messages for loss in harm if loss.messages is not None]
    if known:
        return sum(known) / max(1, sum(known) + read)
    return min(1.0, sum(loss.size for loss in harm) / max(1, size))


class Container(Protocol):
    """Reader of one kind of file."""

    def __call__(
        self, path: Path, losses: list[Loss], topics: Sequence[str] | None = None
    ) -> Iterator[Record]:
        """Yield the records in file order, each channel before its messages.

        Every size is checked before it is trusted. Damaged records are left out and added to
        `losses`.

        Args:
            path: the file, or the folder of a log in several files.
            losses: filled while reading.
            topics: yield only messages of these; None for all.

        Raises:
            LogError: nothing of it can be read.
            OSError: the disk fails.
        """
        ...


def described(error: BaseException) -> str:
    """Format a library's error as a clause of at most 120 characters."""
    return " ".join(str(error).split())[:120] or type(error).__name__


# ---- Resource budget: bound what reading one log may cost.
# A file of a megabyte can claim a hundred million records, or as many places of damage. What is
# over the budget is left out, and a loss says from where on.

_FREE_BYTES = 1024 * 1024 * 1024  # what any file may unpack to in all, however small it is
_MAX_RATIO = 256  # bytes unpacked for each byte of the file, beyond these: messages pack by less
_FREE_RECORDS = 250_000  # of any file, however small it is
# Of the file, for each record beyond these: a message has 31 bytes before it is compressed, and its
# entry in most indexes 16.
_BYTES_A_RECORD = 4
MAX_CHANNELS = 10_000  # of a log; robots have hundreds
# Of types, in a log; all that ROS has are a megabyte, and a bag repeats them for each topic.
_MAX_DEFINITION_BYTES = 128 * 1024 * 1024

CHUNK_RECORDS = 10  # what opening a chunk counts as
PART_RECORDS = 20  # what a record counts as that is parsed field by field: a channel, metadata
DAMAGE_RECORDS = 50  # what a damaged place counts as: its end is searched, and it is reported


class OverBudgetError(Exception):
    """Reading stopped because the log exceeds its budget."""


@dataclass
class Budget:
    """Resource budget of one log, proportional to its size.

    Attributes:
        file_bytes: size of the log.
        spent_bytes: bytes decompressed so far.
        spent_records: records read so far, or work of the same cost.
        channels: number of channels described so far.
        definition_bytes: size of their type definitions.
        files_bytes: size of the files of the log that were read before.
    """

    file_bytes: int
    spent_bytes: int = 0
    spent_records: int = 0
    channels: int = 0
    definition_bytes: int = 0
    files_bytes: int = 0

    def share(self, read: int) -> float:
        """Return the fraction of the log read, with `read` bytes of the current file."""
        return (self.files_bytes + read) / max(self.file_bytes, 1)

    @property
    def left_records(self) -> int:
        """Number of records that may still be read; negative once over budget."""
        return _FREE_RECORDS + self.file_bytes // _BYTES_A_RECORD - self.spent_records

    def spend(self, count: int) -> None:
        """Charge `count` bytes about to be decompressed.

        Raises:
            OverBudgetError: the log decompresses to more than the limit.
        """
        self.spent_bytes += count
        if self.spent_bytes > _FREE_BYTES + _MAX_RATIO * self.file_bytes:
            raise OverBudgetError(f"the log unpacks to more than {_MAX_RATIO} times its size")

    def spend_records(self, count: int = 1) -> None:
        """Charge records, or work of the same cost.

        Raises:
            OverBudgetError: they exceed the limit for the log's size.
        """
        self.spent_records += count
        if self.left_records < 0:
            raise OverBudgetError("it holds far more records than a log of its size")

    def spend_definition(self, count: int) -> None:
        """Charge `count` bytes of a type definition.

        Raises:
            OverBudgetError: all definitions exceed the limit.
        """
        self.definition_bytes += count
        if self.definition_bytes > _MAX_DEFINITION_BYTES:
            raise OverBudgetError(f"it has over {_MAX_DEFINITION_BYTES} bytes of definitions")

    def spend_channel(self) -> None:
        """Charge a channel.

        Raises:
            OverBudgetError: there are more than `MAX_CHANNELS`.
        """
        self.channels += 1
        self.spend_records(PART_RECORDS)
        if self.channels > MAX_CHANNELS:
            raise OverBudgetError(f"it has over {MAX_CHANNELS} channels")


# ---- Stamps in messages of ROS 1, ROS 2, protobuf and JSON.

# What ROS 2, protobuf, Foxglove's JSON and ROS 1 call the parts of a time.
STAMP_FIELDS = (("sec", "nanosec"), ("seconds", "nanos"), ("sec", "nsec"), ("secs", "nsecs"))


def time_ns(time: Any) -> int:
    """Convert a time of ROS, protobuf or JSON to ns.

    Raises:
        ValueError: it has no known pair of fields.
    """
    for whole, part in STAMP_FIELDS:
        if hasattr(time, whole) and hasattr(time, part):
            return int(getattr(time, whole)) * 1_000_000_000 + int(getattr(time, part))
    raise ValueError("it holds no time that is understood")


def ros_stamp_ns(message: Any) -> int:
    """Return the stamp of a message's header [ns]."""
    stamp = message.header.stamp
    try:
        return stamp.sec * 1_000_000_000 + stamp.nanosec
    except AttributeError:
        return time_ns(stamp)


# ---- Structure of message types, in any encoding: fields, lists, numbers, texts.

_MAX_LISTED = 200  # fields listed of a type


class Plain(Enum):
    """A leaf of a structure."""

    NUMBER = "a number"
    WHOLE = "a whole number"
    FLAG = "a flag"
    TEXT = "a text"
    OTHER = "nothing that is read"


@dataclass(frozen=True, eq=False)
class Structure:
    """A message, or a part of one, with fields.

    Attributes:
        name: of its type, "" where it has none.
        fields: by name, in their order.
    """

    name: str
    fields: Mapping[str, Node]

    @property
    def is_time(self) -> bool:
        """Whether it is a time in seconds and nanoseconds."""
        return any(set(self.fields) == set(pair) for pair in STAMP_FIELDS)

    @property
    def is_place(self) -> bool:
        """Whether it is a position x, y, z, and no quaternion."""
        return "w" not in self.fields and all(
            self.fields.get(axis) in NUMBERS for axis in ("x", "y", "z")
        )


@dataclass(frozen=True, eq=False)
class Listed:
    """A list of equal parts.

    Attributes:
        of: each part.
        count: fixed length; None where it varies.
    """

    of: Node
    count: int | None = None


Node = Structure | Listed | Plain  # a message, or a part of one
NUMBERS = (Plain.NUMBER, Plain.WHOLE)  # what may be measured


class NotThereError(LookupError):
    """A field that a type lacks, named by the message."""


def node_at(top: Structure, steps: tuple[str | int, ...]) -> Node:
    """Return the part of a type at a path.

    Args:
        top: the type.
        steps: names of fields, and numbers in lists from 0.

    Raises:
        NotThereError: the type has no such part.
    """
    node: Node = top
    for step in steps:
        if isinstance(step, int):
            if not isinstance(node, Listed) or (node.count is not None and step >= node.count):
                raise NotThereError(f"[{step}]")
            node = node.of
        else:
            if not isinstance(node, Structure) or step not in node.fields:
                raise NotThereError(step)
            node = node.fields[step]
    return node


def numbers_in(node: Node, prefix: str = "") -> list[str]:
    """List the numeric and time fields of a type, as `--columns` names them; 200 at most."""
    found: list[str] = []
    for path in _numbers(node, prefix):
        if len(found) == _MAX_LISTED:
            break
        found.append(path)
    return found


def likely_field(fields: Sequence[str]) -> str:
    """Return the field most likely meant: the first z, else the last."""
    return next((field for field in fields if field.split(".")[-1] == "z"), fields[-1])


def _numbers(node: Node, path: str) -> Iterator[str]:
    if isinstance(node, Listed):
        yield from _numbers(node.of, f"{path}[0]")
    elif isinstance(node, Structure) and node.is_time:
        yield path
    elif isinstance(node, Structure):
        for name, inner in node.fields.items():
            yield from _numbers(inner, f"{path}.{name}" if path else name)
    elif node in NUMBERS:
        yield path
