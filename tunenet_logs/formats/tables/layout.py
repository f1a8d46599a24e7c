"""Lay out the columns of a table: clocks, tracks, joints, and unused ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from tunenet_logs.formats.tables.column_names import by_name, meaning_of
from tunenet_logs.formats.tables.group import Group, Used, plain_words
from tunenet_logs.formats.tables.joints import joints_of
from tunenet_logs.formats.tables.meaning import (
    DateColumn,
    FrameColumn,
    ImpactColumn,
    ImpactNumberColumn,
    JointNameColumn,
    Meaning,
    Reading,
    RunColumn,
    TimeColumn,
    UnusedColumn,
    words_of,
)
from tunenet_logs.formats.tables.run_names import runs_of
from tunenet_logs.formats.tables.times import Clock
from tunenet_logs.formats.tables.tracks import tracks_of

# Of a table: motion capture of hundreds of markers has fewer; each column costs its name's reading.
MAX_COLUMNS = 5000


@dataclass(frozen=True)
class TableLayout:
    """A table's columns.

    Attributes:
        separator: of cells; None is white space.
        names: columns of joint names, by joint number.
        runs: columns that identify run and object of a row, with the kind of each.
        unused: why a column is not used, by its name.
        header: the names of all columns, with their units.
        reading: interpreter of the columns.
    """

    separator: str | None
    groups: tuple[Group, ...]
    names: Mapping[str, int]
    runs: tuple[tuple[int, str], ...]
    unused: Mapping[str, str]
    header: tuple[str, ...]
    reading: Reading = by_name

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.header)


def table_layout_of(
    header: Sequence[str], separator: str | None, reading: Reading = by_name
) -> TableLayout | None:
    """Parse a header line; None where it names no time, and so is no header."""
    least = 2 if reading is by_name else 1
    if not least <= len(header) <= MAX_COLUMNS:
        return None
    columns = runs_of(header) if reading is by_name else [("", name) for name in header]
    names = [name for _, name in columns]
    meanings = {at: reading(at, name) for at, name in enumerate(names)}
    unused = {
        header[at]: meaning.reason
        for at, meaning in meanings.items()
        if isinstance(meaning, UnusedColumn)
    }
    groups: list[Group] = []
    clock: Clock | None = None
    for run in dict.fromkeys(sorted((run for run, _ in columns), key=bool)):
        part = {at: meanings[at] for at, (of, _) in enumerate(columns) if of == run}
        clocks = _clocks(names, part)
        stamps = [one for is_header, one in clocks if is_header]
        shared = clock
        clock = _arrival(clocks) or shared or _frames(names, part)
        if clock is None:
            continue
        found = [
            *tracks_of(names, part, clock, stamps, unused),
            *joints_of(names, part, clock, stamps, unused),
            *_impacts(part, clock),
        ]
        groups += [replace(one, name=one.name_of_run(run)) if run else one for one in found]
    if clock is None:
        return None
    if not groups and any(isinstance(one, ImpactNumberColumn) for one in meanings.values()):
        groups = [_impact_group(clock.indices[0], clock)]
    if not clock.counts_frames:
        frames = (header[at] for at, one in meanings.items() if isinstance(one, FrameColumn))
        unused.update(dict.fromkeys(frames, "there is a column of times"))
    texts = {one.number: at for at, one in meanings.items() if isinstance(one, JointNameColumn)}
    return TableLayout(
        separator, tuple(groups), texts, run_columns(meanings), unused, tuple(header), reading
    )


def run_columns(meanings: Mapping[int, Meaning]) -> tuple[tuple[int, str], ...]:
    """Return the columns that identify run and object of a row, with the kind of each."""
    counts = [(at, one.kind) for at, one in meanings.items() if isinstance(one, RunColumn)]
    runs = [one for one in counts if one[1] == "run"]
    things = sorted((one for one in counts if one[1] != "run"), key=lambda one: one[1] == "object")
    return (*runs[:1], *things[:1])


def clock_of(header: Sequence[str]) -> Clock | None:
    """Return the clock of the rows under a header; None where no name is a time."""
    return _arrival(_clocks(header, dict(enumerate(map(meaning_of, header)))))


def _arrival(clocks: Sequence[tuple[bool, Clock]]) -> Clock | None:
    """Return the clock of the rows: the shortest name, arrival before header stamps."""
    arrivals = [one for is_header, one in clocks if not is_header] or [one for _, one in clocks]
    return min(arrivals, key=lambda one: len(words_of(one.name, camel=True)), default=None)


def _clocks(header: Sequence[str], meanings: Mapping[int, Meaning]) -> list[tuple[bool, Clock]]:
    """Return all clocks; seconds and nanoseconds of one name are one."""
    times = {at: meaning for at, meaning in meanings.items() if isinstance(meaning, TimeColumn)}
    rests = {
        plain_words(header[at])[:-1]: at
        for at, meaning in times.items()
        if meaning.part == "nanosec"
    }
    dates = [at for at, meaning in meanings.items() if isinstance(meaning, DateColumn)]
    clocks: list[tuple[bool, Clock]] = []
    paired: set[int] = set()
    for at, meaning in times.items():
        rest = rests.get(plain_words(header[at])[:-1]) if meaning.part == "sec" else None
        if rest is not None:
            paired.update((at, rest))
            clock = Clock(header[at], (at, rest), 0, meaning.scope)
            clocks.append((meaning.is_header, clock))
    for at, meaning in times.items():
        if at not in paired:
            has_date = bool(dates) and meaning.power is None and not meaning.is_header
            indices = (dates[0], at) if has_date else (at,)
            clock = Clock(header[at], indices, meaning.power, meaning.scope, has_date=has_date)
            clocks.append((meaning.is_header, clock))
    if dates and not times:
        clocks.append((False, Clock(header[dates[0]], (dates[0],), None)))
    clocks += [
        (
            False,
            Clock(header[at], (at,), meaning.power, counts_frames=meaning.counts_frames),
        )
        for at, meaning in meanings.items()
        if isinstance(meaning, ImpactColumn)
    ]
    return clocks


def _frames(header: Sequence[str], meanings: Mapping[int, Meaning]) -> Clock | None:
    """Return the clock of a table that counts frames and has no other."""
    at = next((at for at, one in meanings.items() if isinstance(one, FrameColumn)), None)
    return None if at is None else Clock(header[at], (at,), 0, counts_frames=True)


def _impacts(meanings: Mapping[int, Meaning], clock: Clock) -> list[Group]:
    return [
        _impact_group(at, clock)
        for at, meaning in meanings.items()
        if isinstance(meaning, ImpactColumn)
    ]


def _impact_group(at: int, clock: Clock) -> Group:
    return Group(
        *("impacts", ("impact",), "1", (Used(at, 0, 1.0),)),
        needs_all=True,
        clock=clock,
        is_impacts=True,
    )
