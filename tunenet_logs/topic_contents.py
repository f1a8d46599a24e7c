"""Read the messages of one topic: choose the rules for its type, count, decode and gather."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.by_hand import HandPicked
from tunenet_logs.collect import JointRows, PictureStamps, SoundStamps
from tunenet_logs.drive_rows import NumberRows, WrenchRows
from tunenet_logs.episode import Channel, Signal
from tunenet_logs.formats import registry
from tunenet_logs.formats.any_messages import SchemaBudget
from tunenet_logs.formats.base import (
    DAMAGED,
    BeyondLimitError,
    Decode,
    MessageError,
    RawChannel,
    RawMessages,
    UnusableError,
    described,
)
from tunenet_logs.formats.by_shape import unit_of
from tunenet_logs.formats.decoders import Decoders
from tunenet_logs.formats.message_types import (
    DriveType,
    JointType,
    NumbersType,
    PictureType,
    PlanType,
    PositionType,
    SoundType,
    message_type_of,
    type_key,
)
from tunenet_logs.formats.pictures import checked_pictures
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.ros import known_types, plain_type, ros_name
from tunenet_logs.formats.ros_stacked import Stacked, stacked_decoder
from tunenet_logs.formats.shape_messages import UNUSED, ShapeMessages, shape_messages
from tunenet_logs.formats.sounds import checked_sound
from tunenet_logs.hand_rows import HandRows
from tunenet_logs.left_out import DAMAGED_MESSAGES, LOST, NOT_READ, in_proportion
from tunenet_logs.messages import TASK_OUTCOME
from tunenet_logs.planned_rows import PlannedRows, PointBudget
from tunenet_logs.position_rows import PositionRows

# Messages, bytes of each, and layouts of them that are read together: with few of a layout it would
# take longer than one by one.
_MIN_STACKED, _MAX_STACKED, _MAX_LAYOUTS = 16, 64 * 1024, 8

_MAX_WAITING = 1024  # messages that come one by one, and wait for more to be read with
_LAST_NS = 2**63 - 1  # the last stamp that fits int64: in the year 2262
DriveRows = PlannedRows | NumberRows | WrenchRows  # what gathers commands and forces
# What gathers messages.
_Rows = PositionRows | JointRows | PictureStamps | SoundStamps | DriveRows | HandRows


class ReadingPlan:
    """State shared by the topics of a log while it is read.

    Attributes:
        budget: for definitions of types.
        decoders: of the types that are known.
        picks: the fields that are named; None where none is.
        most_numbers: that are kept of the joints of a topic.
    """

    def __init__(self, path: Path, options: ReadOptions, most_numbers: float) -> None:
        self.most_numbers = most_numbers
        self.budget = SchemaBudget()
        self.decoders = Decoders(self.budget)
        self.picks = HandPicked(path, options, self.budget) if options.columns else None
        self._path = path
        self._options = options

    @cached_property
    def points(self) -> PointBudget:
        """Budget of trajectory points."""
        return PointBudget(registry.file_bytes(self._path))

    def drive_rows(self, topic: str, kind: DriveType) -> DriveRows:
        """Return the collector for a type of commands or forces."""
        if isinstance(kind, PlanType):
            return PlannedRows(topic, self.points)
        return NumberRows(topic) if isinstance(kind, NumbersType) else WrenchRows(topic)

    def length(self, unit: str) -> tuple[str, float]:
        """Return the unit of positions, and the factor to it from `unit`, the messages' own."""
        said = self._options.length_unit
        if not said:
            return unit, 1.0
        return ("px", 1.0) if self._options.length_m is None else ("m", self._options.length_m)

    def named_signals(self) -> tuple[dict[str, Signal], list[str]]:
        """Return the signals of the user's columns, and notes on what was repaired.

        Raises:
            LogError: something of it is not there.
        """
        found, notes = self.picks.signals() if self.picks else ([], [])
        return {signal.name: signal for signal in found}, notes


