"""Read tracks exported as text by the video analysis program Tracker (physlets.org/tracker)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path

from tunenet_logs.episode import UNSTATED, Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.exports.build import export_episode
from tunenet_logs.formats.exports.start import Start
from tunenet_logs.formats.exports.trackers.spot_rows import (
    MAX_BYTES,
    Place,
    Tracks,
    TrackUnits,
    best_separator,
    number_at,
    place_at,
    unique_names,
)
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.failures import DAMAGED_REMEDY, Failures, UnreadableError
from tunenet_logs.formats.tables.layout import MAX_COLUMNS
from tunenet_logs.formats.tables.lines import cells_of, lines_of
from tunenet_logs.formats.tables.meaning import LENGTHS, POWERS, lowered, words_of
from tunenet_logs.formats.tables.numbers import Numbers, decimal_of
from tunenet_logs.regular_file import open_regular

_FIRST = ("t", "frame", "step")  # what the first column of Tracker's is called
# What its columns of places are called, the better ones first.
_AXES = (("x", "pixelx"), ("y", "pixely"), ("z",))

_LOOK_LINES = 100  # read ahead, to see how numbers are written
# Stands at the beginning of what Tracker itself saves (.trk).
_PROJECT = b"org.opensourcephysics.cabrillo.tracker"


@dataclass(frozen=True)
class _Layout:
    """Columns, units and masses that the two header lines state.

    Attributes:
        header: names of the columns.
        when: the column of times, or of frames.
        second: unit of that column [s]; None where it counts frames.
        length: unit of lengths, as `position_signal` takes it.
    """

    separator: str | None
    header: tuple[str, ...]
    when: int
    second: float | None
    length: str
    places: tuple[Place, ...]
    unused: dict[str, str]

    @property
    def needed(self) -> int:
        """Least number of cells of a row."""
        axes = [index for place in self.places for index in place.axes if index is not None]
        return max(self.when, *axes) + 1


def is_tracker(start: Start) -> bool:
    """Return whether a file is an export of Tracker, or one of its projects."""
    if _PROJECT in start.data[:4096]:
        return True
    return names_masses(start.lines)


def names_masses(lines: Sequence[str]) -> bool:
    """Return whether lines begin as an export of Tracker does."""
    first = [line for line in lines[:4] if not line.startswith("#multi")]
    return len(first) > 1 and _layout(first[0], first[1]) is not None


def read_tracker(path: Path, options: ReadOptions) -> Episode:
    """Read each mass as a signal, in metres or pixels as its user calibrated them.

    Raises:
        LogError: no row can be read, or many cannot.
        OSError: the file cannot be read.
    """
    with open_regular(path) as file:
        if _PROJECT in file.read(4096):
            raise LogError(
                f"{path}: is a project of Tracker, not its data; in Tracker, choose File > Export "
                "> Data File"
            )
    if path.stat().st_size > MAX_BYTES:
        raise LogError(f"{path}: is a Tracker export of over {MAX_BYTES >> 20} MiB; split it")
    return read_masses(path, lines_of(path), options)


def read_masses(path: Path, lines: Iterable[str | None], options: ReadOptions) -> Episode:
    """Read the lines of a Tracker export, be they of a file or of a sheet.

    Raises:
        LogError: see `read_tracker`.
    """
    numbered = enumerate(lines, 1)
    layout = _read_header(path, numbered)
    failures, tracks, rows = Failures(), Tracks(path), 0
    first = list(islice(numbered, _LOOK_LINES))
    numbers = _numbers(layout, [line for _, line in first if line])
    for number, line in chain(first, numbered):
        if line is not None and not line.strip(" \t,;"):
            continue
        rows += 1
        try:
            _add(tracks, layout, numbers, line)
        except UnreadableError as error:
            failures.add(number, error)
    if not len(tracks):
        raise LogError(f"{path}: Tracker export: {failures.nothing(rows)}")
    if why := failures.refusal(rows):
        raise LogError(f"{path}: Tracker export: {why}")
    units = TrackUnits(layout.length, layout.second)
    signals, unused, notes = tracks.signals(units, options)
    lost = [failures.lost(rows)] if failures else []
    return export_episode(
        path,
        "Tracker export",
        signals,
        unused={**layout.unused, **unused},
        warnings=notes,
        losses=lost,
    )


def _read_header(path: Path, numbered: Iterator[tuple[int, str | None]]) -> _Layout:
    """Parse the layout from the first lines, consuming them."""
    names = ""
    for _, line in islice(numbered, 4):
        if line is None:
            break
        layout = _layout(names, line)
        if layout is not None:
            return layout
        names = line
    raise LogError(f"{path}: is no Tracker export of x and y; export these columns too")


def _layout(names: str, line: str) -> _Layout | None:
    """Parse a line of masses and the line of columns below it; None where they are none."""
    separator = best_separator(line)
    header = tuple(cell.strip() for cell in cells_of(line, separator))
    if not 2 < len(header) <= MAX_COLUMNS or _bare(header[0]) not in _FIRST:
        return None
    starts = _masses(names, separator, header)
    if not starts:
        return None
    whens = [at for at, name in enumerate(header) if _bare(name) in _FIRST]
    when = next((at for at in whens if _bare(header[at]) == "t"), whens[0])
    unit = _unit(header[when])
    second = 10.0 ** POWERS.get(unit, 0) if _bare(header[when]) == "t" else None
    ends = [at for at, _ in starts[1:]] + [len(header)]
    labels = unique_names(name for _, name in starts)
    places: list[Place] = []
    unused: dict[str, str] = {}
    lengths: set[str] = set()
    for label, (begin, _), end in zip(labels, starts, ends, strict=True):
        columns = {_bare(header[at]): at for at in reversed(range(begin, end)) if header[at]}
        axes = [next((columns[name] for name in names if name in columns), None) for names in _AXES]
        if axes[0] is None and axes[1] is None:
            unused[label] = "it has no column x or y"
            continue
        used = [at for at in axes if at is not None]
        lengths.update(_length(header[at]) for at in used)
        places.append(Place(label, (axes[0], axes[1], axes[2])))
        for name, at in columns.items():
            if at not in used and name not in _FIRST:
                unused[f"{label}.{name}"] = "it is no position"
    if not places or len(lengths) > 1:
        return None
    return _Layout(separator, header, when, second, lengths.pop(), tuple(places), unused)


def _masses(names: str, separator: str | None, header: Sequence[str]) -> list[tuple[int, str]]:
    """Return first column and name of each mass; empty where none is named."""
    if separator is None:
        found = [name for name in names.split("  ") if name.strip()]
        begins = [at for at, name in enumerate(header) if name == header[1]]
        return list(zip(begins, found, strict=False)) if len(begins) == len(found) else []
    cells = [cell.strip() for cell in cells_of(names, separator)][: len(header)]
    if not cells or cells[0]:
        return []
    return [(at, cell) for at, cell in enumerate(cells) if cell]


def _bare(name: str) -> str:
    """Strip a column's name of its unit."""
    return name.partition("(")[0].strip()


