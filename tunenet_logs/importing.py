"""Import any log, table or video into our format: what a task uses, and nothing else."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tunenet_logs import messages
from tunenet_logs.episode import Channel, Episode, Frame, Signal
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.formats.read_options import AS_IT_SAYS, ReadOptions
from tunenet_logs.import_notes import is_impacts, notes_of, notes_of_channels, notes_of_frames
from tunenet_logs.jpeg import compressed
from tunenet_logs.left_out import left_out_of
from tunenet_logs.measured import measured
from tunenet_logs.position_rows import ORIENTATION
from tunenet_logs.progress import told
from tunenet_logs.reader import read_episode
from tunenet_logs.sound import Sound
from tunenet_logs.sound_notes import sound_blocks, sound_notes_of, why_not_kept
from tunenet_logs.terminal import Progress, one_line
from tunenet_logs.writer import EpisodeWriter

JOINT_PARTS = ("position", "velocity", "effort")  # how the signals of a topic of joints end
_POSITION_COLUMNS = ("x", "y", "z")  # the columns of a signal of positions
_MAX_REASONS = 3  # losses that are named where nothing was left to import: what one line holds
# Of sound, after which no further topic's is imported: two of ten minutes at 48 kHz.
_MAX_SAMPLES = 57_600_000

Write = Callable[[EpisodeWriter], None]  # writes one message
_DRIVES = "a command or a force, which stays in the log that is imported: tune a model from that"

_AT_ONCE = 10_000  # samples of joints that are made ready to be written
_NAME_ANOTHER = "name a log that does, or say which column is which with --columns"


@dataclass(frozen=True)
class Imported:
    """Result of an import.

    Attributes:
        messages: how many were written.
        left_out: channels that hold nothing that is used, with the reason; and samples of others.
        renamed: what the log called otherwise than its topic is called now, and that topic.
        warnings: what was lost or is doubtful in the log that was read.
    """

    messages: int
    left_out: tuple[str, ...]
    renamed: tuple[str, ...]
    warnings: tuple[str, ...]


def import_log(
    path: Path,
    output: Path,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    options: ReadOptions = AS_IT_SAYS,
) -> Imported:
    """Write positions, joints, pictures and sound of a log to `output`, ordered by stamp.

    Pictures that are compressed stay as they are; bare pixels of a video become JPEG. A failed
    import leaves nothing.

    Raises:
        UsageError: the output is the log itself.
        LogError: the log cannot be read, holds nothing that is used, or `output` not written.
    """
    if output.suffix != ".mcap":
        raise UsageError(f"{output}: name a .mcap file with -o")
    if output.exists() and path.exists() and output.samefile(path):
        raise UsageError(f"{output}: is the log itself, which is never changed; choose another -o")
    with (progress or Progress(quiet=True)).stages(one_line(path)):
        return _imported(path, output, overwrite=overwrite, options=options)


def _imported(path: Path, output: Path, *, overwrite: bool, options: ReadOptions) -> Imported:
    everything = read_episode(path, options, most_numbers=np.inf)
    episode = measured(everything)  # a command would become a state
    named = {*episode.signals, *episode.picture_topics, *episode.sound_topics}
    topics = _Topics({*named, *joint_topics(episode)})
    said = notes_of_frames(episode) | notes_of_channels(episode, ros_topic)
    heard, unheard = _sounds(episode)
    for sound in heard:
        said |= sound_notes_of(sound)
    streams = [
        *_signal_streams(episode, topics, said),
        *_picture_streams(episode, topics),
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
        f"{channel.topic}: {_DRIVES if channel.drives else channel.skipped}"
        for channel in episode.channels
        if channel.skipped
    ]
    left_out += [*unheard, *map(str, left_out_of(episode))]
    return Imported(writer.written, tuple(left_out), tuple(topics.renamed), episode.warnings)


def ros_topic(name: str) -> str:
    """Convert a signal's name to a valid ROS topic: "/tf.ball" is "/tf/ball"."""
    letters = "".join(letter if letter.isalnum() or letter in "_/" else "/" for letter in name)
    words = [word for word in letters.split("/") if word]
    return "/" + "/".join(words or ["unnamed"])


class _Topics:
    """Unique topics for the names of a log.

    A name that is a topic already keeps it; others that come to the same get a number.

    Attributes:
        renamed: names that became another topic, with that topic.
    """

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
    seen = ", ".join(map(_described, episode.channels)) or "none"
    has_reason = any(channel.skipped for channel in episode.channels)
    known = (*episode.losses, *unheard) or (() if has_reason else episode.warnings)
    said = "; ".join(known[:_MAX_REASONS])
    why = f" that can be used ({said})" if said else ""
    return f"{path}: holds no positions, joints, pictures or sound{why}; channels: {seen}"


def _described(channel: Channel) -> str:
    reason = f": {channel.skipped}" if channel.skipped else ""
    return f"{channel.topic} ({channel.type_name}{reason})"


