"""Read named arrays and records: JSON, MATLAB (.mat) and NumPy (.npy, .npz) files.

JSON holds one record per line, one array of records, or one list per column; its values are
streamed. MAT-files of levels 4 and 5, also Octave's, are parsed here, after MathWorks' "MAT-File
Format". NumPy arrays are checked before anything is allocated, and never unpickled.
"""

from __future__ import annotations

import gc
import json
import re
import struct
import warnings
import zipfile
import zlib
from array import array
from collections.abc import Callable, Iterator, Mapping
from itertools import chain, islice
from math import prod
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any, TextIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from tunenet_logs.episode import Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.files import open_regular, open_regular_text
from tunenet_logs.formats.columns.arrays import (
    MAX_ARRAY_BYTES,
    MAX_ROWS,
    arrays_episode,
    check_rows,
    columns_episode,
    number_names,
    plan_columns,
    spread_names,
)
from tunenet_logs.formats.columns.cells import text_encoding
from tunenet_logs.formats.columns.table import MAX_COLUMNS
from tunenet_logs.formats.kinds import Start
from tunenet_logs.formats.options import ReadOptions

_CHUNK = 262_144  # characters read at a time
_MAX_VALUE = 8 * 1024**2  # characters of one value: in memory it may take 50 times that


class DamagedJsonError(ValueError):
    """Invalid JSON, or a value over the size limit."""


class NumberText(str):
    """A decimal number as written, so that a time loses no digits."""

    __slots__ = ()


def json_values(path: Path) -> Iterator[Any]:
    """Yield the values of a file: JSON lines, concatenated values, or the items of one array.

    Numbers with decimals are `NumberText`.

    Raises:
        DamagedJsonError: invalid JSON from some place on, or a value that is too large.
        OSError: it cannot be read.
    """
    with open_regular_text(path, text_encoding(path), errors="replace") as file:
        window = _Window(file)
        is_array = window.next_mark(" \t\r\n\ufeff") == "["
        if is_array:
            window.at += 1
        while mark := window.next_mark(" \t\r\n,"):
            if is_array and mark == "]":
                return
            yield window.value()


class _Window:
    """Sliding window over a text file; `at` is the index of its next character."""

    def __init__(self, file: TextIO) -> None:
        self.at = 0
        self._file = file
        self._text = file.read(_CHUNK)
        self._decoder = json.JSONDecoder(parse_float=NumberText, parse_constant=_no_number)
        self._count = 0

    def next_mark(self, skipped: str) -> str:
        """Skip the given characters and return the next one; "" at the end."""
        while True:
            text, at = self._text, self.at
            while at < len(text) and text[at] in skipped:
                at += 1
            self.at = at
            if at < len(text) or not self._grow(_CHUNK):
                return text[at : at + 1]

    def value(self) -> Any:
        """Decode the value that begins here and move behind it.

        Raises:
            DamagedJsonError: there is none, or it is too large.
        """
        self._count += 1
        while True:
            try:
                value, end = self._decoded()
            except RecursionError as error:
                raise DamagedJsonError(f"value {self._count} is nested too deeply") from error
            except ValueError as error:
                length = len(self._text) - self.at
                if length > _MAX_VALUE or not self._grow(max(_CHUNK, length)):
                    raise DamagedJsonError(self._why(error, length)) from error
                continue
            if end == len(self._text) and self._grow(_CHUNK):
                continue  # a number may go on
            self.at = end
            return value

    def _decoded(self) -> tuple[Any, int]:
        """Decode the value that begins here; return it with its end.

        Without garbage collection: of millions of lists, its search for cycles takes most time.
        """
        was_on = gc.isenabled()
        gc.disable()
        try:
            return self._decoder.raw_decode(self._text, self.at)
        finally:
            if was_on:
                gc.enable()

    def _grow(self, count: int) -> bool:
        """Read more of the file, dropping what is consumed."""
        more = self._file.read(count)
        self._text, self.at = self._text[self.at :] + more, 0
        return bool(more)

    def _why(self, error: ValueError, length: int) -> str:
        if length > _MAX_VALUE:
            return f"value {self._count} is larger than {_MAX_VALUE >> 20} MiB, or no JSON"
        is_json = isinstance(error, json.JSONDecodeError)
        what = error.msg.lower() if is_json else "a number of too many digits"
        return f"value {self._count} is no JSON ({what})"


def _no_number(_name: str) -> float:
    """Return NaN for NaN and Infinity, which Python and MATLAB write."""
    return float("nan")


