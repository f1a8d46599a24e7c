"""Read marker positions from C3D files (.c3d), as most motion capture systems write them.

A damaged file makes the libraries for the format crash the process, so nothing but numpy reads it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.formats.exports.mocap.c3d_header import (
    BLOCK_BYTES,
    C3dHeader,
    header_of,
    is_header,
)
from tunenet_logs.formats.exports.mocap.markers import (
    MarkerTrack,
    MarkerTracks,
    is_unlabeled,
    rate_of,
    unique,
    unit_of,
)
from tunenet_logs.formats.exports.mocap.number_rows import MAX_COLUMNS
from tunenet_logs.formats.exports.mocap.track_rows import TrackRows
from tunenet_logs.formats.exports.start import Start
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.regular_file import open_regular

WHAT = "C3D file"  # what it is called
# Read for the header and the parameters: at most 127 and 255 blocks of 512 bytes.
_HEADER_BYTES = 512 * 512

_READ_BYTES = 8 * 1024**2  # of data, at once
# Parameters of POINT that name points which are no positions.
_MODEL_GROUPS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")

_MAX_FRAMES = 65535  # that the header can count: it stands there as well where there are more
_UNKNOWN_FRAMES = 2**31

_MAX_ANALOGS = 100  # channels listed


def is_c3d(start: Start) -> bool:
    """Return whether a file is C3D, by its first bytes."""
    return is_header(start.data)


def read_c3d(path: Path, options: ReadOptions) -> Episode:
    """Read a C3D file, one signal per point.

    Raises:
        LogError: it has no point, no frame, or its header is damaged.
        OSError: it cannot be read.
    """
    with open_regular(path) as file:
        try:
            header = header_of(file.read(_HEADER_BYTES))
        except ValueError as error:
            raise LogError(f"{path}: is a {WHAT} that {error}", EXPORT_AGAIN) from error
        if not 0 < header.points <= MAX_COLUMNS // 3:
            raise LogError(
                f"{path}: is a {WHAT} of {header.points} points (1 to {MAX_COLUMNS // 3} can be)",
                "export the ball's marker alone",
            )
        stated = _frames(header)
        tracks, used = _tracks(header, stated)
        rows = TrackRows(path, tracks)
        file.seek(0, 2)
        size = file.tell()
        start = (_data_block(header) - 1) * BLOCK_BYTES
        frame_bytes = _frame_bytes(header)
        frames = min(stated, max(0, size - start) // frame_bytes)
        file.seek(start)
        columns = list(range(1 + 3 * len(used)))
        for first, count in _parts(frames, max(1, _READ_BYTES // frame_bytes)):
            xyz = _points(file.read(count * frame_bytes), header)[:, used]
            numbers = header.first_frame + np.arange(first, first + len(xyz), dtype=np.float64)
            flat = xyz.reshape(len(xyz), 3 * len(used))
            rows.add(columns, np.column_stack([numbers, flat]))
        return rows.episode(options)


def _tracks(header: C3dHeader, frames: int) -> tuple[MarkerTracks, list[int]]:
    """Return the header's description of the points, and the indices of measured positions."""
    labels = header.texts("POINT", "LABELS")[: header.points]
    labels += [f"point {at + 1}" for at in range(len(labels), header.points)]
    names = unique(labels)
    modelled = {name for group in _MODEL_GROUPS for name in header.texts("POINT", group) if name}
    used = [at for at, label in enumerate(labels) if label not in modelled]
    unused = {
        names[at]: "no position: what a model tells"
        for at, label in enumerate(labels)
        if label in modelled
    }
    analogs = header.texts("ANALOG", "LABELS") if header.analogs else []
    units = header.texts("ANALOG", "UNITS")
    units += [""] * (len(analogs) - len(units))
    for name, unit in list(zip(unique(analogs), units, strict=False))[:_MAX_ANALOGS]:
        unused.setdefault(f"analog {name}", f"an analog channel [{unit or '?'}]: no position")
    if len(analogs) > _MAX_ANALOGS:
        unused["other analog channels"] = f"{len(analogs) - _MAX_ANALOGS} more: no positions"
    rate = (header.values("POINT", "RATE") or [header.rate_hz])[0]
    unit = unit_of("".join(header.texts("POINT", "UNITS")[:1]))
    found = [
        MarkerTrack(names[at], (first, first + 1, first + 2), unit, is_unlabeled(names[at]))
        for at, first in zip(used, range(1, 3 * len(used) + 1, 3), strict=True)
    ]
    tracks = MarkerTracks(
        WHAT,
        found,
        frame=0,
        rate_hz=rate_of(str(rate)),
        frames=frames if frames < _UNKNOWN_FRAMES else None,
        zero_is_unseen=True,
        unused=unused,
    )
    return tracks, used


def _frames(header: C3dHeader) -> int:
    """Return the number of frames stated, in any of the places where a file states it."""
    by_header = max(0, header.last_frame - header.first_frame + 1)
    start, end = (header.values("TRIAL", f"ACTUAL_{one}_FIELD") for one in ("START", "END"))
    if start and end and (count := int(_long(end) - _long(start) + 1)) > by_header:
        return count
    for name in ("LONG_FRAMES", "FRAMES"):
        value = (header.values("POINT", name) or [0.0])[0]
        if math.isfinite(value) and by_header < value < _UNKNOWN_FRAMES:
            return int(value)
    return by_header if header.last_frame < _MAX_FRAMES else _UNKNOWN_FRAMES


def _long(words: list[float]) -> float:
    """Combine two 16-bit words into a 32-bit number; one word stands for itself."""
    value = words[0] + 65536 * words[1] if len(words) > 1 else words[0]
    return value if math.isfinite(value) and 0 <= value < _UNKNOWN_FRAMES else 0.0


def _data_block(header: C3dHeader) -> int:
    said = header.values("POINT", "DATA_START")
    block = header.data_block or int(said[0] if said and said[0] == said[0] else 0)
    return max(2, block)


def _frame_bytes(header: C3dHeader) -> int:
    return (4 * header.points + header.analogs) * (4 if header.scale < 0 else 2)


def _points(data: bytes, header: C3dHeader) -> NDArray[np.float64]:
    """Decode the points of some frames, NaN where unseen, shape (T, points, 3)."""
    size = _frame_bytes(header)
    data = data[: len(data) // size * size]
    width = 4 * header.points
    if header.scale < 0:
        numbers = header.numbers.floats(data)
        scale = 1.0
    else:
        numbers = header.numbers.words(data)
        scale = header.scale
    cells = numbers.reshape(-1, width + header.analogs)[:, :width].reshape(-1, header.points, 4)
    with np.errstate(invalid="ignore", over="ignore"):
        xyz = cells[:, :, :3].astype(np.float64) * scale
        xyz[~(cells[:, :, 3] >= 0)] = np.nan
    return xyz


def _parts(count: int, most: int) -> Iterator[tuple[int, int]]:
    """Yield start and length of consecutive parts of at most `most`, up to `count`."""
    for first in range(0, count, most):
        yield first, min(most, count - first)
