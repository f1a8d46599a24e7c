"""Read the tables of programs that track objects in video: DeepLabCut, ImageJ's plug-ins, Tracker.

ImageJ's are MTrack2, tables with one row per spot (Manual Tracking, MTrackJ, TrackMate, results),
and TrackMate's XML. Positions are usually in pixels, y down, by frames.
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice, pairwise
from math import dist, inf, isfinite
from pathlib import Path
from typing import Any, NamedTuple
from xml.parsers import expat

import numpy as np

from tunenet_logs.episode import UNSTATED, Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.files import open_regular
from tunenet_logs.formats.columns.cells import (
    DAMAGED_REMEDY,
    MAX_COLUMNS,
    Clock,
    Failures,
    Numbers,
    UnreadableError,
    best_separator,
    cells_of,
    lines_of,
)
from tunenet_logs.formats.columns.names import LENGTHS, POWERS, lowered, words_of
from tunenet_logs.formats.columns.plan import (
    ROWS,
    ColumnPlan,
    Group,
    Used,
)
from tunenet_logs.formats.columns.signals import (
    MAX_TRACKS,
    ColumnRows,
    Times,
    episode_of_rows,
    unique_names,
)
from tunenet_logs.formats.columns.table import (
    MAX_ROWS,
)
from tunenet_logs.formats.kinds import Start, start_of
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.formats.readers.csv import TextRows, read_csv

_MAX_TEXT_BYTES = 256 * 1024**2  # an hour of images with a hundred objects in each is a tenth
_MAX_NAMES = 100_000  # of tracks
_XYZ = ("x", "y", "z")


def _place(
    name: str, axes: Sequence[int | None], unit: str, clock: Clock, sure: int | None = None
) -> Group:
    """Make the group of an object's columns, None where an axis has none."""
    scale, unit = (LENGTHS[unit], "m") if unit in LENGTHS else (1.0, unit)
    used = tuple(Used(at, axis, scale) for axis, at in enumerate(axes) if at is not None)
    least = None if sure is None else (sure, _MIN_LIKELIHOOD)
    return Group(name, _XYZ, unit, used, clock, is_track=True, sure=least)


def _unit_of(text: str) -> str:
    """Return a unit of length, "px" or `UNSTATED`, of what a program calls it."""
    text = text.lower().replace("µ", "u").replace("μ", "u")
    text = "um" if text.startswith("micron") else text
    text = "px" if text.startswith(("pixel", "px")) else text
    return text if text in LENGTHS or text == "px" else UNSTATED