# ---- JSON records.

_SUFFIXES = (".json", ".jsonl", ".ndjson")

# Begins JSON under another name: no other text begins so.
_JSON = re.compile(r'\s*(?:\{\s*"|\[\s*[\[{])')

_MAX_JSON_BYTES = 256 * 1024**2  # its values are read one by one, in Python
_LOOK_RECORDS = 100  # whose names are the columns
_MAX_DEPTH = 6  # of names within names, and of MATLAB's structs within structs
_MAX_LIST = 64  # values of a list whose places are columns, such as an arm's joints
_MIN_ROWS = 3  # of a list that is a column
_Path = tuple[str | int, ...]  # keys and indices that lead to a value


def is_json_lines(start: Start) -> bool:
    """Return whether a file holds JSON values."""
    if not start.lines:
        return False
    if start.suffix not in _SUFFIXES:
        return _JSON.match("\n".join(start.lines[:3])) is not None
    first = next((line.strip() for line in start.lines if line.strip()), "")
    return first[:1] in ("{", "[")


def read_json_lines(path: Path, options: ReadOptions) -> Episode:
    """Read records with a time and a position or joints; nested names are joined by dots.

    Raises:
        LogError: it is damaged, too large, or its names do not say what it holds.
        OSError: it cannot be read.
    """
    if (size := path.stat().st_size) > _MAX_JSON_BYTES:
        raise LogError(f"{path}: has {size} bytes, over the limit of 256 MiB of JSON; split it")
    losses: list[str] = []
    values = _until_damage(path, json_values(path), losses)
    first = list(islice(values, _LOOK_RECORDS))
    if len(first) == 1 and isinstance(first[0], dict):
        return _read_document(path, first[0], options)
    return _read_records(path, chain(first, values), first, options, losses)


def _until_damage(path: Path, values: Iterator[Any], losses: list[str]) -> Iterator[Any]:
    """Yield values up to the first damaged one, which is recorded as a loss."""
    count = 0
    try:
        for value in values:
            count += 1
            yield value
    except DamagedJsonError as error:
        if not count:
            raise LogError(f"{path}: {error}", EXPORT_AGAIN) from error
        losses.append(f"{error}: what follows it was left out")


def _read_document(path: Path, document: dict[str, Any], options: ReadOptions) -> Episode:
    """Read one object: a list of records in it, or one list per column."""
    if {"task", "verdict", "provenance"} <= document.keys():
        raise LogError(f"{path}: is a tuning that tunenet-tune wrote", "name the log it is of")
    records = max(
        (value for value in document.values() if _is_records(value)), key=len, default=None
    )
    if records is not None:
        rows = _unrolled(records)
        return _read_records(path, iter(rows), rows[:_LOOK_RECORDS], options, [])
    lists: dict[str, NDArray[Any]] = {}
    unused: dict[str, str] = {}
    for name, value in _columns_of(document, ""):
        if (made := _as_array(value)) is not None:
            lists[name] = made
        elif len(unused) < MAX_COLUMNS:
            unused[name] = "no list of numbers"
    if not lists:
        raise LogError(
            f"{path}: is one JSON object without records over time (it has: "
            f"{', '.join(list(map(str, document))[:8])[:200]})",
            "write one list of numbers for time and each of x, y, z",
        )
    return arrays_episode(path, "JSON", lists, options, unused)


def _unrolled(records: list[Any]) -> list[Any]:
    """Flatten records that each hold a list of records, numbering the lists as runs."""
    inner = next((key for key, value in records[0].items() if _is_records(value)), None)
    if inner is None:
        return records
    return [
        {**row, "run": number}
        for number, record in enumerate(records, 1)
        if isinstance(record, dict) and _is_records(record.get(inner))
        for row in record[inner]
        if isinstance(row, dict)
    ]


def _is_records(value: object) -> bool:
    return isinstance(value, list) and len(value) >= _MIN_ROWS and isinstance(value[0], dict)


