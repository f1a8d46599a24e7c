"""Read Qualisys Track Manager's TSV exports: marker trajectories (3D) or rigid bodies (6D).

Lines of a key, a tab and its values, then, if it was asked for, a row of names (`NAME X`), then
rows. QTM writes mm, but the file names no unit.
https://docs.qualisys.com/qtm/content/processing_measurement/motion_data_tsv.htm
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from tunenet_logs.episode import UNSTATED, Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.formats.exports.mocap.markers import (
    MarkerTrack,
    MarkerTracks,
    count_of,
    is_unlabeled,
    rate_of,
    unique,
)
from tunenet_logs.formats.exports.mocap.number_rows import LineReader, header_cells, open_lines
from tunenet_logs.formats.exports.mocap.track_rows import read_tracks
from tunenet_logs.formats.exports.start import Start
from tunenet_logs.formats.read_options import ReadOptions

WHAT = "Qualisys QTM export"  # what it is called
_FIRST = ("FILE_VERSION", "NO_OF_FRAMES", "NO_OF_CAMERAS", "NO_OF_MARKERS", "FREQUENCY")
_NAMES = ("MARKER_NAMES", "BODY_NAMES")
_COUNTS = ("NO_OF_MARKERS", "NO_OF_BODIES")

_KEY = re.compile(r"[A-Z][A-Z0-9_]*[A-Z0-9]")

_MAX_HEADER_LINES = 2000  # each event of a take is a line
_BODY_COLUMNS = 16  # of a rigid body: x, y, z, roll, pitch, yaw, residual and nine of a matrix


def is_qualisys(start: Start) -> bool:
    """Return whether a file is a QTM export, by its keys."""
    if not start.lines or start.lines[0].split("\t")[0] not in _FIRST:
        return False
    keys = {line.split("\t", 1)[0] for line in start.lines[:_MAX_HEADER_LINES]}
    return "NO_OF_FRAMES" in keys and not keys.isdisjoint((*_NAMES, *_COUNTS))


def read_qualisys(path: Path, options: ReadOptions) -> Episode:
    """Read a take, one signal per marker's trajectory or rigid body's position.

    Raises:
        LogError: it holds no marker and no body, no row, or more than is read.
        OSError: it cannot be read.
    """
    with open_lines(path) as lines:
        try:
            keys, columns, first = _header(lines)
        except ValueError as error:
            raise LogError(f"{path}: is a {WHAT} with {error}", EXPORT_AGAIN) from error
        included = " ".join(keys.get("DATA_INCLUDED", ()))
        if included.startswith("2D"):
            raise LogError(
                f"{path}: is a {WHAT} of 2D data, what single cameras saw; export it as 3D"
            )
        tracks = _tracks(keys, columns, first)
        if not tracks.tracks:
            raise LogError(
                f"{path}: is a {WHAT} of {included or 'data'} without a marker or a body; export "
                "it with labeled trajectories"
            )
        return read_tracks(path, lines, "\t", tracks, first=first).episode(options)


def _header(lines: LineReader) -> tuple[dict[str, list[str]], list[str], str]:
    """Return keys with values, column names (if any) and first row; ValueError if too long."""
    keys: dict[str, list[str]] = {}
    columns: list[str] = []
    for _ in range(_MAX_HEADER_LINES):
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
    raise ValueError(f"over {_MAX_HEADER_LINES} lines of header")


def _is_columns(cells: Sequence[str]) -> bool:
    """Return whether a row names columns."""
    return cells[:1] in (["Frame"], ["Time"]) or any(_axis(cell) == "X" for cell in cells[:3])


def _tracks(keys: dict[str, list[str]], columns: Sequence[str], first: str) -> MarkerTracks:
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
        WHAT,
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
