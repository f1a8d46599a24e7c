"""Read positions from the messages of one channel, by the shape of their type."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from tunenet_logs.formats.any_messages import AnyType, SchemaBudget, any_type, structure_of
from tunenet_logs.formats.base import MessageError, RawChannel, UnusableError
from tunenet_logs.formats.by_shape import (
    ShapeReader,
    may_hold_positions,
    shape_reader,
    stamp_steps,
)
from tunenet_logs.formats.position_types import PositionSample
from tunenet_logs.formats.ros import SCHEMA_ENCODINGS
from tunenet_logs.formats.stamps import time_ns
from tunenet_logs.formats.structure import Structure, likely_field, numbers_in

# Without any of these in its definition, a type holds no position.
_HINT = re.compile(rb"\bz\b|position|translation|location|\[3\]|\bpos\b")

UNUSED = "its type is not one that a task uses"  # why most channels are not read
_TRIES = 100  # messages of JSON that may be without what tells their shape, as a list of nothing is


class ShapeMessages:
    """Reader of one channel's messages, by `ShapeReader`.

    Args:
        kind: structure and decoder of the type.
        reader: reader of their positions; None where only a message tells.
        top: structure of the messages.
        budget: for messages that are decoded only to infer their structure.
    """

    def __init__(
        self,
        kind: AnyType,
        reader: ShapeReader | None,
        top: Structure | None,
        budget: SchemaBudget,
    ) -> None:
        self._budget = budget
        self._kind = kind
        self._reader = reader
        self._tries = _TRIES
        self._why = ""
        self._top = top
        self._stamp = kind.getter(steps) if top and (steps := stamp_steps(top)) else None

    def decode(self, data: bytes | memoryview) -> Any:
        """Decode a message; None where it is unreadable and its shape still unknown.

        Raises:
            MessageError: it is damaged.
        """
        if self._reader is not None:
            return None if self._reader.refused else self._kind.decode(data)
        if not self._tries or self._budget.left_guesses < len(data):
            return None
        self._tries -= 1
        self._budget.left_guesses -= len(data)
        try:
            return self._kind.decode(data)
        except MessageError:
            return None

    def read(self, message: Any) -> Iterable[PositionSample]:
        """Return the positions of a message.

        Raises:
            ValueError, TypeError, AttributeError: its content is invalid.
        """
        reader = self._reader or self._told_by(message)
        if reader is None or message is None:
            return ()
        try:
            stamp_ns = time_ns(self._stamp(message)) if self._stamp is not None else 0
        except LookupError:
            stamp_ns = 0
        return reader(message, stamp_ns)

    def _told_by(self, message: Any) -> ShapeReader | None:
        if message is None:
            return None
        top = structure_of(message)
        self._top = top
        reader = shape_reader(self._kind, top)
        if isinstance(reader, str):
            self._why = self._why or reader
            return None
        if steps := stamp_steps(top):
            self._stamp = self._kind.getter(steps)
        self._reader = reader
        return reader

    def outcome(self, topic: str) -> tuple[str, list[str]]:
        """Return why the channel is not used ("" where it is), and notes on it."""
        why = self._reader.refused if self._reader else self._why
        if why:
            return f"{why}; {_choose(topic, self._top)}", []
        if self._reader is None:
            return UNUSED, []
        if self._reader.doubled:
            why = f"{self._reader.doubled} entries were left out that share their name with another"
            return "", [f"{topic}: {why}"]
        return "", []


def shape_messages(channel: RawChannel, budget: SchemaBudget) -> ShapeMessages | None:
    """Return a reader of a channel by the shape of its messages; None without any evidence.

    Raises:
        UnusableError: its positions are ambiguous: the user has to choose the columns.
    """
    is_json = channel.encoding == "json"
    hinted = is_json or not channel.schema or _HINT.search(channel.schema)
    if not hinted or not may_hold_positions(channel.type_name):
        return None
    try:
        kind = any_type(channel, budget)
    except UnusableError:
        known = SCHEMA_ENCODINGS.get(channel.encoding)
        if known and channel.schema_encoding and channel.schema_encoding not in known:
            raise  # it may well be a type that a task uses
        return None
    if kind.structure is None:
        return ShapeMessages(kind, None, None, budget)
    reader = shape_reader(kind, kind.structure)
    if isinstance(reader, str):
        if reader:
            raise UnusableError(f"{reader}; {_choose(channel.topic, kind.structure)}")
        return None
    return ShapeMessages(kind, reader, kind.structure, budget)


def _choose(topic: str, top: Structure | None) -> str:
    """Return the option to type where the shape alone is ambiguous."""
    fields = numbers_in(top) if top else []
    field = likely_field(fields) if fields else "FIELD"
    return f"choose one with --columns z={topic}.{field}"
