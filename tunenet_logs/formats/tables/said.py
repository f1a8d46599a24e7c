"""Interpret the columns of a table that a user names with `--columns`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from tunenet_logs.formats.tables.column_names import meaning_of
from tunenet_logs.formats.tables.meaning import (
    CoordinateColumn,
    FrameColumn,
    ImpactColumn,
    JointColumn,
    Meaning,
    Reading,
    RunColumn,
    TimeColumn,
    UnusedColumn,
)
from tunenet_logs.formats.tables.units import unit_behind

CLOCKS = ("t", "frame", "times")  # what tells when; one of them is enough
_AXES = {"x": 0, "y": 1, "z": 2}  # of targets that are coordinates
_UNSAID = UnusedColumn("--columns does not name it")  # the meaning of all others


def contradiction_of(columns: Mapping[str, str]) -> str:
    """Return why `--columns` contradicts itself; "" where it does not."""
    clocks = [one for one in CLOCKS if one in columns]
    if len(clocks) > 1:
        return f"--columns says {clocks[0]} and {clocks[1]}; say one of them"
    if "times" in columns and len(columns) > 1:
        return "--columns says times, which are impacts, and other columns; say times alone"
    return ""


def is_name(place: str, names: Sequence[str]) -> bool:
    """Return whether a column has this name."""
    return _named(place, names) is not None


def places_of(columns: Mapping[str, str], names: Sequence[str]) -> tuple[dict[int, str], list[str]]:
    """Find the user's columns in a table; return targets by index, and the missing ones.

    Args:
        columns: names, or numbers from 1, by target.
        names: of the table's columns.
    """
    found: dict[int, str] = {}
    missing: list[str] = []
    for target, place in columns.items():
        at = _named(place, names)
        if at is None and re.fullmatch(r"[1-9]\d{0,3}", place, re.ASCII):
            at = int(place) - 1 if int(place) <= len(names) else None
        if at is None:
            missing.append(place)
        else:
            found[at] = target
    return found, missing


def _named(place: str, names: Sequence[str]) -> int | None:
    place = place.strip()
    stripped = [name.strip() for name in names]
    if place in stripped:
        return stripped.index(place)
    folded, wanted = [name.casefold() for name in stripped], place.casefold()
    if wanted in folded:
        return folded.index(wanted)
    without = [re.sub(r"(?<!\s)\s*[(\[][^()\[\]]*[)\]]$", "", name) for name in folded]
    return without.index(wanted) if without.count(wanted) == 1 else None


def said_reading(places: Mapping[int, str]) -> Reading:
    """Return the interpreter of columns that a user names, by index.

    A clock that is named excludes all other clocks; values that are named, all other values. The
    interpreter raises ValueError where a column's unit does not fit its target.
    """
    targets = set(places.values()) - {"object"}
    has_clock = not targets.isdisjoint(CLOCKS)
    has_values = "times" in targets or not targets.issubset(CLOCKS)

    def read(at: int, name: str) -> Meaning:
        if at in places:
            return _meaning_as(places[at], name)
        found = meaning_of(name)
        if isinstance(found, RunColumn | UnusedColumn):
            return found
        is_clock = isinstance(found, TimeColumn | FrameColumn)
        return _UNSAID if (has_clock if is_clock else has_values) else found

    return read


def _meaning_as(target: str, name: str) -> Meaning:
    """Return the meaning of a column named as a target; its name may state the unit."""
    if target in ("frame", "object"):
        return FrameColumn() if target == "frame" else RunColumn("object")
    unit = unit_behind(name)
    if target in _AXES:
        found = meaning_of(f"{target} ({unit})" if unit else target)
        if isinstance(found, CoordinateColumn):
            return found
    elif target in ("t", "times"):
        found = meaning_of(f"t ({unit})" if unit else "t")
        own = meaning_of(name)
        if target == "times" and isinstance(own, FrameColumn):
            return ImpactColumn(0, counts_frames=True)
        if not unit and isinstance(own, TimeColumn):
            found = TimeColumn(own.power)
        if isinstance(found, TimeColumn):
            return ImpactColumn(found.power) if target == "times" else found
    else:
        quantity, _, number = target.partition("_")
        found = meaning_of(f"joint{number}_{quantity}" + (f" ({unit})" if unit else ""))
        if isinstance(found, JointColumn):
            return found
    raise ValueError(
        f"--columns says that {name[:60]!r} is {target}, but it is in {unit[:40]!r}, which is no "
        "unit of that; name another column"
    )
