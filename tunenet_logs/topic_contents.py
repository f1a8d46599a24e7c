"""The messages of one topic: by which rules they are read, how many there are, what they hold."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

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
from tunenet_logs.formats.shape_messages import UNUSED, ShapeMessages, shape_messages
from tunenet_logs.formats.sounds import checked_sound
from tunenet_logs.hand_rows import HandRows
from tunenet_logs.messages import TASK_OUTCOME
from tunenet_logs.planned_rows import PlannedRows, PointBudget
from tunenet_logs.position_rows import PositionRows

_LAST_NS = 2**63 - 1
"""The last stamp that fits int64: in the year 2262."""

DriveRows = PlannedRows | NumberRows | WrenchRows
"""What gathers commands and forces."""

_Rows = PositionRows | JointRows | PictureStamps | SoundStamps | DriveRows | HandRows
"""What gathers messages."""


class ReadingPlan:
    """What is shared by the topics of a log while it is read.

    Args:
        path: the log.
        options: what its user says of it.

    Attributes:
        budget: for definitions of types.
        decoders: of the types that are known.
        picks: the fields that are named; None where none is.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self.budget = SchemaBudget()
        self.decoders = Decoders(self.budget)
        self.picks = HandPicked(path, options, self.budget) if options.columns else None
        self._path = path
        self._options = options

    @cached_property
    def points(self) -> PointBudget:
        """For trajectories."""
        return PointBudget(registry.file_bytes(self._path))

    def drive_rows(self, topic: str, kind: DriveType) -> DriveRows:
        """What gathers the messages of a type of commands or forces."""
        if isinstance(kind, PlanType):
            return PlannedRows(topic, self.points)
        return NumberRows(topic) if isinstance(kind, NumbersType) else WrenchRows(topic)

    def length(self, unit: str) -> tuple[str, float]:
        """The unit of positions, and what makes it of those in messages.

        Args:
            unit: as the type of the messages says.
        """
        said = self._options.length_unit
        if not said:
            return unit, 1.0
        return ("px", 1.0) if self._options.length_m is None else ("m", self._options.length_m)

    def named_signals(self) -> tuple[dict[str, Signal], list[str]]:
        """What `--columns` names, and what was repaired of it.

        Raises:
            LogError: something of it is not there.
        """
        found, notes = self.picks.signals() if self.picks else ([], [])
        return {signal.name: signal for signal in found}, notes


class TopicContents:
    """The messages of one topic, in one type: counted, decoded, gathered.

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
        try:
            if not plan.picks or isinstance(self._type, PictureType | SoundType):
                self._read_by_type(plan)
            else:
                self._read_by_hand(plan)
        except UnusableError as reason:
            self._unusable = str(reason)

    def _read_by_type(self, plan: ReadingPlan) -> None:
        """Go by the channel's type, or by the shape of its messages.

        Raises:
            UnusableError: nothing of them can be used.
        """
        channel, kind = self.channel, self._type
        if kind is None and channel.encoding in registry.DECODERS:
            is_outcome = type_key(channel.type_name) == TASK_OUTCOME
            shape = None if is_outcome else shape_messages(channel, plan.budget)
            if shape is None:
                use = "for tunenet-review" if is_outcome else UNUSED
                raise UnusableError(use)
            self._shape, self._decode, self._read = shape, shape.decode, shape.read
            self.rows = PositionRows(channel.topic, *plan.length(unit_of(channel.type_name)))
            self._add = self.rows.add
            return
        self._decode = plan.decoders.of(channel)
        assert kind is not None
        if isinstance(kind, PositionType):
            self.rows = PositionRows(channel.topic, *plan.length("m"))
        elif isinstance(kind, JointType):
            self.rows = JointRows(channel.topic)
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
        self._add: Callable[[int, Any], None] = self.rows.add

    def _read_by_hand(self, plan: ReadingPlan) -> None:
        """Read the fields that `--columns` names.

        Raises:
            UnusableError: it names none of the channel's.
            LogError: it names one that is not there.
        """
        rows = plan.picks.rows_of(self.channel) if plan.picks else None
        if rows is None:
            raise UnusableError("--columns names none of its fields")
        self.rows, self._decode, self._add = rows, rows.decode, rows.add
        self._read = lambda message: message

    @property
    def is_by_shape(self) -> bool:
        """Whether positions are read by what the fields of its messages are called."""
        return self._shape is not None

    @property
    def drives(self) -> bool:
        """Whether its messages are commands or forces."""
        return isinstance(self.rows, DriveRows)

    @property
    def is_video(self) -> bool:
        """Whether its pictures are made from those before them."""
        return isinstance(self._type, PictureType) and self._type.is_video

    def checked_shape(self) -> list[str] | None:
        """What is to be said of what was read by shape; None where that may not be believed."""
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
            drives=self.drives,
            sounds=isinstance(self._type, SoundType),
        )


def _bounded(decode: Decode, check: Callable[[bytes | memoryview], None]) -> Decode:
    """Decodes what is worth it, as a check of the message's bytes says."""

    def decode_checked(data: bytes | memoryview) -> Any:
        check(data)
        return decode(data)

    return decode_checked
