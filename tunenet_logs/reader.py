"""Read any log into an episode, however it was left, and report what was lost."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from tunenet_logs.collect import MAX_NUMBERS, JointRows, PictureStamps, SoundStamps
from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Frame, Signal
from tunenet_logs.errors import CHECK_DISK, COPY_AGAIN, LogError
from tunenet_logs.formats import registry
from tunenet_logs.formats.base import (
    Container,
    Loss,
    RawChannel,
    RawMessage,
    RawMessages,
    RawMetadata,
    Record,
    lost_share,
)
from tunenet_logs.formats.pictures import frames_of, in_order
from tunenet_logs.formats.read_options import AS_IT_SAYS, ReadOptions
from tunenet_logs.formats.sounds import sound_of
from tunenet_logs.images import FREE_VIDEO_PIXELS, VIDEO_PIXELS_A_BYTE
from tunenet_logs.import_notes import restored
from tunenet_logs.late_stamps import BY_ARRIVALS, STAMPS_NOTE
from tunenet_logs.left_out import BY_CLOCK, added, share_of_note
from tunenet_logs.messages import INFO_RECORD, RECOVERY_RECORD
from tunenet_logs.one_clock import jump_warnings, with_jumps_of_pictures
from tunenet_logs.position_rows import PositionRows
from tunenet_logs.sound import Sound
from tunenet_logs.sound_notes import noted_rates
from tunenet_logs.terminal import short_name
from tunenet_logs.topic_contents import DriveRows, ReadingPlan, TopicContents
from tunenet_logs.unused_reading import unused_of_messages, unused_reading

# Of the pictures of a whole log, whatever its size is: a second of decoding.
_FREE_PIXELS = 50_000_000

# Of a log, beyond those: a camera's pictures have 20, rendered ones without noise 300.
_PIXELS_A_BYTE = 500

# Cameras of a log whose pictures are read, however many other messages it has; and of its
# microphones, no more.
_FEW_TOPICS = 8

# That all picture topics together may pass: each is read by a pass over the file. Those of any log,
# and its bytes for each beyond.
_FREE_MESSAGES, _BYTES_A_MESSAGE = 5_000_000, 50

# Places of damage that are named one by one among the warnings; the rest is counted.
_MAX_LOSSES = 5

_LAST_NS = 2**63 - 1  # the last stamp that fits int64: in the year 2262


def read_episode(
    path: Path, options: ReadOptions = AS_IT_SAYS, *, most_numbers: float = MAX_NUMBERS
) -> Episode:
    """Read a log into memory, images aside: `frames()` reads those on demand.

    Signals are named by their topic. What was lost, repaired or is doubtful is in `warnings`.

    Args:
        path: of the log.
        options: what its user says of it.
        most_numbers: that are kept of the joints of a topic; of more messages some are left out.

    Raises:
        LogError: `path` does not exist, is not a log, or holds nothing readable at all.
    """
    container = registry.open_log(path, options)
    if isinstance(container, Episode):
        found = with_jumps_of_pictures(container)
        said = (*jump_warnings(found), *unused_reading(path, found, options, registry.open_log))
        return replace(found, warnings=(*found.warnings, *said))
    losses: list[Loss] = []
    plan = ReadingPlan(path, options, most_numbers)
    contents = _Contents(plan)
    try:
        for record in container(path, losses):
            contents.add(record)
        for topic in contents.topics:
            topic.finish()
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error
    topics, info = contents.topics, contents.info
    if not topics and not info and not all(loss.harmless for loss in losses):
        why = "; ".join([str(loss) for loss in losses if not loss.harmless][:2])
        raise LogError(f"{path}: nothing in it can be read: {why}", COPY_AGAIN)
    about = EpisodeInfo.from_strings(info)
    episode = _episode(path, container, losses, about, topics, plan, contents.share)
    episode = restored(episode, options)
    unused = unused_of_messages(episode, options)
    return replace(episode, warnings=(*episode.warnings, *jump_warnings(episode), *unused))


class _Contents:
    """Contents that a container delivers.

    Attributes:
        info: what the log says of itself.
        share: of it, that was lost before it was recovered.
    """

    def __init__(self, plan: ReadingPlan) -> None:
        self.info: Mapping[str, str] = {}
        self.share = 0.0
        self._plan = plan
        self._by_channel: dict[RawChannel, TopicContents] = {}
        self._last: dict[tuple[str, ...], TopicContents] = {}

    @property
    def topics(self) -> list[TopicContents]:
        """Each topic once, in the order of the log."""
        return list(dict.fromkeys(self._by_channel.values()))

    def add(self, record: Record) -> None:
        """Add one record."""
        if isinstance(record, RawMessages):
            for channel, messages in record.by_channel():
                self._by_channel[channel].add_all(messages)
        elif isinstance(record, RawMessage):
            self._by_channel[record.channel].add(record.log_ns, record.data)
        elif isinstance(record, RawChannel):
            # One of the same topic, type and encoding as another goes on with it.
            key = (record.topic, record.type_name, record.encoding, record.schema_encoding)
            topic = self._last.get(key)
            if topic is None or topic.channel.schema != record.schema:
                topic = self._last[key] = TopicContents(record, self._plan)
            self._by_channel[record] = topic
        elif isinstance(record, RawMetadata) and record.name == INFO_RECORD:
            self.info = dict(record.values)
        elif isinstance(record, RawMetadata) and record.name == RECOVERY_RECORD:
            self.share = share_of_note(record.values)


def _episode(
    path: Path,
    container: Container,
    losses: Sequence[Loss],
    info: EpisodeInfo,
    topics: Sequence[TopicContents],
    plan: ReadingPlan,
    share: float,
) -> Episode:
    """Build the episode; `share` of the log was lost before it was recovered."""
    joint_names = tuple(filter(None, info.notes.get("joint_names", "").split(",")))
    damaged: list[str] = []
    refused: list[str] = []
    notes: list[str] = []
    doubts: list[str] = []
    signals, repairs = plan.named_signals()
    notes += repairs
    size, read = registry.file_bytes(path), sum(topic.messages for topic in topics)
    share = max(share, lost_share(losses, read, size))
    by_log: set[str] = set()  # topics of pictures or sound whose header stamps tell no time
    # What is known by its shape alone comes behind what is known by its type, commands behind all.
    for topic in sorted(topics, key=lambda one: (one.drives, one.is_by_shape)):
        name, rows = topic.channel.topic, topic.rows
        shaped = topic.checked_shape()
        if topic.damaged:
            damaged.append(f"{name}: {topic.damaged} damaged messages were left out{topic.first}")
        if topic.refused and topic.used:  # where none is used, the channel's summary says why
            refused.append(f"{name}: {topic.refused} messages were left out{topic.first}")
        if isinstance(rows, PictureStamps | SoundStamps):
            is_header, reasons = rows.trusts_header()
            doubts += reasons
            is_found = info.notes.get(STAMPS_NOTE, "").startswith(BY_ARRIVALS)  # of pictures alone
            if not is_header or (is_found and isinstance(rows, PictureStamps)):
                by_log.add(name)
        elif isinstance(rows, PositionRows | JointRows | DriveRows):
            if shaped is None:
                continue
            told = (
                partial(rows.signals, joint_names) if isinstance(rows, JointRows) else rows.signals
            )
            found, repairs = told()
            if any(signal.name in signals for signal in found):  # another channel of that topic
                rows.topic = topic.another_name(signals)
                found, repairs = told()
                kind = short_name(topic.channel.type_name)
                notes.append(
                    f"{name}: a second channel of that name, of {kind}, goes by {rows.topic} "
                    "(--topic)"
                )
            notes += [*repairs, *shaped]
            signals |= {signal.name: _with_lost(signal, topic, share) for signal in found}
    lost = [loss for loss in losses if not loss.harmless]
    found = [_summary(topic, share) for topic in topics]
    passed = max(1, sum(one.messages for one in found))
    free = (_FREE_MESSAGES + size // _BYTES_A_MESSAGE) // passed
    cameras = [one for one in found if one.pictures and one.skipped is None]
    microphones = [one for one in found if one.sounds and one.skipped is None]
    channels, more = _few(found, cameras, max(_FEW_TOPICS, free), "pictures")
    doubts += more
    channels, more = _few(channels, microphones, _FEW_TOPICS, "sound")
    doubts += more
    ahead = {
        topic.channel.topic: topic.rows.ahead
        for topic in topics
        if isinstance(topic.rows, PictureStamps)
    }
    return Episode(
        info=info,
        signals=signals,
        channels=channels,
        warnings=(*_lost_words(losses), *damaged, *refused, *notes, *doubts),
        losses=(*map(str, lost), *damaged),
        tainted=next((str(loss) for loss in losses if loss.taints), ""),
        open_frames=partial(_frames, path, container, by_log, ahead, _most_pixels(path, topics)),
        open_sound=partial(_sound, path, container, by_log, info.notes),
    )


def _lost_words(losses: Sequence[Loss]) -> list[str]:
    """Describe what containers lost: the first places, and how many more."""
    lost = [loss for loss in losses if not loss.harmless]
    words = [str(loss) for loss in losses if loss.harmless]
    words += [str(loss) for loss in lost[:_MAX_LOSSES]]
    if rest := lost[_MAX_LOSSES:]:
        size = sum(loss.size for loss in rest)
        words.append(f"{len(rest)} more places are damaged ({size} bytes); see tunenet-logs check")
    return words


def _with_lost(signal: Signal, topic: TopicContents, share: float) -> Signal:
    lost = topic.lost_of(len(signal.stamps_ns), share)
    return replace(signal, left_out=added(signal.left_out, lost))


def _summary(topic: TopicContents, share: float) -> Channel:
    channel = topic.summary()
    rows = topic.rows
    if not isinstance(rows, PictureStamps | SoundStamps):
        return channel  # its signals say it
    cut = {BY_CLOCK: rows.cut} if isinstance(rows, PictureStamps) else {}
    return replace(channel, left_out=added(cut, topic.lost_of(channel.messages, share)))


def _few(
    channels: Sequence[Channel], those: Sequence[Channel], most: int, what: str
) -> tuple[tuple[Channel, ...], list[str]]:
    """Mark all but the first `most` of `those` channels as left out, and warn of it."""
    if len(those) <= most:
        return tuple(channels), []
    why = f"the log has over {most} channels of {what}"
    left = {id(one) for one in those[most:]}
    some = [replace(one, skipped=why) if id(one) in left else one for one in channels]
    return tuple(some), [f"the {what} of {len(left)} channels were left out: {why}"]


def _most_pixels(path: Path, topics: Sequence[TopicContents]) -> dict[str, int]:
    """Return the pixels each topic's pictures may have: a share of the log's, by their number."""
    cameras = [topic for topic in topics if isinstance(topic.rows, PictureStamps)]
    used = max(1, sum(topic.used for topic in cameras))
    size = registry.file_bytes(path)
    stills = _FREE_PIXELS + _PIXELS_A_BYTE * size
    video = FREE_VIDEO_PIXELS + VIDEO_PIXELS_A_BYTE * size
    most: dict[str, int] = {}
    for topic in cameras:
        share = (video if topic.is_video else stills) * topic.used // used
        most[topic.channel.topic] = most.get(topic.channel.topic, 0) + share
    return most


def _sound(
    path: Path, container: Container, by_log: Set[str], notes: Mapping[str, str], topic: str
) -> Sound:
    """Decode the sound of one topic afresh from the file; `by_log` as in `_frames`."""
    exact_hz, file_hz = noted_rates(notes)
    return sound_of(
        container(path, [], (topic,)),
        topic,
        trusts_header=topic not in by_log,
        exact_hz=exact_hz,
        file_hz=file_hz,
    )


def _frames(
    path: Path,
    container: Container,
    by_log: Set[str],
    ahead: Mapping[str, int],
    most_pixels: Mapping[str, int],
    topic: str,
) -> Iterator[Frame]:
    """Yield the frames of one topic, read afresh from the file.

    Args:
        path: the log.
        container: how it is read.
        by_log: topics whose header stamps cannot be trusted.
        ahead: places by which the pictures of a topic may lie from their own.
        most_pixels: that the pictures of a topic may have.
        topic: the channel's.

    Raises:
        LogError: a small log claims so many pixels that decoding them would take minutes.
    """
    records = container(path, [], (topic,))
    left = most_pixels.get(topic, 0)
    frames = frames_of(records, topic, trusts_header=topic not in by_log)
    for frame in in_order(frames, ahead.get(topic, 0)):
        with suppress(LogError):  # one that is damaged costs nothing
            left -= frame.work_px()
        if left < 0:
            raise LogError(
                f"{path}: its pictures claim far more pixels than a log of that size has",
                COPY_AGAIN,
            )
        yield frame
