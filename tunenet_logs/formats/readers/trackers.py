"""Read the tables of programs that track objects in video: DeepLabCut, ImageJ's plug-ins, Tracker.

ImageJ's are MTrack2, tables with one row per spot (Manual Tracking, MTrackJ, TrackMate, results),
and TrackMate's XML. Positions are usually in pixels, y down, by frames.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice, pairwise
from math import dist, inf, isfinite
from pathlib import Path
from xml.parsers import expat

from tunenet_logs.episode import UNSTATED, Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.files import open_regular
from tunenet_logs.formats.columns.cells import (
    DAMAGED_REMEDY,
    Failures,
    Numbers,
    UnreadableError,
    cells_of,
    decimal_of,
    lines_of,
)
from tunenet_logs.formats.columns.names import LENGTHS, POWERS, lowered, words_of
from tunenet_logs.formats.columns.table import (
    MAX_COLUMNS,
    MAX_TEXT_BYTES,
    MAX_TRACKS,
    Place,
    Tracks,
    TrackUnits,
    best_separator,
    export_episode,
    number_at,
    place_at,
    unique_names,
)
from tunenet_logs.formats.kinds import Start, start_of
from tunenet_logs.formats.options import ReadOptions

# ---- Parse XML element by element: without entities, without a tree, and not too deep.

_CHUNK_BYTES = 1024**2
_MAX_DEPTH = 50

# Takes the name and the attributes of an element that begins; a ValueError refuses it.
Begin = Callable[[str, dict[str, str]], None]


def read_elements(path: Path, what: str, begin: Begin) -> None:
    """Call `begin` with each element of a file as it begins.

    Args:
        path: of the file.
        what: it is, for messages.
        begin: takes them.

    Raises:
        LogError: it is no XML, declares entities, is nested too deep, or `begin` refuses it.
        OSError: it cannot be read.
    """
    parser = expat.ParserCreate()
    depth = 0

    def enter(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _MAX_DEPTH:
            raise ValueError(f"its elements are nested over {_MAX_DEPTH} deep")
        begin(name, attributes)

    def leave(_: str) -> None:
        nonlocal depth
        depth -= 1

    def refuse(*_: object) -> None:
        raise ValueError("it declares types or entities, which no export does")

    parser.StartElementHandler = enter
    parser.EndElementHandler = leave
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        with open_regular(path) as file:
            while data := file.read(_CHUNK_BYTES):
                parser.Parse(data, False)
        parser.Parse(b"", True)
    except (expat.ExpatError, ValueError, LookupError) as error:  # an encoding that is none
        where = f"line {parser.CurrentLineNumber}: "
        text = str(error) if isinstance(error, expat.ExpatError) else f"{where}{error}"
        raise LogError(f"{path}: {what}: {text}; export it again") from error


# ---- DeepLabCut (.csv): position and likelihood of each body part in each frame.
# Rows of a header say `scorer`, maybe `individuals`, `bodyparts` and `coords`; then a row a frame.
# A part has `x`, `y` [px, y down] and `likelihood`; one that was triangulated has `x`, `y`, `z`.
# https://deeplabcut.github.io/DeepLabCut/docs/standardDeepLabCut_UserGuide.html

_WHAT = "DeepLabCut table"
_MAX_HEADS = 4  # rows of the header
_MIN_LIKELIHOOD = 0.6  # below it DeepLabCut itself takes a part as not seen (`pcutoff`)


def is_deeplabcut(start: Start) -> bool:
    """Return whether a file is a DeepLabCut table, by the rows of its header."""
    firsts = [line.split(",", 1)[0] for line in start.lines[:_MAX_HEADS]]
    return firsts[:1] == ["scorer"] and "bodyparts" in firsts and "coords" in firsts


def read_deeplabcut(path: Path, options: ReadOptions) -> Episode:
    """Read each part of each body as a signal, without frames of low likelihood.

    Raises:
        LogError: it names no part, or its rows cannot be read.
        OSError: it cannot be read.
    """
    lines = enumerate(lines_of(path), 1)
    heads: dict[str, list[str]] = {}
    for _, line in islice(lines, _MAX_HEADS):
        name, *cells = [cell.strip() for cell in cells_of(line or "", ",")[:MAX_COLUMNS]]
        heads[name] = cells
        if name == "coords":
            break
    parts = _parts(heads)
    if not parts:
        raise LogError(f"{path}: is a {_WHAT} that names no part's x and y", EXPORT_AGAIN)
    rows = _FrameRows(path, parts, ("frame", *heads["coords"]))
    for number, line in lines:
        if line is None or line.strip(" ,"):
            rows.add(number, line)
    return rows.episode(options)


class _FrameRows:
    """Rows of a table, while they are read."""

    def __init__(
        self, path: Path, parts: Sequence[tuple[Place, int | None]], header: Sequence[str]
    ) -> None:
        self._path, self._parts, self._header = path, parts, header
        self._tracks, self._failures, self._numbers = Tracks(path), Failures(), Numbers(",")
        self._count = self._unsure = 0

    def add(self, number: int, line: str | None) -> None:
        """Add the row of a line, or count it as unreadable."""
        self._count += 1
        try:
            self._add(cells_of(line or "", ","))
        except UnreadableError as error:
            self._failures.add(number, error)

    def _add(self, cells: Sequence[str]) -> None:
        header, numbers = self._header, self._numbers
        if len(cells) < len(header):
            raise UnreadableError(f"it has {len(cells)} of {len(header)} cells", DAMAGED_REMEDY)
        frame = number_at(cells, 0, header, numbers)
        for place, sure in self._parts:
            seen = 1.0 if sure is None else number_at(cells, sure, header, numbers)
            if seen < _MIN_LIKELIHOOD:
                self._unsure += 1
            else:
                self._tracks.add(place.name, frame, place_at(cells, place, header, numbers))

    def episode(self, options: ReadOptions) -> Episode:
        """Build an episode of the rows."""
        path, count, failures = self._path, self._count, self._failures
        if not len(self._tracks):
            if failures:
                raise LogError(f"{path}: {_WHAT}: {failures.nothing(count)}")
            why = f"nothing is seen with a likelihood of {_MIN_LIKELIHOOD}"
            raise LogError(f"{path}: {_WHAT}: {why}", "label more frames, train and analyse again")
        if why := failures.refusal(count):
            raise LogError(f"{path}: {_WHAT}: {why}")
        is_flat = all(place.axes[2] is None for place, _ in self._parts)
        units = TrackUnits("px" if is_flat else UNSTATED, None)
        signals, unused, notes = self._tracks.signals(units, options)
        if self._unsure:
            notes.append(
                f"{self._unsure} places with a likelihood below {_MIN_LIKELIHOOD} were left out"
            )
        lost = [failures.lost(count)] if failures else []
        return export_episode(path, _WHAT, signals, unused=unused, warnings=notes, losses=lost)


def _parts(heads: dict[str, list[str]]) -> list[tuple[Place, int | None]]:
    """Return each part's columns, and that of its likelihood."""
    found: dict[str, dict[str, int]] = {}
    bodies = heads.get("individuals", [])
    for at, (part, axis) in enumerate(
        zip(heads.get("bodyparts", ()), heads.get("coords", ()), strict=False)
    ):
        body = bodies[at] if at < len(bodies) and bodies[at] != "single" else ""
        name = f"{body}.{part}" if body else part
        found.setdefault(name, {}).setdefault(axis, at + 1)
    there = {name: at for name, at in found.items() if {"x", "y"} <= at.keys()}
    return [
        (Place(name, (at["x"], at["y"], at.get("z"))), at.get("likelihood"))
        for name, at in zip(unique_names(there), there.values(), strict=True)
    ]