def _signal_streams(
    episode: Episode, topics: _Topics, said: dict[str, str]
) -> Iterator[Iterator[tuple[int, str, Write]]]:
    """Yield the messages of each signal; `said` gets the notes on what they cannot say."""
    for name, signal in episode.signals.items():
        if signal.is_position or is_impacts(signal):
            topic = topics.claim(name)
            said |= notes_of(signal, topic)
            turns = episode.signals.get(f"{name}.{ORIENTATION}")
            yield _poses(topic, signal, turns) if signal.is_position else _impacts(topic, signal)
    for name, parts in joint_topics(episode).items():
        topic = topics.claim(name)
        for part, signal in parts.items():
            said |= notes_of(signal, f"{topic}.{part}")
        yield _joint_states(topic, parts)


def joint_topics(episode: Episode) -> dict[str, dict[str, Signal]]:
    """Group joint signals (position, velocity, effort) by topic."""
    joints: dict[str, dict[str, Signal]] = {}
    for name, signal in episode.signals.items():
        topic, _, part = name.rpartition(".")
        if part in JOINT_PARTS and signal.columns != _POSITION_COLUMNS:
            joints.setdefault(topic, {})[part] = signal
    return joints


def _poses(topic: str, signal: Signal, turns: Signal | None) -> Iterator[tuple[int, str, Write]]:
    frame = signal.frame or "world"
    quaternions = np.tile(messages.NOT_TURNED, (len(signal.values), 1))
    if turns is not None:
        quaternions = turns.values
    rows = zip(signal.stamps_ns.tolist(), signal.values, quaternions, strict=True)
    for stamp_ns, position_m, quaternion in rows:

        def write(
            writer: EpisodeWriter,
            stamp: int = stamp_ns,
            at: np.ndarray = position_m,
            turn: np.ndarray = quaternion,
        ) -> None:
            writer.write_pose(topic, stamp, at, turn, frame)

        yield stamp_ns, topic, write


def _impacts(topic: str, signal: Signal) -> Iterator[tuple[int, str, Write]]:
    """Yield a header for each: nothing is known of an impact but its time."""
    for stamp_ns in signal.stamps_ns.tolist():

        def write(writer: EpisodeWriter, stamp: int = stamp_ns) -> None:
            data = messages.encode(messages.header(stamp, ""), messages.HEADER)
            writer.write_message(topic, messages.HEADER, stamp, data)

        yield stamp_ns, topic, write


def _joint_states(topic: str, parts: dict[str, Signal]) -> Iterator[tuple[int, str, Write]]:
    """Yield messages of every joint that a part has, at every stamp of a part.

    Parts that came in the same messages have the same stamps and joints; those of a table need not.
    """
    names = list(dict.fromkeys(name for part in parts.values() for name in part.columns))
    places = {part: [names.index(name) for name in parts[part].columns] for part in parts}
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

            def write(
                writer: EpisodeWriter, stamp: int = stamp_ns, row: int = row, of: Any = columns
            ) -> None:
                quantities = [() if one is None or not one[1][row] else one[0][row] for one in of]
                writer.write_joints(topic, stamp, names, *quantities)

            yield stamp_ns, topic, write


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
        if sum(len(sound.samples) for sound in heard) >= _MAX_SAMPLES:
            unheard.append(f"{topic}: the log has more sound than an import takes")
        elif (sound := episode.sounds(topic)) is None:
            unheard.append(f"{topic}: holds no sound")
        elif why := why_not_kept(sound):
            unheard.append(f"{topic}: {why}")
        else:
            heard.append(sound)
    return heard, unheard


def _blocks(sound: Sound, topic: str) -> Iterator[tuple[int, str, Write]]:
    for stamp_ns, pcm in sound_blocks(sound):

        def write(writer: EpisodeWriter, stamp: int = stamp_ns, block: Any = pcm) -> None:
            writer.write_sound(topic, stamp, block, round(sound.rate_hz))

        yield stamp_ns, topic, write


def _picture_streams(
    episode: Episode, topics: _Topics
) -> Iterator[Iterator[tuple[int, str, Write]]]:
    for topic in dict.fromkeys(episode.picture_topics):
        yield _pictures(episode, topic, topics)


def _pictures(episode: Episode, topic: str, topics: _Topics) -> Iterator[tuple[int, str, Write]]:
    """Yield the pictures of one topic; bare and compressed ones are messages of two types."""
    encodings = {channel.topic: channel.encoding for channel in episode.channels}
    targets: dict[bool, str] = {}
    for frame in episode.frames(topic):
        kept = compressed(frame) if encodings[topic] == "video" else frame
        is_bare = kept.size is not None
        if is_bare not in targets:
            targets[is_bare] = topics.claim(topic)

        def write(
            writer: EpisodeWriter, target: str = targets[is_bare], picture: Frame = kept
        ) -> None:
            writer.write_frame(target, picture)

        yield frame.stamp_ns, targets[is_bare], write