def _unit(name: str) -> str:
    words = lowered(words_of(name.partition("(")[2], camel=False))
    return words[0] if words else ""


def _length(name: str) -> str:
    if _bare(name).startswith("pixel"):
        return "px"
    unit = _unit(name)
    return unit if unit in LENGTHS else "px" if unit.startswith("px") else UNSTATED


def _numbers(layout: _Layout, lines: Sequence[str]) -> Numbers:
    places = [index for place in layout.places for index in place.axes if index is not None]
    used = [layout.when, *places]
    rows = [cells_of(line, layout.separator) for line in lines]
    decimal = decimal_of(row[at] for row in rows if len(row) >= layout.needed for at in used)
    return Numbers(layout.separator, "" if decimal == layout.separator else decimal)


def _add(tracks: Tracks, layout: _Layout, numbers: Numbers, line: str | None) -> None:
    """Add a row's positions; raise UnreadableError where it is malformed."""
    if line is None:
        raise UnreadableError("it is longer than any row", DAMAGED_REMEDY)
    cells = cells_of(line, layout.separator)
    if len(cells) < layout.needed:
        raise UnreadableError(f"it has {len(cells)} of {layout.needed} cells", DAMAGED_REMEDY)
    when = number_at(cells, layout.when, layout.header, numbers)
    if when != when:  # noqa: PLR0124 (NaN)
        raise UnreadableError("it has no time", DAMAGED_REMEDY)
    for place in layout.places:
        tracks.add(place.name, when, place_at(cells, place, layout.header, numbers))