# ---- `Follower`: assign the points of blank-separated MTrack2 rows to tracks.
# An unseen track leaves only blanks, so the row does not say which is missing. But MTrack2 numbers
# tracks as they begin: a row holds some of those that were seen before, in their order, and behind
# them those that begin; each is near its last place or its extrapolation.

Point = tuple[float, float]

_FARTHEST = 60.0  # of a track from where it was expected; a new track costs as much
_MAX_WORK = 5_000_000  # of comparisons, in the whole file
_MAX_POINTS = 80  # in a row: a block holds 75 tracks


@dataclass(frozen=True)
class _Seen:
    """Last frame, place and velocity [per frame] of a track."""

    frame: float
    place: Point
    speed: Point

    def off(self, frame: float, point: Point) -> float:
        """Return a point's distance to the last or extrapolated place; infinite if too far."""
        passed = frame - self.frame
        going = (
            self.place[0] + passed * self.speed[0],
            self.place[1] + passed * self.speed[1],
        )
        off = min(dist(point, self.place), dist(point, going))
        return off if off <= _FARTHEST else inf


class Follower:
    """Tracker of one block's tracks, row by row."""

    def __init__(self, first: int) -> None:
        self._first = first
        self._seen: list[_Seen] = []
        self._work = 0

    def named(self, frame: float, points: Sequence[Point]) -> list[int]:
        """Return the track number of each point, by dynamic programming over the track order.

        Raises:
            ValueError: there are more points than a block's tracks.
        """
        self._work += len(self._seen) * len(points)
        if len(points) > _MAX_POINTS or self._work > _MAX_WORK:
            raise ValueError("it holds more tracks than a block does")
        matched = _matched([[one.off(frame, point) for point in points] for one in self._seen])
        matched += [None] * (len(points) - len(matched))
        numbers: list[int] = []
        for point, at in zip(points, matched, strict=True):
            if at is None:
                numbers.append(self._first + len(self._seen))
                self._seen.append(_Seen(frame, point, (0.0, 0.0)))
            else:
                old = self._seen[at]
                passed = max(frame - old.frame, 1.0)
                speed = ((point[0] - old.place[0]) / passed, (point[1] - old.place[1]) / passed)
                self._seen[at] = _Seen(frame, point, speed)
                numbers.append(self._first + at)
        return numbers


