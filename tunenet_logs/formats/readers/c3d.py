"""Read marker positions from C3D files (.c3d), as most motion capture systems write them.

A damaged file makes the libraries for the format crash the process, and they have no wheels for
every machine, so only numpy reads it, after the C3D user guide,
https://www.c3d.org/docs/C3D_User_Guide.pdf: header and parameters, then frames. Every size is
checked before it is trusted.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.files import open_regular
from tunenet_logs.formats.columns.cells import MAX_COLUMNS
from tunenet_logs.formats.kinds import Start
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.formats.readers.mocap import (
    MarkerTrack,
    MarkerTracks,
    TrackRows,
    is_unlabeled,
    rate_of,
    unique,
    unit_of,
)

_WHAT = "a C3D file"
_BLOCK_BYTES = 512  # unit of positions in a file, which count from 1
_PROCESSORS = {84: "intel", 85: "dec", 86: "mips"}
_HEADER_BYTES = 512 * _BLOCK_BYTES  # read for header and parameters: at most 127 and 255 blocks
_READ_BYTES = 8 * 1024**2  # of data, at once
_SIZES = {-1: 1, 1: 1, 2: 2, 4: 4}  # bytes of a parameter's items by its type; -1 is text
# Parameters of POINT that name the points that are no positions.
_MODEL_GROUPS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
_UNKNOWN_FRAMES = 2**31
_MAX_ANALOGS = 100  # channels listed

# Of a parameter: texts without the blanks behind them, or numbers.
Value = tuple[str, ...] | tuple[float, ...]


@dataclass(frozen=True)
class _Header:
    """Header and parameters of a C3D file."""

    processor: str  # "intel", "dec" or "mips", whose numbers are stored
    points: int = 0  # in each frame
    analogs: int = 0  # samples of other sensors in each frame
    first_frame: int = 0  # its number
    last_frame: int = 0  # as a 16-bit number, which may be too small
    # units for each step of whole numbers; negative where data are floating point
    scale: float = 0.0
    data_block: int = 0  # first block of the data, or 0
    rate_hz: float = 0.0  # frame rate, 0 where it is unstated
    parameters: dict[tuple[str, str], Value] = field(default_factory=dict)  # by group and name

    @property
    def order(self) -> str:
        """Byte order, as numpy and struct name it."""
        return ">" if self.processor == "mips" else "<"

    def words(self, data: bytes) -> NDArray[np.int16]:
        """Decode signed 16-bit integers."""
        return np.frombuffer(data, f"{self.order}i2")

    def floats(self, data: bytes) -> NDArray[np.float64]:
        """Decode 32-bit floats; DEC's are VAX F_floating, a quarter of the same IEEE 754 bits."""
        with np.errstate(invalid="ignore"):  # a damaged file's
            if self.processor != "dec":
                return np.frombuffer(data, f"{self.order}f4").astype(np.float64)
            swapped = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1].copy()
            return swapped.view("<f4").ravel().astype(np.float64) / 4

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


def is_c3d(start: Start) -> bool:
    """Return whether a file is C3D, by its first bytes."""
    data = start.data
    if len(data) < _BLOCK_BYTES or data[0] == 0 or data[1] != 0x50:
        return False
    at = (data[0] - 1) * _BLOCK_BYTES
    return data[at + 3 : at + 4] == b"" or data[at + 3] in _PROCESSORS


