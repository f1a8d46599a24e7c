"""How the columns of a table belong together: clocks, tracks, joints, and what is not used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from tunenet_logs.formats.tables.column_names import PIXELS, meaning_of
from tunenet_logs.formats.tables.meaning import (
    CoordinateColumn,
    JointColumn,
    JointNameColumn,
    Meaning,
    TimeColumn,
    UnusedColumn,
    Words,
    lowered,
    words_of,
)
from tunenet_logs.formats.tables.times import Clock

MOST_COLUMNS = 5000
"""Of a table: motion capture of hundreds of markers has fewer; each column costs its name's
reading."""


@dataclass(frozen=True)
class Used:
    """One column of values: `row` of the result [its unit] is `scale` times the text."""

    index: int
    row: int
    scale: float


@dataclass(frozen=True)
class Group:
    """Columns that are one signal.

    Attributes:
        name: of the signal.
        columns: of the signal; no column of the table where an axis is missing.
        unit: of the signal.
        needs_all: whether a row that has some of the values is damaged.
        stamp: when its samples were taken, where the table says that beside when they arrived.
        numbers: of the joints that go by a number alone, by column.
    """

    name: str
    columns: tuple[str, ...]
    unit: str
    used: tuple[Used, ...]
    needs_all: bool
    stamp: Clock | None = None
    numbers: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class TableLayout:
    """A table's columns.

    Attributes:
        separator: of cells; None is white space.
        clock: when a row arrived, or was taken.
        names: the columns that hold the names of joints, by the joint's number.
        unused: why a column is not used, by its name.
        header: the names of all columns, with their units.
    """

    separator: str | None
    clock: Clock
    groups: tuple[Group, ...]
    names: Mapping[str, int]
    unused: Mapping[str, str]
    header: tuple[str, ...]

    @property
    def width(self) -> int:
        """How many columns there are."""
        return len(self.header)


def table_layout_of(header: Sequence[str], separator: str | None) -> TableLayout | None:
    """What a header line says; None where it is none: there is no time among its names."""
    if not 2 <= len(header) <= MOST_COLUMNS:
        return None
    meanings = [meaning_of(name) for name in header]
    clocks = _clocks(header, meanings)
    if not clocks:
        return None
    stamps = [clock for is_header, clock in clocks if is_header]
    arrivals = [clock for is_header, clock in clocks if not is_header] or stamps
    clock = min(arrivals, key=lambda candidate: len(words_of(candidate.name, camel=True)))
    unused: dict[str, str] = {}
    for at, meaning in enumerate(meanings):
        if isinstance(meaning, UnusedColumn):
            unused[header[at]] = _reason(header, at, meaning)
    groups = [
        *_tracks(header, meanings, stamps, unused),
        *_joints(header, meanings, stamps, unused),
    ]
    names = {
        meaning.number: at
        for at, meaning in enumerate(meanings)
        if isinstance(meaning, JointNameColumn)
    }
    return TableLayout(separator, clock, tuple(groups), names, unused, tuple(header))


def _reason(header: Sequence[str], at: int, meaning: UnusedColumn) -> str:
    """Why a column is not used; (u, v) are a picture's, u alone is a controller's."""
    words = _words(header[at])
    pair = {"u": "v", "v": "u"}.get(words[-1] if words else "")
    if pair and any(_words(name) == (*words[:-1], pair) for name in header):
        return PIXELS.reason
    return meaning.reason


def _words(name: str) -> Words:
    return lowered(words_of(name, camel=False))


def _clocks(header: Sequence[str], meanings: Sequence[Meaning]) -> list[tuple[bool, Clock]]:
    """All times; seconds and nanoseconds of one name are one."""
    times = {at: meaning for at, meaning in enumerate(meanings) if isinstance(meaning, TimeColumn)}
    rests = {
        _words(header[at])[:-1]: at for at, meaning in times.items() if meaning.part == "nanosec"
    }
    clocks: list[tuple[bool, Clock]] = []
    paired: set[int] = set()
    for at, meaning in times.items():
        rest = rests.get(_words(header[at])[:-1]) if meaning.part == "sec" else None
        if rest is not None:
            paired.update((at, rest))
            clock = Clock(header[at], (at, rest), 0, meaning.scope)
            clocks.append((meaning.is_header, clock))
    for at, meaning in times.items():
        if at not in paired:
            clocks.append(
                (meaning.is_header, Clock(header[at], (at,), meaning.power, meaning.scope))
            )
    return clocks


def _tracks(
    header: Sequence[str],
    meanings: Sequence[Meaning],
    stamps: Sequence[Clock],
    unused: dict[str, str],
) -> list[Group]:
    things: dict[str, dict[int, list[int]]] = {}
    for at, meaning in enumerate(meanings):
        if isinstance(meaning, CoordinateColumn):
            things.setdefault(meaning.thing, {}).setdefault(meaning.axis, []).append(at)
    groups: list[Group] = []
    for thing, candidates in things.items():
        indices = [at for found in candidates.values() for at in found]
        axes = {axis: _without_heights(found, meanings) for axis, found in candidates.items()}
        chosen = [at for found in axes.values() for at in found]
        for at in set(indices).difference(chosen):
            unused[header[at]] = "there is a column z"
        if any(len(found) > 1 for found in axes.values()):
            for at in chosen:
                unused[header[at]] = f"several columns are a coordinate of {thing!r}"
            continue
        used = tuple(
            Used(at, axis, meaning.scale)
            for axis, (at,) in axes.items()
            if isinstance(meaning := meanings[at], CoordinateColumn)
        )
        stamp = _stamp_for(_words(header[chosen[0]]), stamps)
        groups.append(Group(thing, ("x", "y", "z"), "m", used, needs_all=True, stamp=stamp))
    return groups


def _without_heights(found: list[int], meanings: Sequence[Meaning]) -> list[int]:
    """Those called z, where there are any."""
    axes = [
        at
        for at in found
        if isinstance(meaning := meanings[at], CoordinateColumn) and not meaning.is_height
    ]
    return axes or found


def _stamp_for(words: Words, stamps: Sequence[Clock]) -> Clock | None:
    """The stamp of the message that a column comes from: with the longest name in common."""
    fitting = [clock for clock in stamps if words[: len(clock.scope)] == clock.scope]
    return max(fitting, key=lambda clock: len(clock.scope), default=None)


_QUANTITIES = {"position": "rad", "velocity": "rad/s", "effort": "N·m"}
"""Units of the signals of joints."""


def _joints(
    header: Sequence[str],
    meanings: Sequence[Meaning],
    stamps: Sequence[Clock],
    unused: dict[str, str],
) -> list[Group]:
    values = {
        at: meaning for at, meaning in enumerate(meanings) if isinstance(meaning, JointColumn)
    }
    if not any(not meaning.is_bare or meaning.quantity == "effort" for meaning in values.values()):
        for at in values:
            unused[header[at]] = "it says not of what; name it x, y, z, height_m or JOINT_position"
        return []
    tables: dict[tuple[str, str], dict[str, list[int]]] = {}
    for at, meaning in values.items():
        found = tables.setdefault((meaning.group, meaning.quantity), {})
        found.setdefault(meaning.label, []).append(at)
    groups: list[Group] = []
    for (group, quantity), labels in tables.items():
        for label in [label for label, found in labels.items() if len(found) > 1]:
            for at in labels.pop(label):
                unused[header[at]] = f"several columns are the {quantity} of {label!r}"
        indices = [found[0] for found in labels.values()]
        used = tuple(Used(at, row, values[at].scale) for row, at in enumerate(indices))
        numbers = {values[at].label: values[at].number for at in indices if values[at].number}
        name, unit = f"{group}.{quantity}", _QUANTITIES[quantity]
        if used:
            stamp = _stamp_for(_words(header[indices[0]]), stamps)
            groups.append(Group(name, tuple(labels), unit, used, False, stamp, numbers))
    return groups