def points_of(cells: Sequence[str]) -> tuple[list[tuple[str, str]], list[bool]]:
    """Pair the numbers behind a row's frame, and return which pairs carry a flag.

    Raises:
        ValueError: the numbers are not in pairs.
    """
    values = [at for at, cell in enumerate(cells) if cell != "*"]
    if len(values) % 2 or any(cells[at - 1 : at] == ["*"] for at in values[1::2]):
        raise ValueError("its numbers are no pairs")
    pairs = [(cells[x], cells[y]) for x, y in zip(values[::2], values[1::2], strict=True)]
    return pairs, [cells[y + 1 : y + 2] == ["*"] for y in values[1::2]]


def _matched(off: Sequence[Sequence[float]]) -> list[int | None]:
    """Assign points to tracks in order, by dynamic programming; None where a point begins a track.

    Minimizes the sum of the distances `off`, with a fixed cost for each new track.
    """
    count = len(off[0]) if off else 0
    # costs[i][j]: of the first j points among the first i tracks
    costs = [[0.0] + [inf] * count]
    for row in off:
        pairs = zip(row, pairwise(costs[-1]), strict=True)
        costs.append([0.0] + [min(one, before + apart) for apart, (before, one) in pairs])
    whole = [cost + _FARTHEST * (count - j) for j, cost in enumerate(costs[-1])]
    j = min(range(count + 1), key=lambda at: (whole[at], -at))
    found: list[int | None] = [None] * count
    for i in range(len(off), 0, -1):
        if j and costs[i][j] < costs[i - 1][j]:
            j -= 1
            found[j] = i - 1
    return found


# ---- MTrack2: one row per frame, three columns per track, in blocks of tracks.

# How a file begins, and what stands between its cells.
_HEADER = re.compile(r"Frame([\t,; ])X1\1Y1\1Flag1(?:\1|$)")

# Which tracks the next rows are of.
_BLOCK = re.compile(r"Tracks[\s,;](\d{1,6})[\s,;]to[\s,;]\d{1,6}\b")

# What stands above one row for each track, below all of the frames.
_SUMMARY = re.compile(r"Track\s*[\s,;]Length")


def is_mtrack2(line: str) -> bool:
    """Return whether a file with this first line is an MTrack2 table."""
    return _HEADER.match(line) is not None


