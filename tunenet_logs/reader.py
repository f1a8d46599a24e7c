"""read_episode: opens any log, however it was left, and says what was lost."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tunenet_logs.collect import JointRows, PictureStamps, PositionRows
from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Frame, Signal
from tunenet_logs.errors import LogError
from tunenet_logs.formats import registry
from tunenet_logs.formats.base import (
    DAMAGED,
    BeyondLimitError,
    Container,
    Decode,
    Loss,
    MessageError,
    RawChannel,
    RawMessage,
    RawMetadata,
    UnusableError,
    described,
)
from tunenet_logs.formats.message_types import (
    JointType,
    PictureType,
    PositionType,
    message_type_of,
    type_key,
)
from tunenet_logs.formats.pictures import checked_pictures, frames_of
from tunenet_logs.messages import INFO_RECORD, TASK_OUTCOME

_FREE_PIXELS = 100_000_000
"""Of a whole log, whatever its size: some seconds of decoding."""

_MOST_PIXELS_A_BYTE = 20_000
"""Of a whole log; ten times what one picture may have, as a video repeats nothing that rests."""

_MOST_LOSSES = 5
"""Places of damage that are named one by one among the warnings; the rest is counted."""

_LAST_NS = 2**63 - 1
"""The last stamp that fits int64: in the year 2262."""

_ROWS = {PositionType: PositionRows, JointType: JointRows, PictureType: PictureStamps}
"""What gathers the messages of a type."""


def read_episode(path: Path) -> Episode:
    """Read a log into memory, images aside: those are read when `frames()` is asked for them.

    Signals are named by their topic. What was lost, repaired or is doubtful is in `warnings`.

    Raises:
        LogError: `path` does not exist, is not a log, or holds nothing readable at all.
    """
    container = registry.open_log(path)
    if isinstance(container, Episode):
        return container
    losses: list[Loss] = []
    info: Mapping[str, str] = {}
    by_channel: dict[RawChannel, _TopicContents] = {}
    topics: dict[tuple[str, ...], _TopicContents] = {}
    try:
        for record in container(path, losses):
            if isinstance(record, RawMessage):
                by_channel[record.channel].add(record.log_ns, record.data)
            elif isinstance(record, RawChannel):
                # One of the same topic, type and encoding as another goes on with it.
                key = (record.topic, record.type_name, record.encoding, record.schema_encoding)
                topic = topics.get(key)
                if topic is None or topic.channel.schema != record.schema:
                    topic = topics[key] = _TopicContents(record)
                by_channel[record] = topic
            elif isinstance(record, RawMetadata) and record.name == INFO_RECORD:
                info = dict(record.values)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error
    if not topics and not info and not all(loss.harmless for loss in losses):
        why = "; ".join(str(loss) for loss in losses[:3])
        raise LogError(f"{path}: nothing in it can be read: {why}")
    contents = list(dict.fromkeys(by_channel.values()))
    return _episode(path, container, losses, EpisodeInfo.from_strings(info), contents)


def _episode(
    path: Path,
    container: Container,
    losses: Sequence[Loss],
    info: EpisodeInfo,
    topics: Sequence[_TopicContents],
) -> Episode:
    """All that a log has delivered."""
    joint_names = tuple(filter(None, info.notes.get("joint_names", "").split(",")))
    damaged: list[str] = []
    refused: list[str] = []
    notes: list[str] = []
    doubts: list[str] = []
    signals: dict[str, Signal] = {}
    seconds: set[_TopicContents] = set()  # whose names were taken already
    by_log: set[str] = set()  # topics of pictures whose header stamps do not tell the time
    for topic in topics:
        name, rows = topic.channel.topic, topic.rows
        if topic.damaged:
            damaged.append(f"{name}: {topic.damaged} damaged messages were left out{topic.first}")
        if topic.refused and topic.used:  # where none is used, the channel's summary says why
            refused.append(f"{name}: {topic.refused} messages were left out{topic.first}")
        if isinstance(rows, PictureStamps):
            is_header, reasons = rows.trusts_header()
            doubts += reasons
            if not is_header:
                by_log.add(name)
        elif rows is not None:
            is_joints = isinstance(rows, JointRows)
            found, repairs = rows.signals(joint_names) if is_joints else rows.signals()
            if any(signal.name in signals for signal in found):
                seconds.add(topic)
                notes.append(f"{name}: a second channel of that name was left out")
                continue
            notes += repairs
            signals |= {signal.name: signal for signal in found}
    lost = [loss for loss in losses if not loss.harmless]
    words = [str(loss) for loss in losses if loss.harmless]
    words += [str(loss) for loss in lost[:_MOST_LOSSES]]
    if rest := lost[_MOST_LOSSES:]:
        size = sum(loss.size for loss in rest)
        words.append(f"{len(rest)} more places are damaged ({size} bytes); see tunenet-logs check")
    return Episode(
        info=info,
        signals=signals,
        channels=tuple(topic.summary(is_second=topic in seconds) for topic in topics),
        warnings=(*words, *damaged, *refused, *notes, *doubts),
        losses=(*map(str, lost), *damaged),
        tainted=next((str(loss) for loss in losses if loss.taints), ""),
        open_frames=partial(_frames, path, container, by_log),
    )


class _TopicContents:
    """The messages of one topic, in one type: counted, decoded, gathered.

    Attributes:
        rows: what they hold, as far as it was read; None where the type or encoding is not.
        damaged: messages that cannot be read.
        refused: those that may be whole, but of a kind or size that is not read.
        used: those that were read.
    """

    def __init__(self, channel: RawChannel) -> None:
        self.channel = channel
        self.rows: PositionRows | JointRows | PictureStamps | None = None
        self.damaged = 0
        self.refused = 0
        self._log_ns = array("q")
        self._unusable: str | None = None
        self._why = ""  # the first message that was left out was
        self.used = 0
        self._type = message_type_of(channel)
        self._decode: Decode | None = None
        try:
            if self._type is None and channel.encoding in registry.DECODERS:
                is_outcome = type_key(channel.type_name) == TASK_OUTCOME
                use = "for tunenet-review" if is_outcome else "its type is not one that a task uses"
                raise UnusableError(use)
            self._decode = registry.decoder_for(channel)
        except UnusableError as reason:
            self._unusable = str(reason)
            return
        assert self._type is not None
        rows = self.rows = _ROWS[type(self._type)](channel.topic)
        self._read: Callable[[Any], Any] = self._type.read
        if isinstance(self._type, PictureType):
            self._read = checked_pictures(self._type)
        self._add: Callable[[int, Any], None] = rows.add

    def add(self, log_ns: int, data: bytes | memoryview) -> None:
        """One message, received at `log_ns` [ns]."""
        if not 0 <= log_ns <= _LAST_NS:
            self.damaged += 1
            self._why = self._why or "its time lies beyond the year 2262"
            return
        self._log_ns.append(log_ns)
        if self._decode is None:
            return
        try:
            self._add(log_ns, self._read(self._decode(data)))
            self.used += 1
        except (UnusableError, BeyondLimitError) as reason:
            self.refused += 1
            self._why = self._why or str(reason)
        except (MessageError, *DAMAGED) as error:
            self.damaged += 1
            self._why = self._why or described(error)

    @property
    def first(self) -> str:
        """Why the first message was left out, in parentheses; "" where none was."""
        return f" (the first: {self._why})" if self._why else ""

    def summary(self, *, is_second: bool) -> Channel:
        """The channel.

        Args:
            is_second: whether another channel of that topic is used instead.
        """
        skipped = self._unusable
        if skipped is None and is_second:
            skipped = "another channel of that name is used"
        elif skipped is None and not self.used:
            if not self._log_ns and not self.damaged:
                skipped = "it holds no message"
            else:
                skipped = self._why if self.refused else f"all its messages are damaged{self.first}"
        return Channel(
            topic=self.channel.topic,
            type_name=self.channel.type_name,
            encoding=self.channel.encoding,
            log_ns=np.array(self._log_ns, np.int64),
            skipped=skipped,
            pictures=isinstance(self._type, PictureType),
        )


def _frames(path: Path, container: Container, by_log: Set[str], topic: str) -> Iterator[Frame]:
    """The frames of one topic, read afresh from the file.

    Args:
        path: the log.
        container: how it is read.
        by_log: topics whose header stamps do not tell the time.
        topic: the channel's.

    Raises:
        LogError: a small log claims so many pixels that decoding them would take minutes.
    """
    records = container(path, [], (topic,))
    most_pixels = _FREE_PIXELS + _MOST_PIXELS_A_BYTE * registry.file_bytes(path)
    for frame in frames_of(records, topic, trusts_header=topic not in by_log):
        with suppress(LogError):  # one that is damaged costs nothing
            most_pixels -= math.prod(frame.size_px())
        if most_pixels < 0:
            raise LogError(
                f"{path}: its pictures claim far more pixels than a log of that size has"
            )
        yield frame
