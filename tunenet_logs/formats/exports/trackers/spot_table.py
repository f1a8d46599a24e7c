"""Read tables with one row per spot detected in an image: ImageJ's results and trackers."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path

from tunenet_logs.episode import UNSTATED, Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.exports.build import export_episode
from tunenet_logs.formats.exports.trackers.spot_rows import (
    Place,
    Tracks,
    TrackUnits,
    best_separator,
    number_at,
    place_at,
)
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.failures import DAMAGED_REMEDY, Failures, UnreadableError
from tunenet_logs.formats.tables.layout import MAX_COLUMNS
from tunenet_logs.formats.tables.lines import cells_of
from tunenet_logs.formats.tables.meaning import LENGTHS, POWERS
from tunenet_logs.formats.tables.numbers import Numbers, decimal_of

# What columns are called, in small letters and without units.
_ROLES: Mapping[str, re.Pattern[str]] = {
    "cluster": re.compile(r"cid"),
    "track": re.compile(r"track[ _]?(?:n\W?|id|label)|tid|trajectory|particle"),
    "frame": re.compile(r"frame(?: ?n\W?)?"),
    "slice": re.compile(r"slice(?: ?n\W?)?"),
    "time": re.compile(r"position_t|t"),
    "x": re.compile(r"position_x|x"),
    "y": re.compile(r"position_y|y"),
    "z": re.compile(r"position_z|z"),
    "xm": re.compile(r"xm"),
    "ym": re.compile(r"ym"),
}

# Names of other columns of ImageJ's results: two of them tell such a table.
_MEASURED = frozenset(("area", "mean", "min", "max", "stddev", "xm", "ym", "label"))

_UNIT = re.compile(r"[\[(]([^\[\]()]*)[\])]")  # a unit in a name, or below it
# Times that POWERS lacks [s].
_MINUTES = {"min": 60.0, "mins": 60.0, "minute": 60.0, "h": 3600.0, "hour": 3600.0}

_LOOK_LINES = 200  # read ahead: units, how numbers are written, whether times are more than frames
_MAX_SHARED = 0.05  # of the rows: with more that share a frame, several things are one track


@dataclass(frozen=True)
class SpotLayout:
    """Columns of a spot table.

    Attributes:
        columns: index of each of `_ROLES`.
        what: kind of table, in words.
    """

    separator: str | None
    header: tuple[str, ...]
    columns: Mapping[str, int]
    what: str

    @property
    def frames(self) -> tuple[int, ...]:
        """Frame columns, the better one first."""
        return tuple(self.columns[role] for role in ("frame", "slice") if role in self.columns)

    @property
    def place(self) -> Place:
        """Position columns: the centroid of the outline before the centre of brightness."""
        x, y = ("x", "y") if {"x", "y"} <= self.columns.keys() else ("xm", "ym")
        return Place("", (self.columns[x], self.columns[y], self.columns.get("z")))


def spot_layout(line: str) -> SpotLayout | None:
    """Parse a header line; None where it is not a spot table's."""
    separator = best_separator(line)
    header = tuple(cell.strip() for cell in cells_of(line, separator)[:MAX_COLUMNS])
    bare = [_UNIT.sub("", name).strip().lower() for name in header]
    columns: dict[str, int] = {}
    for at, name in enumerate(bare):
        for role, pattern in _ROLES.items():
            if pattern.fullmatch(name):
                columns.setdefault(role, at)
    has_place = {"x", "y"} <= columns.keys() or {"xm", "ym"} <= columns.keys()
    is_spots = {"position_x", "position_y"}.issubset(bare)
    is_linked = "track" in columns and bool({"frame", "slice", "time"} & columns.keys())
    is_results = separator in ("\t", ",") and not header[0] and len(_MEASURED & set(bare)) > 1
    if not has_place or not (is_linked or is_results or is_spots):
        return None
    what = "TrackMate spots" if is_spots else "ImageJ tracks" if is_linked else "ImageJ results"
    if "particle" in bare:
        what = "table of tracked particles"
    return SpotLayout(separator, header, columns, what)


def read_spots(path: Path, text: Iterable[str | None], options: ReadOptions) -> Episode:
    """Read each track of a spot table as a signal.

    Args:
        path: of the file, for messages.
        text: its lines, or those of one of its sheets.
        options: the user's.

    Raises:
        LogError: no row can be read, many cannot, or nothing identifies the objects.
    """
    lines = iter(text)
    layout = spot_layout(next(lines, None) or "")
    if layout is None:
        raise LogError(f"{path}: has no columns of places and frames; export it again")
    numbered = enumerate(lines, 2)
    first = list(islice(numbered, _LOOK_LINES))
    table = _SpotTable(path, layout, [cells_of(line or "", layout.separator) for _, line in first])
    for number, line in chain(first, numbered):
        table.takes(number, line, options)
    return table.episode(options)


