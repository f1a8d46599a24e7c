"""Read motion capture exports: OptiTrack Motive, Vicon Nexus, Qualisys QTM, and TRC files.

Each reader parses its header to `MarkerTracks`, and `read_tracks` reads the rows below it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tunenet_logs.episode import UNSTATED, Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.formats.columns.cells import LineReader, header_cells, open_lines, separator_of
from tunenet_logs.formats.columns.table import (
    MarkerTrack,
    MarkerTracks,
    TrackRows,
    count_of,
    is_unlabeled,
    rate_of,
    read_tracks,
    unique,
    unit_of,
)
from tunenet_logs.formats.kinds import Start
from tunenet_logs.formats.options import ReadOptions

# ---- OptiTrack Motive (.csv), format versions 1.1 to 1.25: rigid bodies and markers.
# Line 1 holds pairs of a key and a value. Above the columns stand rows of their type, name, ID and,
# in later versions, parent, then `Rotation` or `Position`, then the axis. In early versions these
# rows have no labels of their own. https://docs.optitrack.com/motive/data-export/data-export-csv

_MOTIVE = "OptiTrack Motive export"
# One of them follows the format version in line 1.
_KEYS = ("Take Name", "Capture Frame Rate", "Export Frame Rate", "Rotation Type", "Length Units")

_MAX_HEADER_LINES = 40

_ROTATION = "a rotation: only positions are used"
_QUALITY = "says how well it was measured; it is not used"
_BONE = "a bone of a skeleton: computed from its markers, which are used"
_LOCAL = "relative to its body or parent (Coordinate Space is Local); export it as Global"


@dataclass(frozen=True)
class _MotiveColumn:
    """Header cells above a column."""

    kind: str
    name: str
    quantity: str
    axis: str


def is_motive(start: Start) -> bool:
    """Return whether a file is a Motive export."""
    if not start.lines or not start.lines[0].lstrip('"').startswith("Format Version"):
        return False
    return any(key in start.lines[0] for key in _KEYS)


def read_motive(path: Path, options: ReadOptions) -> Episode:
    """Read a take, one signal per rigid body's position, then per marker's.

    Raises:
        LogError: it has no column of positions, no row, or more than is read.
        OSError: it cannot be read.
    """
    with open_lines(path) as lines:
        first = lines.line() or ""
        separator = separator_of(first)
        try:
            said = header_cells(first, separator)
            header = _header(lines, separator)
        except ValueError as error:
            raise LogError(f"{path}: is an {_MOTIVE} with {error}", EXPORT_AGAIN) from error
        pairs = dict(zip(said[::2], said[1::2], strict=False))
        tracks = _motive_tracks(pairs, *header)
        if not tracks.tracks:
            held = ", ".join(dict.fromkeys(tracks.unused.values())) or "nothing"
            raise LogError(
                f"{path}: is an {_MOTIVE} without a position (it holds: {held}); export it "
                "with markers or rigid bodies"
            )
        return read_tracks(path, lines, separator, tracks).episode(options)


def _header(lines: LineReader, separator: str) -> tuple[list[str], list[_MotiveColumn]]:
    """Return the row of axes and each column's header; raise ValueError without such a row."""
    above: list[list[str]] = []
    for _ in range(_MAX_HEADER_LINES):
        line = lines.line()
        if line is None:
            break
        cells = header_cells(line, separator)
        if cells and cells[0].lower() == "frame":
            return cells, _columns(above, cells)
        if cells:
            above.append(cells)
    raise ValueError("no row that begins with Frame")


def _columns(above: Sequence[Sequence[str]], axes: Sequence[str]) -> list[_MotiveColumn]:
    by_label = {row[1].lower(): row for row in above if len(row) > 1 and row[1]}
    plain = [row for row in above if len(row) > 1 and not row[1]]
    quantities = plain[-1] if plain else []
    if "name" in by_label:
        kinds, names = by_label.get("type", []), by_label["name"]
    else:
        kinds = plain[0] if len(plain) > 1 else []
        names = plain[1] if len(plain) > 2 else []
    width = max([len(axes), len(quantities)])
    return [
        _MotiveColumn(_cell(kinds, at), _cell(names, at), _cell(quantities, at), _cell(axes, at))
        for at in range(width)
    ]


