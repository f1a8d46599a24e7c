"""Records, losses, limits and message structure that all containers and encodings share.

A `Container` takes a file apart into `Record`s, within a `Budget`; what it cannot read becomes a
`Loss`. A `Decode` turns a message's bytes into an object, and `Structure` describes its type.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from operator import attrgetter
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

# What parsers raise on bytes that are not what they say they are, found by fuzzing them;
# UnicodeDecodeError and binascii.Error are ValueErrors.
DAMAGED = (
    *(struct.error, ValueError, TypeError, AttributeError, LookupError),
    *(OverflowError, MemoryError, RecursionError, EOFError),
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
    """A channel as its container describes it; compared by identity."""

    topic: str
    type_name: str  # as written in the container ("sensor_msgs/JointState" in ROS 1)
    encoding: str  # of the messages: "cdr", "ros1", "protobuf", "json", ...
    schema_encoding: str = ""  # "ros2msg", "protobuf", ...; "" where the container holds none
    schema: bytes = b""
    metadata: Mapping[str, str] = field(default_factory=dict)  # kept for a copy


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
    """Undecoded messages in one contiguous buffer, in file order."""

    plain: memoryview
    channels: Mapping[int, RawChannel]  # by number
    # channel number, sequence, log_ns and publish_ns of each message, shape (N,)
    heads: NDArray[np.void]
    # first byte of each message in `plain`, shape (N,), and in `ends` the end byte
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
        yield from record if isinstance(record, RawMessages) else (record,)


@dataclass(frozen=True)
class Loss:
    """Data of a log that is missing, unreadable, or of unverified integrity."""

    what: str  # without the place
    file: str = ""  # its name, where the log has several
    at_byte: int | None = None  # where it begins; None for the whole file
    size: int = 0  # bytes concerned
    messages: int | None = None  # lost; None where only the size is known
    harmless: bool = False  # whether all messages were read nevertheless
    taints: bool = False  # whether messages that were read may have been changed

    def __str__(self) -> str:
        """Format the loss with its place."""
        text = f"{self.file}: {self.what}" if self.file else self.what
        if self.at_byte is None:
            return text
        if not self.size:
            return f"{text} (at byte {self.at_byte})"
        return f"{text} (bytes {self.at_byte} to {self.at_byte + self.size})"


def lost_share(losses: Iterable[Loss], read: int, size: int) -> float:
    """Return the lost fraction of a log of `size` bytes: by messages if counted, else by bytes."""
    harm = [loss for loss in losses if not loss.harmless]
    known = [loss.messages for loss in harm if loss.messages is not None]
    if known:
        return sum(known) / max(1, sum(known) + read)
    return min(1.0, sum(loss.size for loss in harm) / max(1, size))


Topics = Sequence[str] | None  # of which messages are read; None for all


class Container(Protocol):
    """Reader of one kind of log."""

    def __call__(
        self, path: Path, losses: list[Loss], topics: Topics = None, budget: Budget | None = None
    ) -> Iterator[Record]:
        """Yield the records in file order, each channel before its messages.

        Every size is checked before it is trusted. Damaged records are left out and added to
        `losses`; `budget` is what is left, where the file was unpacked or is one of several.

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
_BYTES_A_RECORD = 4  # of the file, for each record beyond: a message has 31 before it is compressed
MAX_CHANNELS = 10_000  # of a log; robots have hundreds
# Of types, in a log; all that ROS has are a megabyte, and a bag repeats them for each topic.
_MAX_DEFINITION_BYTES = 128 * 1024 * 1024
# What counts as so many records: opening a chunk; what is parsed field by field, as a channel or
# metadata; a damaged place, whose end is searched, and which is reported.
CHUNK_RECORDS, PART_RECORDS, DAMAGE_RECORDS = 10, 20, 50


class OverBudgetError(Exception):
    """Reading stopped because the log exceeds its budget."""


def block_sizes() -> Iterator[int]:
    """Yield sizes of blocks [bytes] to search one by one: what is sought is near, mostly."""
    size = 4 * 1024
    while True:
        yield size
        size = min(2 * size, 1024 * 1024)


@dataclass
class Budget:
    """Resource budget of one log, in proportion to its size."""

    file_bytes: int  # size of the log
    spent_bytes: int = 0  # decompressed so far
    spent_records: int = 0  # read so far, or work of the same cost
    channels: int = 0  # described so far
    definition_bytes: int = 0  # of their types
    files_bytes: int = 0  # size of the files of the log that were read before

    def share(self, read: int) -> float:
        """Return the fraction of the log read, with `read` bytes of the current file."""
        return (self.files_bytes + read) / max(self.file_bytes, 1)

    @property
    def left_records(self) -> int:
        """Number of records that may still be read; negative once over budget."""
        return _FREE_RECORDS + self.file_bytes // _BYTES_A_RECORD - self.spent_records

    def spend(
        self,
        unpacked: int = 0,
        *,
        records: int = 0,
        channels: int = 0,
        definition: bytes | str = b"",
    ) -> None:
        """Charge bytes about to be decompressed, records or as much work; raise OverBudgetError."""
        self.spent_bytes += unpacked
        self.spent_records += records
        self.channels += channels
        self.definition_bytes += len(definition)
        if self.spent_bytes > _FREE_BYTES + _MAX_RATIO * self.file_bytes:
            raise OverBudgetError(f"the log unpacks to more than {_MAX_RATIO} times its size")
        if self.left_records < 0:
            raise OverBudgetError("it holds far more records than a log of its size")
        if self.channels > MAX_CHANNELS:
            raise OverBudgetError(f"it has over {MAX_CHANNELS} channels")
        if self.definition_bytes > _MAX_DEFINITION_BYTES:
            raise OverBudgetError(f"it has over {_MAX_DEFINITION_BYTES} bytes of definitions")


