"""Read ROS 2 bags in sqlite3 (`.db3`): messages in recording order, past damage.

The file is a stranger's: it is opened read-only, plain tables alone are asked, row by row, and what
cannot be read is a loss.
"""

from __future__ import annotations

import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
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
    described,
)
from tunenet_logs.formats.compressed import MAX_PART_BYTES, ZSTD_MAGIC, unpack_message
from tunenet_logs.terminal import silent, teller

MAGIC = b"SQLite format 3\0"  # how an SQLite file begins
_HEADER = struct.Struct(">16xH10xI")  # size of a page (1: 65536), ..., number of pages
# Numbers of rows: no recorder writes negative ones, and SQLite has none larger.
_FIRST, _LAST = 0, 2**63 - 1

# Damaged places that are passed in a table; each costs some queries, and there may be millions.
_MAX_DAMAGED_PLACES = 1000

_SCHEMA = "sqlite_master"  # the table of the tables
_NUMBER = "_rowid_"  # what SQLite calls a row's own number
Row = tuple[int, tuple[Any, ...]]  # a row's own number, and its values, of any type

# What comes of a damaged file; the second where the error itself quotes what is damaged.
DATABASE_ERRORS = (sqlite3.Error, UnicodeDecodeError)


class NoTableError(Exception):
    """A file lacks a table, or the table is not a plain one."""


@contextmanager
def opened(path: Path, losses: list[Loss]) -> Iterator[sqlite3.Connection]:
    """Open a database read-only, applying a killed recorder's write-ahead log where that is safe.

    Args:
        path: the file; neither it nor its folder is changed.
        losses: what is noted about the whole file.

    Raises:
        DATABASE_ERRORS: it cannot be opened.
        OSError: the disk fails.
    """
    if _size(_beside(path, "-journal")):
        # A journal can name a file that SQLite then deletes, so a stranger's is never rolled back.
        losses.append(Loss("a transaction was not ended; what it changed may be damaged"))
    if not _size(_beside(path, "-wal")):
        is_cut = _is_cut(path, losses)
        with closing(_connected(f"{path.resolve().as_uri()}?mode=ro&immutable=1")) as database:
            _protect(database, is_cut=is_cut)
            yield database
        return
    what = "read with what a recording that did not end left beside it (-wal)"
    losses.append(Loss(what, harmless=True))
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "log.db3"
        shutil.copyfile(path, copy)
        shutil.copyfile(_beside(path, "-wal"), _beside(copy, "-wal"))
        with closing(_connected(f"{copy.as_uri()}?mode=rw")) as database:
            _protect(database)
            yield database


def _connected(uri: str) -> sqlite3.Connection:
    # Episodes hand their frames to any thread, one at a time.
    return sqlite3.connect(uri, uri=True, isolation_level=None, check_same_thread=False)


def _protect(database: sqlite3.Connection, *, is_cut: bool = False) -> None:
    """Harden a connection against a hostile schema and oversized values.

    Args:
        database: before its first query.
        is_cut: whether pages are missing at the end, which SQLite refuses to read past otherwise.
    """
    database.text_factory = lambda raw: raw.decode("utf-8", "replace")
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_PART_BYTES)
    database.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
    for setting in ("trusted_schema = OFF", "cell_size_check = ON", "mmap_size = 0"):
        database.execute(f"PRAGMA {setting}")
    if is_cut:
        database.execute("PRAGMA writable_schema = ON")
    database.set_authorizer(_allowed)


def _allowed(action: int, first: str | None, *_rest: str | None) -> int:
    """Authorize reading columns of tables only: no functions, no recursion, no other pragma."""
    plain = action in (sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ)
    if plain or (action == sqlite3.SQLITE_PRAGMA and first == "table_xinfo"):
        return sqlite3.SQLITE_OK
    return sqlite3.SQLITE_DENY


def _beside(path: Path, suffix: str) -> Path:
    return path.with_name(path.name + suffix)


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0


def _is_cut(path: Path, losses: list[Loss]) -> bool:
    """Return whether the file is shorter than its page count states."""
    with open_regular(path) as file:
        head = file.read(_HEADER.size)
    if len(head) < _HEADER.size:
        return False
    page, pages = _HEADER.unpack(head)
    size, stated = _size(path), pages * (65536 if page == 1 else page)
    if size < stated:
        losses.append(Loss("the file is cut", at_byte=size, size=stated - size))
    return size < stated


