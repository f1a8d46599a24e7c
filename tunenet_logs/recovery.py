"""Recover a damaged log: copy what is whole to a file that opens in every reader."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from mcap.writer import Writer

from tunenet_logs import __version__, messages
from tunenet_logs.episode import Episode, EpisodeInfo
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.formats.base import (
    Container,
    Loss,
    RawAttachment,
    RawChannel,
    RawMessage,
    RawMetadata,
    Record,
    lost_share,
    one_by_one,
)
from tunenet_logs.formats.registry import file_bytes, open_log
from tunenet_logs.formats.ros import ros_name
from tunenet_logs.left_out import SHARE_NOTE
from tunenet_logs.messages import INFO_RECORD, RECOVERY_RECORD
from tunenet_logs.output.log_place import check_log_name, not_writable
from tunenet_logs.output.owned_file import OutputPlace, nothing, own_log

_LAST_STAMP = 2**64  # the first stamp [ns] that MCAP cannot hold
_PROFILES = {"cdr": "ros2", "ros1": "ros1"}  # of an MCAP file, by the encoding of its messages


@dataclass(frozen=True)
class Recovered:
    """Result of a recovery.

    Attributes:
        messages: how many were saved.
        losses: what was not, in words.
        holds_ros1: whether there are messages of ROS 1 among them, which stay what they are.
    """

    messages: int
    losses: tuple[str, ...]
    holds_ros1: bool = False


def recover(path: Path, output: Path, *, overwrite: bool = False) -> Recovered:
    """Copy all whole messages of a log, as they are, into a new MCAP file with all checksums.

    Raises:
        UsageError: the output is the log itself, exists, or is no .mcap.
        LogError: nothing of the log can be read, or the output cannot be written.
    """
    _check_output(path, output, overwrite=overwrite)
    container = open_log(path)
    if isinstance(container, Episode):
        raise LogError(
            f"{path}: holds no messages to recover; bring it in with tunenet-logs import"
        )
    try:
        place = OutputPlace(output, "log", own_log if overwrite else nothing)
        with place.replacing() as partial, partial.open("wb") as file:
            recovered = _Copy(Writer(file, enable_data_crcs=True), path.name).of(path, container)
            file.flush()
            os.fsync(file.fileno())
            if not recovered.messages:
                why = f" ({recovered.losses[0]})" if recovered.losses else ""
                raise LogError(f"{path}: holds no message that can be saved{why}")
    except OSError as error:
        raise not_writable(output, error) from error
    return recovered


def _check_output(path: Path, output: Path, *, overwrite: bool) -> None:
    if output.suffix != ".mcap":
        raise UsageError(f"{output}: name a .mcap file with -o")
    if output.exists() and path.exists() and output.samefile(path):
        raise UsageError(f"{output}: is the log itself, which is never changed; choose another -o")
    try:
        check_log_name(output, overwrite=overwrite)
    except LogError as error:
        raise UsageError(str(error)) from error


def _records(path: Path, container: Container, losses: list[Loss]) -> Iterator[Record]:
    """Yield what is read; a disk that fails to read is not to be taken for the one written to."""
    try:
        yield from one_by_one(container(path, losses))
    except OSError as error:
        why = f"cannot be read ({error.strerror})"
        raise LogError(f"{path}: {why}; copy it to another disk and recover the copy") from error


class _Copy:
    """Copy of a container's records by a writer."""

    def __init__(self, writer: Writer, source: str) -> None:
        self._writer = writer
        self._source = source
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[RawChannel, int] = {}
        self._info: Mapping[str, str] = {}
        self._messages = 0
        self._beyond = 0
        self._holds_ros1 = False
        self._started = False

    def of(self, path: Path, container: Container) -> Recovered:
        losses: list[Loss] = []
        for record in _records(path, container, losses):
            if isinstance(record, RawChannel):
                self._start(_PROFILES.get(record.encoding, ""))
                self._register(record)
            elif isinstance(record, RawMessage):
                self._add(record)
            elif isinstance(record, RawMetadata):
                self._start("ros2" if record.name == INFO_RECORD else "")
                self._writer.add_metadata(record.name, dict(record.values))
                if record.name == INFO_RECORD:
                    self._info = record.values
            elif isinstance(record, RawAttachment):
                self._start("")
                self._writer.add_attachment(
                    record.create_ns, record.log_ns, record.name, record.media_type, record.data
                )
        self._start("")
        lost = [str(loss) for loss in losses if not loss.harmless]
        if self._beyond:
            lost.append(f"{self._beyond} messages with impossible stamps were left out")
        self._say(lost, lost_share(losses, self._messages, file_bytes(path)))
        self._writer.finish()
        return Recovered(self._messages, tuple(lost), self._holds_ros1)

    def _start(self, profile: str) -> None:
        if not self._started:
            self._writer.start(profile, f"tunenet-logs {__version__}")
            self._started = True

    def _register(self, channel: RawChannel) -> None:
        text, encoding = channel.schema, channel.schema_encoding
        if not encoding and channel.encoding == "cdr":  # a .db3 need not hold definitions
            text, encoding = _known_definition(channel.type_name)
        schema = 0
        if channel.type_name:
            key = (channel.type_name, encoding, text)
            if key not in self._schemas:
                self._schemas[key] = self._writer.register_schema(*key)
            schema = self._schemas[key]
        self._channels[channel] = self._writer.register_channel(
            channel.topic, channel.encoding, schema, dict(channel.metadata)
        )

    def _add(self, message: RawMessage) -> None:
        if not (0 <= message.log_ns < _LAST_STAMP and 0 <= message.publish_ns < _LAST_STAMP):
            self._beyond += 1
            return
        self._writer.add_message(
            self._channels[message.channel],
            message.log_ns,
            bytes(message.data),
            message.publish_ns,
            message.sequence,
        )
        self._messages += 1
        self._holds_ros1 |= message.channel.encoding == "ros1"

    def _say(self, lost: list[str], share: float) -> None:
        """Record what was lost, and the counts that its recorder did not come to write."""
        if self._info:
            info = EpisodeInfo.from_strings(self._info)
            if "written" not in info.counts:
                info = info.ended("the recording did not end by itself", written=self._messages)
                self._writer.add_metadata(INFO_RECORD, info.to_strings())
        words = {"from": self._source, "messages": str(self._messages)}
        words[SHARE_NOTE] = f"{share:.6f}"
        words |= {f"lost.{number}": text for number, text in enumerate(lost[:100])}
        self._writer.add_metadata(RECOVERY_RECORD, words)


def _known_definition(type_name: str) -> tuple[bytes, str]:
    name = ros_name(type_name)
    if name not in messages.typestore().types:
        return b"", ""
    return messages.definition(name).encode(), "ros2msg"