class Tracks:
    """Places of objects, one by one, that the engine makes an episode of."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._names: dict[str, int] = {}
        self._things = array("q")
        self._frames = array("d")
        self._places = array("d")

    def __len__(self) -> int:
        return len(self._names)

    def add(self, name: str, frame: float, place: tuple[float, float, float]) -> None:
        """Add the place of an object in a frame; LogError if there are too many."""
        if len(self._things) == MAX_ROWS:
            raise LogError(f"{self._path}: holds more than {MAX_ROWS} places; export fewer tracks")
        if name not in self._names and len(self._names) == _MAX_NAMES:
            raise LogError(f"{self._path}: holds more than {_MAX_NAMES} tracks; filter them first")
        self._things.append(self._names.setdefault(name, len(self._names)))
        self._frames.append(frame)
        self._places.extend(place)

    def episode(self, what: str, unit: str, options: ReadOptions, **more: Any) -> Episode:
        """Build an episode of all places; `more` as in `episode_of_rows`."""
        clock = Clock("frame", (0,), 0, counts_frames=True)
        group = _place("track", (1, 2, 3), unit, clock)
        plan = ColumnPlan(("frame", *_XYZ), (group,), is_stacked=True)
        frames = np.frombuffer(self._frames)
        known = np.abs(frames) < 2**32  # NaN is not
        stamps = np.round(np.where(known, frames, 0) * 1e9).astype(np.int64)
        places = np.frombuffer(self._places).reshape(-1, 3)
        values = {axis + 1: np.ascontiguousarray(places[:, axis]) for axis in range(3)}
        things = np.frombuffer(self._things, np.int64)
        rows = ColumnRows(values, {clock: Times(stamps, known)}, things, list(self._names))
        return episode_of_rows(self._path, what, plan, rows, options, **more)


# ---- Parse XML element by element: without entities, without a tree, and not too deep.


def read_elements(path: Path, what: str, begin: Callable[[str, dict[str, str]], None]) -> None:
    """Call `begin` with the name and the attributes of each element; a ValueError refuses it."""
    parser = expat.ParserCreate()
    depth = 0

    def enter(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > 50:
            raise ValueError("its elements are nested over 50 deep")
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
            while data := file.read(1024**2):
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

_MAX_HEADS = 4  # rows of the header
_MIN_LIKELIHOOD = 0.6  # below it DeepLabCut itself takes a part as not seen (`pcutoff`)


def is_deeplabcut(start: Start) -> bool:
    """Return whether a file is a DeepLabCut table, by the rows of its header."""
    firsts = [line.split(",", 1)[0] for line in start.lines[:_MAX_HEADS]]
    return firsts[:1] == ["scorer"] and "bodyparts" in firsts and "coords" in firsts


def read_deeplabcut(path: Path, options: ReadOptions) -> Episode:
    """Read each part of each body as a signal, without frames of low likelihood."""
    lines = enumerate(lines_of(path), 1)
    heads: dict[str, list[str]] = {}
    for _, line in islice(lines, _MAX_HEADS):
        name, *cells = [cell.strip() for cell in cells_of(line or "", ",")[:MAX_COLUMNS]]
        heads[name] = cells
        if name == "coords":
            break
    found: dict[str, dict[str, int]] = {}
    bodies = heads.get("individuals", [])
    parts = zip(heads.get("bodyparts", ()), heads.get("coords", ()), strict=False)
    for at, (part, axis) in enumerate(parts):
        body = bodies[at] if at < len(bodies) and bodies[at] != "single" else ""
        found.setdefault(f"{body}.{part}" if body else part, {}).setdefault(axis, at + 1)
    there = {name: at for name, at in found.items() if {"x", "y"} <= at.keys()}
    if not there:
        raise LogError(f"{path}: is a DeepLabCut table that names no part's x and y", EXPORT_AGAIN)
    unit = "px" if all("z" not in at for at in there.values()) else UNSTATED
    clock = Clock("frame", (0,), 0, counts_frames=True)
    groups = tuple(
        _place(name, [at.get(axis) for axis in _XYZ], unit, clock, at.get("likelihood"))
        for name, at in zip(unique_names(there), there.values(), strict=True)
    )
    names = ("frame", *heads["coords"])
    rows = TextRows(path, ColumnPlan(names, groups), ",", len(names))
    rows.read(lines)
    return rows.episode("DeepLabCut table", options)


# ---- `Follower`: assign the points of blank-separated MTrack2 rows to tracks.
# An unseen track leaves only blanks, so the row does not say which is missing. But MTrack2 numbers
# tracks as they begin: a row holds some of those that were seen before, in their order, and behind
# them those that begin; each is near its last place or its extrapolation.

Point = tuple[float, float]
_FARTHEST = 60.0  # of a track from where it was expected; a new track costs as much


class _Seen(NamedTuple):
    """Last frame, place and velocity [per frame] of a track."""

    frame: float
    place: Point
    speed: Point

    def off(self, frame: float, point: Point) -> float:
        """Return a point's distance to the last or extrapolated place; infinite if too far."""
        passed = frame - self.frame
        going = (self.place[0] + passed * self.speed[0], self.place[1] + passed * self.speed[1])
        off = min(dist(point, self.place), dist(point, going))
        return off if off <= _FARTHEST else inf