def read_c3d(path: Path, options: ReadOptions) -> Episode:
    """Read a C3D file, one signal per point."""
    with open_regular(path) as file:
        data = file.read(_HEADER_BYTES)
        at = (data[0] - 1) * _BLOCK_BYTES
        if len(data) < at + 4 or data[at + 3] not in _PROCESSORS:
            raise LogError(f"{path}: is {_WHAT} that ends before its parameters", EXPORT_AGAIN)
        header = _Header(_PROCESSORS[data[at + 3]])
        words = [int(one) & 0xFFFF for one in header.words(data[:24])]
        scale, rate_hz = (float(header.floats(data[one : one + 4])[0]) for one in (12, 20))
        parameters = _parameters(data, at, header)
        points, analogs, first, last = words[1:5]
        header = _Header(
            header.processor, points, analogs, first, last, scale, words[8], rate_hz, parameters
        )
        if not 0 < header.points <= MAX_COLUMNS // 3:
            raise LogError(
                f"{path}: is {_WHAT} of {header.points} points (1 to {MAX_COLUMNS // 3} can be)",
                "export the ball's marker alone",
            )
        stated = _frames(header)
        tracks, used = _tracks(header, stated)
        rows = TrackRows(path, tracks)
        said = header.values("POINT", "DATA_START")
        block = header.data_block or int(said[0] if said and said[0] == said[0] else 0)
        start = (max(2, block) - 1) * _BLOCK_BYTES
        width, is_float = 4 * header.points + header.analogs, scale < 0
        frame_bytes = width * (4 if is_float else 2)  # its analog samples included
        frames = min(stated, max(0, file.seek(0, 2) - start) // frame_bytes)
        file.seek(start)
        at_once = max(1, _READ_BYTES // frame_bytes)
        for first in range(0, frames, at_once):
            data = file.read(min(at_once, frames - first) * frame_bytes)
            data = data[: len(data) // frame_bytes * frame_bytes]
            # Each point is x, y, z and a residual, which is negative where it was not seen.
            cells = (header.floats(data) if is_float else header.words(data)).reshape(-1, width)
            cells = cells[:, : 4 * header.points].reshape(-1, header.points, 4)
            with np.errstate(invalid="ignore", over="ignore"):
                xyz = cells[:, :, :3].astype(np.float64) * (1.0 if is_float else scale)
                xyz[~(cells[:, :, 3] >= 0)] = np.nan
            numbers = header.first_frame + np.arange(first, first + len(xyz), dtype=np.float64)
            places = xyz[:, used].reshape(len(xyz), 3 * len(used))
            rows.add(range(1 + 3 * len(used)), np.column_stack([numbers, places]))
        return rows.episode(options)


def _parameters(data: bytes, start: int, numbers: _Header) -> dict[tuple[str, str], Value]:
    """Return all parameters of the section by group and name."""
    end = min(len(data), start + max(1, data[start + 2]) * _BLOCK_BYTES)
    groups: dict[int, str] = {}
    found: list[tuple[int, str, Value]] = []
    at = start + 4
    for _ in range(20_000):  # more than any file has
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
    return {(groups.get(group, ""), name): value for group, name, value in found}


def _value(data: bytes, numbers: _Header) -> Value | None:
    """Decode a parameter; None where it is truncated or of an unknown type."""
    kind, dimensions = struct.unpack_from("<bB", data) if len(data) > 1 else (0, 0)
    if kind not in _SIZES or dimensions > 7 or len(data) < 2 + dimensions:
        return None
    shape = tuple(data[2 : 2 + dimensions])
    count = math.prod(shape)
    body = data[2 + dimensions : 2 + dimensions + count * _SIZES[kind]]
    if len(body) < count * _SIZES[kind]:
        return None
    if kind == -1:
        width = shape[0] if len(shape) > 1 else count
        texts = [body[at : at + width] for at in range(0, count, width)] if width else []
        return tuple(text.decode("utf-8", "replace").rstrip(" \0") for text in texts)
    if kind == 4:
        return tuple(numbers.floats(body).tolist())
    return tuple(float(int(one) & 0xFFFF) for one in (numbers.words(body) if kind == 2 else body))


def _tracks(header: _Header, frames: int) -> tuple[MarkerTracks, list[int]]:
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
    rate_hz = (header.values("POINT", "RATE") or [header.rate_hz])[0]
    unit = unit_of("".join(header.texts("POINT", "UNITS")[:1]))
    found = [
        MarkerTrack(names[at], 1 + 3 * place, unit, is_unlabeled(names[at]))
        for place, at in enumerate(used)
    ]
    tracks = MarkerTracks(
        _WHAT,
        found,
        frame=0,
        rate_hz=rate_of(str(rate_hz)),
        frames=frames if frames < _UNKNOWN_FRAMES else None,
        zero_is_unseen=True,
        unused=unused,
    )
    return tracks, used


def _frames(header: _Header) -> int:
    """Return the number of frames stated, in any of the places where a file states it."""
    by_header = max(0, header.last_frame - header.first_frame + 1)
    start, end = (header.values("TRIAL", f"ACTUAL_{one}_FIELD") for one in ("START", "END"))
    if start and end:  # each a 32-bit number in two words, or one word
        ends = [one[0] + 65536 * one[1] if len(one) > 1 else one[0] for one in (start, end)]
        first, last = (
            one if math.isfinite(one) and 0 <= one < _UNKNOWN_FRAMES else 0.0 for one in ends
        )
        if last - first + 1 > by_header:
            return int(last - first + 1)
    for name in ("LONG_FRAMES", "FRAMES"):
        value = (header.values("POINT", name) or [0.0])[0]
        if math.isfinite(value) and by_header < value < _UNKNOWN_FRAMES:
            return int(value)
    # The header counts in 16 bits: it states the largest number where there are more.
    return by_header if header.last_frame < 0xFFFF else _UNKNOWN_FRAMES
