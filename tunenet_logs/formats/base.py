"""Records, losses and errors that all containers and message encodings share."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
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
