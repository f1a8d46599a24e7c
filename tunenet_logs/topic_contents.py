"""What one topic of a log delivers: counted, decoded, gathered; and what could not be."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Any

import numpy as np

from tunenet_logs.collect import JointRows, PictureStamps, PositionRows
from tunenet_logs.episode import Channel
from tunenet_logs.formats.base import DAMAGED, BeyondLimitError, RawChannel, described
from tunenet_logs.formats.codec import Decode, MessageError, UnusableError
from tunenet_logs.formats.codecs import check_encoding, decoder_for
from tunenet_logs.formats.kinds import Joints, Pictures, Positions, kind_of, type_key
from tunenet_logs.formats.pictures import checked
from tunenet_logs.messages import TASK_OUTCOME

_LAST_NS = 2**63 - 1
"""The last stamp that fits int64: in the year 2262."""

_ROWS = {Positions: PositionRows, Joints: JointRows, Pictures: PictureStamps}


class TopicContents:
    """The messages of one topic, in one type.

    Attributes:
        rows: what they hold, as far as it was read; None where the type or encoding is not.
        damaged: messages that cannot be read.
        refused: those that may be whole, but of a kind or size that is not read.
    """

    def __init__(self, channel: RawChannel) -> None:
        self.channel = channel
        self.rows: PositionRows | JointRows | PictureStamps | None = None
        self.damaged = 0
        self.refused = 0
        self._log_ns = array("q")
        self._unusable: str | None = None
        self._why = ""  # the first message that was left out was
        self._used = 0
        self._kind = kind_of(channel)
        self._decode: Decode | None = None
        try:
            check_encoding(channel)
            if self._kind is None:
                is_outcome = type_key(channel.type_name) == TASK_OUTCOME
                use = "for tunenet-review" if is_outcome else "its type is not one that a task uses"
                raise UnusableError(use)
            self._decode = decoder_for(channel)
        except UnusableError as reason:
            self._unusable = str(reason)
            return
        rows = self.rows = _ROWS[type(self._kind)](channel.topic)
        self._read: Callable[[Any], Any] = checked(self._kind)
        self._add: Callable[[int, Any], None] = rows.add

    def add(self, log_ns: int, data: bytes | memoryview) -> None:
        """One message."""
        if not 0 <= log_ns <= _LAST_NS:
            self.damaged += 1
            self._why = self._why or "its time lies beyond the year 2262"
            return
        self._log_ns.append(log_ns)
        if self._decode is None:
            return
        try:
            self._add(log_ns, self._read(self._decode(data)))
            self._used += 1
        except (UnusableError, BeyondLimitError) as reason:
            self.refused += 1
            self._why = self._why or str(reason)
        except (MessageError, *DAMAGED) as error:
            self.damaged += 1
            self._why = self._why or described(error)

    def losses(self) -> list[str]:
        """What of it is damaged, in words."""
        if not self.damaged:
            return []
        return [f"{self.channel.topic}: {self.damaged} damaged messages were left out{self._first}"]

    def remarks(self) -> list[str]:
        """What of it is not read though it may be whole, where the rest is."""
        if not self.refused or not self._used:
            return []
        return [f"{self.channel.topic}: {self.refused} messages were left out{self._first}"]

    def summary(self, *, is_second: bool) -> Channel:
        """The channel.

        Args:
            is_second: whether another channel of that topic is used instead.
        """
        return Channel(
            topic=self.channel.topic,
            type_name=self.channel.type_name,
            encoding=self.channel.encoding,
            log_ns=np.array(self._log_ns, np.int64),
            skipped=self._skipped(is_second=is_second),
            pictures=isinstance(self._kind, Pictures),
        )

    @property
    def _first(self) -> str:
        return f" (the first: {self._why})" if self._why else ""

    def _skipped(self, *, is_second: bool) -> str | None:
        if self._unusable is not None:
            return self._unusable
        if is_second:
            return "another channel of that name is used"
        if self._used:
            return None
        if not self._log_ns and not self.damaged:
            return "it holds no message"
        return self._why if self.refused else f"all its messages are damaged{self._first}"
