"""Read any log into an episode, however it was left, and report what was lost.

A container (`formats`) delivers records; `TopicContents` counts, decodes and gathers the messages
of a topic by the rules of its type; `read_episode` makes the episode of them, with warnings. An
imported log gets back what its notes say (`restored`), and `without_commands` drops what drove.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.audio import noted_rates
from tunenet_logs.episode import (
    BY_CLOCK,
    DAMAGED_MESSAGES,
    FRAME_NS,
    LOST,
    NOT_READ,
    UNSTATED,
    Channel,
    Episode,
    EpisodeInfo,
    Frame,
    Signal,
    Sound,
    added,
    as_note,
    in_proportion,
    of_note,
    share_of_note,
)
from tunenet_logs.errors import CHECK_DISK, COPY_AGAIN, LogError, NotFoundError
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
    RawMessages,
    RawMetadata,
    Record,
    StackedDecoder,
    UnusableError,
    described,
    lost_share,
    plain_type,
)
from tunenet_logs.formats.by_shape import UNUSED, ShapeMessages, shape_messages, unit_of
from tunenet_logs.formats.decoders import ENCODINGS, SchemaBudget
from tunenet_logs.formats.message_types import (
    DriveType,
    JointType,
    NumbersType,
    OutcomeType,
    PictureType,
    PlanType,
    PositionType,
    SoundType,
    message_type_of,
)
from tunenet_logs.formats.options import AS_IT_SAYS, ReadOptions
from tunenet_logs.images import FREE_VIDEO_PIXELS, VIDEO_PIXELS_A_BYTE
from tunenet_logs.media_messages import (
    Decoders,
    checked,
    frames_of,
    in_order,
    sound_of,
)
from tunenet_logs.messages import HEADER, INFO_RECORD, RECOVERY_RECORD
from tunenet_logs.signals import (
    MAX_NUMBERS,
    JointRows,
    MediaStamps,
    NumberRows,
    PlannedRows,
    PointBudget,
    PositionRows,
    WrenchRows,
)
from tunenet_logs.terminal import FEW_NAMES, listed, short_name
from tunenet_logs.timing.arrivals import BY_ARRIVALS, STAMPS_NOTE
from tunenet_logs.timing.stamps import LAST_NS, jump_warnings, with_jumps_of_pictures
from tunenet_logs.user_columns import UserColumnRows, UserColumns


def check_start(start_s: float | None, length_s: float) -> None:
    """Refuse a part that begins, in s since the first sample, after the end of a recording."""
    if start_s is not None and start_s > length_s:
        raise NotFoundError(
            f"--start {start_s:g} is past the end: the recording is {length_s:.2f} s long",
            "give an earlier one, or leave it out",
        )


def no_topic(topic: str, usable: Iterable[str]) -> NotFoundError:
    """Build the error for a topic that shows nothing; the message lists `usable` ones."""
    known = listed(sorted(usable), FEW_NAMES)
    remedy = "name one of these with --topic, or leave it out"
    if not known:
        remedy = "leave --topic out; see with tunenet-logs info what the log holds"
    return NotFoundError(f"no usable topic {topic} (there is: {known or 'none'})", remedy)


# ---- Notes of an import: units that nobody named, left-out samples
# Messages cannot say these, so an import notes them by topic: an imported log is then tuned as what
# it was imported from.

# How notes begin, before a signal's name.
_UNIT, _COUNTS, _IMPACTS, _LEFT_OUT = "length_unit:", "counts_frames:", "impacts:", "left_out:"

_UNTIMED = "frames_untimed"  # note of a log whose pictures are stamped by their count
_YES = "1"
_UNKNOWN = "unknown"  # a unit of length that nobody names


def is_impacts(signal: Signal) -> bool:
    """Check whether a signal is a series of impact times, with no other content."""
    return signal.columns == ("impact",)


def notes_of(signal: Signal, name: str) -> dict[str, str]:
    """Return the notes on a signal, under its `name` in the imported log."""
    notes: dict[str, str] = {}
    if signal.is_position and signal.unit != "m":
        notes[_UNIT + name] = signal.unit or _UNKNOWN
    if signal.counts_frames:
        notes[_COUNTS + name] = _YES
    if is_impacts(signal):
        notes[_IMPACTS + name] = _YES
    if signal.left_out:
        notes[_LEFT_OUT + name] = as_note(signal.left_out)
    return notes


def notes_of_channels(episode: Episode, topic_of: Callable[[str], str]) -> dict[str, str]:
    """Return the notes on what pictures and sounds lack, by their topics after the import."""
    untimed = {_UNTIMED: _YES} if episode.frames_untimed else {}
    return untimed | {
        _LEFT_OUT + topic_of(one.topic): as_note(one.left_out)
        for one in episode.channels
        if any(one.left_out.values()) and one.skipped is None
    }


def restored(episode: Episode, options: ReadOptions) -> Episode:
    """Restore what an imported log's notes say; the user's options go before them."""
    notes = episode.info.notes
    if not any(key.startswith((_UNIT, _COUNTS, _IMPACTS, _LEFT_OUT, _UNTIMED)) for key in notes):
        return episode
    impacts = {
        one.topic: _impacts(one)
        for one in episode.channels
        if one.type_name == HEADER and notes.get(_IMPACTS + one.topic) == _YES and one.messages
    }
    channels = tuple(
        replace(
            one,
            skipped=None if one.topic in impacts else one.skipped,
            left_out=added(one.left_out, of_note(notes.get(_LEFT_OUT + one.topic, "")))
            if one.pictures or one.sounds
            else {},
        )
        for one in episode.channels
    )
    signals = {**episode.signals, **impacts}
    found = replace(
        episode,
        signals={name: _restored(one, notes, options) for name, one in signals.items()},
        channels=channels,
    )
    if notes.get(_UNTIMED) != _YES or episode.open_frames is None:
        return found
    if not options.rate_hz:
        return replace(found, frames_untimed=True)
    opened, rate_hz = episode.open_frames, options.rate_hz

    def timed(topic: str) -> Iterator[Frame]:
        for frame in opened(topic):
            stamp_ns = int(_timed(np.array([frame.stamp_ns]), rate_hz)[0])
            yield replace(frame, stamp_ns=stamp_ns)

    return replace(found, open_frames=timed)


def _restored(signal: Signal, notes: Mapping[str, str], options: ReadOptions) -> Signal:
    unit = notes.get(_UNIT + signal.name, "")
    if signal.is_position and unit and not options.length_unit:
        signal = replace(signal, unit=UNSTATED if unit == _UNKNOWN else "px")
    if before := of_note(notes.get(_LEFT_OUT + signal.name, "")):
        signal = replace(signal, left_out=added(signal.left_out, before))
    if notes.get(_COUNTS + signal.name) != _YES:
        return signal
    if not options.rate_hz:
        return replace(signal, counts_frames=True)
    return replace(signal, stamps_ns=_timed(signal.stamps_ns, options.rate_hz))


def _timed(stamps_ns: NDArray[np.int64], rate_hz: float) -> NDArray[np.int64]:
    """Convert stamps that count frames to those of a rate [ns], shape (T,)."""
    return np.round(stamps_ns * (1e9 / rate_hz / FRAME_NS)).astype(np.int64)


def _impacts(channel: Channel) -> Signal:
    """Return impacts by the log's own stamps of their messages, which an import makes the same."""
    stamps_ns = np.unique(channel.log_ns)
    return Signal(channel.topic, stamps_ns, np.ones((len(stamps_ns), 1)), ("impact",), "1")


