"""Read any log into an episode, however it was left, and report what was lost.

A container (`formats`) delivers records; `TopicContents` counts, decodes and gathers the messages
of a topic by the rules of its type; `read_episode` makes the episode of them, with warnings. An
imported log gets back what its notes say (`restored`), and `without_commands` drops what drove.
"""

from __future__ import annotations

import json
import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import replace
from functools import partial
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
    StackedDecoder,
    UnusableError,
    described,
    lost_share,
)
from tunenet_logs.formats.columns.angles import PERCENT
from tunenet_logs.formats.decoders import ENCODINGS, Decoders
from tunenet_logs.formats.fields import (
    UNUSED,
    ShapeMessages,
    UserColumnRows,
    UserColumns,
    shape_messages,
    unit_of,
)
from tunenet_logs.formats.message_types import message_type_of
from tunenet_logs.formats.options import AS_IT_SAYS, ReadOptions
from tunenet_logs.images import FREE_VIDEO_PIXELS, VIDEO_PIXELS_A_BYTE
from tunenet_logs.media_messages import checked, frames_of, in_order, sound_of
from tunenet_logs.messages import HEADER, RECOVERY_RECORD, SHOWS, is_info
from tunenet_logs.signals import (
    MAX_NUMBERS,
    ControllerRows,
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
# Of joints: that it is a command, its unit where it is not the usual one, and what its columns are.
_COMMANDS, _JOINT_UNIT, _COLUMNS = "commands:", "joint_unit:", "columns:"
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
    if signal.drives:
        notes[_COMMANDS + name] = _YES
    if signal.unit in (PERCENT, UNSTATED) and not signal.is_position:
        notes[_JOINT_UNIT + name] = signal.unit or _UNKNOWN
    if signal.drives and signal.unit in ("1", UNSTATED):
        notes[_COLUMNS + name] = json.dumps(list(signal.columns))
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
    notes, rate_hz = episode.info.notes, options.fps
    starts = (_UNIT, _COUNTS, _IMPACTS, _LEFT_OUT, _UNTIMED, _COMMANDS, _JOINT_UNIT)
    if not any(key.startswith(starts) for key in notes):
        return episode
    signals: dict[str, Signal] = dict(episode.signals)
    channels: list[Channel] = []
    for one in episode.channels:
        skipped = one.skipped
        if one.type_name == HEADER and notes.get(_IMPACTS + one.topic) == _YES and one.messages:
            # The log's own stamps of these messages, which an import makes the same.
            stamps_ns = np.unique(one.log_ns)
            ones = np.ones((len(stamps_ns), 1))
            signals[one.topic] = Signal(one.topic, stamps_ns, ones, ("impact",), "1")
            skipped = None
        before = of_note(notes.get(_LEFT_OUT + one.topic, ""))
        is_media = one.pictures or one.sounds
        known = added(one.left_out, before) if is_media else {}
        own = [name for name in signals if name == one.topic or topic_of(name) == one.topic]
        drives = one.drives or (bool(own) and all(notes.get(_COMMANDS + n) == _YES for n in own))
        channels.append(replace(one, skipped=skipped, left_out=known, drives=drives))
    for name, signal in signals.items():
        unit = notes.get(_UNIT + name, "")
        if notes.get(_JOINT_UNIT + name) and not signal.is_position:
            unit = PERCENT if notes[_JOINT_UNIT + name] == PERCENT else UNSTATED
        elif not signal.is_position or not unit or options.length_unit:
            unit = signal.unit
        else:
            unit = UNSTATED if unit == _UNKNOWN else "px"
        counts = notes.get(_COUNTS + name) == _YES
        signals[name] = replace(
            signal,
            unit=unit,
            columns=_columns_of_note(notes.get(_COLUMNS + name, ""), signal),
            drives=signal.drives or notes.get(_COMMANDS + name) == _YES,
            stamps_ns=_timed(signal.stamps_ns, rate_hz) if counts and rate_hz else signal.stamps_ns,
            counts_frames=signal.counts_frames or (counts and not rate_hz),
            left_out=added(signal.left_out, of_note(notes.get(_LEFT_OUT + name, ""))),
        )
    found = replace(episode, signals=signals, channels=tuple(channels))
    opened = episode.open_frames
    if notes.get(_UNTIMED) != _YES or opened is None:
        return found
    if not rate_hz:
        return replace(found, frames_untimed=True)

    def timed(topic: str) -> Iterator[Frame]:
        for frame in opened(topic):
            stamp_ns = int(_timed(np.array([frame.stamp_ns]), rate_hz)[0])
            yield replace(frame, stamp_ns=stamp_ns)

    return replace(found, open_frames=timed)


def topic_of(name: str) -> str:
    """Return the topic of a joint signal's name, which ends with its quantity."""
    return name.rpartition(".")[0]


def _columns_of_note(text: str, signal: Signal) -> tuple[str, ...]:
    """Parse the names of a signal's columns; its own where the note has others than it needs."""
    try:
        found = json.loads(text) if 0 < len(text) < 100_000 else None
    except (ValueError, RecursionError):
        found = None
    names = found if isinstance(found, list) else []
    is_sound = len(names) == len(signal.columns) and all(
        isinstance(one, str) and one.isprintable() for one in names
    )
    return tuple(names) if is_sound else signal.columns


def _timed(stamps_ns: NDArray[np.int64], rate_hz: float) -> NDArray[np.int64]:
    """Convert stamps that count frames to those of a rate [ns], shape (T,)."""
    return np.round(stamps_ns * (1e9 / rate_hz / FRAME_NS)).astype(np.int64)


# ---- Measurements alone: an episode without commands and forces


def without_commands(episode: Episode) -> Episode:
    """Return the episode without commands, forces, and warnings about their channels.

    A commanded trajectory is no joint's state, and a sensor's torque no joint's.
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
# of a layout it would take longer than one by one. So many that came one by one wait for more.
_MIN_STACKED, _MAX_STACKED, _MAX_LAYOUTS, _MAX_WAITING = 16, 64 * 1024, 8, 1024
DriveRows = PlannedRows | NumberRows | WrenchRows  # what gathers commands and forces
# What gathers messages.
_Rows = PositionRows | JointRows | ControllerRows | MediaStamps | DriveRows | UserColumnRows


class ReadingPlan:
    """State shared by the topics of a log while it is read."""

    def __init__(self, path: Path, options: ReadOptions, most_numbers: float) -> None:
        self.most_numbers = most_numbers  # that are kept of the joints of a topic
        self.decoders = Decoders()
        # The fields that are named; None where none is.
        self.picks = UserColumns(path, options, self.decoders) if options.columns else None
        self.points = PointBudget(registry.file_bytes(path))
        self._options = options

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
        self.shape: ShapeMessages | None = None  # where positions are recognised by their fields
        self.damaged = 0  # messages that cannot be read
        self.refused = 0  # those that may be whole, but of a kind or size that is not read
        self.used = 0  # those that were read
        self.log_ns = array("q")
        self._unusable: str | None = None
        self._why = ""  # the first message that was left out was
        self._type = message_type_of(channel)
        self._decode: Decode | None = None
        self._read: Callable[[Any], Any] = lambda message: message
        self._stacked: StackedDecoder | None = None
        self._waiting: tuple[list[int], list[bytes]] = [], []  # log stamps [ns], and data
        try:
            if not plan.picks or (self._type and self._type.is_media):
                self._read_by_type(plan)
            elif rows := plan.picks.rows_of(channel):
                self.rows, self._decode = rows, rows.decode
            else:
                raise UnusableError("--columns names none of its fields")
        except UnusableError as reason:
            self._unusable = str(reason)
        self.drives = isinstance(self.rows, DriveRows)  # whether these are commands or forces

    def _read_by_type(self, plan: ReadingPlan) -> None:
        """Read by the channel's type, or by the shape of its messages; else UnusableError."""
        channel, kind, topic = self.channel, self._type, self.channel.topic
        if SHOWS in channel.metadata:
            raise UnusableError(UNUSED)
        if kind is None and channel.encoding in ENCODINGS:
            shape = shape_messages(channel, plan.decoders)
            if shape is None:
                raise UnusableError(UNUSED)
            self.shape, self._decode, self._read = shape, shape.decode, shape.read
            self.rows = PositionRows(topic, *plan.length(unit_of(channel.type_name)))
            return
        if kind and kind.holds == "outcome":
            raise UnusableError("for tunenet-review")
        decoded = plan.decoders.listed_type(channel)
        assert kind is not None
        self._decode = decoded.decode
        self._read = partial(checked, kind) if kind.is_media else kind.read
        if kind.is_media:
            self.rows = MediaStamps(topic, kind.holds == "sound", kind.is_video)
        elif kind.holds == "positions":
            self.rows = PositionRows(topic, *plan.length("m"), names_one=kind.names_one)
            self._stacked = decoded.stacked
        elif kind.holds == "joints":
            self.rows = JointRows(topic, plan.most_numbers)
            self._stacked = decoded.stacked
        elif kind.holds == "controller":
            self.rows = ControllerRows(topic, plan.most_numbers)
        else:
            if kind.holds == "plan":
                rows = PlannedRows(topic, plan.points)
            else:
                rows = NumberRows(topic) if kind.holds == "numbers" else WrenchRows(topic)
            self.rows = rows

            def decode_checked(data: bytes | memoryview) -> Any:
                rows.check(data)  # before anything of it is decoded
                return decoded.decode(data)

            self._decode = decode_checked

    def checked_shape(self) -> list[str] | None:
        """Return notes on what was recognised by shape; None where that is implausible."""
        if self.shape is None:
            return []
        reason, said = self.shape.outcome(self.channel.topic)
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
        self._wait([log_ns], [bytes(data)])

    def _wait(self, log_ns: list[int], data: list[bytes]) -> None:
        """Let messages wait for more; read all once there are many."""
        stamps, every = self._waiting
        stamps += log_ns
        every += data
        if len(stamps) >= _MAX_WAITING:
            self.finish()

    def finish(self) -> None:
        """Read the messages that wait."""
        (stamps, data), self._waiting = self._waiting, ([], [])
        if not stamps:
            return
        ends = np.cumsum([len(one) for one in data])
        begins = np.concatenate([[0], ends[:-1]])
        heads = np.array(stamps, np.uint64).view([("log_ns", "<u8")])
        self._add_together(RawMessages(memoryview(b"".join(data)), {}, heads, begins, ends))

    def _add(self, log_ns: int, data: bytes | memoryview) -> None:
        if not 0 <= log_ns <= LAST_NS:
            self.damaged += 1
            self._why = self._why or "its time lies beyond the year 2262"
            return
        self.log_ns.append(log_ns)
        if self._decode is None or self.rows is None:
            return
        try:
            self.rows.add(log_ns, self._read(self._decode(data)))
            self.used += 1
        except (UnusableError, BeyondLimitError) as reason:
            self.refused += 1
            self._why = self._why or str(reason)
        except (MessageError, *DAMAGED) as error:
            self.damaged += 1
            self._why = self._why or described(error)

    def add_all(self, messages: RawMessages) -> None:
        """Add messages of one buffer; few may wait for more to be read with."""
        log_ns, begins, ends = messages.heads["log_ns"], messages.begins, messages.ends
        is_usual = (ends - begins).max() <= _MAX_STACKED and log_ns.max() <= LAST_NS
        if self._stacked is not None and is_usual and len(begins) < _MAX_WAITING // 2:
            places = zip(begins.tolist(), ends.tolist(), strict=True)
            data = [bytes(messages.plain[begin:end]) for begin, end in places]
            self._wait(log_ns.tolist(), data)
            return
        self.finish()
        self._add_together(messages)

    def _add_together(self, messages: RawMessages) -> None:
        """Add messages, decoding those of one layout at once."""
        log_ns = messages.heads["log_ns"]
        if self.rows is None and log_ns.max() <= LAST_NS:  # they are only counted
            self.log_ns.frombytes(log_ns.astype(np.int64).tobytes())
            return
        if self._stacked is not None and self._add_stacked(self._stacked, messages):
            return
        for stamp_ns, begin, end in zip(
            log_ns.tolist(), messages.begins.tolist(), messages.ends.tolist(), strict=True
        ):
            self._add(stamp_ns, messages.plain[begin:end])

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
            assert isinstance(self.rows, JointRows | PositionRows)
            self.rows.add_all(sorted(parts, key=lambda part: part[0][0]))
        except DAMAGED:
            return False
        self.used += len(log_ns)
        self.log_ns.frombytes(log_ns.tobytes())
        return True

    @property
    def first(self) -> str:
        """Why the first message was left out, in parentheses; "" where none was."""
        return f" (the first: {self._why})" if self._why else ""

    def lost_of(self, samples: int, share: float) -> dict[str, int]:
        """Estimate the missing samples by reason; `share` of the whole log is lost."""
        return {
            DAMAGED_MESSAGES: in_proportion(samples, self.damaged, self.used),
            NOT_READ: in_proportion(samples, self.refused, self.used),
            LOST: in_proportion(samples, share, 1 - share),
        }

    def another_name(self, taken: Iterable[str]) -> str:
        """Return an unused name for a topic whose name another channel's signals have, too."""
        plain = re.split(r"[/.:]", self.channel.type_name)[-1]
        name, names = f"{self.channel.topic}@{plain}", set(taken)
        every = (f"{name}{number or ''}" for number in (0, *range(2, len(names) + 3)))
        return next(n for n in every if not any(f"{one}.".startswith(f"{n}.") for one in names))

    def summary(self, share: float) -> Channel:
        """Summarise as a `Channel`; `share` of the whole log is lost."""
        skipped, kind = self._unusable, self._type
        if skipped is None and not self.used:
            if not self.log_ns and not self.damaged:
                skipped = "it holds no message"
            else:
                skipped = self._why if self.refused else f"all its messages are damaged{self.first}"
        left_out: Mapping[str, int] = {}
        if isinstance(self.rows, MediaStamps):  # of others their signals say it
            cut = {} if self.rows.is_sound else {BY_CLOCK: self.rows.cut}
            left_out = added(cut, self.lost_of(len(self.log_ns), share))
        return Channel(
            topic=self.channel.topic,
            type_name=self.channel.type_name,
            encoding=self.channel.encoding,
            log_ns=np.frombuffer(self.log_ns, np.int64),
            skipped=skipped,
            pictures=kind is not None and kind.holds == "picture",
            drives=self.drives,
            sounds=kind is not None and kind.holds == "sound",
            left_out=left_out,
        )


# ---- Reading options that made no difference


def said_unused(name: str, warnings: Iterable[str]) -> bool:
    """Check whether one of the warnings says that an option changed nothing."""
    return any(warning.startswith(f"{name} not used") for warning in warnings)


def unused_of_messages(episode: Episode, options: ReadOptions) -> tuple[str, ...]:
    """Return a line for each option that counts for nothing in a log of messages."""
    found: list[str] = []
    has_times = not any(key.startswith((_COUNTS, _UNTIMED)) for key in episode.info.notes)
    if options.fps is not None and has_times:
        found.append("--fps not used: its messages have times of their own")
    reads_joints = any(one.startswith(("position", "velocity")) for one in options.columns)
    if options.angle_unit and not reads_joints:
        found.append("--angle-unit not used: its messages have angles in rad")
    reads_currents = any(name.startswith("current") for name in options.columns)
    if options.torque_constants and not reads_currents:
        found.append(
            "--torque-constants not used: no current is read of its messages (where its efforts "
            "are currents, add --effort-unit A)"
        )
    return tuple(found)


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
            if not isinstance(other, Episode) or list(episode.signals) != list(other.signals):
                continue
            pairs = zip(episode.signals.values(), other.signals.values(), strict=True)
            if not all(
                (one.columns, one.unit, one.counts_frames)
                == (two.columns, two.unit, two.counts_frames)
                and np.array_equal(one.stamps_ns, two.stamps_ns)
                and np.array_equal(one.values, two.values, equal_nan=True)
                for one, two in pairs
            ):
                continue
        found.append(f"{name} not used: the file reads the same without")
    return tuple(found)


# ---- Reading: from the records of a container to an episode

# Pixels of all pictures of a log, whatever its size is (a second of decoding), and further ones for
# each of its bytes: a camera's pictures have 20, rendered ones without noise 300.
_FREE_PIXELS, _PIXELS_A_BYTE = 50_000_000, 500
_FEW_TOPICS = 8  # cameras that are read, however long the log is; and microphones, at most
# Messages that all picture topics together may pass, since each is read by a pass over the file: of
# any log, and the bytes of a log for each beyond.
_FREE_MESSAGES, _BYTES_A_MESSAGE = 5_000_000, 50


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
    info: dict[str, str] = {}  # what the log says of itself
    share = 0.0  # of it, that was lost before it was recovered
    plan = ReadingPlan(path, options, most_numbers)
    by_channel: dict[RawChannel, TopicContents] = {}
    last: dict[tuple[str, ...], TopicContents] = {}
    try:
        for record in container(path, losses):
            if isinstance(record, RawMessages):
                for channel, messages in record.by_channel():
                    by_channel[channel].add_all(messages)
            elif isinstance(record, RawMessage):
                by_channel[record.channel].add(record.log_ns, record.data)
            elif isinstance(record, RawChannel):
                # One of the same topic, type and encoding as another goes on with it.
                key = (record.topic, record.type_name, record.encoding, record.schema_encoding)
                topic = last.get(key)
                if topic is None or topic.channel.schema != record.schema:
                    topic = last[key] = TopicContents(record, plan)
                by_channel[record] = topic
            elif isinstance(record, RawMetadata) and is_info(record.name):
                info |= record.values
            elif isinstance(record, RawMetadata) and record.name == RECOVERY_RECORD:
                share = share_of_note(record.values)
        # Each once, in the order of the log, without those that draw another for viewers.
        every = dict.fromkeys(by_channel.values())
        topics = [one for one in every if SHOWS not in one.channel.metadata]
        for topic in topics:
            topic.finish()
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error
    if not topics and not info and not all(loss.harmless for loss in losses):
        why = "; ".join([str(loss) for loss in losses if not loss.harmless][:2])
        raise LogError(f"{path}: nothing in it can be read: {why}", COPY_AGAIN)
    about = EpisodeInfo.from_strings(info)
    episode = restored(_episode(path, container, losses, about, topics, plan, share), options)
    unused = unused_of_messages(episode, options)
    return replace(episode, warnings=(*episode.warnings, *jump_warnings(episode), *unused))


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
    size, read = registry.file_bytes(path), sum(len(topic.log_ns) for topic in topics)
    share = max(share, lost_share(losses, read, size))
    by_log: set[str] = set()  # topics of pictures or sound whose header stamps tell no time
    ahead: dict[str, int] = {}
    # What is known by its shape alone comes behind what is known by its type, commands behind all.
    for topic in sorted(topics, key=lambda one: (one.drives, one.shape is not None)):
        name, rows = topic.channel.topic, topic.rows
        shaped = topic.checked_shape()
        if topic.damaged:
            damaged.append(f"{name}: {topic.damaged} damaged messages were left out{topic.first}")
        if topic.refused and topic.used:  # where none is used, the channel's summary says why
            refused.append(f"{name}: {topic.refused} messages were left out{topic.first}")
        if isinstance(rows, MediaStamps):
            is_header, reasons = rows.trusts_header()
            doubts += reasons
            ahead[name] = rows.ahead
            is_found = info.notes.get(STAMPS_NOTE, "").startswith(BY_ARRIVALS)  # of pictures alone
            if not is_header or (is_found and not rows.is_sound):
                by_log.add(name)
        elif rows is not None and not isinstance(rows, UserColumnRows) and shaped is not None:
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
    channels = [topic.summary(share) for topic in topics]
    free = (_FREE_MESSAGES + size // _BYTES_A_MESSAGE) // max(1, read)
    for what, most in (("pictures", max(_FEW_TOPICS, free)), ("sound", _FEW_TOPICS)):
        of_kind = [one.pictures if what == "pictures" else one.sounds for one in channels]
        used = [at for at, one in enumerate(channels) if of_kind[at] and one.skipped is None]
        why = f"the log has over {most} channels of {what}"
        for at in used[most:]:
            channels[at] = replace(channels[at], skipped=why)
        if more := len(used[most:]):
            doubts.append(f"the {what} of {more} channels were left out: {why}")
    # What containers lost: the first places, and how many more.
    lost = [loss for loss in losses if not loss.harmless]
    words = [str(loss) for loss in (*(one for one in losses if one.harmless), *lost[:5])]
    if rest := lost[5:]:
        more = sum(loss.size for loss in rest)
        words.append(f"{len(rest)} more places are damaged ({more} bytes); see tunenet-logs check")
    exact_hz, file_hz = noted_rates(info.notes)

    def open_sound(topic: str) -> Sound:
        records, trusts_header = container(path, [], (topic,)), topic not in by_log
        return sound_of(
            records, topic, trusts_header=trusts_header, exact_hz=exact_hz, file_hz=file_hz
        )

    return Episode(
        info=info,
        signals=signals,
        channels=tuple(channels),
        warnings=(*words, *damaged, *refused, *notes, *doubts),
        losses=(*map(str, lost), *damaged),
        tainted=next((str(loss) for loss in losses if loss.taints), ""),
        open_frames=partial(_frames, path, container, by_log, ahead, _most_pixels(size, topics)),
        open_sound=open_sound,
    )


def _most_pixels(size: int, topics: Sequence[TopicContents]) -> dict[str, int]:
    """Return the pixels each topic's pictures may have: a share of the log's, by their number."""
    cameras = [one for one in topics if isinstance(one.rows, MediaStamps) and not one.rows.is_sound]
    used = max(1, sum(topic.used for topic in cameras))
    most: dict[str, int] = {}
    for topic in cameras:
        free, a_byte = _FREE_PIXELS, _PIXELS_A_BYTE
        if isinstance(topic.rows, MediaStamps) and topic.rows.is_video:
            free, a_byte = FREE_VIDEO_PIXELS, VIDEO_PIXELS_A_BYTE
        share = (free + a_byte * size) * topic.used // used
        most[topic.channel.topic] = most.get(topic.channel.topic, 0) + share
    return most


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
