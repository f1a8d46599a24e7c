"""What every container and every encoding of messages shares: records, losses, errors."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

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
"""What parsers raise on bytes that are not what they say they are, found by fuzzing them."""


class BeyondLimitError(ValueError):
    """A message that may be whole, but is larger than any that is read."""


class UnusableError(Exception):
    """Why no message of a channel can be used; shown by `tunenet-logs info`."""


class MessageError(Exception):
    """Why one message cannot be used; the messages are counted."""


Decode = Callable[[bytes | memoryview], Any]
"""From a message's bytes to an object with its fields. Raises MessageError."""


@dataclass(frozen=True, eq=False)
class RawChannel:
    """A channel as its container describes it; told apart by identity.

    Attributes:
        type_name: as it is written there ("sensor_msgs/JointState" in ROS 1).
        encoding: of the messages: "cdr", "ros1", "protobuf", "json", ...
        schema_encoding: of `schema`: "ros2msg", "ros2idl", "ros1msg", "protobuf", ... "" where the
            container holds none.
        metadata: what else it says, for a copy.
    """

    topic: str
    type_name: str
    encoding: str
    schema_encoding: str = ""
    schema: bytes = b""
    metadata: Mapping[str, str] = field(default_factory=dict)


@dataclass(slots=True)
class RawMessage:
    """One message as it lies in its container; times in ns, of any size until they are checked."""

    channel: RawChannel
    log_ns: int
    data: bytes | memoryview
    publish_ns: int = 0
    sequence: int = 0


@dataclass(eq=False)
class RawMessages:
    """Messages that lie in one piece of a container, in their order.

    Attributes:
        plain: the piece.
        channels: by number.
        heads: number, sequence, log_ns and publish_ns of each, shape (N,).
        begins: where the bytes of each begin in `plain`, shape (N,).
        ends: where they end, shape (N,).
    """

    plain: memoryview
    channels: Mapping[int, RawChannel]
    heads: NDArray[np.void]
    begins: NDArray[np.int64]
    ends: NDArray[np.int64]

    def __iter__(self) -> Iterator[RawMessage]:
        """Take them apart."""
        places = zip(self.heads.tolist(), self.begins.tolist(), self.ends.tolist(), strict=True)
        for (number, sequence, log_ns, publish_ns), begin, end in places:
            data = self.plain[begin:end]
            yield RawMessage(self.channels[number], log_ns, data, publish_ns, sequence)

    def rows(self, places: NDArray[np.intp], size: int) -> NDArray[np.uint8]:
        """The bytes of those at `places`, each of `size`, shape (R, size)."""
        starts = np.ndarray(
            len(self.plain) - size + 1, np.dtype((np.void, size)), self.plain, strides=(1,)
        )
        return starts[self.begins[places]].view(np.uint8).reshape(len(places), size)

    def by_channel(self) -> Iterator[tuple[RawChannel, RawMessages]]:
        """Those of each channel by themselves, in their order."""
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
    """Names and texts that belong to the whole log."""

    name: str
    values: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class RawAttachment:
    """A file inside the log. Its name is a word, never a path."""

    name: str
    media_type: str
    data: bytes
    log_ns: int
    create_ns: int


Record = RawChannel | RawMessage | RawMessages | RawMetadata | RawAttachment
"""What a container is taken apart into."""


def one_by_one(records: Iterable[Record]) -> Iterator[Record]:
    """Take apart messages that came together."""
    for record in records:
        if isinstance(record, RawMessages):
            yield from record
        else:
            yield record


@dataclass(frozen=True)
class Loss:
    """Something that a log should hold and that cannot be read, or that cannot be vouched for.

    Attributes:
        what: in words, without the place.
        file: name of the file, where the log has several; else "".
        at_byte: where it begins; None for the whole file.
        size: bytes concerned.
        messages: how many are lost by it; None where only its size tells.
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
        """With the place."""
        text = f"{self.file}: {self.what}" if self.file else self.what
        if self.at_byte is None:
            return text
        if not self.size:
            return f"{text} (at byte {self.at_byte})"
        return f"{text} (bytes {self.at_byte} to {self.at_byte + self.size})"


def lost_share(losses: Iterable[Loss], read: int, size: int) -> float:
    """How much of a log is lost, of 1: by its messages where they are counted, else by its bytes.

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
    """Reads one kind of file."""

    def __call__(
        self, path: Path, losses: list[Loss], topics: Sequence[str] | None = None
    ) -> Iterator[Record]:
        """The records in file order; a channel before its messages.

        Every size is checked before it is believed. What is damaged is left out and put into
        `losses`; nothing but the errors below comes out.

        Args:
            path: the file, or the folder of a log in several files.
            losses: filled on the way.
            topics: give only messages of these; None for all.

        Raises:
            LogError: nothing of it can be read.
            OSError: the disk fails.
        """
        ...


def described(error: BaseException) -> str:
    """An error of a library as a part of a sentence."""
    return " ".join(str(error).split())[:120] or type(error).__name__