def _motive_tracks(
    pairs: Mapping[str, str], axes: Sequence[str], columns: Sequence[_MotiveColumn]
) -> MarkerTracks:
    time = next((at for at, name in enumerate(axes) if name.lower().startswith("time (s")), None)
    if time is None and _cell(axes, 1).lower() == "time":
        time = 1
    unit = unit_of(pairs.get("Length Units", ""))
    is_local = pairs.get("Coordinate Space", "").lower() == "local"
    bodies: list[MarkerTrack] = []
    markers: list[MarkerTrack] = []
    unused: dict[str, str] = {}
    at = 1 if time is None else time + 1
    while at < len(columns):
        here = columns[at]
        run = [(one.kind, one.name, one.quantity) for one in columns[at : at + 3]]
        is_position = here.quantity.lower() == "position" and len(set(run)) == 1
        if not (is_position and [one.axis for one in columns[at : at + 3]] == ["X", "Y", "Z"]):
            _note_unused(unused, here)
            at += 1
            continue
        kind = here.kind.lower()
        is_body = "marker" not in kind or "markerset" in kind
        if why := _why_not(kind, is_local=is_local):
            unused[here.name or here.kind] = why
        elif is_body:
            bodies.append(MarkerTrack(here.name, (at, at + 1, at + 2), unit))
        else:
            markers.append(
                MarkerTrack(here.name, (at, at + 1, at + 2), unit, is_unlabeled(here.name))
            )
        at += 3
    found = [*bodies, *markers]
    names = unique(track.name for track in found)
    return MarkerTracks(
        _MOTIVE,
        [
            MarkerTrack(name, track.columns, track.unit, track.is_unlabeled)
            for name, track in zip(names, found, strict=True)
        ],
        frame=0,
        time=time,
        rate_hz=rate_of(pairs.get("Export Frame Rate") or pairs.get("Capture Frame Rate")),
        frames=count_of(pairs.get("Total Exported Frames")),
        unused=unused,
    )


def _why_not(kind: str, *, is_local: bool) -> str:
    """Return why a position is not used; "" where it is."""
    if kind == "bone":
        return _BONE
    return _LOCAL if is_local and kind not in ("rigid body", "marker", "") else ""


def _note_unused(unused: dict[str, str], column: _MotiveColumn) -> None:
    if column.quantity.lower() == "rotation":
        unused[f"{column.name} rotation"] = _ROTATION
    elif column.name and column.quantity:
        unused[f"{column.name} {column.quantity.lower()}"] = _QUALITY


def _cell(cells: Sequence[str], at: int) -> str:
    return cells[at] if at < len(cells) else ""


# ---- Vicon Nexus (.csv): marker trajectories.
# A section is its title, its rate [Hz], a row of names, a row of axes that begins with
# `Frame,Sub Frame`, a row of units, and its rows. Before Nexus 2 the title is `TRAJECTORIES`, the
# rate `100,Hz`, the row of axes begins with `Field #`, and no unit is named.
# https://help.vicon.com/space/Nexus216 (Export to ASCII)

_NEXUS = "Vicon Nexus export"
_TITLES = ("trajectories", "model outputs", "devices", "joints", "segments", "events")

# How names of what a model tells end; early versions write it among the trajectories.
_MODEL = re.compile(r"(?:Angles?|Forces?|Moments?|Powers?)$")

_LOOK_LINES = 40  # in which a file's first section begins: lines about the take may precede it
_MAX_UNUSED = 200  # listed of what is not used
_MAX_SECTIONS = 50
_MAX_BETWEEN = 10_000  # lines between two sections


@dataclass(frozen=True)
class _Section:
    """Header of a section; `first` is its first row of numbers, where that was read already."""

    title: str
    separator: str
    rate_hz: float | None
    names: Sequence[str]
    axes: Sequence[str]
    units: Sequence[str]
    first: str = ""


def is_nexus(start: Start) -> bool:
    """Return whether a file is a Nexus export: a section's title above its rate."""
    lines = start.lines[:_LOOK_LINES]
    for title, rate, names in zip(lines, lines[1:], lines[2:], strict=False):
        if _title(title) in _TITLES and _rate(rate) is not None and names[:1] in (",", ";", "\t"):
            return True
    return False


