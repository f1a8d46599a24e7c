"""Parse header and parameters of a C3D file; every size is checked before it is trusted.

After the C3D user guide, https://www.c3d.org/docs/C3D_User_Guide.pdf.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

BLOCK_BYTES = 512  # of which positions in a file are counted, from 1
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
