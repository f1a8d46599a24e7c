"""What every container and every encoding of messages shares: records, losses, errors."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

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


Record = RawChannel | RawMessage | RawMetadata | RawAttachment
"""What a container is taken apart into."""


@dataclass(frozen=True)
class Loss:
    """Something that a log should hold and that cannot be read, or that cannot be vouched for.

    Attributes:
        what: in words, without the place.
        file: name of the file, where the log has several; else "".
        at_byte: where it begins; None for the whole file.
        size: bytes concerned.
        harmless: whether all messages were read nevertheless.
        taints: whether messages that were read may have been changed.
    """

    what: str
    file: str = ""
    at_byte: int | None = None
    size: int = 0
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