def read_nexus(path: Path, options: ReadOptions) -> Episode:
    """Read a take, one signal per marker's trajectory.

    Raises:
        LogError: it has no section of trajectories, no row, or more than is read.
        OSError: it cannot be read.
    """
    rows: TrackRows | None = None
    unused: dict[str, str] = {}
    with open_lines(path) as lines:
        for _ in range(_MAX_SECTIONS):
            try:
                section, stray = _next_section(lines)
            except ValueError as error:
                raise LogError(f"{path}: is a {_NEXUS} with {error}", EXPORT_AGAIN) from error
            if rows is not None and stray:
                rows.is_broken = True
            if section is None:
                break
            if rows is None and section.title == "trajectories":
                tracks = _tracks(section, unused)
                rows = read_tracks(
                    path, lines, section.separator, tracks, first=section.first, until_words=True
                )
                continue
            for name in section.names:
                if name:
                    _note(unused, name, f"of the section {section.title!r}: not where a marker was")
            while lines.block(until_words=True):
                pass
    if rows is None or not rows.tracks.tracks:
        held = ", ".join(list(unused)[:3]) or "nothing"
        raise LogError(
            f"{path}: is a {_NEXUS} without trajectories of markers (it holds {held}); export it "
            "with Trajectories"
        )
    return rows.episode(options)


def _next_section(lines: LineReader) -> tuple[_Section | None, int]:
    """Return the next section's header (None at the end) and the count of stray rows before it.

    Raises:
        ValueError: its header is malformed.
    """
    stray = 0
    for _ in range(_MAX_BETWEEN):
        line = lines.line()
        if line is None:
            return None, stray
        stray += line[:1].isdecimal()
        if (title := _title(line)) in _TITLES:
            break
    else:
        return None, stray
    rate, names, axes = (lines.line() or "" for _ in range(3))
    separator = separator_of(names)
    below = lines.line() or ""
    has_units = not re.match(r'[\s"]*[-+.\d]', below)
    section = _Section(
        title,
        separator,
        _rate(rate),
        header_cells(names, separator),
        header_cells(axes, separator),
        header_cells(below, separator) if has_units else (),
        "" if has_units else below,
    )
    return section, stray


def _tracks(section: _Section, unused: dict[str, str]) -> MarkerTracks:
    axes = [axis.lower() for axis in section.axes]
    frame = 0 if axes[:1] in (["frame"], ["field #"]) else None
    sub_frame = 1 if axes[1:2] == ["sub frame"] else None
    starts = [at for at, name in enumerate(section.names) if name]
    found = [at for at in starts if axes[at : at + 3] == ["x", "y", "z"]]
    if not section.units:
        found = [at for at in found if not _MODEL.search(section.names[at])]
    for at in starts:
        if at in found:
            continue
        if _MODEL.search(section.names[at]):
            _note(unused, section.names[at], "a model's output by its name")
        else:
            _note(unused, section.names[at], f"has no X, Y, Z but {', '.join(axes[at : at + 3])}")
    warnings = []
    if section.rate_hz is None:
        warnings.append("its trajectories have no rate; say it with --fps")
    names = unique(section.names[at] for at in found)
    return MarkerTracks(
        _NEXUS,
        [
            MarkerTrack(name, (at, at + 1, at + 2), _unit(section.units, at), is_unlabeled(name))
            for name, at in zip(names, found, strict=True)
        ],
        frame=frame,
        sub_frame=sub_frame,
        rate_hz=section.rate_hz,
        zero_is_unseen=True,
        unused=unused,
        warnings=warnings,
    )


def _unit(units: Sequence[str], at: int) -> str:
    named = set(units[at : at + 3])
    return unit_of(named.pop()) if len(named) == 1 else UNSTATED


def _note(unused: dict[str, str], name: str, why: str) -> None:
    if len(unused) < _MAX_UNUSED:
        unused[name] = why
    else:
        unused["others"] = "more than are listed, of the same sections"


def _title(line: str) -> str:
    """Return the only cell of a line, in lower case; "" where there are several."""
    return line[:1000].strip(' \t,;"').lower() if len(line) < 100_000 else ""


def _rate(line: str) -> float | None:
    """Parse a section's rate [Hz]; None where the line is none."""
    match = re.fullmatch(r"(\d{1,6}(?:[.,]\d{1,9})?)[,;\t ]*(?:Hz)?", line[:100].strip(' \t,;"'))
    value = float(match[1].replace(",", ".")) if match else math.nan
    return value if value > 0 else None


