"""Read ROS 2 bags in sqlite3 (`.db3`): messages in recording order."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tunenet_logs.errors import COPY_AGAIN, LogError
from tunenet_logs.formats.base import (
    DAMAGED,
    Loss,
    RawChannel,
    RawMessage,
    Record,
    described,
)
from tunenet_logs.formats.budget import PART_RECORDS, Budget, OverBudgetError
from tunenet_logs.formats.compression import ZSTD_MAGIC, unpack_message
from tunenet_logs.formats.database import (
    DATABASE_ERRORS,
    DatabaseTable,
    NoTableError,
    opened,
    table_of,
)
from tunenet_logs.progress import silent, teller

# Columns of the tables of a ROS 2 bag, as rosbag2 names them.
_MESSAGES = ("topic_id", "timestamp", "data")
_TOPICS = ("id", "name", "type", "serialization_format")
_DEFINITIONS = ("topic_type", "encoding", "encoded_message_definition")
# Schema encodings that are read; others are as if none were given.
_SCHEMAS = ("ros2msg", "ros2idl")

# What else a topic may say: its columns, and what the same is called in an MCAP of ROS 2.
_MORE = {
    "offered_qos_profiles": "offered_qos_profiles",
    "type_description_hash": "topic_type_hash",
}


def read_db3(
    path: Path,
    losses: list[Loss],
    topics: Sequence[str] | None = None,
    budget: Budget | None = None,
) -> Iterator[Record]:
    """Yield the records of a ROS 2 sqlite3 bag; see `MessageFile`. The folder stays unchanged."""
    try:
        with opened(path, losses) as database:
            budget = budget or Budget(path.stat().st_size)
            channels = _channels(database, losses, budget)
            table = table_of(database, "messages", _MESSAGES)
            yield from channels.values()
            reading = _Db3Reading(channels, losses, budget)
            yield from reading.messages(database, table, topics)
    except OverBudgetError as error:
        losses.append(Loss(f"reading stopped, as {error}; what follows was left out"))
        return
    except (*DATABASE_ERRORS, NoTableError) as error:
        raise LogError(
            f"{path}: is no ROS 2 bag that can be read: {described(error)}", COPY_AGAIN
        ) from error
    what = "a .db3 bag carries no checksum, so its integrity cannot be vouched for"
    losses.append(Loss(what, harmless=True))


class _Db3Reading:
    """One pass over the messages."""

    def __init__(
        self, channels: Mapping[int, RawChannel], losses: list[Loss], budget: Budget
    ) -> None:
        self._channels = channels
        self._losses = losses
        self._budget = budget

    def messages(
        self, database: sqlite3.Connection, table: DatabaseTable, topics: Sequence[str] | None
    ) -> Iterator[RawMessage]:
        damaged = unknown = seen = last = 0
        first = ""
        before = len(self._losses)
        tell = teller("reading") if topics is None else silent
        try:
            for last, values in self._only(table, topics).rows(database, self._losses):
                seen += 1
                self._budget.spend_records()
                tell(self._budget.spent_bytes / max(self._budget.file_bytes, 1))
                channel = self._channels.get(values[0]) if type(values[0]) is int else None
                if channel is None:
                    unknown += 1
                elif topics is None or channel.topic in topics:
                    try:
                        yield self._message(channel, *values[1:])
                    except DAMAGED as error:
                        first = first or f"message {last}, {described(error)}"
                        damaged += 1
        except OverBudgetError as error:
            self._lose(f"reading stopped at message {last}, as {error}; the rest was left out")
        if last > seen and len(self._losses) == before:
            what = f"{last - seen} of its messages are missing among those numbered to {last}"
            self._lose(what, last - seen)
        if damaged:
            self._lose(f"{damaged} messages are damaged (the first: {first})", damaged)
        if unknown:
            self._lose(f"{unknown} messages belong to topics that nothing describes")

    def _only(self, table: DatabaseTable, topics: Sequence[str] | None) -> DatabaseTable:
        """Return the table restricted to data of some topics: that of others is not even loaded."""
        if topics is None:
            return table
        wanted = [str(key) for key, channel in self._channels.items() if channel.topic in topics]
        data = f"CASE WHEN topic_id IN ({', '.join(wanted)}) THEN data END"
        return replace(table, columns=(*table.columns[:-1], data))

    def _message(self, channel: RawChannel, log_ns: Any, data: Any) -> RawMessage:
        if type(log_ns) is not int or type(data) is not bytes:
            raise TypeError("its time is no whole number, or its data no bytes")
        self._budget.spend(len(data))
        plain = unpack_message(data, self._budget) if data[:4] == ZSTD_MAGIC else data
        return RawMessage(channel, log_ns, plain, log_ns)

    def _lose(self, what: str, messages: int | None = None) -> None:
        self._losses.append(Loss(what, messages=messages))


def _channels(
    database: sqlite3.Connection, losses: list[Loss], budget: Budget
) -> dict[int, RawChannel]:
    """Return the topics by number.

    Raises:
        NoTableError, DATABASE_ERRORS: there is no readable table of topics.
        OverBudgetError: there are too many.
    """
    definitions = _definitions(database, losses, budget)
    table = table_of(database, "topics", _TOPICS, tuple(_MORE))
    channels: dict[int, RawChannel] = {}
    for row, (number, *texts) in table.rows(database, losses):
        budget.spend_channel()
        if type(number) is not int or any(type(text) is not str for text in texts[:3]):
            losses.append(Loss(f"topic {row} is damaged"))
            continue
        name, kind, encoding = texts[:3]
        more = zip(table.columns[len(_TOPICS) :], texts[3:], strict=True)
        metadata = {_MORE[key]: text for key, text in more if type(text) is str and text}
        schema = definitions.get(kind, ("", b""))
        channels.setdefault(number, RawChannel(name, kind, encoding, *schema, metadata))
    return channels


def _definitions(
    database: sqlite3.Connection, losses: list[Loss], budget: Budget
) -> dict[str, tuple[str, bytes]]:
    """Return encoding and text of each type's schema, by name; none in bags of older ROS 2."""
    try:
        table = table_of(database, "message_definitions", _DEFINITIONS)
    except NoTableError:
        return {}
    found: dict[str, tuple[str, bytes]] = {}
    for _, (kind, encoding, text) in table.rows(database, losses):
        budget.spend_records(PART_RECORDS)
        budget.spend_definition(len(text) if type(text) is str else 0)
        if encoding in _SCHEMAS and type(kind) is str and type(text) is str and text:
            found.setdefault(kind, (encoding, text.encode("utf-8", "replace")))
    return found
