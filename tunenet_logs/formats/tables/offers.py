"""Suggest the options to type for a table that is not understood."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import chain, islice

from tunenet_logs.formats.tables.column_names import meaning_of
from tunenet_logs.formats.tables.lines import cells_of
from tunenet_logs.formats.tables.meaning import (
    CoordinateColumn,
    FrameColumn,
    JointColumn,
    TimeColumn,
)
from tunenet_logs.formats.tables.numbers import Numbers

_MAX_SHOWN = 8  # columns in a message
_MAX_ROWS = 100_000  # looked at to describe columns without names
_MAX_LENGTH = 30  # of a name in a message
_MAX_READ = 200  # of a name whose meaning is asked for
_PLAIN = re.compile(r"[^\W\d][\w.\-/]*")  # a name that needs no quotes


def offer_by_number(first: str, rest: Iterable[str | None], separator: str | None) -> str:
    """Describe unnamed columns by their first and last values, with an example of `--columns`."""
    rows = [_values(first, separator)]
    last, increases = rows[0], True
    for line in islice(rest, _MAX_ROWS):
        row = _values(line or "", separator)
        if len(row) == len(rows[0]) and row[0] is not None:
            increases = increases and last[0] is not None and row[0] > last[0]
            last = row
    pairs = list(zip(rows[0], last, strict=True))[:_MAX_SHOWN]
    listed = ", ".join(f"{at}: {_number(a)} to {_number(b)}" for at, (a, b) in enumerate(pairs, 1))
    more = ", ..." if len(last) > _MAX_SHOWN else ""
    text = f"its columns by number are {listed}{more}; say which they are, "
    if increases and len(last) == 4:
        return text + "perhaps --columns t=1,x=2,y=3,z=4"
    if increases and len(last) == 2:
        return text + "perhaps --columns t=1,z=2"
    if len(last) == 1:
        return text + "for example --columns times=1 if they are times of impacts"
    if not increases and len(last) in (2, 3):
        text += "for example --columns t=1,z=2, or, where a row is a picture, "
        return text + "--columns x=1,y=2 --fps 30"
    return text + "for example --columns t=1,z=2"


def offer_by_name(names: Sequence[str]) -> str:
    """Suggest a `--columns` line made of a table's own column names."""
    meanings = [meaning_of(name[:_MAX_READ]) for name in names]
    is_place = [isinstance(one, CoordinateColumn) for one in meanings]
    is_value = [isinstance(one, CoordinateColumn | JointColumn) for one in meanings]
    named = [at for at, name in enumerate(names) if name.strip()]
    clocks = [at for at in named if isinstance(meanings[at], TimeColumn | FrameColumn)]
    clock = next(chain(clocks, (at for at in named if not is_value[at])), None)
    if clock is None:
        return _offer_of_rows(names, meanings)
    target = "frame" if isinstance(meanings[clock], FrameColumn) else "t"
    said = f"say which they are, for example --columns {target}={_quoted(names, clock)}"
    other = next((at for at in named if at != clock), None)
    if any(is_place) or other is None:
        return said
    meaning = meanings[other]
    value = f"{meaning.quantity}_1" if isinstance(meaning, JointColumn) else "z"
    return f"{said},{value}={_quoted(names, other)}"


def _offer_of_rows(names: Sequence[str], meanings: Sequence[object]) -> str:
    """Suggest options where there are positions alone: a row may be a frame."""
    text = "add a column of times (t) or of the numbers of frames (frame)"
    axes = {
        one.axis: _quoted(names, at)
        for at, one in reversed(list(enumerate(meanings)))
        if isinstance(one, CoordinateColumn)
    }
    said = ",".join(f"{'xyz'[axis]}={name}" for axis, name in sorted(axes.items()))
    if not said:
        return f"{text}; where rows have an even rate, say it: --fps 100"
    return f"{text}; where a row is a picture: --columns {said} --fps 30"


def short_list(names: Sequence[str]) -> str:
    """List the first few names."""
    shown = [repr(name.strip()[:_MAX_LENGTH]) for name in names if name.strip()]
    more = f", ... ({len(shown)} in all)" if len(shown) > _MAX_SHOWN else ""
    return ", ".join(shown[:_MAX_SHOWN]) + more


def _quoted(names: Sequence[str], at: int) -> str:
    """Return a column's name as it can be typed, or its number."""
    name = names[at].strip()
    if _PLAIN.fullmatch(name) and len(name) <= _MAX_LENGTH:
        return name
    if (
        not name
        or len(name) > _MAX_LENGTH
        or not name.isprintable()
        or set("'\"\\`$,=") & set(name)
    ):
        return str(at + 1)
    return f"'{name}'"


def _values(line: str, separator: str | None) -> list[float | None]:
    numbers = Numbers(separator)
    values: list[float | None] = []
    for cell in cells_of(line, separator):
        values.append(None)
        with suppress(ValueError):
            values[-1] = numbers.read(cell)
    return values


def _number(value: float | None) -> str:
    return "?" if value is None or value != value else f"{value:.4g}"  # noqa: PLR0124 (NaN)