class Follower:
    """Tracker of one block's tracks, row by row."""

    def __init__(self, first: int) -> None:
        self.first = first
        self._seen: list[_Seen] = []
        self._work = 0

    def named(self, frame: float, points: Sequence[Point]) -> list[int]:
        """Return the track number of each point, by dynamic programming over the track order."""
        self._work += len(self._seen) * len(points)
        # A block holds 75 tracks; the work is of comparisons in the whole file.
        if len(points) > 80 or self._work > 5_000_000:
            raise ValueError("it holds more tracks than a block does")
        off = [[one.off(frame, point) for point in points] for one in self._seen]
        count = len(off[0]) if off else 0
        # costs[i][j]: of the first j points among the first i tracks
        costs = [[0.0] + [inf] * count]
        for row in off:
            pairs = zip(row, pairwise(costs[-1]), strict=True)
            costs.append([0.0] + [min(one, before + apart) for apart, (before, one) in pairs])
        whole = [cost + _FARTHEST * (count - j) for j, cost in enumerate(costs[-1])]
        j = min(range(count + 1), key=lambda at: (whole[at], -at))
        found: list[int | None] = [None] * len(points)  # None where a point begins a track
        for i in range(len(off), 0, -1):
            if j and costs[i][j] < costs[i - 1][j]:
                j -= 1
                found[j] = i - 1
        numbers: list[int] = []
        for point, at in zip(points, found, strict=True):
            if at is None:
                numbers.append(self.first + len(self._seen))
                self._seen.append(_Seen(frame, point, (0.0, 0.0)))
            else:
                old = self._seen[at]
                passed = max(frame - old.frame, 1.0)
                speed = ((point[0] - old.place[0]) / passed, (point[1] - old.place[1]) / passed)
                self._seen[at] = _Seen(frame, point, speed)
                numbers.append(self.first + at)
        return numbers


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
    """Read each track as a signal in an unstated unit, its stamps counting frames."""
    lines = iter(text)
    found = _HEADER.match(next(lines, None) or "")
    if found is None:
        raise LogError(f"{path}: is no table of MTrack2; export it again")
    separator = found[1]
    numbers = Numbers(separator, "" if separator == "," else ".")
    tracks, failures, flags = Tracks(path), Failures(), Counter[str]()
    follower, count = Follower(1), 0
    for number, line in enumerate(lines, 2):
        if line is None:
            count += 1
            failures.add(number, UnreadableError("it is longer than any row", DAMAGED_REMEDY))
            continue
        if block := _BLOCK.match(line):
            follower = Follower(int(block[1]))
            continue
        if _SUMMARY.match(line):
            break
        if not line.strip(" \t,;") or _HEADER.match(line):
            continue
        count += 1
        try:
            read = _points_by_blanks if separator == " " else _points_by_cells
            frame, points = read(line, separator, numbers, follower)
        except ValueError:
            why = f"{line[:60]!r} is no row"
            failures.add(number, UnreadableError(why, DAMAGED_REMEDY))
            continue
        for track, (x, y), is_doubtful in points:
            tracks.add(f"track{track}", frame, (x, y, 0.0))
            flags[f"track{track}"] += is_doubtful
    if why := failures.refusal(count) if len(tracks) else failures.nothing(count):
        raise LogError(f"{path}: table of MTrack2: {why}")
    notes = [
        f"{name}: MTrack2 was not sure of {number} of its places"
        for name, number in flags.items()
        if number
    ]
    lost = [failures.lost(count)] if failures else []
    return tracks.episode("MTrack2 table of ImageJ", UNSTATED, options, warnings=notes, losses=lost)


_Points = list[tuple[int, Point, bool]]  # tracks, places, and whether MTrack2 was not sure


