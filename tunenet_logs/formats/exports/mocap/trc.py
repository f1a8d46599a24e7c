"""Read TRC (track row column) files of markers, as OpenSim, Motive, Cortex and others write them.

Line 1 begins with `PathFileType`, lines 2 and 3 are keys and values (rate, units), line 4 names the
markers, line 5 their axes (`X1`); then, after an empty line or none, the rows: frame, time, and
three cells for each marker. Names and axes may stand a cell further right than their numbers.
https://opensimconfluence.atlassian.net/wiki/spaces/OpenSim/pages/53089972
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
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
from tunenet_logs.formats.exports.mocap.number_rows import header_cells, open_lines, separator_of
from tunenet_logs.formats.exports.mocap.track_rows import read_tracks
from tunenet_logs.formats.exports.start import Start
from tunenet_logs.formats.read_options import ReadOptions

WHAT = "TRC file of markers"  # what it is called
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
            raise LogError(f"{path}: is a {WHAT} with {error}", EXPORT_AGAIN) from error
        cells += [[] for _ in range(_HEADER_LINES - len(cells))]
        _, keys, values, names, axes = cells
        has_axes = any(map(_is_x, axes))
        first = texts[-1] if len(texts) == _HEADER_LINES and axes and not has_axes else ""
        said = dict(zip((key.lower() for key in keys), values, strict=False))
        tracks = _tracks(said, names, axes if has_axes else ())
        if not tracks.tracks:
            raise LogError(f"{path}: is a {WHAT} that names no marker", EXPORT_AGAIN)
        return read_tracks(path, lines, separator, tracks, first=first).episode(options)


def _tracks(said: Mapping[str, str], header: Sequence[str], axes: Sequence[str]) -> MarkerTracks:
    names = [name for name in header[2:] if name]
    count = len([axis for axis in axes if _is_x(axis)]) or len(names)
    names = [*names[:count], *(f"marker {at + 1}" for at in range(len(names), count))]
    unit = unit_of(said.get("units", ""))
    return MarkerTracks(
        WHAT,
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