# ---- Names of message types


def ros_name(type_name: str) -> str:
    """Return a type name as ROS 2 writes it, "sensor_msgs/msg/JointState", from ROS 1 or IDL."""
    package, _, name = type_name.replace("::", "/").partition("/")
    if name and "/" not in name:
        name = f"msg/{name}"
    full = f"{package}/{name}" if name else package
    # ROS 1 moved this one to another package.
    return "tf2_msgs/msg/TFMessage" if full == "tf/msg/tfMessage" else full


def type_key(type_name: str) -> str:
    """Return the canonical name of a type, be it written by ROS 1, ROS 2 or Foxglove."""
    name = ros_name(type_name)
    package, _, plain = name.rpartition("/msg/")
    return f"foxglove.{plain}" if package in ("foxglove_msgs", "foxglove") else name


# ---- Stamps in messages of ROS 1, ROS 2, protobuf and JSON.

# What ROS 2, protobuf, Foxglove's JSON and ROS 1 call the parts of a time.
STAMP_FIELDS = (("sec", "nanosec"), ("seconds", "nanos"), ("sec", "nsec"), ("secs", "nsecs"))


def time_ns(time: Any) -> int:
    """Convert a time of ROS, protobuf or JSON to ns; raise ValueError for no known fields."""
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

MAX_NODES = 5000  # parts of a type or message that are looked at, lists of any length aside


class Plain(Enum):
    """A leaf of a structure; the value describes it in messages."""

    NUMBER = "a number"
    WHOLE = "a whole number"
    FLAG = "true, false, 1 or 0"
    TEXT = "a text"
    DATA = "bytes"
    OTHER = "nothing that is read"
    # What is asked of a type alone:
    OPTIONAL = "a number that may be absent"
    TIME = "a time in seconds and nanoseconds"


@dataclass(frozen=True, eq=False)
class Structure:
    """A message, or a part of one, with fields."""

    name: str  # of its type, "" where it has none
    fields: Mapping[str, Node]  # by name, in their order
    # fields whose absence shows, in protobuf; None where no field can be absent
    can_lack: frozenset[str] | None = None

    @property
    def is_time(self) -> bool:
        """Whether it is a time in seconds and nanoseconds."""
        return any(set(self.fields) == set(pair) for pair in STAMP_FIELDS)

    @property
    def is_place(self) -> bool:
        """Whether it is a position x, y, z, and no quaternion."""
        return "w" not in self.fields and all(self.fields.get(axis) in NUMBERS for axis in "xyz")


@dataclass(frozen=True, eq=False)
class Listed:
    """A list of equal parts, `count` of them; None where that varies."""

    of: Node
    count: int | None = None


@dataclass(frozen=True, eq=False)
class Maybe:
    """A part that is asked of a type, but may be absent or of another kind."""

    of: Node


Node = Structure | Listed | Plain | Maybe  # a message, or a part of one
NUMBERS = (Plain.NUMBER, Plain.WHOLE)  # what may be measured
# Decodes those of many messages, shape (R, L), that share the first one's layout: a message whose
# numbers are arrays of shape (N, ...), and of which rows these are, shape (R,).
StackedDecoder = Callable[[NDArray[np.uint8]], tuple[Any, NDArray[np.bool_]]]
# Where a part of a message is: names of fields, and numbers in lists from 0.
Steps = tuple[str | int, ...]


@dataclass(frozen=True)
class AnyType:
    """Structure and decoder of the messages of one type."""

    structure: Structure | None  # fields of the type; None where only a message shows them (JSON)
    decode: Decode
    checks_presence: bool = False  # whether an absent field reads as zero, as in protobuf
    # decoder of many messages at once (`ros.stacked_decoder`), where there is one
    stacked: StackedDecoder | None = None

    def getter(self, steps: Steps) -> Callable[[Any], Any]:
        """Return a function that gets the part at `steps`, or LookupError, AttributeError."""
        is_plain = bool(steps) and not any(isinstance(one, int) or "." in one for one in steps)
        if is_plain and not self.checks_presence:
            return attrgetter(".".join(map(str, steps)))

        def get(message: Any) -> Any:
            for step in steps:
                if isinstance(step, int):
                    message = message[step]
                    continue
                if self.checks_presence:
                    field = message.DESCRIPTOR.fields_by_name[step]
                    if field.has_presence and not message.HasField(step):
                        raise LookupError(f"it has no {step}")
                message = getattr(message, step)
            return message

        return get