def _columns_of(value: dict[str, Any], prefix: str, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield the lists and numbers in an object, by their joined names."""
    for key, inner in islice(value.items(), MAX_COLUMNS):
        name = f"{prefix}{key}"
        if not isinstance(inner, dict):
            yield name, inner
        elif inner and all(one.isdecimal() for one in islice(inner, 10)):  # rows by their number
            yield name, list(inner.values())
        elif depth < _MAX_DEPTH:
            yield from _columns_of(inner, f"{name}.", depth + 1)


def _as_array(value: object) -> NDArray[Any] | None:
    """Return a list as a 1-D or 2-D array; None where it is not of numbers or texts."""
    if isinstance(value, int | float | str) and not isinstance(value, bool):
        return np.array(_number(value))
    if not isinstance(value, list) or not value:
        return None
    widths = {len(row) if isinstance(row, list) else 0 for row in value}
    if widths == {0}:
        return _column(value)
    if len(widths) > 1 or max(widths) > _MAX_LIST:
        return None
    return np.array([[_number(one) for one in row] for row in value], np.float64)


def _column(values: list[Any]) -> NDArray[Any]:
    """Return values as numbers, or as texts where a float would lose a time's digits."""
    if any(type(one) is str for one in values):
        return np.array([str(one)[:60] for one in values])
    if all(type(one) is int and abs(one) < 2**62 for one in values):
        return np.array(values, np.int64)
    return np.array([_number(one) for one in values], np.float64)


def _number(value: object) -> float:
    """Return a value as a number, NaN where it is none."""
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return float("nan")


def _read_records(
    path: Path,
    records: Iterator[Any],
    first: list[Any],
    options: ReadOptions,
    losses: list[str],
) -> Episode:
    paths = list(dict.fromkeys(one for record in first for one in _paths(record, (), 0)))
    names, meant = _names(paths)
    plan = plan_columns(path, names, options, meant)
    clocks = [plan.clock, plan.impacts, *(signal.clock for signal in plan.signals)]
    exact = {at for clock in clocks if clock is not None for at in clock.indices}
    exact.update(at for at, _ in plan.runs)
    texts: dict[int, list[Any]] = {at: [] for at in exact}
    numbers = {at: array("d") for at in plan.needed if at not in exact}
    adders: list[tuple[_Path, Callable[[Any], None]]] = [
        *((paths[at], texts[at].append) for at in texts),
        *((paths[at], _adder(numbers[at])) for at in numbers),
    ]
    for count, record in enumerate(records, 1):
        if count > MAX_ROWS:
            check_rows(path, count, plan)
        for keys, add in adders:
            add(_at(record, keys))
    arrays: dict[int, NDArray[Any]] = {at: _times(values) for at, values in texts.items()}
    arrays |= {at: np.frombuffer(values, np.float64) for at, values in numbers.items()}
    return columns_episode(path, "JSON records", plan, arrays, options, losses=losses)


def _adder(values: array[float]) -> Callable[[Any], None]:
    def add(value: object) -> None:
        values.append(_number(value))

    return add


def _times(values: list[Any]) -> NDArray[Any]:
    """Return times as integers where all are, else as written."""
    if all(type(one) is int and abs(one) < 2**62 for one in values):
        return np.array(values, np.int64)
    made = np.empty(len(values), object)
    made[:] = ["" if isinstance(one, dict | list) else str(one)[:60] for one in values]
    return made


def _paths(value: object, above: _Path, depth: int) -> Iterator[_Path]:
    """Yield the paths to an object's numbers and texts."""
    if isinstance(value, Mapping):
        if depth < _MAX_DEPTH:
            for key, inner in islice(value.items(), MAX_COLUMNS):
                yield from _paths(inner, (*above, key), depth + 1)
    elif isinstance(value, list):
        if len(value) <= _MAX_LIST and not any(isinstance(one, dict | list) for one in value):
            for at in range(len(value)):
                yield (*above, at)
    else:
        yield above


def _names(paths: list[_Path]) -> tuple[list[str], list[str]]:
    """Return the columns' names, and those to interpret: a list of three is x, y, z."""
    widths: dict[_Path, int] = {}
    for keys in paths:
        if keys and isinstance(keys[-1], int):
            widths[keys[:-1]] = max(widths.get(keys[:-1], 0), keys[-1] + 1)
    spread = {above: spread_names(_joined(above), width) for above, width in widths.items()}
    names: list[str] = []
    meant: list[str] = []
    for keys in paths:
        if keys and isinstance(keys[-1], int):
            own, said = spread[keys[:-1]]
            names.append(own[keys[-1]])
            meant.append(said[keys[-1]])
        else:
            names.append(_joined(keys))
            meant.append(names[-1])
    return names, meant


def _joined(keys: _Path) -> str:
    return ".".join(map(str, keys))[:200] or "value"


def _at(record: Any, keys: _Path) -> Any:
    """Return a record's value at a path; None where it is absent."""
    try:
        for key in keys:
            record = record[key]
    except (KeyError, IndexError, TypeError):
        return None
    return record


# ---- MAT-file elements of levels 4 and 5: numeric arrays, texts, and structs of these.
# Nothing is executed, and every size is checked against the bytes that are there.

_MAX_MATLAB_BYTES = 128 * 1024**2  # of a file, and of what is unpacked of it
# NumPy types of the numbers of an element.
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8"}
_TYPES |= {13: "u8", 16: "u1", 17: "u2", 18: "u4"}
_MATRIX, _COMPRESSED = 14, 15  # elements that hold others
_STRUCT = 2
_NUMBERS = range(6, 16)  # classes of arrays that are read
# All other classes.
_CLASSES = {1: "a cell array", 3: "an object", 4: "text", 5: "a sparse matrix", 16: "a function"}
_CLASSES |= {17: "a table, timetable or timeseries, which only MATLAB can read; save its columns"}
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
            data = unpacker.decompress(content, _MAX_MATLAB_BYTES - self._unpacked + 1)
        except zlib.error as error:
            raise DamagedMatlabError(f"a packed variable is damaged ({error})") from error
        self._unpacked += len(data)
        if self._unpacked > _MAX_MATLAB_BYTES:
            raise DamagedMatlabError(
                f"unpacked it is over the limit of {_MAX_MATLAB_BYTES >> 20} MiB"
            )
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


# ---- Variables saved by MATLAB or Octave (.mat).

_LEVEL5 = b"MATLAB 5.0 MAT-file"
_LEVEL73 = b"MATLAB 7.3 MAT-file"
_HDF5 = b"\x89HDF\r\n"

_REMEDY = "save it with `save('FILE.mat', '-v7')`"


def is_matlab_file(start: Start) -> bool:
    """Return whether a file holds MATLAB variables."""
    return start.data.startswith((_LEVEL5, _LEVEL73)) or start.suffix == ".mat"


def read_matlab_file(path: Path, options: ReadOptions) -> Episode:
    """Read variables named like columns: t, z, ball (T x 3), q and tau (T x J), also in structs.

    Raises:
        LogError: it is of version 7.3, damaged, too large, or its names do not say what it holds.
        OSError: it cannot be read.
    """
    if (size := path.stat().st_size) > _MAX_MATLAB_BYTES:
        raise LogError(
            f"{path}: has {size} bytes, over the limit of {_MAX_MATLAB_BYTES >> 20} MiB; save "
            "fewer variables"
        )
    with open_regular(path) as file:
        data = file.read()
    if data.startswith((_LEVEL73, _HDF5)):
        raise LogError(f"{path}: is a MATLAB file of version 7.3, which is not read; {_REMEDY}")
    found = MatlabArrays()
    try:
        if data[124:128] and data[126:128] in (b"IM", b"MI") and not level4_header(data):
            found.read_level5(data)
        elif level4_header(data) is not None:
            found.read_level4(data)
        else:
            raise LogError(f"{path}: is no MATLAB file, despite its name; {_REMEDY}")
    except DamagedMatlabError as error:
        raise LogError(
            f"{path}: is a MATLAB file that cannot be read ({error}); {_REMEDY}"
        ) from error
    return arrays_episode(path, "MATLAB variables", found.arrays, options, found.unused)


# ---- NumPy arrays (.npy, .npz).

_NPY = b"\x93NUMPY"
_ZIP = b"PK\x03\x04"

_MAX_FILE_BYTES = 1024**3  # of an .npz; its arrays may have less
_MAX_DIRECTORY_BYTES = 1024**2  # of an .npz, which `zipfile` reads at once: some 10,000 members
# The record at a zip file's end: signature, ..., bytes and place of the list of members, ...
_END = struct.Struct("<4s4H2LH")

# What NumPy and `zipfile` raise at damaged files.
_DAMAGED = (ValueError, EOFError, KeyError, OverflowError, zlib.error, zipfile.BadZipFile)
_DAMAGED += (struct.error, SyntaxError, TypeError, RuntimeError, NotImplementedError, MemoryError)
_DAMAGED += (RecursionError, TokenError)


class _RefusedError(ValueError):
    """An intact array that is not supported."""


def is_numpy_file(start: Start) -> bool:
    """Return whether a file holds NumPy arrays."""
    if start.data.startswith(_NPY):
        return True
    if not start.data.startswith(_ZIP) or len(start.data) < 30:
        return False
    length = int.from_bytes(start.data[26:28], "little")
    return start.data[30 : 30 + length].endswith(b".npy")


def read_numpy_file(path: Path, options: ReadOptions) -> Episode:
    """Read arrays named like columns: t, z, ball (T, 3), q and tau (T, J).

    Raises:
        LogError: it is damaged, too large, or its names do not say what it holds.
        OSError: it cannot be read.
    """
    with open_regular(path) as file:
        if file.read(len(_NPY)) == _NPY:
            file.seek(0)
            return _read_single(path, file, options)
    unused: dict[str, str] = {}
    try:
        arrays = _members(path, unused)
    except _DAMAGED as error:
        raise _damaged(path, error) from error
    return arrays_episode(path, "NumPy arrays", arrays, options, unused)


def _damaged(path: Path, error: Exception) -> LogError:
    why = str(error).partition("\n")[0][:120]
    if isinstance(error, _RefusedError):
        return LogError(f"{path}: {why}", "save it again, as numbers alone")
    return LogError(f"{path}: NumPy's file is damaged ({why}); save it again")


def _read_single(path: Path, file: IO[bytes], options: ReadOptions) -> Episode:
    try:
        array = _array(file, path.stat().st_size, MAX_ARRAY_BYTES)
    except _DAMAGED as error:
        raise _damaged(path, error) from error
    named = (
        {path.stem: array} if array.dtype.names is not None else number_names(array, path, options)
    )
    return arrays_episode(path, "NumPy array", named, options, {})


def _members(path: Path, unused: dict[str, str]) -> dict[str, NDArray[Any]]:
    """Read the arrays of an .npz, adding refused ones to `unused`."""
    _check_directory(path)
    arrays: dict[str, NDArray[Any]] = {}
    left = MAX_ARRAY_BYTES
    with open_regular(path) as packed, zipfile.ZipFile(packed) as archive:
        members = [one for one in archive.infolist() if one.filename.endswith(".npy")]
        if len(members) > _MAX_ARRAYS:
            raise _RefusedError(f"holds {len(members)} arrays, over the limit of {_MAX_ARRAYS}")
        for member in members:
            name = member.filename.removesuffix(".npy")
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                unused[name] = "compressed in a way that NumPy does not use"
                continue
            try:
                with archive.open(member) as file:
                    arrays[name] = _array(file, member.file_size, left)
            except _RefusedError as error:
                unused[name] = str(error)
                continue
            left -= arrays[name].nbytes
    return arrays


def _check_directory(path: Path) -> None:
    """Refuse an archive whose directory is larger than arrays need, with a ValueError."""
    size = path.stat().st_size
    if size > _MAX_FILE_BYTES:
        raise _RefusedError(f"has {size} bytes, over the limit of 1 GiB; save fewer arrays")
    with open_regular(path) as file:
        file.seek(max(0, size - 65536 - _END.size))
        tail = file.read()
    at = tail.rfind(b"PK\x05\x06")
    if at < 0 or len(tail) < at + _END.size:
        raise ValueError("its end is missing")
    listed = _END.unpack_from(tail, at)[5]
    if listed > _MAX_DIRECTORY_BYTES or b"PK\x06\x07" in tail[max(0, at - 20) : at]:
        raise _RefusedError("holds more arrays than can be read; save fewer")


def _array(file: IO[bytes], there: int, most: int) -> NDArray[Any]:
    """Read one array, header first; raise ValueError if damaged, too large or of objects."""
    version = npy.read_magic(file)
    read_header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    if version not in read_header:
        raise _RefusedError(f"version {version} of NumPy's format is not read; save it again")
    with warnings.catch_warnings(action="ignore"):  # of a header that Python 2 wrote
        shape, is_fortran, dtype = read_header[version](file, max_header_size=10_000)
    if dtype.hasobject:
        raise _RefusedError("Python objects, which are never unpickled; save numbers")
    if any(length < 0 for length in shape) or len(shape) > 8:
        raise ValueError(f"shape {shape}")
    size = prod(shape) * dtype.itemsize
    if len(shape) > 2:
        raise _RefusedError(f"its shape {' x '.join(map(str, shape))} is no table's")
    if size > there:
        raise ValueError(f"{size} bytes are claimed, and not there")
    if size > most:
        raise _RefusedError(
            f"with it there are over {MAX_ARRAY_BYTES >> 20} MiB; save fewer numbers"
        )
    data = file.read(size)
    if len(data) < size:
        raise ValueError(f"{len(data)} of {size} bytes are there")
    flat = np.frombuffer(data, dtype) if dtype.itemsize else np.zeros(0, np.float64)
    return flat.reshape(shape, order="F" if is_fortran else "C")
