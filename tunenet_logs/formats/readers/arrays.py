"""Read named arrays and records: JSON and NumPy (.npy, .npz) files.

JSON holds one record per line, one array of records, or one list per column; its values are
streamed. NumPy arrays are checked before anything is allocated, and never unpickled.
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
from tunenet_logs.formats.columns.cells import MAX_COLUMNS, UNIT_ROWS, text_encoding
from tunenet_logs.formats.columns.names import spread_names
from tunenet_logs.formats.columns.table import (
    MAX_ARRAY_BYTES,
    MAX_ROWS,
    Table,
    check_rows,
    episode_of_columns,
    episode_of_table,
    number_names,
    plan_columns,
    told_apart,
)
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
_MAX_DEPTH = 6  # of names within names
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
    first = list(islice(values, UNIT_ROWS))
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
        return _read_records(path, iter(rows), rows[:UNIT_ROWS], options, [])
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
    return episode_of_table(path, Table("JSON", lists, unused=unused), options)


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
    path: Path, records: Iterator[Any], first: list[Any], options: ReadOptions, losses: list[str]
) -> Episode:
    paths = list(dict.fromkeys(one for record in first for one in _paths(record, (), 0)))
    names, meant = _names(paths)
    plan = plan_columns(path, names, options, meant)
    if not options.columns:
        plan = told_apart(plan, [[_cell(_at(one, keys)) for keys in paths] for one in first])
    exact = {at for clock in plan.clocks for at in clock.indices}
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
    return episode_of_columns(path, "JSON records", plan, arrays, options, losses=losses)


def _adder(values: array[float]) -> Callable[[Any], None]:
    def add(value: object) -> None:
        values.append(_number(value))

    return add


def _times(values: list[Any]) -> NDArray[Any]:
    """Return times as integers where all are, else as written."""
    if all(type(one) is int and abs(one) < 2**62 for one in values):
        return np.array(values, np.int64)
    made = np.empty(len(values), object)
    made[:] = list(map(_cell, values))
    return made


def _cell(value: object) -> str:
    return "" if value is None or isinstance(value, dict | list) else str(value)[:60]


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


# ---- NumPy arrays (.npy, .npz).

_NPY = b"\x93NUMPY"
_ZIP = b"PK\x03\x04"
_MAX_FILE_BYTES = 1024**3  # of an .npz; its arrays may have less
_MAX_ARRAYS = 5000  # in a file
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
    return episode_of_table(path, Table("NumPy arrays", arrays, unused=unused), options)


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
    return episode_of_table(path, Table("NumPy array", named), options)


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