# ---- Measurements alone: an episode without commands and forces


def without_commands(episode: Episode) -> Episode:
    """Return the episode without commands, forces, and warnings about their channels.

    A commanded trajectory is no joint's state, and a sensor's torque no joint's: whoever looks for
    something in a log by its units looks at this. One without any is given back as it is.
    """
    driving = {name for name, signal in episode.signals.items() if signal.drives}
    channels = [channel for channel in episode.channels if channel.drives]
    if not driving and not channels:
        return episode
    others = {channel.topic for channel in episode.channels if not channel.drives}
    names = driving | ({channel.topic for channel in channels} - others)
    starts = tuple(f"{one}: " for name in names for one in (name, short_name(name)))

    def kept(lines: Iterable[str]) -> tuple[str, ...]:
        return tuple(line for line in lines if not line.startswith(starts))

    return replace(
        episode,
        signals={name: one for name, one in episode.signals.items() if name not in driving},
        channels=tuple(
            replace(one, skipped=UNUSED) if one.drives else one for one in episode.channels
        ),
        warnings=kept(episode.warnings),
        losses=kept(episode.losses),
    )


# ---- Topic: count, decode and gather its messages by the rules of their type

# Messages that are decoded together, at least; bytes of each and layouts of them, at most: with few
# of a layout it would take longer than one by one.
_MIN_STACKED, _MAX_STACKED, _MAX_LAYOUTS = 16, 64 * 1024, 8

