"""Read ROS 2 bags in sqlite3 (`.db3`): messages in recording order, past damage.

The file is a stranger's: it is opened read-only, plain tables alone are asked, row by row, and what
cannot be read is a loss.
"""

from __future__ import annotations

import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tunenet_logs.errors import COPY_AGAIN, LogError
from tunenet_logs.files import open_regular
from tunenet_logs.formats.base import (
    DAMAGED,
    PART_RECORDS,
    Budget,
    Loss,
    OverBudgetError,
    RawChannel,
    RawMessage,
    Record,
    Topics,
    described,
)
from tunenet_logs.formats.compressed import MAX_PART_BYTES, ZSTD_MAGIC, unpack_message
from tunenet_logs.terminal import silent, teller

MAGIC = b"SQLite format 3\0"  # how an SQLite file begins
_HEADER = struct.Struct(">16xH10xI")  # size of a page (1: 65536), ..., number of pages
_LAST = 2**63 - 1  # number of a row: no recorder writes negative ones, and SQLite has none larger
# Damaged places that are passed in a table; each costs some queries, and there may be millions.
_MAX_DAMAGED_PLACES = 1000
_NUMBER = "_rowid_"  # what SQLite calls a row's own number
Row = tuple[int, tuple[Any, ...]]  # a row's own number, and its values, of any type
# What comes of a damaged file; the second where the error itself quotes what is damaged.
_DATABASE_ERRORS = (sqlite3.Error, UnicodeDecodeError)


class _NoTableError(Exception):
    """A file lacks a table, or the table is not a plain one."""


@contextmanager
def _opened(path: Path, losses: list[Loss]) -> Iterator[sqlite3.Connection]:
    """Open a database read-only, applying a killed recorder's write-ahead log where that is safe.

    Neither the file nor its folder is changed; `losses` gets what is noted about the whole file.
    """
    journal, ahead = (path.with_name(path.name + suffix) for suffix in ("-journal", "-wal"))
    if journal.is_file() and journal.stat().st_size:
        # A journal can name a file that SQLite then deletes, so a stranger's is never rolled back.
        losses.append(Loss("a transaction was not ended; what it changed may be damaged"))
    if not (ahead.is_file() and ahead.stat().st_size):
        is_cut = False  # shorter than its page count states
        with open_regular(path) as file:
            head = file.read(_HEADER.size)
        if len(head) == _HEADER.size:
            page, pages = _HEADER.unpack(head)
            size, stated = path.stat().st_size, pages * (65536 if page == 1 else page)
            if is_cut := size < stated:
                losses.append(Loss("the file is cut", at_byte=size, size=stated - size))
        with closing(
            _connected(f"{path.resolve().as_uri()}?mode=ro&immutable=1", is_cut)
        ) as opened:
            yield opened
        return
    what = "read with what a recording that did not end left beside it (-wal)"
    losses.append(Loss(what, harmless=True))
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "log.db3"
        shutil.copyfile(path, copy)
        shutil.copyfile(ahead, copy.with_name("log.db3-wal"))
        with closing(_connected(f"{copy.as_uri()}?mode=rw")) as opened:
            yield opened


def _connected(uri: str, is_cut: bool = False) -> sqlite3.Connection:
    """Connect, hardened against a hostile schema, and reading past the end where it `is_cut`."""
    # Episodes hand their frames to any thread, one at a time.
    database = sqlite3.connect(uri, uri=True, isolation_level=None, check_same_thread=False)
    database.text_factory = lambda raw: raw.decode("utf-8", "replace")
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_PART_BYTES)
    database.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
    for setting in ("trusted_schema = OFF", "cell_size_check = ON", "mmap_size = 0"):
        database.execute(f"PRAGMA {setting}")
    if is_cut:
        database.execute("PRAGMA writable_schema = ON")
    database.set_authorizer(_allowed)
    return database


def _allowed(action: int, first: str | None, *_rest: str | None) -> int:
    """Authorize reading columns of tables only: no functions, no recursion, no other pragma."""
    plain = action in (sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ)
    if plain or (action == sqlite3.SQLITE_PRAGMA and first == "table_xinfo"):
        return sqlite3.SQLITE_OK
    return sqlite3.SQLITE_DENY


