"""Check, import and recover logs: what `tunenet-logs check`, `import` and `recover` do.

`check` reads all of a log and decodes every picture and sound. `import_log` writes what a task uses
of any log, table or video to a log of our format. `recover` copies the whole messages of a damaged
log, as they are, to a file that opens in every reader of MCAP.
"""

from __future__ import annotations

import heapq
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer

from tunenet_logs import __version__, messages
from tunenet_logs.audio import sound_blocks, sound_notes_of, why_not_kept
from tunenet_logs.episode import (
    MAX_LEFT_OUT,
    SHARE_NOTE,
    UNSTATED,
    Episode,
    EpisodeInfo,
    LeftOut,
    Signal,
    Sound,
    left_out_of,
)
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
    ros_name,
)
from tunenet_logs.formats.fields import UNUSED
from tunenet_logs.formats.options import AS_IT_SAYS, ReadOptions
from tunenet_logs.formats.registry import file_bytes, open_log
from tunenet_logs.messages import INFO_RECORD, RECOVERY_RECORD, SHOWS, compressed, is_info
from tunenet_logs.reader import (
    is_impacts,
    notes_of,
    notes_of_channels,
    read_episode,
    topic_of,
    without_commands,
)
from tunenet_logs.signals import ORIENTATION
from tunenet_logs.terminal import Progress, one_line, told
from tunenet_logs.timing.stamps import trim_clock_jumps
from tunenet_logs.writing.owned_path import (
    OutputPlace,
    check_log_name,
    not_writable,
    nothing,
    own_log,
)
from tunenet_logs.writing.writer import EpisodeWriter