def _points_by_cells(
    line: str, separator: str, numbers: Numbers, follower: Follower
) -> tuple[float, _Points]:
    """Read a row with three cells for each track of its block; ValueError if it is none."""
    cells = line.split(separator)
    frame, *values = [
        float("nan") if at and at % 3 == 0 else numbers.read(cell) for at, cell in enumerate(cells)
    ]
    if not isfinite(frame):
        raise ValueError("it has no frame")
    return frame, [
        (follower.first + at // 3, (x, y), cells[at + 3 : at + 4] == ["*"])
        for at in range(0, len(values) - 1, 3)
        for x, y in [values[at : at + 2]]
        if isfinite(x) and isfinite(y)
    ]


def _points_by_blanks(
    line: str, _: str, numbers: Numbers, follower: Follower
) -> tuple[float, _Points]:
    """Read a row whose unseen tracks leave only blanks; ValueError if it is none."""
    frame, *cells = line.split()
    when = numbers.read(frame)
    # Numbers in pairs, each of which may carry a flag.
    values = [at for at, cell in enumerate(cells) if cell != "*"]
    if len(values) % 2 or any(cells[at - 1 : at] == ["*"] for at in values[1::2]):
        raise ValueError("its numbers are no pairs")
    read = [numbers.read(cells[at]) for at in values]
    points = list(zip(read[::2], read[1::2], strict=True))
    flags = [cells[y + 1 : y + 2] == ["*"] for y in values[1::2]]
    if not all(map(isfinite, (when, *chain(*points)))):
        raise ValueError("a number is missing")
    return when, list(zip(follower.named(when, points), points, flags, strict=True))


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
# Times that POWERS lacks [ns].
_MINUTES_NS = {
    **dict.fromkeys(("min", "mins", "minute"), 60 * 10**9),
    **dict.fromkeys(("h", "hour"), 3600 * 10**9),
}
_LOOK_LINES = 200  # read ahead for units, and whether times only count frames


@dataclass(frozen=True)
class SpotLayout:
    """Columns of a spot table."""

    separator: str | None
    header: tuple[str, ...]
    columns: Mapping[str, int]  # index of each of `_ROLES`
    what: str  # kind of table, in words

    def unit(self, column: int, above: Sequence[Sequence[str]]) -> str:
        """Return the unit in a column's name or in the rows below it; "" where none is."""
        for text in (self.header[column], *(row[column] for row in above)):
            if found := _UNIT.search(text):
                return found[1].strip().lower().replace("µ", "u").replace("μ", "u")
        return ""

    def thing_of(self, cells: Sequence[str]) -> str:
        """Name a row's track by its number and perhaps its cluster's; "" where it has none."""
        if not cells:
            return "track"
        text = cells[0].strip()[:40]
        if text.lower() in ("", "none", "nan", "-1"):
            return ""
        text = text.removesuffix(".0").removesuffix(".000")
        prefix = f"{cells[1].strip()[:20]}." if len(cells) > 1 else ""
        return f"track{prefix}{text}" if text[0].isdigit() else text


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
    """Read each track of a spot table as a signal."""
    lines = iter(text)
    layout = spot_layout(next(lines, None) or "")
    if layout is None:
        raise LogError(f"{path}: has no columns of places and frames; export it again")
    every = ((at, line) for at, line in enumerate(lines, 2) if line is None or line.strip(" \t,;"))
    first = list(islice(every, _LOOK_LINES))
    columns, width = layout.columns, max(layout.columns.values()) + 1
    cells = [cells_of(line or "", layout.separator) for _, line in first]
    # The centroid of the outline goes before the centre of brightness.
    x, y = ("x", "y") if {"x", "y"} <= columns.keys() else ("xm", "ym")
    above = [row for row in cells[:4] if len(row) >= width and not _is_number(row[columns[x]])]
    whole = [row for row in cells[len(above) :] if len(row) >= width]
    clock = _clock_of(layout, above, whole, options)
    unit = _unit_of(layout.unit(columns[x], above))
    group = _place("track", (columns[x], columns[y], columns.get("z")), unit, clock)
    told = tuple((columns[one], one) for one in ("track", "cluster") if one in columns)
    told = told if "track" in columns else ()
    plan = ColumnPlan(layout.header, (group,), told, thing_of=layout.thing_of, is_stacked=True)
    if not told:
        remedy = "measure one thing alone, or link them with TrackMate or MTrack2"
        plan = replace(plan, remedy=f"nothing tells which thing is which; {remedy}")
    rows = TextRows(path, plan, layout.separator, width)
    rows.read(chain(first[len(above) :], every))
    if rows.unlinked and rows.unlinked == rows.count - len(rows.failures):
        raise LogError(
            f"{path}: {layout.what}: none of the {rows.unlinked} places belongs to a track; "
            "link them to tracks first"
        )
    unlinked = {"places of no track": f"{rows.unlinked} places were not linked"}
    return rows.episode(layout.what, options, unused=unlinked if rows.unlinked else {})


def _clock_of(
    layout: SpotLayout,
    above: Sequence[Sequence[str]],
    rows: Sequence[Sequence[str]],
    options: ReadOptions,
) -> Clock:
    """Choose the column of frames or of times; a time that repeats the frames is none."""
    columns, at = layout.columns, layout.columns.get("time")
    frames = [columns[role] for role in ("frame", "slice") if role in columns]
    changing = [one for one in frames if len({row[one].strip() for row in rows}) > 1]
    frame = next(iter((*changing, *frames)), None)
    by_frame = ROWS
    if frame is not None:
        by_frame = Clock(layout.header[frame], (frame,), 0, counts_frames=True)
    if at is None or (options.fps and frame is not None):
        return by_frame
    unit, name = layout.unit(at, above), layout.header[at]
    if unit.startswith("frame"):
        return Clock(name, (at,), 0, counts_frames=True)
    numbers = Numbers(layout.separator)
    try:
        is_same = frame is not None and all(
            abs(numbers.read(row[at]) - numbers.read(row[frame])) < 1e-6 for row in rows
        )
    except ValueError:
        is_same = False
    if is_same:
        return by_frame
    return Clock(name, (at,), POWERS.get(unit, 0), unit_ns=_MINUTES_NS.get(unit, 0))


def _is_number(text: str) -> bool:
    try:
        Numbers(None).read(text)
    except ValueError:
        return False
    return bool(text.strip())


# ---- TrackMate's XML: its exports, and whole sessions.

_MAX_COUNT = 1_000_000  # of spots and of links between them, which come after all spots
Spot = tuple[float, float, float, float]  # a frame, and x, y, z there


def is_trackmate_xml(data: bytes) -> bool:
    """Return whether a file's first bytes are TrackMate XML of either kind."""
    start = data[:4096]
    return b"<Tracks " in start or b"<TrackMate" in start


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
            ends = (attributes.get(f"SPOT_{end}_ID", "") for end in ("SOURCE", "TARGET"))
            self._links[self._track].update(dict.fromkeys(ends))
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

    def units(self) -> tuple[str, float | None, list[str]]:
        """Return unit of length and frame rate that the file states, and doubts about them."""
        length = _unit_of(self._first("spaceunits", "spatialunits", "spaceunit"))
        try:
            power = POWERS[self._first("timeunits", "timeunit").lower()]
            interval_s = float(self._first("frameinterval", "timeinterval")) * 10.0**power
        except (KeyError, ValueError):
            interval_s = 0.0
        if interval_s == 1.0:
            doubt = "it says a frame a second, as ImageJ does where nobody told it; not used"
            return length, None, [doubt]
        return length, 1 / interval_s if 0 < interval_s < inf else None, []

    def _first(self, *keys: str) -> str:
        return next((self._said[key] for key in keys if key in self._said), "")


def _spot(attributes: dict[str, str]) -> Spot:
    """Parse a spot; raise ValueError where a number is missing."""
    small = {key.lower(): text for key, text in attributes.items()}
    try:
        return (float(small["t"]), float(small["x"]), float(small["y"]), float(small.get("z", "0")))
    except (KeyError, ValueError):
        raise ValueError("a place has no t, x or y that is a number") from None


# ---- Choose the reader of an ImageJ file.


def _check_size(path: Path, what: str) -> None:
    if path.stat().st_size > _MAX_TEXT_BYTES:
        raise LogError(f"{path}: is {what} of over {_MAX_TEXT_BYTES >> 20} MiB; split it")


def is_imagej(start: Start) -> bool:
    """Return whether a file is an ImageJ table or TrackMate XML."""
    if is_trackmate_xml(start.data):
        return True
    return bool(start.lines) and (
        is_mtrack2(start.lines[0]) or spot_layout(start.lines[0]) is not None
    )


def read_imagej(path: Path, options: ReadOptions) -> Episode:
    """Read each track as a signal: usually in pixels, y down, by frames."""
    _check_size(path, "an ImageJ table")
    start = start_of(path)
    if is_trackmate_xml(start.data):
        reading = _XmlReading()
        read_elements(path, "tracks of TrackMate", reading.begin)
        tracks, unused = reading.tracks(path)
        if not len(tracks):
            raise LogError(f"{path}: tracks of TrackMate: it holds none; track first, then export")
        unit, rate_hz, doubts = reading.units()
        more = {"rate_hz": rate_hz, "unused": unused, "warnings": doubts}
        return tracks.episode("TrackMate tracks", unit, options, **more)
    first = next(iter(start.lines), "")
    if is_mtrack2(first):
        return read_mtrack2(path, lines_of(path), options)
    return read_csv(path, options) if options.columns else read_spots(path, lines_of(path), options)


# ---- Text exports of the video analysis program Tracker (physlets.org/tracker).

_FIRST = ("t", "frame", "step")  # names of the first column
_AXES = (("x", "pixelx"), ("y", "pixely"), ("z",))  # names of coordinates, the better ones first
# Stands at the beginning of what Tracker itself saves (.trk).
_PROJECT = b"org.opensourcephysics.cabrillo.tracker"


def is_tracker(start: Start) -> bool:
    """Return whether a file is an export of Tracker, or one of its projects."""
    return _PROJECT in start.data[:4096] or names_masses(start.lines)


def names_masses(lines: Sequence[str]) -> bool:
    """Return whether lines begin as an export of Tracker does."""
    first = [line for line in lines[:4] if not line.startswith("#multi")]
    return len(first) > 1 and _masses_plan(first[0], first[1]) is not None


def read_tracker(path: Path, options: ReadOptions) -> Episode:
    """Read each mass as a signal, in metres or pixels as its user calibrated them."""
    with open_regular(path) as file:
        if _PROJECT in file.read(4096):
            raise LogError(
                f"{path}: is a project of Tracker, not its data; in Tracker, choose File > Export "
                "> Data File"
            )
    _check_size(path, "a Tracker export")
    return read_masses(path, lines_of(path), options)


def read_masses(path: Path, lines: Iterable[str | None], options: ReadOptions) -> Episode:
    """Read the lines of a Tracker export, be they of a file or of a sheet."""
    numbered = enumerate(lines, 1)
    names, found = "", None
    for _, line in islice(numbered, 4):
        found = None if line is None else _masses_plan(names, line)
        if line is None or found is not None:
            break
        names = line
    if found is None:
        raise LogError(f"{path}: is no Tracker export of x and y; export these columns too")
    plan, separator = found
    rows = TextRows(path, plan, separator, max(plan.needed) + 1)
    rows.read(numbered)
    return rows.episode("Tracker export", options)


def _masses_plan(names: str, line: str) -> tuple[ColumnPlan, str | None] | None:
    """Parse a line of masses and the line of columns below it; None where they are none."""
    separator = best_separator(line)
    header = tuple(cell.strip() for cell in cells_of(line, separator))
    if not 2 < len(header) <= MAX_COLUMNS or _bare(header[0]) not in _FIRST:
        return None
    # First column and name of each mass; empty where none is named.
    if separator is None:
        found = [name for name in names.split("  ") if name.strip()]
        begins = [at for at, name in enumerate(header) if name == header[1]]
        starts = list(zip(begins, found, strict=False)) if len(begins) == len(found) else []
    else:
        cells = [cell.strip() for cell in cells_of(names, separator)][: len(header)]
        starts = [(at, cell) for at, cell in enumerate(cells) if cell and not cells[0]]
    if not starts:
        return None
    whens = [at for at, name in enumerate(header) if _bare(name) in _FIRST]
    when = next((at for at in whens if _bare(header[at]) == "t"), whens[0])
    power, counts = POWERS.get(_unit(header[when]), 0), _bare(header[when]) != "t"
    clock = Clock(header[when], (when,), 0 if counts else power, counts_frames=counts)
    ends = [at for at, _ in starts[1:]] + [len(header)]
    labels = unique_names(name for _, name in starts)
    places: list[tuple[str, list[int | None]]] = []
    unused: dict[str, str] = {}
    lengths: set[str] = set()
    for label, (begin, _), end in zip(labels, starts, ends, strict=True):
        columns = {_bare(header[at]): at for at in reversed(range(begin, end)) if header[at]}
        axes = [next((columns[one] for one in named if one in columns), None) for named in _AXES]
        if axes[0] is None and axes[1] is None:
            unused[label] = "it has no column x or y"
            continue
        used = [at for at in axes if at is not None]
        lengths.update(_length(header[at]) for at in used)
        places.append((label, axes))
        for name, at in columns.items():
            if at not in used and name not in _FIRST:
                unused[f"{label}.{name}"] = "it is no position"
    if not places or len(lengths) > 1:
        return None
    unit = lengths.pop()
    groups = tuple(_place(label, axes, unit, clock) for label, axes in places)
    return ColumnPlan(header, groups, unused=unused), separator


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