def read_mtrack2(path: Path, text: Iterable[str | None], options: ReadOptions) -> Episode:
    """Read each track as a signal in an unstated unit, its stamps counting frames.

    Args:
        path: of the file, for messages.
        text: its lines, or those of one of its sheets.
        options: the user's.

    Raises:
        LogError: no row can be read, or many cannot.
    """
    lines = iter(text)
    header = next(lines, None)
    found = _HEADER.match(header or "")
    if found is None:
        raise LogError(f"{path}: is no table of MTrack2; export it again")
    table = _Blocks(path, found[1])
    for number, line in enumerate(lines, 2):
        if not table.accepted_options(number, line):
            break
    return table.episode(options)


class _Blocks:
    """Rows of a table, while they are read."""

    def __init__(self, path: Path, separator: str) -> None:
        self._path = path
        self._separator = separator
        self._numbers = Numbers(separator, "" if separator == "," else ".")
        self._tracks = Tracks(path)
        self._failures = Failures()
        self._first_track = 1
        self._rows = 0
        self._flags: Counter[str] = Counter()
        self._follower = Follower(1)

    def accepted_options(self, number: int, line: str | None) -> bool:
        """Read a line; return whether rows may follow it."""
        if line is not None and (block := _BLOCK.match(line)):
            self._first_track = int(block[1])
            self._follower = Follower(self._first_track)
            return True
        if line is not None and _SUMMARY.match(line):
            return False
        if line is not None and (not line.strip(" \t,;") or _HEADER.match(line)):
            return True
        self._rows += 1
        try:
            if line is None:
                raise UnreadableError("it is longer than any row", DAMAGED_REMEDY)
            self._add(line)
        except UnreadableError as error:
            self._failures.add(number, error)
        return True

    def _add(self, line: str) -> None:
        if self._separator == " ":
            self._add_blanks(line)
            return
        cells = line.split(self._separator)
        try:
            frame, *values = [
                float("nan") if at and at % 3 == 0 else self._numbers.read(cell)
                for at, cell in enumerate(cells)
            ]
        except ValueError:
            raise UnreadableError(f"{line[:60]!r} is no row", DAMAGED_REMEDY) from None
        if frame != frame:  # noqa: PLR0124 (NaN)
            raise UnreadableError(f"{line[:60]!r} is no row", DAMAGED_REMEDY)
        for at in range(0, len(values) - 1, 3):
            x, y = values[at : at + 2]
            if x == x and y == y:  # noqa: PLR0124 (NaN)
                name = f"track{self._first_track + at // 3}"
                self._tracks.add(name, frame, (x, y, 0.0))
                self._flags[name] += len(cells) > at + 3 and cells[at + 3].strip() == "*"

    def _add_blanks(self, line: str) -> None:
        frame, *cells = line.split()
        try:
            when = self._numbers.read(frame)
            pairs, flags = points_of(cells)
            points = [(self._numbers.read(x), self._numbers.read(y)) for x, y in pairs]
            if not all(map(isfinite, (when, *chain(*points)))):
                raise ValueError("a number is missing")
            numbers = self._follower.named(when, points)
        except ValueError:
            raise UnreadableError(f"{line[:60]!r} is no row", DAMAGED_REMEDY) from None
        for number, (x, y), flag in zip(numbers, points, flags, strict=True):
            self._tracks.add(f"track{number}", when, (x, y, 0.0))
            self._flags[f"track{number}"] += flag

    def episode(self, options: ReadOptions) -> Episode:
        """Build an episode of the rows."""
        if not len(self._tracks):
            raise LogError(f"{self._path}: table of MTrack2: {self._failures.nothing(self._rows)}")
        if why := self._failures.refusal(self._rows):
            raise LogError(f"{self._path}: table of MTrack2: {why}")
        signals, unused, notes = self._tracks.signals(TrackUnits(UNSTATED, None), options)
        notes += [
            f"{name}: MTrack2 was not sure of {count} of its places"
            for name, count in self._flags.items()
            if count and name not in unused
        ]
        lost = [self._failures.lost(self._rows)] if self._failures else []
        return export_episode(
            self._path,
            "MTrack2 table of ImageJ",
            signals,
            unused=unused,
            warnings=notes,
            losses=lost,
        )


# ---- Tables with one row per spot.

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

