"""read_episode: opens any log, however it was left, and says what was lost."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tunenet_logs.collect import JointRows, PictureStamps, PositionRows
from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Frame, Signal
from tunenet_logs.errors import LogError
from tunenet_logs.formats import opening
from tunenet_logs.formats.base import (
    DAMAGED,
    Container,
    Loss,
    RawChannel,
    RawMessage,
    RawMetadata,
)
from tunenet_logs.formats.codec import Decode, MessageError, UnusableError
from tunenet_logs.formats.codecs import check_encoding, decoder_for
from tunenet_logs.formats.kinds import Joints, Pictures, Positions, kind_of
from tunenet_logs.formats.pictures import checked, frames_of
from tunenet_logs.messages import INFO_RECORD

_LAST_NS = 2**63 - 1
"""The last stamp that fits int64: in the year 2262."""

_ROWS = {Positions: PositionRows, Joints: JointRows, Pictures: PictureStamps}
_MOST_LOSSES = 5
"""Places of damage that are named one by one among the warnings."""


def read_episode(path: Path) -> Episode:
    """Read a log into memory, images aside: those are read when `frames()` is asked for them.

    Signals are named by their topic. What was lost, repaired or is doubtful is in `warnings`.

    Raises:
        LogError: `path` does not exist, is not a log, or holds nothing readable at all.
    """
    found = opening.opened(path)
    if isinstance(found, Episode):
        return found
    losses: list[Loss] = []
    gathered = _Gathered()
    try:
        for record in found(path, losses):
            if isinstance(record, RawMessage):
                gathered.add(record)
            elif isinstance(record, RawChannel):
                gathered.describe(record)
            elif isinstance(record, RawMetadata) and record.name == INFO_RECORD:
                gathered.info = dict(record.values)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error
    if gathered.is_empty and not all(one.harmless for one in losses):
        why = "; ".join(str(one) for one in losses[:3])
        raise LogError(f"{path}: nothing in it can be read: {why}")
    return gathered.episode(path, found, losses)


class _Topic:
    """What one topic, in one type, has delivered so far."""

    def __init__(self, channel: RawChannel) -> None:
        self.channel = channel
        self.log_ns = array("q")
        self.damaged = 0
        self.skipped: str | None = None
        self.refused = 0
        self._refusal = ""
        self.rows: PositionRows | JointRows | PictureStamps | None = None
        self.kind = kind_of(channel)
        self._decode: Decode | None = None
        try:
            check_encoding(channel)
            if self.kind is None:
                raise UnusableError("its type is not one that a task uses")
            self._decode = decoder_for(channel)
        except UnusableError as reason:
            self.skipped = str(reason)
            return
        rows = self.rows = _ROWS[type(self.kind)](channel.topic)
        self._read: Callable[[Any], Any] = checked(self.kind)
        self._add: Callable[[int, Any], None] = rows.add

    def add(self, log_ns: int, data: bytes | memoryview) -> None:
        if not 0 <= log_ns <= _LAST_NS:
            self.damaged += 1
            return
        self.log_ns.append(log_ns)
        if self._decode is None:
            return
        try:
            self._add(log_ns, self._read(self._decode(data)))
        except UnusableError as reason:
            self.refused += 1
            self._refusal = self._refusal or str(reason)
        except (MessageError, *DAMAGED):
            self.damaged += 1

    @property
    def why_skipped(self) -> str | None:
        """Why none of its messages is used, as far as they were seen; None if one is."""
        if self.refused and self.refused + self.damaged >= len(self.log_ns):
            return self._refusal
        return self.skipped

    @property
    def lost(self) -> int:
        """Messages that could not be used among others that could."""
        return self.damaged if self.why_skipped else self.damaged + self.refused

    def summary(self) -> Channel:
        return Channel(
            topic=self.channel.topic,
            type_name=self.channel.type_name,
            encoding=self.channel.encoding,
            log_ns=np.array(self.log_ns, np.int64),
            skipped=self.why_skipped,
            pictures=isinstance(self.kind, Pictures),
        )


class _Gathered:
    """What a log has delivered so far."""

    def __init__(self) -> None:
        self.info: Mapping[str, str] = {}
        self._by_channel: dict[RawChannel, _Topic] = {}
        self._topics: dict[tuple[str, ...], _Topic] = {}

    @property
    def is_empty(self) -> bool:
        """Whether nothing came, not even a description."""
        return not self._topics and not self.info

    def describe(self, channel: RawChannel) -> None:
        """A channel; one of the same topic, type and encoding as another goes on with it."""
        key = (channel.topic, channel.type_name, channel.encoding, channel.schema_encoding)
        topic = self._topics.get(key)
        if topic is None or topic.channel.schema != channel.schema:
            topic = self._topics[key] = _Topic(channel)
        self._by_channel[channel] = topic

    def add(self, message: RawMessage) -> None:
        self._by_channel[message.channel].add(message.log_ns, message.data)

    def episode(self, path: Path, container: Container, losses: Sequence[Loss]) -> Episode:
        topics = list(dict.fromkeys(self._by_channel.values()))
        damaged = [
            f"{one.channel.topic}: {one.lost} damaged messages were left out"
            for one in topics
            if one.lost
        ]
        signals, notes = _signals(topics)
        by_log = _untold(topics, notes)
        return Episode(
            info=EpisodeInfo.from_strings(self.info),
            signals=signals,
            channels=tuple(one.summary() for one in topics),
            warnings=(*_in_words(losses), *damaged, *notes),
            losses=(*(str(one) for one in losses if not one.harmless), *damaged),
            tainted=next((str(one) for one in losses if one.taints), ""),
            open_frames=partial(_frames, path, container, by_log),
        )


def _in_words(losses: Sequence[Loss]) -> list[str]:
    words = [str(one) for one in losses if one.harmless]
    losses = [one for one in losses if not one.harmless]
    words += [str(one) for one in losses[:_MOST_LOSSES]]
    if len(losses) > _MOST_LOSSES:
        rest = losses[_MOST_LOSSES:]
        lost = sum(one.size for one in rest)
        words.append(f"{len(rest)} more places are damaged ({lost} bytes); see tunenet-logs check")
    return words


def _signals(topics: Sequence[_Topic]) -> tuple[dict[str, Signal], list[str]]:
    signals: dict[str, Signal] = {}
    notes: list[str] = []
    for one in topics:
        if not isinstance(one.rows, PositionRows | JointRows):
            continue
        found, repairs = one.rows.signals()
        notes += repairs
        for signal in found:
            if signal.name in signals:
                notes.append(f"{signal.name}: a second channel of that name was left out")
            signals.setdefault(signal.name, signal)
    return signals, notes


def _untold(topics: Sequence[_Topic], notes: list[str]) -> set[str]:
    """Topics of pictures whose header stamps do not tell the time; reasons go into `notes`."""
    untold: set[str] = set()
    for one in topics:
        if isinstance(one.rows, PictureStamps) and one.log_ns:
            is_header, reasons = one.rows.trusts_header()
            notes += reasons
            if not is_header:
                untold.add(one.channel.topic)
    return untold


def _frames(path: Path, container: Container, by_log: Set[str], topic: str) -> Iterator[Frame]:
    """The frames of one topic, read afresh from the file.

    Args:
        path: the log.
        container: how it is read.
        by_log: topics whose header stamps do not tell the time.
        topic: the channel's.
    """
    records = container(path, [], (topic,))
    return frames_of(records, topic, is_told=topic not in by_log)
