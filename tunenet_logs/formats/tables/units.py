"""Apply units that a table states beside its names: in a row of them, or in its preamble."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from tunenet_logs.formats.tables.column_names import UNKNOWN, by_name
from tunenet_logs.formats.tables.meaning import (
    LENGTHS,
    POWERS,
    CoordinateColumn,
    JointColumn,
    Meaning,
    Reading,
    TimeColumn,
    lowered,
    words_of,
)
from tunenet_logs.formats.tables.run_names import runs_of

# Words of units, those that are not read too: a row of them is no row of numbers.
_WORDS = frozenset(
    (
        *LENGTHS,
        *POWERS,
        *("rad", "radian", "radians", "deg", "degree", "degrees", "n", "nm", "mnm", "kn"),
        *("px", "pix", "pixel", "pixels", "um", "km", "dm", "ma"),
        "yd",
        *("min", "mins", "minute", "minutes", "h", "hr", "hour", "hours", "day", "days"),
    )
)

_NONE = frozenset(("", "-", "1"))  # cells of a row of units that say none
# A preamble's "Length Units,Millimeters" or "units: mm".
_SAID = re.compile(r"\b(length[ _])?units?\b\W{1,5}(\w+)", re.IGNORECASE)

# What to do about a unit that is not read.
_REMEDY = "convert it to m, cm, mm, in or ft (times: s, ms, us or ns)"


def with_row(
    header: Sequence[str], cells: Sequence[str], reading: Reading = by_name
) -> list[str] | None:
    """Add the units of a row below a header to its names; None where it is no row of units.

    Args:
        header: the names.
        cells: the row's.
        reading: interpreter of the columns.

    Raises:
        ValueError: a unit is unknown, or contradicts the one in the name.
    """
    if any(map(str.strip, cells[len(header) :])):
        return None
    names = [name for _, name in runs_of(header)]
    said = {
        at: unit
        for at, (name, cell) in enumerate(zip(names, cells, strict=False))
        if (unit := cell.strip(" \t()[]")) not in _NONE and _size(reading(at, name)) is not None
    }
    texts = said.values()
    if any(map(str.isdecimal, "".join(texts))) or not any(map(_is_unit, texts)):
        return None
    return [
        _named(name, names[at], said[at], lambda text, at=at: reading(at, text))
        if at in said
        else name
        for at, name in enumerate(header)
    ]


def length_in(line: str) -> str:
    """Return the length unit that a line of a preamble states; "" where it states none.

    Raises:
        ValueError: the unit is unknown.
    """
    for is_length, unit in _SAID.findall(line):
        if unit.lower() in LENGTHS:
            return unit
        if is_length:
            raise ValueError(f"lengths are in {unit[:40]!r}, which is not read; {_REMEDY}")
    return ""


def with_lengths(header: Sequence[str], unit: str, reading: Reading = by_name) -> list[str]:
    """Add a length unit to the names of positions that state none."""
    return [
        f"{name} ({unit})"
        if isinstance(reading(at, rest), CoordinateColumn) and _without_unit(rest) is None
        else name
        for at, (name, (_, rest)) in enumerate(zip(header, runs_of(header), strict=True))
    ]


def with_degrees(header: Sequence[str], reading: Reading = by_name) -> list[str]:
    """Add degrees to the names of joint angles and velocities that state no unit."""
    return [
        f"{name} (deg{'/s' if meaning.quantity == 'velocity' else ''})"
        if isinstance(meaning := reading(at, rest), JointColumn)
        and meaning.quantity in ("position", "velocity")
        and _without_unit(rest) is None
        else name
        for at, (name, (_, rest)) in enumerate(zip(header, runs_of(header), strict=True))
    ]


def unit_behind(name: str) -> str:
    """Return the unit at the end of a name, in brackets or as last word; "" for none."""
    found = re.search(r"[(\[]([^()\[\]]{1,40})[)\]]\s*$", name)
    words = lowered(words_of(found[1] if found else name, camel=False))
    if found:
        return found[1] if _WORDS.intersection(words) or words in (("a",), ("ma",)) else ""
    return words[-1] if len(words) > 1 and words[-1] in _WORDS else ""


def unit_alone(text: str) -> str | None:
    """Return the unit that a cell consists of, in brackets or not; None where it is no unit."""
    stripped = text.strip(" \t()[]")
    return stripped if stripped in _NONE or _is_unit(stripped) else None


def _is_unit(text: str) -> bool:
    words = lowered(words_of(text, camel=False))
    return bool(words) and _WORDS.issuperset(words)


def _without_unit(name: str) -> str | None:
    """Strip a name of its unit; None where it has none."""
    words = words_of(name, camel=False)
    rest = list(words)
    while rest and rest[-1].lower() in _WORDS:
        rest.pop()
    return (" ".join(rest) or "time") if len(rest) < len(words) else None


def _named(name: str, plain: str, unit: str, reading: Callable[[str], Meaning]) -> str:
    """Return a column's name with its unit; `plain` is the name without its run."""
    rest = _without_unit(plain)
    meaning = reading(f"{rest or plain} ({unit})")
    if meaning == UNKNOWN:
        raise ValueError(f"{name[:60]!r} is in {unit[:40]!r}, which is not read; {_REMEDY}")
    if rest is None:
        return f"{name} ({unit})"
    if _size(meaning) != _size(reading(plain)):
        raise ValueError(f"{name[:60]!r} is said to be in {unit[:40]!r}; say one unit")
    return name


def _size(meaning: Meaning) -> float | None:
    """Return the size of a meaning's unit; None where it has no values."""
    if isinstance(meaning, TimeColumn):
        return meaning.power or 0
    return meaning.scale if isinstance(meaning, CoordinateColumn | JointColumn) else None