# Other columns of ImageJ's results: two of them identify such a table.
_MEASURED = frozenset(("area", "mean", "min", "max", "stddev", "xm", "ym", "label"))

_UNIT = re.compile(r"[\[(]([^\[\]()]*)[\])]")  # a unit in a name, or below it
# Times that POWERS lacks [s].
_MINUTES = {"min": 60.0, "mins": 60.0, "minute": 60.0, "h": 3600.0, "hour": 3600.0}

_LOOK_LINES = 200  # read ahead for units, number format, and whether times only count frames
_MAX_SHARED = 0.05  # of the rows: with more that share a frame, several objects are one track


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
        table.accepted_options(number, line, options)
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

    def accepted_options(self, number: int, line: str | None, options: ReadOptions) -> None:
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


# ---- TrackMate's XML: its exports, and whole sessions.

_MAX_COUNT = 1_000_000  # of spots and of links between them, which come after all spots
_NO_RATE_S = 1.0  # between frames: ImageJ states it where nobody set the rate
Spot = tuple[float, float, float, float]  # a frame, and x, y, z there


def is_trackmate_xml(data: bytes) -> bool:
    """Return whether a file's first bytes are TrackMate XML of either kind."""
    start = data[:4096]
    return b"<Tracks " in start or b"<TrackMate" in start


def read_trackmate_xml(path: Path, options: ReadOptions) -> Episode:
    """Read each track as a signal.

    Raises:
        LogError: it is no such XML, or holds no track.
        OSError: it cannot be read.
    """
    reading = _XmlReading()
    read_elements(path, "tracks of TrackMate", reading.begin)
    tracks, unused = reading.tracks(path)
    if not len(tracks):
        raise LogError(f"{path}: tracks of TrackMate: it holds none; track first, then export")
    units, doubts = reading.units()
    signals, more, notes = tracks.signals(units, options)
    warnings = [*doubts, *notes]
    return export_episode(
        path, "TrackMate tracks", signals, unused={**unused, **more}, warnings=warnings
    )


class _XmlReading:
    """Collector of spots, tracks and links, element by element."""

    def __init__(self) -> None:
        self._said: dict[str, str] = {}
        self._places: dict[str, list[Spot]] = {}
        self._spots: dict[str, Spot] = {}
        self._links: dict[str, dict[str, None]] = {}
        self._track = ""
        self._kept: set[str] = set()
        self._count = 0

    def begin(self, name: str, attributes: dict[str, str]) -> None:
        """Collect one element; raise ValueError if it is invalid or one too many."""
        if name in ("Tracks", "Model", "ImageData"):
            self._said.update((key.lower(), text.strip()) for key, text in attributes.items())
        elif name == "particle":
            self._track = f"track{len(self._places) + 1}"
            self._places[self._track] = []
        elif name == "Track":
            self._track = f"track{attributes.get('TRACK_ID', str(len(self._links)))[:40]}"
            self._links[self._track] = {}
        elif name == "detection":
            self._places.setdefault(self._track or "track1", []).append(_spot(attributes))
            self._counted()
        elif name == "Spot" and "ID" in attributes:
            small = {key.removeprefix("POSITION_"): text for key, text in attributes.items()}
            self._spots[attributes["ID"]] = _spot({**small, "T": attributes.get("FRAME", "")})
            self._counted()
        elif name == "Edge" and self._track in self._links:
            for key in ("SPOT_SOURCE_ID", "SPOT_TARGET_ID"):
                self._links[self._track][attributes.get(key, "")] = None
            self._counted()
        elif name == "TrackID":
            self._kept.add(f"track{attributes.get('TRACK_ID', '')[:40]}")

    def _counted(self) -> None:
        self._count += 1
        if self._count > _MAX_COUNT:
            raise ValueError(f"it holds over {_MAX_COUNT} spots and links; filter them first")

    def tracks(self, path: Path) -> tuple[Tracks, dict[str, str]]:
        """Return the tracks, and why others are not used."""
        unused: dict[str, str] = {}
        places = dict(self._places)
        for name, links in self._links.items():
            spots = [self._spots[one] for one in links if one in self._spots]
            if self._kept and name not in self._kept:
                unused[name] = "it was filtered out in TrackMate"
            elif len({spot[0] for spot in spots}) < len(spots):
                unused[name] = "it splits or merges: several things are in one frame"
            else:
                places[name] = sorted(spots)
        if rest := len(self._spots) - len({one for of in self._links.values() for one in of}):
            unused["places of no track"] = f"{rest} places were not linked"
        tracks = Tracks(path)
        for name, spots in places.items():
            for frame, x, y, z in spots:
                tracks.add(name, frame, (x, y, z))
        return tracks, dict(list(unused.items())[-MAX_TRACKS:])

    def units(self) -> tuple[TrackUnits, list[str]]:
        """Return the units that the file states, and doubts about them."""
        length = self._first("spaceunits", "spatialunits", "spaceunit").lower()
        length = length.replace("µ", "u").replace("μ", "u").replace("micron", "um")
        length = "px" if length.startswith(("pixel", "px")) else length
        length = length if length in LENGTHS or length == "px" else UNSTATED
        try:
            power = POWERS[self._first("timeunits", "timeunit").lower()]
            interval_s = float(self._first("frameinterval", "timeinterval")) * 10.0**power
        except (KeyError, ValueError):
            interval_s = 0.0
        is_told = 0 < interval_s < float("inf") and interval_s != _NO_RATE_S
        doubts = ["it says a frame a second, as ImageJ does where nobody told it; not used"]
        return (
            TrackUnits(length, None, 1 / interval_s if is_told else None),
            doubts if interval_s == _NO_RATE_S else [],
        )

    def _first(self, *keys: str) -> str:
        return next((self._said[key] for key in keys if key in self._said), "")