_MAX_WAITING = 1024  # messages that came one by one, and wait to be decoded together
DriveRows = PlannedRows | NumberRows | WrenchRows  # what gathers commands and forces
# What gathers messages.
_Rows = PositionRows | JointRows | MediaStamps | DriveRows | UserColumnRows


class ReadingPlan:
    """State shared by the topics of a log while it is read."""

    def __init__(self, path: Path, options: ReadOptions, most_numbers: float) -> None:
        self.most_numbers = most_numbers  # that are kept of the joints of a topic
        self.budget = SchemaBudget()  # for definitions of types
        self.decoders = Decoders(self.budget)  # of the types that are known
        # The fields that are named; None where none is.
        self.picks = UserColumns(path, options, self.budget) if options.columns else None
        self._path = path
        self._options = options

    @cached_property
    def points(self) -> PointBudget:
        """Budget of trajectory points."""
        return PointBudget(registry.file_bytes(self._path))

    def length(self, unit: str) -> tuple[str, float]:
        """Return the unit of positions, and the factor to it from `unit`, the messages' own."""
        said = self._options.length_unit
        if not said:
            return unit, 1.0
        return ("px", 1.0) if self._options.length_m is None else ("m", self._options.length_m)


class TopicContents:
    """Messages of one topic, in one type: counted, decoded, gathered."""

    def __init__(self, channel: RawChannel, plan: ReadingPlan) -> None:
        self.channel = channel
        self.rows: _Rows | None = None  # None where the type or encoding is not read
        self.damaged = 0  # messages that cannot be read
        self.refused = 0  # those that may be whole, but of a kind or size that is not read
        self.used = 0  # those that were read
        self._log_ns = array("q")
        self._unusable: str | None = None
        self._why = ""  # the first message that was left out was
        self._type = message_type_of(channel)
        self._decode: Decode | None = None
        self._shape: ShapeMessages | None = None
        self._stacked: StackedDecoder | None = None
        self._waiting: list[tuple[int, bytes]] = []
        try:
            if not plan.picks or isinstance(self._type, PictureType | SoundType):
                self._read_by_type(plan)
                return
            rows = plan.picks.rows_of(self.channel)
            if rows is None:
                raise UnusableError("--columns names none of its fields")
            self.rows, self._decode, self._gather = rows, rows.decode, rows.add
            self._read = lambda message: message
        except UnusableError as reason:
            self._unusable = str(reason)

    def _read_by_type(self, plan: ReadingPlan) -> None:
        """Read by the channel's type, or by the shape of its messages; else UnusableError."""
        channel, kind = self.channel, self._type
        if isinstance(kind, OutcomeType):
            raise UnusableError("for tunenet-review")
        if kind is None and channel.encoding in ENCODINGS:
            shape = shape_messages(channel, plan.budget)
            if shape is None:
                raise UnusableError(UNUSED)
            self._shape, self._decode, self._read = shape, shape.decode, shape.read
            self.rows = PositionRows(channel.topic, *plan.length(unit_of(channel.type_name)))
            self._gather = self.rows.add
            return
        decoded = plan.decoders.of(channel)
        self._decode = decoded.decode
        assert kind is not None
        if isinstance(kind, PositionType):
            self.rows = PositionRows(channel.topic, *plan.length("m"), names_one=kind.names_one)
        elif isinstance(kind, JointType):
            self.rows = JointRows(channel.topic, plan.most_numbers)
            self._stacked = decoded.stacked
        elif isinstance(kind, DriveType):
            if isinstance(kind, PlanType):
                rows = PlannedRows(channel.topic, plan.points)
            elif isinstance(kind, NumbersType):
                rows = NumberRows(channel.topic)
            else:
                rows = WrenchRows(channel.topic)
            self.rows = rows

            def decode_checked(data: bytes | memoryview) -> Any:
                rows.check(data)  # before anything of it is decoded
                return decoded.decode(data)

            self._decode = decode_checked
        elif isinstance(kind, SoundType):
            self.rows = MediaStamps(channel.topic, is_sound=True)
        else:
            assert isinstance(kind, PictureType)
            self.rows = MediaStamps(channel.topic, is_video=kind.is_video)
        is_media = isinstance(kind, PictureType | SoundType)
        self._read: Callable[[Any], Any] = checked(kind) if is_media else kind.read
        self._gather: Callable[[int, Any], None] = self.rows.add

    @property
    def is_by_shape(self) -> bool:
        """Whether positions are recognised by the names of message fields."""
        return self._shape is not None

    @property
    def drives(self) -> bool:
        """Whether its messages are commands or forces."""
        return isinstance(self.rows, DriveRows)

    @property
    def is_video(self) -> bool:
        """Whether its frames depend on earlier ones."""
        return isinstance(self._type, PictureType) and self._type.is_video

    def checked_shape(self) -> list[str] | None:
        """Return notes on what was recognised by shape; None where that is implausible."""
        if self._shape is None:
            return []
        reason, said = self._shape.outcome(self.channel.topic)
        if not self.used and self.damaged:  # laid out in another way than is known here
            reason = f"its messages cannot be read{self.first}"
            self.damaged = 0
        if reason:
            self._unusable = reason
            return None
        return said

    def add(self, log_ns: int, data: bytes | memoryview) -> None:
        """Add one message, received at `log_ns` [ns]; it may wait for more to be read with."""
        if self._stacked is None or len(data) > _MAX_STACKED or not 0 <= log_ns <= LAST_NS:
            self.finish()
            self._add(log_ns, data)
            return
        self._waiting.append((log_ns, bytes(data)))
        if len(self._waiting) >= _MAX_WAITING:
            self.finish()

    def finish(self) -> None:
        """Read the messages that wait."""
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return
        stamps, data = zip(*waiting, strict=True)
        ends = np.cumsum([len(one) for one in data])
        begins = np.concatenate([[0], ends[:-1]])
        heads = np.array(list(zip(stamps, strict=True)), [("log_ns", "<u8")])
        plain = memoryview(b"".join(data))
        self.add_all(RawMessages(plain, {}, heads, begins, ends))

    def _add(self, log_ns: int, data: bytes | memoryview) -> None:
        if not 0 <= log_ns <= LAST_NS:
            self.damaged += 1
            self._why = self._why or "its time lies beyond the year 2262"
            return
        self._log_ns.append(log_ns)
        if self._decode is None:
            return
        try:
            self._gather(log_ns, self._read(self._decode(data)))
            self.used += 1
        except (UnusableError, BeyondLimitError) as reason:
            self.refused += 1
            self._why = self._why or str(reason)
        except (MessageError, *DAMAGED) as error:
            self.damaged += 1
            self._why = self._why or described(error)

    def add_all(self, messages: RawMessages) -> None:
        """Add contiguous messages, decoding those of one layout at once."""
        self.finish()
        if self._stacked is not None and self._add_stacked(self._stacked, messages):
            return
        stamps = messages.heads["log_ns"].tolist()
        for log_ns, begin, end in zip(
            stamps, messages.begins.tolist(), messages.ends.tolist(), strict=True
        ):
            self._add(log_ns, messages.plain[begin:end])

    def _add_stacked(self, decode: StackedDecoder, messages: RawMessages) -> bool:
        """Decode messages of few layouts at once; False if there are more, or one is damaged."""
        log_ns = messages.heads["log_ns"]
        sizes = messages.ends - messages.begins
        if len(sizes) < _MIN_STACKED or log_ns.max() > LAST_NS or sizes.max() > _MAX_STACKED:
            return False
        log_ns = log_ns.astype(np.int64)
        parts: list[tuple[NDArray[np.intp], NDArray[np.int64], Any]] = []
        try:
            for size in np.unique(sizes).tolist():
                places = np.flatnonzero(sizes == size)
                rows = messages.rows(places, size)
                while len(places):
                    if len(parts) >= _MAX_LAYOUTS:
                        return False
                    message, same = decode(rows)
                    parts.append((places[same], log_ns[places[same]], self._read(message)))
                    places, rows = places[~same], rows[~same]
            assert isinstance(self.rows, JointRows)
            self.rows.add_all(sorted(parts, key=lambda part: part[0][0]))
        except DAMAGED:
            return False
        self.used += len(log_ns)
        self._log_ns.frombytes(log_ns.tobytes())
        return True

    @property
    def first(self) -> str:
        """Why the first message was left out, in parentheses; "" where none was."""
        return f" (the first: {self._why})" if self._why else ""

    @property
    def messages(self) -> int:
        """Number of messages."""
        return len(self._log_ns)

    def lost_of(self, samples: int, share: float) -> dict[str, int]:
        """Estimate the missing samples by reason; `share` of the whole log is lost."""
        return {
            DAMAGED_MESSAGES: in_proportion(samples, self.damaged, self.used),
            NOT_READ: in_proportion(samples, self.refused, self.used),
            LOST: in_proportion(samples, share, 1 - share),
        }

    def another_name(self, taken: Iterable[str]) -> str:
        """Return an unused name for a topic whose name another channel's signals have, too."""
        name, number = f"{self.channel.topic}@{plain_type(self.channel.type_name)}", 1
        names = set(taken)
        while any(f"{one}.".startswith(f"{name}{number if number > 1 else ''}.") for one in names):
            number += 1
        return f"{name}{number if number > 1 else ''}"

    def summary(self, share: float) -> Channel:
        """Summarise as a `Channel`; `share` of the whole log is lost."""
        skipped = self._unusable
        if skipped is None and not self.used:
            if not self._log_ns and not self.damaged:
                skipped = "it holds no message"
            else:
                skipped = self._why if self.refused else f"all its messages are damaged{self.first}"
        left_out: Mapping[str, int] = {}
        if isinstance(self.rows, MediaStamps):  # of others their signals say it
            cut = {} if self.rows.is_sound else {BY_CLOCK: self.rows.cut}
            left_out = added(cut, self.lost_of(self.messages, share))
        return Channel(
            topic=self.channel.topic,
            type_name=self.channel.type_name,
            encoding=self.channel.encoding,
            log_ns=np.frombuffer(self._log_ns, np.int64),
            skipped=skipped,
            pictures=isinstance(self._type, PictureType),
            drives=self.drives,
            sounds=isinstance(self._type, SoundType),
            left_out=left_out,
        )