# ---- Qualisys Track Manager (.tsv): marker trajectories (3D) or rigid bodies (6D).
# Lines of a key, a tab and its values, then, if it was asked for, a row of names (`NAME X`), then
# rows. QTM writes mm, but the file names no unit.
# https://docs.qualisys.com/qtm/content/processing_measurement/motion_data_tsv.htm

_QUALISYS = "Qualisys QTM export"
_FIRST = ("FILE_VERSION", "NO_OF_FRAMES", "NO_OF_CAMERAS", "NO_OF_MARKERS", "FREQUENCY")
_NAMES = ("MARKER_NAMES", "BODY_NAMES")
_COUNTS = ("NO_OF_MARKERS", "NO_OF_BODIES")

_KEY = re.compile(r"[A-Z][A-Z0-9_]*[A-Z0-9]")

_MAX_KEY_LINES = 2000  # each event of a take is a line
_BODY_COLUMNS = 16  # of a rigid body: x, y, z, roll, pitch, yaw, residual and nine of a matrix


def is_qualisys(start: Start) -> bool:
    """Return whether a file is a QTM export, by its keys."""
    if not start.lines or start.lines[0].split("\t")[0] not in _FIRST:
        return False
    keys = {line.split("\t", 1)[0] for line in start.lines[:_MAX_KEY_LINES]}
    return "NO_OF_FRAMES" in keys and not keys.isdisjoint((*_NAMES, *_COUNTS))


def read_qualisys(path: Path, options: ReadOptions) -> Episode:
    """Read a take, one signal per marker's trajectory or rigid body's position.

    Raises:
        LogError: it holds no marker and no body, no row, or more than is read.
        OSError: it cannot be read.
    """
    with open_lines(path) as lines:
        try:
            keys, columns, first = _qualisys_header(lines)
        except ValueError as error:
            raise LogError(f"{path}: is a {_QUALISYS} with {error}", EXPORT_AGAIN) from error
        included = " ".join(keys.get("DATA_INCLUDED", ()))
        if included.startswith("2D"):
            raise LogError(
                f"{path}: is a {_QUALISYS} of 2D data, what single cameras saw; export it as 3D"
            )
        tracks = _qualisys_tracks(keys, columns, first)
        if not tracks.tracks:
            raise LogError(
                f"{path}: is a {_QUALISYS} of {included or 'data'} without a marker or a body; "
                "export it with labeled trajectories"
            )
        return read_tracks(path, lines, "\t", tracks, first=first).episode(options)


def _qualisys_header(lines: LineReader) -> tuple[dict[str, list[str]], list[str], str]:
    """Return keys with values, column names (if any) and first row; ValueError if too long."""
    keys: dict[str, list[str]] = {}
    columns: list[str] = []
    for _ in range(_MAX_KEY_LINES):
        line = lines.line()
        if line is None:
            return keys, columns, ""
        cells = header_cells(line, "\t")
        if not columns and cells and _KEY.fullmatch(cells[0]) and not _is_columns(cells):
            keys.setdefault(cells[0], cells[1:])
        elif not columns and _is_columns(cells):
            columns = cells
        elif cells:
            return keys, columns, line
    raise ValueError(f"over {_MAX_KEY_LINES} lines of header")


def _is_columns(cells: Sequence[str]) -> bool:
    """Return whether a row names columns."""
    return cells[:1] in (["Frame"], ["Time"]) or any(_axis(cell) == "X" for cell in cells[:3])


