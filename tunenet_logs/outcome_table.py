"""Read outcomes from a table: a line each, the columns by their names."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from math import isnan
from pathlib import Path
from typing import Any, NoReturn

from tunenet_logs.errors import CHECK_DISK, LogError
from tunenet_logs.formats.tables.lines import SEPARATORS, cells_of, lines_of
from tunenet_logs.formats.tables.numbers import Numbers
from tunenet_logs.outcome import BOUNCE_SHOT, Outcome
from tunenet_logs.terminal import listed, short_name

# The columns of a table, by what they become; any case.
_NAMES = {
    "task": ("task",),
    "ball": ("ball",),
    "attempt": ("attempt", "trial"),
    "success": ("success", "outcome", "result"),
    "stamp_ns": ("time", "date", "stamp"),
    "shot_height_m": ("shot_height_m", "shot_height"),
    "miss_m": ("miss_m", "miss", "miss_distance_m", "miss_distance"),
    "tuned_parameter": ("tuned_parameter", "restitution"),
    "drop_log": ("drop_log", "log"),
    "tuning": ("tuning",),
    "reason": ("reason",),
    "note": ("note", "notes", "comment"),
}

_NEEDED = ("ball", "success")  # columns without which a table holds no outcomes
# How people write that an attempt succeeded, in small letters.
_WORDS = {
    **dict.fromkeys(("1", "true", "yes", "y", "success", "ok", "hit"), True),
    **dict.fromkeys(("0", "false", "no", "n", "failure", "fail", "miss"), False),
}


def is_outcome_table(path: Path) -> bool:
    """Check whether a table's first line names a ball and a result.

    Raises:
        LogError: it is too large.
        OSError: it cannot be read.
    """
    columns = next((_columns(line) for _, line in _lines(path)), None)
    return columns is not None and all(name in columns.indices for name in _NEEDED)


def read_outcome_table(path: Path) -> tuple[Outcome, ...]:
    """Read the outcomes of a table, in its order.

    Columns: ball and success must be there; task ("bounce-shot" where there is none), attempt
    (where there is none, counted by task and ball), time, shot_height_m, miss_m, tuned_parameter,
    drop_log, tuning, reason and note may be. Others are passed over.

    Raises:
        LogError: a column is missing or a cell is wrong; names line, column, value and remedy.
    """
    lines = _lines(path)
    try:
        header = next(lines, None)
        if header is None:
            raise LogError(f"{path}: is empty; put a line with the names of the columns on top")
        table = _Table(path, _checked(path, header[1]))
        return tuple(table.outcome(number, line) for number, line in lines)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the numbered lines that are not empty; comments (#) stand before the header."""
    is_row = False
    for number, line in enumerate(lines_of(path), 1):
        if line is None:
            raise LogError(f"{path}: line {number} is too long for a table; split it")
        if line.strip() and (is_row or not line.startswith("#")):
            is_row = True
            yield number, line


@dataclass(frozen=True)
class _Columns:
    """Index of each field's column, and what separates the cells."""

    indices: Mapping[str, int]
    separator: str | None
    names: tuple[str, ...]


def _columns(line: str) -> _Columns:
    """Parse a header by the separator that yields the most known names."""
    read = [_named(line, separator) for separator in SEPARATORS if separator]
    return max(read, key=lambda columns: len(columns.indices))


def _named(line: str, separator: str) -> _Columns:
    names = tuple(name.strip() for name in cells_of(line, separator))
    lowered = [name.lower().replace(" ", "_") for name in names]
    indices = {
        field: lowered.index(name)
        for field, known in _NAMES.items()
        for name in known[::-1]
        if name in lowered
    }
    return _Columns(indices, separator, names)


def _checked(path: Path, header: str) -> _Columns:
    columns = _columns(header)
    for name in _NEEDED:
        if name not in columns.indices:
            there = listed(map(short_name, columns.names))
            raise LogError(
                f"{path}: has no column {name!r} (there are: {there}); name the columns in the "
                f"first line: {','.join(_NAMES)}".replace("stamp_ns", "time")
            )
    return columns


class _Table:
    """Rows of one table."""

    def __init__(self, path: Path, columns: _Columns) -> None:
        self._path = path
        self._columns = columns
        self._numbers = Numbers(columns.separator)
        self._counts: Counter[tuple[str, str]] = Counter()

    def outcome(self, number: int, line: str) -> Outcome:
        cells = [cell.strip() for cell in cells_of(line, self._columns.separator)]
        if len(cells) > len(self._columns.names):
            raise LogError(
                f"{self._path}: line {number} has {len(cells)} cells under "
                f"{len(self._columns.names)} names; put a text with a separator into quotes"
            )
        texts = {
            field: cells[index] if index < len(cells) else ""
            for field, index in self._columns.indices.items()
        }
        values = {field: self._value(number, field, text) for field, text in texts.items()}
        values["task"] = values.get("task") or BOUNCE_SHOT
        values["is_counted"] = not values.get("attempt")
        kind = values["task"], values["ball"]
        self._counts[kind] = values.get("attempt") or self._counts[kind] + 1
        values["attempt"] = self._counts[kind]
        try:
            return Outcome(**values)
        except ValueError as error:
            raise LogError(f"{self._path}: line {number}: {error}; correct that line") from error

    def _value(self, number: int, field: str, text: str) -> Any:
        """Convert a cell to its value."""
        if field == "success":
            return self._success(number, text)
        if field == "stamp_ns":
            return self._stamp_ns(number, text)
        if field == "attempt":
            return self._attempt(number, text)
        if field in ("shot_height_m", "miss_m", "tuned_parameter"):
            return self._number(number, field, text)
        return text

    def _success(self, number: int, text: str) -> bool:
        found = _WORDS.get(text.lower())
        if found is None:
            self._refuse(number, "success", text, "write success or failure")
        return found

    def _number(self, number: int, field: str, text: str) -> float | None:
        try:
            value = self._numbers.read(text)
        except ValueError as error:
            self._refuse(number, field, text, "write a number, or nothing", str(error))
        return None if isnan(value) else value

    def _attempt(self, number: int, text: str) -> int:
        value = self._number(number, "attempt", text) or 0
        if value != int(value) or value < 0:
            self._refuse(number, "attempt", text, "write 1, 2, 3, ..., or nothing")
        return int(value)

    def _stamp_ns(self, number: int, text: str) -> int:
        try:
            return stamp_ns(text) if text else 0
        except ValueError:
            self._refuse(number, "stamp_ns", text, "write it as 2026-11-22 14:30, or nothing")

    def _refuse(self, number: int, field: str, text: str, remedy: str, why: str = "") -> NoReturn:
        name = self._columns.names[self._columns.indices[field]]
        reason = why or "cannot be read"
        raise LogError(
            f"{self._path}: line {number}, column {name!r}: {short_name(text)!r} {reason}; {remedy}"
        )


def stamp_ns(text: str) -> int:
    """Parse a time as people write it (2026-11-22 14:30, local without a zone) [ns since 1970].

    Raises:
        ValueError: it is no time, or lies before 1970.
    """
    try:
        when = datetime.fromisoformat(text.strip()).astimezone()
    except OverflowError as error:
        raise ValueError("it lies beyond all clocks") from error
    microseconds = round(when.timestamp() * 1e6)
    if microseconds < 0:
        raise ValueError("it lies before 1970")
    return microseconds * 1000