@dataclass(frozen=True, eq=False)
class Health:
    """Result of an integrity check."""

    episode: Episode
    damage: tuple[str, ...]  # what is wrong and where, one a line; empty for a whole log
    doubts: tuple[str, ...]  # what is no damage but should be known
    # of which so much is left out that the log is not whole, though not damaged
    left_out: tuple[LeftOut, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether nothing is damaged and everything is used."""
        return not self.damage and not self.left_out


def check(path: Path, progress: Progress, options: ReadOptions = AS_IT_SAYS) -> Health:
    """Check a log by reading all of it and decoding all of its pictures and sound."""
    with progress.stages(one_line(path)):
        episode = read_episode(path, options)
    damage = list(episode.losses)
    for topic in episode.picture_topics:
        stated = sum(channel.messages for channel in episode.channels if channel.topic == topic)
        bad_ns: list[int] = []
        count = 0
        with progress.bar(stated, topic, "picture") as bar:
            try:
                for frame in episode.frames(topic):
                    count += 1
                    bar.update(1)
                    try:
                        frame.decode(frame.coarse)
                    except LogError:
                        bad_ns.append(frame.stamp_ns)
            except LogError as error:
                damage.append(f"{topic}: reading ends after {count} of {stated} pictures: {error}")
        if bad_ns:
            what = f"{len(bad_ns)} of {count} pictures are damaged, first {bad_ns[0]} ns"
            damage.append(f"{topic}: {what}")
    heard: list[str] = []
    for topic in episode.sound_topics:
        if sound := episode.sounds(topic):
            heard += [f"{topic}: {said}" for said in sound.warnings]
    lost = set(episode.losses)
    doubts = tuple(warning for warning in episode.warnings if warning not in lost)
    left_out = (one for one in left_out_of(trim_clock_jumps(episode)) if one.share > MAX_LEFT_OUT)
    return Health(episode, tuple(damage), (*doubts, *heard), tuple(left_out))


# ---- Import: any log, table or video in our format, what a task uses and nothing else

JOINT_PARTS = ("position", "velocity", "effort")  # how the signals of a topic of joints end
# Messages of one topic in order: stamp, topic, and what writes it.
TopicMessages = Iterator[tuple[int, str, Callable[[EpisodeWriter], None]]]
_FORCES = "a force, which stays in the log that is imported: tune a model from that"
_AT_ONCE = 10_000  # samples of joints that are prepared at a time
_NAME_ANOTHER = "name a log that does, or say which column is which with --columns"


@dataclass(frozen=True)
class Imported:
    """Result of an import."""

    messages: int  # how many were written
    # channels that hold nothing that is used, with the reason; and samples of others
    left_out: tuple[str, ...]
    # what the log called otherwise than its topic is called now, and that topic
    renamed: tuple[str, ...]
    warnings: tuple[str, ...]  # what was lost or is doubtful in the log that was read


def import_log(
    path: Path,
    output: Path,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    options: ReadOptions = AS_IT_SAYS,
) -> Imported:
    """Write what tasks use of a log to `output`, by stamp; a failed import leaves nothing."""
    _check_output(path, output)
    with (progress or Progress(quiet=True)).stages(one_line(path)):
        return _imported(path, output, overwrite=overwrite, options=options)


def _check_output(path: Path, output: Path) -> None:
    if output.suffix != ".mcap":
        raise UsageError(f"{output}: name a .mcap file with -o")
    if output.exists() and path.exists() and output.samefile(path):
        raise UsageError(f"{output}: is the log itself, which is never changed; choose another -o")


def _imported(path: Path, output: Path, *, overwrite: bool, options: ReadOptions) -> Imported:
    everything = read_episode(path, options, most_numbers=np.inf)
    episode = with_commands_of_joints(everything)
    named = {*episode.signals, *episode.picture_topics, *episode.sound_topics}
    topics = _Topics({*named, *joint_topics(episode)})
    said = notes_of_channels(episode, ros_topic)
    heard, unheard = _sounds(episode)
    for sound in heard:
        said |= sound_notes_of(sound)
    streams = [
        *_signal_streams(episode, topics, said),
        *(_pictures(episode, topic, topics) for topic in dict.fromkeys(episode.picture_topics)),
        *(_blocks(sound, topics.claim(sound.name)) for sound in heard),
    ]
    if not streams:
        raise LogError(_why_nothing(path, episode, unheard), _NAME_ANOTHER)
    notes = {**episode.info.notes, **said, "imported_from": path.name}
    source = episode.info.source or path.name
    info = replace(episode.info, source=source, notes=notes)
    total = sum(channel.messages for channel in episode.channels if channel.skipped is None)
    with EpisodeWriter(output, info, overwrite=overwrite, live=False, is_import=True) as writer:
        merged = heapq.merge(*streams, key=lambda message: message[:2])
        for _, _, write in told(merged, "importing", total):
            write(writer)
        if not writer.accepted:
            raise LogError(_why_nothing(path, episode, unheard), _NAME_ANOTHER)
    left_out = [
        f"{channel.topic}: {_FORCES if channel.drives else channel.skipped}"
        for channel in episode.channels
        if channel.skipped
    ]
    left_out += [
        f"{name}: nothing tells what it is, or in which unit"
        for name, signal in episode.signals.items()
        if signal.unit == UNSTATED and not signal.is_position and not _is_kept(signal)
    ]
    left_out += [*unheard, *map(str, left_out_of(episode))]
    return Imported(writer.written, tuple(left_out), tuple(topics.renamed), episode.warnings)


def ros_topic(name: str) -> str:
    """Convert a signal's name to a valid ROS topic: "/tf.ball" is "/tf/ball"."""
    letters = "".join(letter if letter.isalnum() or letter in "_/" else "/" for letter in name)
    words = [word for word in letters.split("/") if word]
    return "/" + "/".join(words or ["unnamed"])


class _Topics:
    """Unique topics for the names of a log; a name that is a topic already keeps it."""

    def __init__(self, names: Iterable[str]) -> None:
        self.renamed: list[str] = []
        self._kept = {name for name in names if ros_topic(name) == name}
        self._taken: set[str] = set()
        self._numbers: dict[str, int] = {}

    def claim(self, name: str) -> str:
        """Return a topic for one more thing of that name."""
        topic = wanted = ros_topic(name)
        while topic in self._taken or (topic in self._kept and topic != name):
            self._numbers[wanted] = number = self._numbers.get(wanted, 1) + 1
            topic = f"{wanted}_{number}"
        self._taken.add(topic)
        if topic != name:
            self.renamed.append(f"{name!r} is {topic}")
        return topic


def _why_nothing(path: Path, episode: Episode, unheard: list[str]) -> str:
    """Say that nothing can be imported, with what each channel is and what the reader said."""
    seen = ", ".join(
        f"{one.topic} ({one.type_name}{f': {one.skipped}' if one.skipped else ''})"
        for one in episode.channels
    )
    has_reason = any(channel.skipped for channel in episode.channels)
    known = (*episode.losses, *unheard) or (() if has_reason else episode.warnings)
    said = "; ".join(known[:3])  # what one line holds
    why = f" that can be used ({said})" if said else ""
    return f"{path}: holds no positions, joints, pictures or sound{why}; channels: {seen or 'none'}"


def _signal_streams(
    episode: Episode, topics: _Topics, said: dict[str, str]
) -> Iterator[TopicMessages]:
    """Yield the messages of each signal; `said` gets the notes on what they cannot say."""
    for name, signal in episode.signals.items():
        if signal.is_position or is_impacts(signal):
            topic = topics.claim(name)
            said |= notes_of(signal, topic)
            turns = episode.signals.get(f"{name}.{ORIENTATION}")
            yield _poses(topic, signal, turns) if signal.is_position else _impacts(topic, signal)
        elif signal.drives and _is_kept(signal) and name.rpartition(".")[2] not in JOINT_PARTS:
            topic = topics.claim(name)
            said |= notes_of(signal, topic)
            yield _numbers(topic, signal)
    for name, parts in joint_topics(episode).items():
        topic = topics.claim(name)
        for part, signal in parts.items():
            said |= notes_of(signal, f"{topic}.{part}")
        yield joint_states(topic, parts)


def with_commands_of_joints(episode: Episode) -> Episode:
    """Return the episode without forces: commands of joints are imported, and noted as such."""
    plain = without_commands(episode)
    kept = {name for name, one in episode.signals.items() if one.drives and _is_kept(one)}
    if not kept:
        return plain
    topics = {*kept, *map(topic_of, kept)}
    channels = (
        replace(one, skipped=one.skipped or UNUSED)
        if one.drives and one.topic not in topics
        else one
        for one in episode.channels
    )
    signals = {name: one for name, one in episode.signals.items() if not one.drives or name in kept}
    return replace(episode, signals=signals, channels=tuple(channels))


def _is_kept(signal: Signal) -> bool:
    """Return whether a signal is of joints, or of commands that say no quantity."""
    is_joints = signal.name.rpartition(".")[2] in JOINT_PARTS and signal.columns != ("x", "y", "z")
    return is_joints or (signal.drives and signal.unit in ("1", UNSTATED))


def joint_topics(episode: Episode) -> dict[str, dict[str, Signal]]:
    """Group joint signals (position, velocity, effort) by topic."""
    joints: dict[str, dict[str, Signal]] = {}
    for name, signal in episode.signals.items():
        topic, _, part = name.rpartition(".")
        if part in JOINT_PARTS and signal.columns != ("x", "y", "z"):
            joints.setdefault(topic, {})[part] = signal
    return joints


def _poses(topic: str, signal: Signal, turns: Signal | None) -> TopicMessages:
    still = np.tile(messages.NOT_TURNED, (len(signal.values), 1))
    quaternions = still if turns is None else turns.values
    rows = zip(signal.stamps_ns.tolist(), signal.values, quaternions, strict=True)
    write = partial(EpisodeWriter.write_pose, topic=topic, frame=signal.frame or "world")
    for stamp_ns, position_m, turn in rows:
        yield stamp_ns, topic, partial(write, stamp_ns=stamp_ns, position_m=position_m, turn=turn)


def _impacts(topic: str, signal: Signal) -> TopicMessages:
    """Yield a header for each: nothing is known of an impact but its time."""
    write = partial(EpisodeWriter.write_message, topic=topic, type_name=messages.HEADER)
    for stamp_ns in signal.stamps_ns.tolist():
        data = messages.encode(messages.header(stamp_ns, ""), messages.HEADER)
        yield stamp_ns, topic, partial(write, stamp_ns=stamp_ns, data=data)


def _numbers(topic: str, signal: Signal) -> TopicMessages:
    """Yield commands that say no quantity, in the order of the signal's columns."""
    write = partial(EpisodeWriter.write_message, topic=topic, type_name=messages.NUMBERS)
    for stamp_ns, values in zip(signal.stamps_ns.tolist(), signal.values, strict=True):
        data = messages.encode(messages.numbers(values), messages.NUMBERS)
        yield stamp_ns, topic, partial(write, stamp_ns=stamp_ns, data=data)


def joint_states(topic: str, parts: dict[str, Signal]) -> TopicMessages:
    """Yield messages of every joint that a part has, at every stamp of a part.

    Parts that came in the same messages have the same stamps and joints; those of a table need not.
    """
    names = list(dict.fromkeys(name for part in parts.values() for name in part.columns))
    places = {part: [names.index(name) for name in parts[part].columns] for part in parts}
    write = partial(EpisodeWriter.write_joints, topic=topic, names=names)
    every = [signal.stamps_ns for signal in parts.values()]
    stamps_ns = every[0]
    if any(one is not stamps_ns for one in every):
        stamps_ns = np.unique(np.concatenate(every))
    for begin in range(0, len(stamps_ns), _AT_ONCE):
        some_ns = stamps_ns[begin : begin + _AT_ONCE]
        columns = [
            _values_at(parts[part], some_ns, places[part], len(names)) if part in parts else None
            for part in JOINT_PARTS
        ]
        for row, stamp_ns in enumerate(some_ns.tolist()):
            given = [() if one is None or not one[1][row] else one[0][row] for one in columns]
            state: dict[str, Any] = dict(
                zip(("position_rad", "velocity_rad_s", "effort_nm"), given, strict=True)
            )
            yield stamp_ns, topic, partial(write, stamp_ns=stamp_ns, **state)


def _values_at(
    signal: Signal, stamps_ns: np.ndarray, places: list[int], count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return a signal's values, shape (T, count), NaN without one, and whether stamped, (T,)."""
    rows = np.minimum(np.searchsorted(signal.stamps_ns, stamps_ns), len(signal.stamps_ns) - 1)
    values = np.full((len(stamps_ns), count), np.nan)
    values[:, places] = signal.values[rows]
    return values, signal.stamps_ns[rows] == stamps_ns


def _sounds(episode: Episode) -> tuple[list[Sound], list[str]]:
    """Return the sounds of a log that are imported, and why others are not."""
    heard: list[Sound] = []
    unheard: list[str] = []
    for topic in dict.fromkeys(episode.sound_topics):
        if sum(len(sound.samples) for sound in heard) >= 57_600_000:  # two of 10 min at 48 kHz
            unheard.append(f"{topic}: the log has more sound than an import takes")
        elif (sound := episode.sounds(topic)) is None:
            unheard.append(f"{topic}: holds no sound")
        elif why := why_not_kept(sound):
            unheard.append(f"{topic}: {why}")
        else:
            heard.append(sound)
    return heard, unheard


def _blocks(sound: Sound, topic: str) -> TopicMessages:
    write = partial(EpisodeWriter.write_sound, topic=topic, rate_hz=round(sound.rate_hz))
    for stamp_ns, pcm in sound_blocks(sound):
        yield stamp_ns, topic, partial(write, stamp_ns=stamp_ns, pcm=pcm)


def _pictures(episode: Episode, topic: str, topics: _Topics) -> TopicMessages:
    """Yield the pictures of one topic; bare and compressed ones are messages of two types."""
    encodings = {channel.topic: channel.encoding for channel in episode.channels}
    targets: dict[bool, str] = {}
    for frame in episode.frames(topic):
        kept = compressed(frame) if encodings[topic] == "video" else frame
        is_bare = kept.size is not None
        if is_bare not in targets:
            targets[is_bare] = topics.claim(topic)
        target = targets[is_bare]
        yield frame.stamp_ns, target, partial(EpisodeWriter.write_frame, topic=target, frame=kept)


# ---- Recovery: copy what is whole of a damaged log


@dataclass(frozen=True)
class Recovered:
    """Result of a recovery."""

    messages: int  # how many were saved
    losses: tuple[str, ...]  # what was not, in words
    # whether there are messages of ROS 1 among them, which stay what they are
    holds_ros1: bool = False


def recover(path: Path, output: Path, *, overwrite: bool = False) -> Recovered:
    """Copy all whole messages of a log, as they are, into a new MCAP file with all checksums."""
    _check_output(path, output)
    try:
        check_log_name(output, overwrite=overwrite)
    except LogError as error:
        raise UsageError(str(error)) from error
    container = open_log(path)
    if isinstance(container, Episode):
        raise LogError(
            f"{path}: holds no messages to recover; bring it in with tunenet-logs import"
        )
    try:
        place = OutputPlace(output, "log", own_log if overwrite else nothing)
        with place.replacing() as unfinished, unfinished.open("wb") as file:
            recovered = _copied(Writer(file, enable_data_crcs=True), path, container)
            file.flush()
            os.fsync(file.fileno())
            if not recovered.messages:
                why = f" ({recovered.losses[0]})" if recovered.losses else ""
                raise LogError(f"{path}: holds no message that can be saved{why}")
    except OSError as error:
        raise not_writable(output, error) from error
    return recovered


def _records(path: Path, container: Container, losses: list[Loss]) -> Iterator[Record]:
    """Yield what is read; a disk that fails to read is not to be taken for the one written to."""
    try:
        yield from one_by_one(container(path, losses))
    except OSError as error:
        why = f"cannot be read ({error.strerror})"
        raise LogError(f"{path}: {why}; copy it to another disk and recover the copy") from error


def _copied(writer: Writer, path: Path, container: Container) -> Recovered:
    """Copy a container's records by a writer."""
    losses: list[Loss] = []
    schemas: dict[tuple[str, str, bytes], int] = {}
    channels: dict[RawChannel, int] = {}
    info: dict[str, str] = {}
    count = beyond = 0
    holds_ros1 = is_started = False
    for record in _records(path, container, losses):
        if not is_started:
            profile = "ros2" if isinstance(record, RawMetadata) and is_info(record.name) else ""
            if isinstance(record, RawChannel):
                profile = {"cdr": "ros2", "ros1": "ros1"}.get(record.encoding, "")
            writer.start(profile, f"tunenet-logs {__version__}")
            is_started = True
        if isinstance(record, RawChannel):
            channels[record] = _registered(writer, record, schemas)
        elif isinstance(record, RawMessage):
            data, log_ns, publish_ns = bytes(record.data), record.log_ns, record.publish_ns
            if not (0 <= log_ns < 2**64 and 0 <= publish_ns < 2**64):  # MCAP holds no other
                beyond += 1
                continue
            channel = channels[record.channel]
            writer.add_message(channel, log_ns, data, publish_ns, record.sequence)
            count += SHOWS not in record.channel.metadata
            holds_ros1 |= record.channel.encoding == "ros1"
        elif isinstance(record, RawMetadata):
            writer.add_metadata(record.name, dict(record.values))
            if is_info(record.name):
                info |= record.values
        elif isinstance(record, RawAttachment):
            writer.add_attachment(
                record.create_ns, record.log_ns, record.name, record.media_type, record.data
            )
    if not is_started:
        writer.start("", f"tunenet-logs {__version__}")
    lost = [str(loss) for loss in losses if not loss.harmless]
    if beyond:
        lost.append(f"{beyond} messages with impossible stamps were left out")
    # The counts that its recorder did not come to write, and what was lost.
    known = EpisodeInfo.from_strings(info)
    if info and "written" not in known.counts:
        known = known.ended("the recording did not end by itself", written=count)
        writer.add_metadata(f"{INFO_RECORD}/recovered", known.news(info))
    words = {"from": path.name, "messages": str(count)}
    words[SHARE_NOTE] = f"{lost_share(losses, count, file_bytes(path)):.6f}"
    words |= {f"lost.{number}": text for number, text in enumerate(lost[:100])}
    writer.add_metadata(RECOVERY_RECORD, words)
    writer.finish()
    return Recovered(count, tuple(lost), holds_ros1)


def _registered(
    writer: Writer, channel: RawChannel, schemas: dict[tuple[str, str, bytes], int]
) -> int:
    """Announce a channel, and its type where it is new; return its number."""
    text, encoding = channel.schema, channel.schema_encoding
    if not encoding and channel.encoding == "cdr":  # a .db3 need not hold definitions
        name, text = ros_name(channel.type_name), b""
        if name in messages.typestore().types:
            text, encoding = messages.definition(name).encode(), "ros2msg"
    schema = 0
    if channel.type_name:
        key = (channel.type_name, encoding, text)
        if key not in schemas:
            schemas[key] = writer.register_schema(*key)
        schema = schemas[key]
    return writer.register_channel(channel.topic, channel.encoding, schema, dict(channel.metadata))