# ---- Reading options that made no difference

_NO_RATE = "--fps not used: its messages have times of their own"
_NO_CURRENTS = (
    "--torque-constants not used: no current is read of its messages (where its efforts are "
    "currents, add --effort-unit A)"
)


def said_unused(name: str, warnings: Iterable[str]) -> bool:
    """Check whether one of the warnings says that an option changed nothing."""
    return any(warning.startswith(f"{name} not used") for warning in warnings)


def unused_of_messages(episode: Episode, options: ReadOptions) -> tuple[str, ...]:
    """Return a line for each option that counts for nothing in a log of messages."""
    reads_currents = any(name.startswith("current") for name in options.columns)
    has_constants = bool(options.torque_constants)
    has_times = not any(key.startswith((_COUNTS, _UNTIMED)) for key in episode.info.notes)
    lines = {
        _NO_RATE: options.rate_hz is not None and has_times,
        _NO_CURRENTS: has_constants and not reads_currents,
    }
    return tuple(filter(lines.get, lines))


def unused_reading(
    path: Path,
    episode: Episode,
    options: ReadOptions,
    read: Callable[[Path, ReadOptions], Container | Episode],
) -> tuple[str, ...]:
    """Return a line for each option without which a file reads the same.

    Pictures and tables are not asked about what always counts there: their rate, their columns.
    """
    has_pictures = episode.open_frames is not None
    is_table = episode.info.source.startswith("table ")
    counts = {"--fps": has_pictures, "--columns": is_table}
    found: list[str] = []
    for name, field in options.given().items():
        if counts.get(name):
            continue
        if not has_pictures or episode.signals:
            without = replace(options, **{field: getattr(AS_IT_SAYS, field)})
            try:
                other = read(path, without)
            except LogError:
                continue
            if not isinstance(other, Episode) or not (
                list(episode.signals) == list(other.signals)
                and all(map(_is_same_signal, episode.signals.values(), other.signals.values()))
            ):
                continue
        found.append(f"{name} not used: the file reads the same without")
    return tuple(found)