@dataclass(frozen=True)
class _PlainTable:
    """A plain table. Only names written in this code enter its queries."""

    database: sqlite3.Connection
    name: str
    columns: tuple[str, ...]

    @classmethod
    def of(
        cls,
        database: sqlite3.Connection,
        name: str,
        needed: Sequence[str],
        more: Sequence[str] = (),
    ) -> _PlainTable:
        """Find a plain table with the columns needed, and those it has of more."""
        every = cls(database, "sqlite_master", ("type", "name", "rootpage")).rows([])
        kinds = [
            (kind, root)
            for _, (kind, title, root) in every
            if kind in ("table", "view") and str(title).lower() == name
        ]
        if not kinds:
            raise _NoTableError(f"it has no table {name!r}")
        (kind, root), *others = kinds
        if kind != "table" or type(root) is not int or root <= 0 or others:  # virtual: no root
            raise _NoTableError(f"its {name!r} is no plain table")
        columns = {row[1]: row[6] for row in database.execute(f"PRAGMA table_xinfo({name})")}
        if any(column.lower() == _NUMBER for column in columns):
            raise _NoTableError(f"its table {name!r} hides its rows' numbers")
        for column in needed:
            if columns.get(column) != 0:  # a computed one is hidden
                raise _NoTableError(f"its table {name!r} has no plain column {column!r}")
        return cls(database, name, (*needed, *(one for one in more if columns.get(one) == 0)))

    def rows(self, losses: list[Loss]) -> Iterator[Row]:
        """Yield all rows by row number, so in recording order; unreadable ones are losses."""
        columns = ", ".join(self.columns)
        start = 0
        for _ in range(_MAX_DAMAGED_PLACES):
            why = ""
            while True:
                try:
                    for row in self._asked(columns, start):
                        start = row[0] + 1
                        yield row
                    return
                except _DATABASE_ERRORS as error:
                    why = described(error)
                row = self._one(columns, start)
                if row is None:
                    break
                start = row[0] + 1  # the library drops the last row before the damage
                yield row
            found = self._behind(start)
            rows = f"{start} to {found - 1}" if found is not None else f"{start} to the last"
            lost = found - start if found is not None and self.name == "messages" else None
            what = f"table {self.name}: rows {rows} cannot be read: {why}"
            losses.append(Loss(what, messages=lost))
            if found is None or found > _LAST:
                return
            start = found
        losses.append(Loss(f"table {self.name}: what follows row {start} was not tried"))

    def _asked(self, columns: str, start: int, limit: str = "") -> Iterator[Row]:
        """Query rows from a number on; raise _DATABASE_ERRORS at the first damaged one."""
        # An index is not used: it may be damaged, or say something else than the table.
        question = (
            f"SELECT {_NUMBER}, {columns} FROM {self.name} NOT INDEXED "  # noqa: S608 (see the class)
            f"WHERE {_NUMBER} >= ? ORDER BY {_NUMBER} {limit}"
        )
        for number, *values in self.database.execute(question, (start,)):
            if type(number) is not int or number < start:
                raise sqlite3.DatabaseError("its rows are in disorder")
            start = number + 1
            yield number, tuple(values)

    def _one(self, columns: str, start: int) -> Row | None:
        """Return the first row from a number on; None where it is unreadable or absent."""
        if start > _LAST:
            return None
        try:
            return next(self._asked(columns, start, "LIMIT 1"), None)
        except _DATABASE_ERRORS:
            return None

    def _behind(self, start: int) -> int | None:
        """Return the first row number behind damage, by exponential search and bisection."""
        if (found := self._one("1", start)) is not None:  # what is damaged are that row's values
            return max(found[0], start) + 1
        low, high = start, start + 1
        while (found := self._one("1", high)) is None:
            low, high = high, 2 * high - start
            if high > _LAST:
                return None
        while high - low > 1:
            middle = (low + high) // 2
            if (between := self._one("1", middle)) is None:
                low = middle
            else:
                high, found = middle, between
        return max(found[0], start + 1)


# ---- The tables of a bag: topics, definitions of their types, messages.

# Columns of the tables of a ROS 2 bag, as rosbag2 names them.
_MESSAGES = ("topic_id", "timestamp", "data")
_TOPICS = ("id", "name", "type", "serialization_format")
_DEFINITIONS = ("topic_type", "encoding", "encoded_message_definition")
_SCHEMAS = ("ros2msg", "ros2idl")  # encodings that are read; others are as if none were given
# Columns of what else a topic states, and the same in an MCAP of ROS 2.
_MORE = {"offered_qos_profiles": "offered_qos_profiles", "type_description_hash": "topic_type_hash"}


