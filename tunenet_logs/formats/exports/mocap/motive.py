"""Read OptiTrack Motive's CSV exports, format versions 1.1 to 1.25: rigid bodies and markers.

Line 1 holds pairs of a key and a value. Above the columns stand rows of their type, name, ID and,
in later versions, parent, then `Rotation` or `Position`, then the axis. In early versions these
rows have no labels of their own. https://docs.optitrack.com/motive/data-export/data-export-csv
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tunenet_logs.episode import Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.formats.exports.mocap.markers import (
    MarkerTrack,
    MarkerTracks,
    count_of,
    is_unlabeled,
    rate_of,
    unique,
    unit_of,
)
from tunenet_logs.formats.exports.mocap.number_rows import (
    LineReader,
    header_cells,
    open_lines,
    separator_of,
)
from tunenet_logs.formats.exports.mocap.track_rows import read_tracks
from tunenet_logs.formats.exports.start import Start
from tunenet_logs.formats.read_options import ReadOptions

WHAT = "OptiTrack Motive export"  # what it is called
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
            raise LogError(f"{path}: is an {WHAT} with {error}", EXPORT_AGAIN) from error
        pairs = dict(zip(said[::2], said[1::2], strict=False))
        tracks = _tracks(pairs, *header)
        if not tracks.tracks:
            held = ", ".join(dict.fromkeys(tracks.unused.values())) or "nothing"
            raise LogError(
                f"{path}: is an {WHAT} without a position (it holds: {held}); export it with "
                "markers or rigid bodies"
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


def _tracks(
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
        WHAT,
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