def _is_same_signal(one: Signal, other: Signal) -> bool:
    facts = [(each.columns, each.unit, each.counts_frames) for each in (one, other)]
    return (
        facts[0] == facts[1]
        and np.array_equal(one.stamps_ns, other.stamps_ns)
        and np.array_equal(one.values, other.values, equal_nan=True)
    )


# ---- Reading: from the records of a container to an episode

# Pixels of all pictures of a log, whatever its size is (a second of decoding), and further ones for
# each of its bytes: a camera's pictures have 20, rendered ones without noise 300.
_FREE_PIXELS, _PIXELS_A_BYTE = 50_000_000, 500

_FEW_TOPICS = 8  # cameras that are read, however long the log is; and microphones, at most
# Messages that all picture topics together may pass, since each is read by a pass over the file: of
# any log, and the bytes of a log for each beyond.
_FREE_MESSAGES, _BYTES_A_MESSAGE = 5_000_000, 50

_MAX_LOSSES = 5  # damaged places that the warnings name; the rest is counted


def read_episode(
    path: Path, options: ReadOptions = AS_IT_SAYS, *, most_numbers: float = MAX_NUMBERS
) -> Episode:
    """Read a log into memory, images aside: `frames()` reads those on demand.

    Signals are named by their topic. What was lost, repaired or is doubtful is in `warnings`. Of
    the joints of a topic `most_numbers` are kept; of more messages some are left out. LogError:
    `path` does not exist, is not a log, or holds nothing readable at all.
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
    """Contents that a container delivers."""

    def __init__(self, plan: ReadingPlan) -> None:
        self.info: Mapping[str, str] = {}  # what the log says of itself
        self.share = 0.0  # of it, that was lost before it was recovered
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
    doubts: list[str] = []
    named, notes = plan.picks.signals() if plan.picks else ([], [])
    signals = {signal.name: signal for signal in named}
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
        if isinstance(rows, MediaStamps):
            is_header, reasons = rows.trusts_header()
            doubts += reasons
            is_found = info.notes.get(STAMPS_NOTE, "").startswith(BY_ARRIVALS)  # of pictures alone
            if not is_header or (is_found and not rows.is_sound):
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
            for signal in found:
                missing = topic.lost_of(len(signal.stamps_ns), share)
                known = added(signal.left_out, missing)
                signals[signal.name] = replace(signal, left_out=known)
    lost = [loss for loss in losses if not loss.harmless]
    found = [topic.summary(share) for topic in topics]
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
        if isinstance(topic.rows, MediaStamps)
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
    cameras = [one for one in topics if isinstance(one.rows, MediaStamps) and not one.rows.is_sound]
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

    `by_log` names topics whose header stamps cannot be trusted, `ahead` the places by which the
    pictures of a topic may lie from their own. A small log that claims so many pixels that decoding
    them would take minutes is a LogError.
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
