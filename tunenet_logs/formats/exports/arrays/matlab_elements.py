"""Parse MAT-file elements of levels 4 and 5: numeric arrays, texts, and structs of these.

Written after MathWorks' "MAT-File Format". Nothing is executed, and every size is checked against
the bytes that are there.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_BYTES = 128 * 1024**2  # of a file, and of what is unpacked of it
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8"}
_TYPES |= {13: "u8", 16: "u1", 17: "u2", 18: "u4"}
"""How the numbers of an element are stored."""

_MATRIX, _COMPRESSED = 14, 15  # elements that hold others
_STRUCT = 2
_NUMBERS = range(6, 16)  # Classes of arrays that are read
_CLASSES = {1: "a cell array", 3: "an object", 4: "text", 5: "a sparse matrix", 16: "a function"}
_CLASSES |= {17: "a table, timetable or timeseries, which only MATLAB can read; save its columns"}
"""What others are."""

_MAX_DEPTH = 6  # of structs within structs
_MAX_ARRAYS = 5000  # in a file
_V4_TYPES = ("f8", "f4", "i4", "i2", "u2", "u1")
_V4_HEADER = 20  # bytes before a name


class DamagedMatlabError(ValueError):
    """Not a MAT-file, or a damaged one."""


class MatlabArrays:
    """Arrays of one MAT-file.

    Attributes:
        arrays: numeric arrays by name; struct fields by their names joined by dots.
        unused: other variables, with the reason.
    """

    def __init__(self) -> None:
        self.arrays: dict[str, NDArray[Any]] = {}
        self.unused: dict[str, str] = {}
        self._unpacked = 0

    def read_level5(self, data: bytes) -> None:
        """Parse all elements of a level 5 file.

        Raises:
            DamagedMatlabError: it is damaged, or too large.
        """
        order = "<" if data[126:128] == b"IM" else ">"
        for kind, content in _elements(memoryview(data)[128:], order):
            if kind == _COMPRESSED:
                for inner, unpacked in _elements(self._unpack(content), order):
                    if inner == _MATRIX:
                        self._matrix(unpacked, order, "", 0)
            elif kind == _MATRIX:
                self._matrix(content, order, "", 0)

    def _unpack(self, content: memoryview) -> memoryview:
        unpacker = zlib.decompressobj()
        try:
            data = unpacker.decompress(content, MAX_BYTES - self._unpacked + 1)
        except zlib.error as error:
            raise DamagedMatlabError(f"a packed variable is damaged ({error})") from error
        self._unpacked += len(data)
        if self._unpacked > MAX_BYTES:
            raise DamagedMatlabError(f"unpacked it is over the limit of {MAX_BYTES >> 20} MiB")
        return memoryview(data)

    def _matrix(self, content: memoryview, order: str, above: str, depth: int) -> None:
        """Parse one array; its own name is used unless it is a struct's field."""
        if len(self.arrays) + len(self.unused) >= _MAX_ARRAYS:
            raise DamagedMatlabError(f"it holds over {_MAX_ARRAYS} variables")
        parts = _elements(content, order)
        flags = _next(parts)
        kind = _word(flags, 0, order) & 0xFF if len(flags) >= 4 else 0
        if kind == 17:  # its name comes first
            name = above or _text(_next(parts)) or "unnamed"
            self.unused[name] = _CLASSES[kind]
            return
        shape = tuple(int(one) for one in np.frombuffer(_whole(_next(parts), 4), f"{order}i4"))
        own = _text(_next(parts))  # empty in a struct
        if not (name := above or own):  # MATLAB's own notes on objects
            return
        if kind == _STRUCT:
            self._struct(parts, order, name, shape, depth)
        elif kind in _NUMBERS:
            stored, values = next(parts, (0, memoryview(b"")))
            self.arrays[name] = _shaped(_numbers(stored, values, order), shape, name)
        else:
            self.unused[name] = _CLASSES.get(kind, "no array of numbers")

    def _struct(
        self,
        parts: Iterator[tuple[int, memoryview]],
        order: str,
        name: str,
        shape: tuple[int, ...],
        depth: int,
    ) -> None:
        if prod(shape) != 1:
            size = " x ".join(map(str, shape))
            self.unused[name] = f"an array of structs ({size}); save one of them"
            return
        if depth == _MAX_DEPTH:
            self.unused[name] = "structs within structs within structs; save the inner one"
            return
        length = _word(_next(parts), 0, order)
        if not 1 <= length <= 256:
            raise DamagedMatlabError(f"{name[:60]}: names of {length} characters")
        texts = _next(parts)
        fields = [_text(texts[at : at + length]) for at in range(0, len(texts), length)]
        for field, (kind, content) in zip(fields, parts, strict=False):
            if kind == _MATRIX and len(content):
                self._matrix(content, order, f"{name}.{field}", depth + 1)

    def read_level4(self, data: bytes) -> None:
        """Parse all arrays of a level 4 file.

        Raises:
            DamagedMatlabError: it is damaged.
        """
        at = 0
        while at < len(data):
            if len(self.arrays) + len(self.unused) >= _MAX_ARRAYS:
                raise DamagedMatlabError(f"it holds over {_MAX_ARRAYS} variables")
            at = self._level4_array(data, at)

    def _level4_array(self, data: bytes, at: int) -> int:
        """Parse the array at a byte and return the byte behind it."""
        if (found := level4_header(data, at)) is None:
            raise DamagedMatlabError(f"byte {at} begins no variable")
        order, stored, kind, (rows, columns, is_complex, length) = found
        begin = at + _V4_HEADER + length
        size = rows * columns * np.dtype(stored).itemsize
        end = begin + size * (2 if is_complex else 1)
        name = _text(memoryview(data)[at + _V4_HEADER : begin])
        if end > len(data):
            raise DamagedMatlabError(f"{name[:60]!r} claims {end - len(data)} bytes too many")
        if kind:
            self.unused[name] = _CLASSES[4] if kind == 1 else _CLASSES[5]
        else:
            flat = np.frombuffer(data[begin : begin + size], order + stored)
            self.arrays[name] = flat.reshape((rows, columns), order="F")
        return end