class TopicContents:
    """Messages of one topic, in one type: counted, decoded, gathered.

    Attributes:
        rows: what they hold, as far as it was read; None where the type or encoding is not.
        damaged: messages that cannot be read.
        refused: those that may be whole, but of a kind or size that is not read.
        used: those that were read.
    """

    def __init__(self, channel: RawChannel, plan: ReadingPlan) -> None:
        self.channel = channel
        self.rows: _Rows | None = None
        self.damaged = 0
        self.refused = 0
        self._log_ns = array("q")
        self._unusable: str | None = None
        self._why = ""  # the first message that was left out was
        self.used = 0
        self._type = message_type_of(channel)
        self._decode: Decode | None = None
        self._shape: ShapeMessages | None = None
        self._stacked: Callable[[NDArray[np.uint8]], Stacked] | None = None
        self._waiting: list[tuple[int, bytes]] = []
        try:
            if not plan.picks or isinstance(self._type, PictureType | SoundType):
                self._read_by_type(plan)
            else:
                self._read_by_hand(plan)
        except UnusableError as reason:
            self._unusable = str(reason)

    def _read_by_type(self, plan: ReadingPlan) -> None:
        """Read by the channel's type, or by the shape of its messages; else UnusableError."""
        channel, kind = self.channel, self._type
        if kind is None and channel.encoding in registry.DECODERS:
            is_outcome = type_key(channel.type_name) == TASK_OUTCOME
            shape = None if is_outcome else shape_messages(channel, plan.budget)
            if shape is None:
                use = "for tunenet-review" if is_outcome else UNUSED
                raise UnusableError(use)
            self._shape, self._decode, self._read = shape, shape.decode, shape.read
            self.rows = PositionRows(channel.topic, *plan.length(unit_of(channel.type_name)))
            self._gather = self.rows.add
            return
        self._decode = plan.decoders.of(channel)
        assert kind is not None
        if isinstance(kind, PositionType):
            self.rows = PositionRows(channel.topic, *plan.length("m"), names_one=kind.names_one)
        elif isinstance(kind, JointType):
            self.rows = JointRows(channel.topic, plan.most_numbers)
            if channel.encoding in ("cdr", "ros1"):
                is_ros1 = channel.encoding == "ros1"
                types, name = known_types(is_ros1=is_ros1), ros_name(channel.type_name)
                self._stacked = stacked_decoder(types, name, is_ros1=is_ros1)
        elif isinstance(kind, DriveType):
            self.rows = plan.drive_rows(channel.topic, kind)
            self._decode = _bounded(self._decode, self.rows.check)
        elif isinstance(kind, SoundType):
            self.rows = SoundStamps(channel.topic)
        else:
            self.rows = PictureStamps(channel.topic, kind.is_video)
        self._read: Callable[[Any], Any] = kind.read
        if isinstance(kind, PictureType):
            self._read = checked_pictures(kind)
        elif isinstance(kind, SoundType):
            self._read = checked_sound(kind)
        self._gather: Callable[[int, Any], None] = self.rows.add

    def _read_by_hand(self, plan: ReadingPlan) -> None:
        """Read the user's columns; UnusableError where none is of this channel."""
        rows = plan.picks.rows_of(self.channel) if plan.picks else None
        if rows is None:
            raise UnusableError("--columns names none of its fields")
        self.rows, self._decode, self._gather = rows, rows.decode, rows.add
        self._read = lambda message: message

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
        if self._stacked is None or len(data) > _MAX_STACKED or not 0 <= log_ns <= _LAST_NS:
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
        if not 0 <= log_ns <= _LAST_NS:
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

    def _add_stacked(
        self, decode: Callable[[NDArray[np.uint8]], Stacked], messages: RawMessages
    ) -> bool:
        """Decode messages of few layouts at once; False if there are more, or one is damaged."""
        log_ns = messages.heads["log_ns"]
        sizes = messages.ends - messages.begins
        if len(sizes) < _MIN_STACKED or log_ns.max() > _LAST_NS or sizes.max() > _MAX_STACKED:
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

    def summary(self) -> Channel:
        """Summarise as a `Channel`."""
        skipped = self._unusable
        if skipped is None and not self.used:
            if not self._log_ns and not self.damaged:
                skipped = "it holds no message"
            else:
                skipped = self._why if self.refused else f"all its messages are damaged{self.first}"
        return Channel(
            topic=self.channel.topic,
            type_name=self.channel.type_name,
            encoding=self.channel.encoding,
            log_ns=np.frombuffer(self._log_ns, np.int64),
            skipped=skipped,
            pictures=isinstance(self._type, PictureType),
            drives=self.drives,
            sounds=isinstance(self._type, SoundType),
        )


def _bounded(decode: Decode, check: Callable[[bytes | memoryview], None]) -> Decode:
    """Return a decoder that first checks the bytes of a message."""

    def decode_checked(data: bytes | memoryview) -> Any:
        check(data)
        return decode(data)

    return decode_checked
