"""read_episode: opens any log, however it was left, and says what was lost."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import suppress
from functools import partial
from pathlib import Path

from tunenet_logs.collect import JointRows, PictureStamps, PositionRows, named
from tunenet_logs.episode import Episode, EpisodeInfo, Frame, Signal
from tunenet_logs.errors import LogError
from tunenet_logs.formats import opening
from tunenet_logs.formats.base import (
    Container,
    Loss,
    RawChannel,
    RawMessage,
    RawMetadata,
)
from tunenet_logs.formats.pictures import frames_of
from tunenet_logs.messages import INFO_RECORD
from tunenet_logs.topic_contents import TopicContents

_FREE_PIXELS = 100_000_000
_MOST_PIXELS_A_BYTE = 20_000
"""Of a whole log; ten times what one picture may have, as a video repeats nothing that rests."""

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


class _Gathered:
    """What a log has delivered so far."""

    def __init__(self) -> None:
        self.info: Mapping[str, str] = {}
        self._by_channel: dict[RawChannel, TopicContents] = {}
        self._topics: dict[tuple[str, ...], TopicContents] = {}

    @property
    def is_empty(self) -> bool:
        """Whether nothing came, not even a description."""
        return not self._topics and not self.info

    def describe(self, channel: RawChannel) -> None:
        """A channel; one of the same topic, type and encoding as another goes on with it."""
        key = (channel.topic, channel.type_name, channel.encoding, channel.schema_encoding)
        topic = self._topics.get(key)
        if topic is None or topic.channel.schema != channel.schema:
            topic = self._topics[key] = TopicContents(channel)
        self._by_channel[channel] = topic

    def add(self, message: RawMessage) -> None:
        self._by_channel[message.channel].add(message.log_ns, message.data)

    def episode(self, path: Path, container: Container, losses: Sequence[Loss]) -> Episode:
        topics = list(dict.fromkeys(self._by_channel.values()))
        damaged = [text for one in topics for text in one.losses()]
        remarks = [text for one in topics for text in one.remarks()]
        signals, seconds, notes = _signals(topics)
        by_log = _untold(topics, notes)
        info = EpisodeInfo.from_strings(self.info)
        joints = tuple(filter(None, info.notes.get("joint_names", "").split(",")))
        return Episode(
            info=info,
            signals={name: named(one, joints) for name, one in signals.items()},
            channels=tuple(one.summary(is_second=one in seconds) for one in topics),
            warnings=(*_in_words(losses), *damaged, *remarks, *notes),
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


def _signals(
    topics: Sequence[TopicContents],
) -> tuple[dict[str, Signal], set[TopicContents], list[str]]:
    """The signals by name, the topics whose names were taken already, and what is of note."""
    signals: dict[str, Signal] = {}
    seconds: set[TopicContents] = set()
    notes: list[str] = []
    for one in topics:
        if not isinstance(one.rows, PositionRows | JointRows):
            continue
        found, repairs = one.rows.signals()
        if any(signal.name in signals for signal in found):
            seconds.add(one)
            notes.append(f"{one.channel.topic}: a second channel of that name was left out")
            continue
        notes += repairs
        signals |= {signal.name: signal for signal in found}
    return signals, seconds, notes


def _untold(topics: Sequence[TopicContents], notes: list[str]) -> set[str]:
    """Topics of pictures whose header stamps do not tell the time; reasons go into `notes`."""
    untold: set[str] = set()
    for one in topics:
        if isinstance(one.rows, PictureStamps):
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

    Raises:
        LogError: a small log claims so many pixels that decoding them would take minutes.
    """
    records = container(path, [], (topic,))
    most_pixels = _FREE_PIXELS + _MOST_PIXELS_A_BYTE * opening.file_bytes(path)
    for frame in frames_of(records, topic, is_told=topic not in by_log):
        with suppress(LogError):  # one that is damaged costs nothing
            most_pixels -= math.prod(frame.size_px())
        if most_pixels < 0:
            raise LogError(
                f"{path}: its pictures claim far more pixels than a log of that size has"
            )
        yield frame
