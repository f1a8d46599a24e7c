"""Rewrite the header stamps of a finished log of ours, when they are known only at its end.

The log is copied and then replaced at once, so that it is whole at every moment: with its old
stamps, or with its new ones.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

from mcap.exceptions import McapError
from mcap.records import Channel, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from tunenet_logs import __version__
from tunenet_logs.errors import LogError
from tunenet_logs.late_stamps import STAMPS_NOTE
from tunenet_logs.messages import INFO_RECORD
from tunenet_logs.output.claimed_name import ClaimedName
from tunenet_logs.output.log_place import not_writable
from tunenet_logs.output.mcap_output import McapOutput
from tunenet_logs.output.whole_file import WholeFile
from tunenet_logs.regular_file import open_regular

_PARTIAL = ".stamping"  # behind the copy's name while it is written
_STAMP = struct.Struct("<iI")
_STAMP_AT = 4  # a header's stamp in CDR: seconds and nanoseconds behind the encapsulation


def header_stamps_ns(path: Path, topic: str) -> list[int]:
    """Return the header stamps of a topic's messages, in the order of the file [ns].

    Raises:
        LogError: the log cannot be read.
    """
    stamps: list[int] = []
    numbers: set[int] = set()
    try:
        with open_regular(path) as log:
            for record in _records(log):
                if isinstance(record, Channel) and record.topic == topic:
                    numbers.add(record.id)
                elif isinstance(record, Message) and record.channel_id in numbers:
                    stamps.append(_stamp_ns(record.data))
    except (OSError, McapError, struct.error) as error:
        raise LogError(f"{path}: cannot be read again ({error})", "check its disk") from error
    return stamps


def restamp(path: Path, topic: str, stamps_ns: Mapping[int, int], note: str) -> None:
    """Replace the header stamps of a topic's messages; their log stamps stay what they were.

    Args:
        path: a whole log that `EpisodeWriter` wrote.
        topic: of messages that begin with a header.
        stamps_ns: the new stamp [ns] by the old one.
        note: whose clock that is, for the info record.

    Raises:
        LogError: it cannot be copied; the log is as it was.
    """
    try:
        name = path.with_name(f"{path.name}.{os.getpid()}{_PARTIAL}")
        copy = ClaimedName(name, takes_over=False)
        try:
            with open_regular(path) as log:
                _copy(log, copy.descriptor, topic, stamps_ns, note)
                if not os.path.samestat(os.lstat(path), os.fstat(log.fileno())):
                    raise LogError(
                        f"{path}: was replaced while its stamps were written",
                        "leave it where it is, and do it again",
                    )
                copy.rename(path, replaces=True)
        finally:
            copy.remove()  # nothing is there where it was renamed
    except (OSError, McapError) as error:
        if isinstance(error, OSError):
            raise not_writable(path, error) from error
        raise LogError(f"{path}: cannot be read again ({error})", "check its disk") from error


def _copy(
    log: BinaryIO, descriptor: int, topic: str, stamps_ns: Mapping[int, int], note: str
) -> None:
    file = WholeFile(descriptor)
    output = McapOutput(file, "ros2", f"tunenet-logs {__version__}")
    channels: dict[int, Channel] = {}
    ids: dict[int, int] = {}
    types: dict[int, Schema] = {}
    schemas: dict[int, int] = {}
    last: Mapping[str, str] | None = None
    for record in _records(log):
        if isinstance(record, Schema):
            types[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Metadata):
            if last is not None:
                output.close_chunk()
                output.add_metadata(INFO_RECORD, last)
            last = record.metadata
        elif isinstance(record, Message):
            channel = channels[record.channel_id]
            if channel.schema_id not in schemas:
                schema = types[channel.schema_id]
                schemas[schema.id] = output.add_schema(
                    schema.name, schema.encoding, schema.data.decode()
                )
            if channel.id not in ids:
                ids[channel.id] = output.add_channel(
                    channel.topic, channel.message_encoding, schemas[channel.schema_id]
                )
            data, published_ns = record.data, record.publish_time
            if channel.topic == topic:
                published_ns = stamps_ns[_stamp_ns(data)]
                stamp = _STAMP.pack(*divmod(published_ns, 10**9))
                data = data[:_STAMP_AT] + stamp + data[_STAMP_AT + _STAMP.size :]
            output.add_message(
                ids[channel.id], record.sequence, record.log_time, max(published_ns, 0), data
            )
    output.close_chunk()
    output.end(INFO_RECORD, {**(last or {}), f"notes.{STAMPS_NOTE}": note})
    file.sync()


def _records(log: BinaryIO) -> Iterator[McapRecord]:
    return iter(StreamReader(log).records)


def _stamp_ns(data: bytes) -> int:
    seconds, nanoseconds = _STAMP.unpack_from(data, _STAMP_AT)
    return seconds * 10**9 + nanoseconds
