"""Read marker positions from C3D files (.c3d), as most motion capture systems write them.

A damaged file makes the libraries for the format crash the process, so nothing but numpy reads it,
after the C3D user guide, https://www.c3d.org/docs/C3D_User_Guide.pdf: header and parameters, then
frames. Every size is checked before it is trusted.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.files import open_regular
from tunenet_logs.formats.columns.cells import MAX_COLUMNS
from tunenet_logs.formats.columns.table import (
    MarkerTrack,
    MarkerTracks,
    TrackRows,
    is_unlabeled,
    rate_of,
    unique,
    unit_of,
)
from tunenet_logs.formats.kinds import Start
from tunenet_logs.formats.options import ReadOptions

BLOCK_BYTES = 512  # unit of positions in a file, which count from 1
KEY = 0x50  # the second byte of a file, and of its parameters
_PROCESSORS = {84: "intel", 85: "dec", 86: "mips"}

_MAX_PARAMETERS = 20_000
_MAX_DIMENSIONS = 7

# Types of parameters.
_TEXT = -1
_SIZES = {_TEXT: 1, 1: 1, 2: 2, 4: 4}

# Of a parameter: texts without the blanks behind them, or numbers.
Value = tuple[str, ...] | tuple[float, ...]


@dataclass(frozen=True)
class C3dNumbers:
    """Number representation of a processor.

    Attributes:
        processor: "intel", "dec" or "mips".
    """

    processor: str

    @property
    def order(self) -> Literal["<", ">"]:
        """Byte order, as numpy and struct name it."""
        return ">" if self.processor == "mips" else "<"

    def words(self, data: bytes) -> NDArray[np.int16]:
        """Decode signed 16-bit integers."""
        return np.frombuffer(data, np.dtype(np.int16).newbyteorder(self.order))

    def floats(self, data: bytes) -> NDArray[np.float64]:
        """Decode 32-bit floats; DEC's are VAX F_floating, a quarter of the same IEEE 754 bits."""
        if self.processor != "dec":
            plain = np.frombuffer(data, np.dtype(np.float32).newbyteorder(self.order))
            with np.errstate(invalid="ignore"):  # a damaged file's
                return plain.astype(np.float64)
        swapped = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1].copy()
        with np.errstate(invalid="ignore"):
            return swapped.view("<f4").ravel().astype(np.float64) / 4


@dataclass(frozen=True)
class C3dHeader:
    """Header and parameters of a C3D file.

    Attributes:
        numbers: number representation.
        points: in each frame.
        analogs: samples of other sensors in each frame.
        first_frame: its number.
        last_frame: as a 16-bit number, which may be too small.
        scale: units for each step of whole numbers; negative where data are floating point.
        data_block: first block of the data.
        rate_hz: frame rate, 0 where it is unstated.
        parameters: by group and name.
    """

    numbers: C3dNumbers
    points: int
    analogs: int
    first_frame: int
    last_frame: int
    scale: float
    data_block: int
    rate_hz: float
    parameters: dict[tuple[str, str], Value] = field(default_factory=dict)

    def texts(self, group: str, name: str) -> list[str]:
        """Return a text parameter with its continuations (LABELS, LABELS2, ...)."""
        found: list[str] = []
        for number in ("", *range(2, 100)):
            value = self.parameters.get((group, f"{name}{number}"), ())
            texts = [one for one in value if isinstance(one, str)]
            if not texts:
                break
            found += texts
        return found

    def values(self, group: str, name: str) -> list[float]:
        """Return a numeric parameter; empty where it is absent."""
        value = self.parameters.get((group, name), ())
        return [float(one) for one in value if not isinstance(one, str)]


def is_header(data: bytes) -> bool:
    """Return whether the first bytes of a file are a C3D header."""
    if len(data) < BLOCK_BYTES or data[0] == 0 or data[1] != KEY:
        return False
    at = (data[0] - 1) * BLOCK_BYTES
    return data[at + 3 : at + 4] == b"" or data[at + 3] in _PROCESSORS


def header_of(data: bytes) -> C3dHeader:
    """Parse the header from a file's first 128 KiB or more.

    Raises:
        ValueError: it is truncated.
    """
    at = (data[0] - 1) * BLOCK_BYTES
    if len(data) < at + 4 or data[at + 3] not in _PROCESSORS:
        raise ValueError("ends before its parameters")
    numbers = C3dNumbers(_PROCESSORS[data[at + 3]])
    words = [int(one) & 0xFFFF for one in numbers.words(data[: 2 * 12])]
    scale = float(numbers.floats(data[12:16])[0])
    rate = float(numbers.floats(data[20:24])[0])
    parameters = dict(_parameters(data, at, numbers))
    return C3dHeader(
        numbers, words[1], words[2], words[3], words[4], scale, words[8], rate, parameters
    )


def _parameters(
    data: bytes, start: int, numbers: C3dNumbers
) -> Iterator[tuple[tuple[str, str], Value]]:
    """Return all parameters of the section by group and name."""
    end = min(len(data), start + max(1, data[start + 2]) * BLOCK_BYTES)
    groups: dict[int, str] = {}
    found: list[tuple[int, str, Value]] = []
    at = start + 4
    for _ in range(_MAX_PARAMETERS):
        if at + 2 > end:
            break
        length, group = struct.unpack_from("<bb", data, at)
        name_end = at + 2 + abs(length)
        if length == 0 or name_end + 2 > end:
            break
        name = data[at + 2 : name_end].decode("latin-1").strip().upper()
        (offset,) = struct.unpack_from(f"{numbers.order}H", data, name_end)
        if group < 0:
            groups[-group] = name
        elif (value := _value(data[name_end + 2 : end], numbers)) is not None:
            found.append((group, name, value))
        if offset == 0:
            break
        at = name_end + offset
    return (((groups.get(group, ""), name), value) for group, name, value in found)


def _value(data: bytes, numbers: C3dNumbers) -> Value | None:
    """Decode a parameter; None where it is truncated or of an unknown type."""
    kind, dimensions = struct.unpack_from("<bB", data) if len(data) > 1 else (0, 0)
    if kind not in _SIZES or dimensions > _MAX_DIMENSIONS or len(data) < 2 + dimensions:
        return None
    shape = tuple(data[2 : 2 + dimensions])
    count = 1
    for size in shape:
        count *= size
    body = data[2 + dimensions : 2 + dimensions + count * _SIZES[kind]]
    if len(body) < count * _SIZES[kind]:
        return None
    if kind == _TEXT:
        width = shape[0] if len(shape) > 1 else count
        texts = [body[at : at + width] for at in range(0, count, width)] if width else []
        return tuple(text.decode("utf-8", "replace").rstrip(" \0") for text in texts)
    if kind == 4:
        return tuple(numbers.floats(body).tolist())
    if kind == 2:
        return tuple(float(int(one) & 0xFFFF) for one in numbers.words(body))
    return tuple(float(one) for one in body)


# ---- Frames of points.

WHAT = "C3D file"  # in messages
# Read for header and parameters: at most 127 and 255 blocks.
_HEADER_BYTES = 512 * 512
_READ_BYTES = 8 * 1024**2  # of data, at once
# Parameters of POINT that name the points that are no positions.
_MODEL_GROUPS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")

_MAX_FRAMES = 65535  # that the header can count: it states this where there are more
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