def level4_header(data: bytes, at: int = 0) -> tuple[str, str, int, tuple[int, ...]] | None:
    """Return byte order, type, kind and sizes of a level 4 array; None where none begins."""
    for order in "<>":
        if len(data) < at + _V4_HEADER:
            return None
        kind, *sizes = (int(one) for one in np.frombuffer(data[at : at + 20], f"{order}i4"))
        machine, rest = divmod(kind, 1000)
        fits = machine == (0 if order == "<" else 1) and rest < 100 and rest % 10 < 3
        fits = fits and 1 < sizes[3] <= 256 and sizes[2] in (0, 1) and min(sizes) >= 0
        if fits and rest // 10 < len(_V4_TYPES):
            return order, _V4_TYPES[rest // 10], rest % 10, tuple(sizes)
    return None


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Yield type and content of each element; raise where one overruns the data."""
    at = 0
    while at + 8 <= len(data):
        kind = _word(data, at, order)
        if kind >> 16:  # up to four bytes, in the tag
            size = kind >> 16
            if size > 4:
                raise DamagedMatlabError(f"an element claims {size} bytes in four")
            yield kind & 0xFFFF, data[at + 4 : at + 4 + size]
            at += 8
            continue
        size = _word(data, at + 4, order)
        if at + 8 + size > len(data):
            raise DamagedMatlabError(
                f"an element claims {size} bytes, {len(data) - at - 8} are there"
            )
        yield kind, data[at + 8 : at + 8 + size]
        at += 8 + size + (-size % 8 if kind != _COMPRESSED else 0)


def _word(data: memoryview, at: int, order: str) -> int:
    return int.from_bytes(data[at : at + 4], "little" if order == "<" else "big")


def _next(parts: Iterator[tuple[int, memoryview]]) -> memoryview:
    found = next(parts, None)
    if found is None:
        raise DamagedMatlabError("a variable is cut short")
    return found[1]


def _text(data: memoryview) -> str:
    return bytes(data).partition(b"\0")[0].decode("utf-8", "replace")


def _whole(data: memoryview, size: int) -> memoryview:
    return data[: len(data) // size * size]


def _numbers(stored: int, data: memoryview, order: str) -> NDArray[Any]:
    if stored not in _TYPES:
        return np.zeros(0)
    dtype = np.dtype(order + _TYPES[stored])
    return np.frombuffer(_whole(data, dtype.itemsize), dtype)


def _shaped(values: NDArray[Any], shape: tuple[int, ...], name: str) -> NDArray[Any]:
    if min(shape, default=0) < 0 or prod(shape) != len(values):
        size = " x ".join(map(str, shape[:8]))
        raise DamagedMatlabError(f"{name[:60]!r} is {size}, with {len(values)} numbers")
    return values.reshape([one for one in shape if one != 1] or [1], order="F")