def _spot(attributes: dict[str, str]) -> Spot:
    """Parse a spot; raise ValueError where a number is missing."""
    small = {key.lower(): text for key, text in attributes.items()}
    try:
        return (
            float(small["t"]),
            float(small["x"]),
            float(small["y"]),
            float(small.get("z", "0")),
        )
    except (KeyError, ValueError):
        raise ValueError("a place has no t, x or y that is a number") from None


# ---- Choose the reader of an ImageJ file.


def is_imagej(start: Start) -> bool:
    """Return whether a file is an ImageJ table or TrackMate XML."""
    if is_trackmate_xml(start.data):
        return True
    return bool(start.lines) and (
        is_mtrack2(start.lines[0]) or spot_layout(start.lines[0]) is not None
    )


def read_imagej(path: Path, options: ReadOptions) -> Episode:
    """Read each track as a signal: usually in pixels, y down, by frames.

    Raises:
        LogError: it holds no track, or is damaged.
        OSError: it cannot be read.
    """
    if path.stat().st_size > MAX_TEXT_BYTES:
        raise LogError(f"{path}: is an ImageJ table of over {MAX_TEXT_BYTES >> 20} MiB; split it")
    start = start_of(path)
    if is_trackmate_xml(start.data):
        return read_trackmate_xml(path, options)
    first = next(iter(start.lines), "")
    read = read_mtrack2 if is_mtrack2(first) else read_spots
    return read(path, lines_of(path), options)


# ---- Text exports of the video analysis program Tracker (physlets.org/tracker).

_FIRST = ("t", "frame", "step")  # names of the first column
_AXES = (("x", "pixelx"), ("y", "pixely"), ("z",))  # names of coordinates, the better ones first
_FORMAT_LOOK_LINES = 100  # read ahead, which tell the number format
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
    if path.stat().st_size > MAX_TEXT_BYTES:
        raise LogError(f"{path}: is a Tracker export of over {MAX_TEXT_BYTES >> 20} MiB; split it")
    return read_masses(path, lines_of(path), options)


def read_masses(path: Path, lines: Iterable[str | None], options: ReadOptions) -> Episode:
    """Read the lines of a Tracker export, be they of a file or of a sheet.

    Raises:
        LogError: see `read_tracker`.
    """
    numbered = enumerate(lines, 1)
    layout = _read_header(path, numbered)
    failures, tracks, rows = Failures(), Tracks(path), 0
    first = list(islice(numbered, _FORMAT_LOOK_LINES))
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