def read_db3(
    path: Path, losses: list[Loss], topics: Topics = None, budget: Budget | None = None
) -> Iterator[Record]:
    """Yield the records of a ROS 2 sqlite3 bag; see `Container`. The folder stays unchanged."""
    try:
        with _opened(path, losses) as database:
            budget = budget or Budget(path.stat().st_size)
            channels = _channels(database, losses, budget)
            table = _PlainTable.of(database, "messages", _MESSAGES)
            yield from channels.values()
            yield from _messages(table, channels, losses, topics, budget)
    except OverBudgetError as error:
        losses.append(Loss(f"reading stopped, as {error}; what follows was left out"))
        return
    except (*_DATABASE_ERRORS, _NoTableError) as error:
        raise LogError(
            f"{path}: is no ROS 2 bag that can be read: {described(error)}", COPY_AGAIN
        ) from error
    what = "a .db3 bag carries no checksum, so its integrity cannot be vouched for"
    losses.append(Loss(what, harmless=True))


def _messages(
    table: _PlainTable,
    channels: dict[int, RawChannel],
    losses: list[Loss],
    topics: Topics,
    budget: Budget,
) -> Iterator[RawMessage]:
    damaged = unknown = seen = last = 0
    first = ""
    before = len(losses)
    tell = teller("reading") if topics is None else silent
    if topics is not None:  # data of other topics are not even loaded
        wanted = ", ".join(str(key) for key, one in channels.items() if one.topic in topics)
        data = f"CASE WHEN topic_id IN ({wanted}) THEN data END"
        table = replace(table, columns=(*table.columns[:-1], data))
    try:
        for last, (number, log_ns, data) in table.rows(losses):
            seen += 1
            budget.spend(records=1)
            tell(budget.spent_bytes / max(budget.file_bytes, 1))
            channel = channels.get(number) if type(number) is int else None
            if channel is None:
                unknown += 1
            elif topics is None or channel.topic in topics:
                try:
                    if type(log_ns) is not int or type(data) is not bytes:
                        raise TypeError("its time is no whole number, or its data no bytes")
                    budget.spend(len(data))
                    plain = unpack_message(data, budget) if data[:4] == ZSTD_MAGIC else data
                except DAMAGED as error:
                    first = first or f"message {last}, {described(error)}"
                    damaged += 1
                    continue
                yield RawMessage(channel, log_ns, plain, log_ns)
    except OverBudgetError as error:
        what = f"reading stopped at message {last}, as {error}; the rest was left out"
        losses.append(Loss(what))
    if last > seen and len(losses) == before:
        what = f"{last - seen} of its messages are missing among those numbered to {last}"
        losses.append(Loss(what, messages=last - seen))
    if damaged:
        what = f"{damaged} messages are damaged (the first: {first})"
        losses.append(Loss(what, messages=damaged))
    if unknown:
        losses.append(Loss(f"{unknown} messages belong to topics that nothing describes"))


def _channels(
    database: sqlite3.Connection, losses: list[Loss], budget: Budget
) -> dict[int, RawChannel]:
    """Return the topics by number; raise _NoTableError, _DATABASE_ERRORS where none is read."""
    definitions: dict[str, tuple[str, bytes]] = {}  # none in bags of older ROS 2
    with suppress(_NoTableError):
        table = _PlainTable.of(database, "message_definitions", _DEFINITIONS)
        for _, (kind, encoding, text) in table.rows(losses):
            is_text = type(text) is str
            budget.spend(records=PART_RECORDS, definition=text if is_text else "")
            if encoding in _SCHEMAS and type(kind) is str and is_text and text:
                definitions.setdefault(kind, (encoding, text.encode("utf-8", "replace")))
    table = _PlainTable.of(database, "topics", _TOPICS, tuple(_MORE))
    channels: dict[int, RawChannel] = {}
    for row, (number, *texts) in table.rows(losses):
        budget.spend(records=PART_RECORDS, channels=1)
        if type(number) is not int or any(type(text) is not str for text in texts[:3]):
            losses.append(Loss(f"topic {row} is damaged"))
            continue
        name, kind, encoding = texts[:3]
        more = zip(table.columns[len(_TOPICS) :], texts[3:], strict=True)
        metadata = {_MORE[key]: text for key, text in more if type(text) is str and text}
        schema = definitions.get(kind, ("", b""))
        channels.setdefault(number, RawChannel(name, kind, encoding, *schema, metadata))
    return channels