def table_of(
    database: sqlite3.Connection, name: str, needed: Sequence[str], more: Sequence[str] = ()
) -> DatabaseTable:
    """Find a plain table with the needed columns.

    Args:
        database: an open connection.
        name: the table's.
        needed: required columns.
        more: optional columns.

    Raises:
        NoTableError: it is missing, no plain table, or lacks a column.
        DATABASE_ERRORS: the file is damaged.
    """
    every = DatabaseTable(_SCHEMA, ("type", "name", "rootpage")).rows(database, [])
    kinds = [
        (kind, root)
        for _, (kind, title, root) in every
        if kind in ("table", "view") and str(title).lower() == name
    ]
    if not kinds:
        raise NoTableError(f"it has no table {name!r}")
    (kind, root), *others = kinds
    if kind != "table" or type(root) is not int or root <= 0 or others:  # a virtual one has no root
        raise NoTableError(f"its {name!r} is no plain table")
    columns = {row[1]: row[6] for row in database.execute(f"PRAGMA table_xinfo({name})")}
    if any(column.lower() == _NUMBER for column in columns):
        raise NoTableError(f"its table {name!r} hides its rows' numbers")
    found = (*needed, *(column for column in more if columns.get(column) == 0))
    for column in needed:
        if columns.get(column) != 0:  # a computed one is hidden
            raise NoTableError(f"its table {name!r} has no plain column {column!r}")
    return DatabaseTable(name, found)


@dataclass(frozen=True)
class DatabaseTable:
    """A plain table. Only names written in this code enter its queries."""

    name: str
    columns: tuple[str, ...]

    def rows(self, database: sqlite3.Connection, losses: list[Loss]) -> Iterator[Row]:
        """Yield all rows by row number, so in recording order; unreadable ones are losses."""
        columns = ", ".join(self.columns)
        start, damaged_places = _FIRST, 0
        while start <= _LAST and damaged_places < _MAX_DAMAGED_PLACES:
            try:
                for row in self._asked(database, columns, start):
                    start = row[0] + 1
                    yield row
                return
            except DATABASE_ERRORS as error:
                why = described(error)
            row = self._one(database, columns, start)
            if row is not None:  # the library drops the last row before the damage
                start = row[0] + 1
                yield row
                continue
            damaged_places += 1
            found = self._behind(database, start)
            rows = f"{start} to {found - 1}" if found is not None else f"{start} to the last"
            lost = found - start if found is not None and self.name == "messages" else None
            what = f"table {self.name}: rows {rows} cannot be read: {why}"
            losses.append(Loss(what, messages=lost))
            if found is None:
                return
            start = found
        if damaged_places == _MAX_DAMAGED_PLACES:
            losses.append(Loss(f"table {self.name}: what follows row {start} was not tried"))

    def _asked(
        self, database: sqlite3.Connection, columns: str, start: int, limit: str = ""
    ) -> Iterator[Row]:
        """Query rows from a number on; raise DATABASE_ERRORS at the first damaged one."""
        # An index is not used: it may be damaged, or say something else than the table.
        question = (
            f"SELECT {_NUMBER}, {columns} FROM {self.name} NOT INDEXED "  # noqa: S608 (see the class)
            f"WHERE {_NUMBER} >= ? ORDER BY {_NUMBER} {limit}"
        )
        for number, *values in database.execute(question, (start,)):
            if type(number) is not int or number < start:
                raise sqlite3.DatabaseError("its rows are in disorder")
            start = number + 1
            yield number, tuple(values)

    def _one(self, database: sqlite3.Connection, columns: str, start: int) -> Row | None:
        """Return the first row from a number on; None where it is unreadable or absent."""
        try:
            return next(self._asked(database, columns, start, "LIMIT 1"), None)
        except DATABASE_ERRORS:
            return None

    def _behind(self, database: sqlite3.Connection, start: int) -> int | None:
        """Return the first row number that can be read again behind damage; None if there is none.

        Exponential search, then bisection, so a damaged page costs few queries.
        """
        found = self._next(database, start)
        if found is not None:  # what is damaged are that row's values
            return max(found, start) + 1
        low, high = start, start + 1
        while (found := self._next(database, high)) is None:
            low, high = high, 2 * high - start
            if high > _LAST:
                return None
        while high - low > 1:
            middle = (low + high) // 2
            if (between := self._next(database, middle)) is None:
                low = middle
            else:
                high, found = middle, between
        return max(found, start + 1)

    def _next(self, database: sqlite3.Connection, start: int) -> int | None:
        row = self._one(database, "1", start) if start <= _LAST else None
        return None if row is None else row[0]


# ---- The tables of a bag: topics, definitions of their types, messages.

# Columns of the tables of a ROS 2 bag, as rosbag2 names them.
_MESSAGES = ("topic_id", "timestamp", "data")
_TOPICS = ("id", "name", "type", "serialization_format")
_DEFINITIONS = ("topic_type", "encoding", "encoded_message_definition")
_SCHEMAS = ("ros2msg", "ros2idl")  # encodings that are read; others are as if none were given
# Columns of what else a topic states, and the same in an MCAP of ROS 2.
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