class _SpotTable:
    """Rows of a table, while they are read."""

    def __init__(self, path: Path, layout: SpotLayout, first: Sequence[Sequence[str]]) -> None:
        self._path = path
        self._layout = layout
        self._place = layout.place
        columns = [*layout.columns.values()]
        self._width = max(columns) + 1
        whole = [row for row in first if len(row) >= self._width]
        self._above = [row for row in whole[:4] if not _is_number(row[self._place.axes[0] or 0])]
        rows = whole[len(self._above) :]
        decimal = decimal_of(row[at] for row in rows for at in columns)
        separator = layout.separator
        self._numbers = Numbers(separator, "" if decimal == separator else decimal)
        self._frame = self._frame_column(rows)
        self._time, self._second = self._time_column(rows)
        self._tracks = Tracks(path)
        self._failures = Failures()
        self._rows = self._unlinked = self._skipped = 0

    def _frame_column(self, rows: Sequence[Sequence[str]]) -> int | None:
        """Return the column that counts frames: the first that changes."""
        frames = self._layout.frames
        changing = [at for at in frames if len({row[at].strip() for row in rows}) > 1]
        return next(iter((*changing, *frames)), None)

    def _time_column(self, rows: Sequence[Sequence[str]]) -> tuple[int | None, float | None]:
        """Return the time column and its unit [s]; None where it repeats the frames."""
        at = self._layout.columns.get("time")
        if at is None:
            return None, None
        unit = self._unit(at).lower()
        if unit.startswith("frame"):
            return at, None
        second = _MINUTES.get(unit, 10.0 ** POWERS.get(unit, 0))
        frame = self._frame
        if frame is None:
            return at, second
        try:
            is_same = all(
                abs(self._numbers.read(row[at]) - self._numbers.read(row[frame])) < 1e-6
                for row in rows
            )
        except ValueError:
            is_same = False
        return (None, None) if is_same else (at, second)

    def _unit(self, column: int) -> str:
        """Return the unit in a column's name or below it; "" where none is."""
        for text in (self._layout.header[column], *(row[column] for row in self._above)):
            if found := _UNIT.search(text):
                return found[1].strip()
        return ""

    def _length(self) -> str:
        unit = self._unit(self._place.axes[0] or 0).lower().replace("µ", "u").replace("μ", "u")
        if unit.startswith(("pixel", "px")):
            return "px"
        unit = "um" if unit.startswith("micron") else unit
        return unit if unit in LENGTHS else UNSTATED

    def takes(self, number: int, line: str | None, options: ReadOptions) -> None:
        """Read one line."""
        if line is not None and not line.strip(" \t,;"):
            return
        if self._skipped < len(self._above):
            self._skipped += 1
            return
        self._rows += 1
        try:
            if line is None:
                raise UnreadableError("it is longer than any row", DAMAGED_REMEDY)
            self._add(cells_of(line, self._layout.separator), options)
        except UnreadableError as error:
            self._failures.add(number, error)

    def _add(self, cells: Sequence[str], options: ReadOptions) -> None:
        if len(cells) < self._width:
            raise UnreadableError(f"it has {len(cells)} of {self._width} cells", DAMAGED_REMEDY)
        header = self._layout.header
        name = self._name(cells)
        if not name:
            self._unlinked += 1
            return
        is_by_frame = self._is_by_frame(options)
        column = self._frame if is_by_frame else self._time
        when = (
            float(self._rows) if column is None else number_at(cells, column, header, self._numbers)
        )
        place = place_at(cells, self._place, header, self._numbers)
        if when != when:  # noqa: PLR0124 (NaN)
            raise UnreadableError("it has no frame", DAMAGED_REMEDY)
        self._tracks.add(name, when, place)

    def _is_by_frame(self, options: ReadOptions) -> bool:
        return self._time is None or bool(options.rate_hz and self._frame is not None)

    def _name(self, cells: Sequence[str]) -> str:
        """Return the name of a row's track; "" where it has none."""
        if "track" not in self._layout.columns:
            return "track"
        text = cells[self._layout.columns["track"]].strip()[:40]
        if text.lower() in ("", "none", "nan", "-1"):
            return ""
        text = text.removesuffix(".0").removesuffix(".000")
        cluster = self._layout.columns.get("cluster")
        prefix = f"{cells[cluster].strip()[:20]}." if cluster is not None else ""
        return f"track{prefix}{text}" if text[0].isdigit() else text

    def episode(self, options: ReadOptions) -> Episode:
        """Build an episode of the rows."""
        what, path = self._layout.what, self._path
        if not len(self._tracks):
            if self._unlinked:
                raise LogError(
                    f"{path}: {what}: none of the {self._unlinked} places belongs to a track; "
                    "link them to tracks first"
                )
            raise LogError(f"{path}: {what}: {self._failures.nothing(self._rows)}")
        if why := self._failures.refusal(self._rows):
            raise LogError(f"{path}: {what}: {why}")
        second = None if self._is_by_frame(options) else self._second
        signals, unused, notes = self._tracks.signals(TrackUnits(self._length(), second), options)
        if "track" not in self._layout.columns:
            self._check_one_thing(sum(len(one.stamps_ns) for one in signals))
            if self._frame is None and self._time is None:
                notes.append("no column counts frames, so each row was taken for one")
        if self._unlinked:
            unused["places of no track"] = f"{self._unlinked} places were not linked"
        lost = [self._failures.lost(self._rows)] if self._failures else []
        return export_episode(path, what, signals, unused=unused, warnings=notes, losses=lost)

    def _check_one_thing(self, samples: int) -> None:
        """Refuse, with a LogError, a table in which several objects share frames."""
        shared = self._rows - len(self._failures) - samples
        if shared > _MAX_SHARED * self._rows:
            raise LogError(
                f"{self._path}: {self._layout.what}: {shared} of {self._rows} rows share a frame "
                "with another, and nothing tells which thing is which; measure one thing alone, "
                "or link them with TrackMate or MTrack2"
            )


def _is_number(text: str) -> bool:
    try:
        Numbers(None).read(text)
    except ValueError:
        return False
    return bool(text.strip())