def _qualisys_tracks(
    keys: dict[str, list[str]], columns: Sequence[str], first: str
) -> MarkerTracks:
    is_bodies = "BODY_NAMES" in keys or "NO_OF_BODIES" in keys
    names = keys.get(_NAMES[is_bodies], [])
    count = len(names) or count_of("".join(keys.get(_COUNTS[is_bodies], ()))) or 0
    stride = _BODY_COLUMNS if is_bodies else 3
    frame = time = None
    if columns:
        frame = 0 if columns[0] == "Frame" else None
        time = next((at for at, name in enumerate(columns[:2]) if name.startswith("Time")), None)
        starts = [at for at in range(len(columns) - 2) if _axes(columns[at : at + 3]) == "XYZ"]
        names = names if len(names) == len(starts) else [columns[at][:-1].strip() for at in starts]
    else:
        cells = len(first.split("\t"))
        lead = 2 if count and cells >= stride * count + 2 else 0
        frame, time = (0, 1) if lead else (None, None)
        starts = [lead + stride * at for at in range(min(count, cells))]
    kind = "body" if is_bodies else "marker"
    names = [*names, *(f"{kind} {at + 1}" for at in range(len(names), len(starts)))]
    unused = {}
    if is_bodies:
        unused["rotations"] = "only positions are used"
    return MarkerTracks(
        _QUALISYS,
        [
            MarkerTrack(name, (at, at + 1, at + 2), UNSTATED, is_unlabeled(name))
            for name, at in zip(unique(names), starts, strict=False)
        ],
        frame=frame,
        time=time,
        rate_hz=rate_of(" ".join(keys.get("FREQUENCY", ()))),
        frames=count_of("".join(keys.get("NO_OF_FRAMES", ()))),
        zero_is_unseen=True,
        unused=unused,
    )


def _axis(name: str) -> str:
    """Return the axis at the end of a column's name; "" where there is none."""
    match = re.fullmatch(r"(?:.*[\s._:])?([XYZ])", name)
    return match[1] if match else ""


def _axes(names: Sequence[str]) -> str:
    return "".join(map(_axis, names))


# ---- TRC (track row column) files of markers, as OpenSim, Motive, Cortex and others write them.
# Line 1 begins with `PathFileType`, lines 2 and 3 are keys and values (rate, units), line 4 names
# the markers, line 5 their axes (`X1`); then, after an empty line or none, the rows: frame, time,
# and three cells for each marker. Names and axes may stand a cell further right than their numbers.
# https://opensimconfluence.atlassian.net/wiki/spaces/OpenSim/pages/53089972

_TRC = "TRC file of markers"
_HEADER_LINES = 5


def is_trc(start: Start) -> bool:
    """Return whether a file is TRC."""
    return bool(start.lines) and start.lines[0].lstrip(' "').startswith("PathFileType")


def read_trc(path: Path, options: ReadOptions) -> Episode:
    """Read a TRC file, one signal per marker.

    Raises:
        LogError: it names no marker, has no row, or more than is read.
        OSError: it cannot be read.
    """
    with open_lines(path) as lines:
        texts = [line for line in (lines.line() for _ in range(_HEADER_LINES)) if line is not None]
        separator = separator_of("\n".join(texts))
        try:
            cells = [header_cells(text, separator) for text in texts]
        except ValueError as error:
            raise LogError(f"{path}: is a {_TRC} with {error}", EXPORT_AGAIN) from error
        cells += [[] for _ in range(_HEADER_LINES - len(cells))]
        _, keys, values, names, axes = cells
        has_axes = any(map(_is_x, axes))
        first = texts[-1] if len(texts) == _HEADER_LINES and axes and not has_axes else ""
        said = dict(zip((key.lower() for key in keys), values, strict=False))
        tracks = _trc_tracks(said, names, axes if has_axes else ())
        if not tracks.tracks:
            raise LogError(f"{path}: is a {_TRC} that names no marker", EXPORT_AGAIN)
        return read_tracks(path, lines, separator, tracks, first=first).episode(options)


def _trc_tracks(
    said: Mapping[str, str], header: Sequence[str], axes: Sequence[str]
) -> MarkerTracks:
    names = [name for name in header[2:] if name]
    count = len([axis for axis in axes if _is_x(axis)]) or len(names)
    names = [*names[:count], *(f"marker {at + 1}" for at in range(len(names), count))]
    unit = unit_of(said.get("units", ""))
    return MarkerTracks(
        _TRC,
        [
            MarkerTrack(name, (at, at + 1, at + 2), unit, is_unlabeled(name))
            for name, at in zip(unique(names), range(2, 3 * count + 2, 3), strict=True)
        ],
        frame=0,
        time=1,
        rate_hz=rate_of(said.get("datarate", "")),
        frames=count_of(said.get("numframes", "")),
        zero_is_unseen=True,
    )


def _is_x(cell: str) -> bool:
    return re.fullmatch(r"[Xx]\d*", cell) is not None
