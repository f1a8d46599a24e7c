"""Read named arrays and records: JSON and NumPy (.npy, .npz) files.

JSON holds one record per line, one array of records, or one list per column; its values are
streamed. NumPy arrays are checked before anything is allocated, and never unpickled.
"""

from __future__ import annotations

import gc
import json
import math
import re
import struct
import warnings
import zipfile
import zlib
from array import array
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from tunenet_logs.episode import Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.files import open_regular, open_regular_text
from tunenet_logs.formats.columns.cells import MAX_COLUMNS, UNIT_ROWS, number_of, text_encoding
from tunenet_logs.formats.columns.names import spread_names
from tunenet_logs.formats.columns.plan import (
    plan_columns,
)
from tunenet_logs.formats.columns.signals import (
    told_apart,
)
from tunenet_logs.formats.columns.table import (
    MAX_ARRAY_BYTES,
    MAX_ROWS,
    Table,
    check_rows,
    episode_of_columns,
    episode_of_table,
    number_names,
)
from tunenet_logs.formats.kinds import Start
from tunenet_logs.formats.options import ReadOptions

_CHUNK = 262_144  # characters read at a time
_MAX_VALUE = 8 * 1024**2  # characters of one value: in memory it may take 50 times that
_BETWEEN = re.compile(r"[ \t\r\n,]*")  # values


class NumberText(str):
    """A decimal number as written, so that a time loses no digits."""

    __slots__ = ()


def _json_values(path: Path, losses: list[str]) -> Iterator[Any]:
    """Yield the values of a file: JSON lines, concatenated values, or the items of one array.

    Numbers with decimals are `NumberText`. The first damaged value ends them, as a loss.
    """
    # Python and MATLAB write NaN and Infinity.
    decoder = json.JSONDecoder(parse_float=NumberText, parse_constant=lambda _: math.nan)
    count, was_on = 0, gc.isenabled()
    with open_regular_text(path, text_encoding(path), errors="replace") as file:
        text = file.read(_CHUNK).lstrip(" \t\r\n\ufeff")
        is_array = text.startswith("[")
        at = int(is_array)
        while True:
            at = _BETWEEN.match(text, at).end()  # type: ignore[union-attr]
            if at == len(text):
                text, at = file.read(_CHUNK), 0
                if text:
                    continue
                return
            if is_array and text[at] == "]":
                return
            length, why = len(text) - at, ""
            value, end = None, at
            gc.disable()  # of millions of lists, its search for cycles takes most time
            try:
                value, end = decoder.raw_decode(text, at)
            except RecursionError:
                why = "is nested too deeply"
            except ValueError as error:
                is_json = isinstance(error, json.JSONDecodeError)
                why = error.msg.lower() if is_json else "a number of too many digits"
                why = f"is no JSON ({why})"
                if length > _MAX_VALUE:
                    why = f"is larger than {_MAX_VALUE >> 20} MiB, or no JSON"
                elif more := file.read(max(_CHUNK, length)):
                    text, at = text[at:] + more, 0
                    continue
            else:
                if end == len(text) and (more := file.read(_CHUNK)):  # a number may go on
                    text, at = text[at:] + more, 0
                    continue
            finally:
                if was_on:
                    gc.enable()
            count += 1
            if why and count == 1:
                raise LogError(f"{path}: value {count} {why}", EXPORT_AGAIN)
            if why:
                losses.append(f"value {count} {why}: what follows it was left out")
                return
            yield value
            at = end


# ---- JSON records.

_SUFFIXES = (".json", ".jsonl", ".ndjson")
# Begins JSON under another name: no other text begins so.
_JSON = re.compile(r'\s*(?:\{\s*"|\[\s*[\[{])')
_MAX_DEPTH = 6  # of names within names
_MIN_SAMPLES = 10  # of a motion, as lists side by side
_MAX_MOTION_ROWS = 200_000  # of all motions: each becomes an object
_MAX_LIST = 64  # values of a list whose places are columns, such as an arm's joints
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
    """Read records with a time and a position or joints; nested names are joined by dots."""
    if (size := path.stat().st_size) > 256 * 1024**2:  # its values are read one by one, in Python
        raise LogError(f"{path}: has {size} bytes, over the limit of 256 MiB of JSON; split it")
    losses: list[str] = []
    values = _json_values(path, losses)
    first = list(islice(values, UNIT_ROWS))
    if len(first) == 1 and isinstance(first[0], dict):
        return _read_document(path, first[0], options)
    return _read_records(path, chain(first, values), first, options, losses)


TUNINGS_USE = "name the log it is of, or give it to tunenet-export or tunenet-report"


def _read_document(path: Path, document: dict[str, Any], options: ReadOptions) -> Episode:
    """Read one object: a list of records, or one list per column; note what else it states."""
    episode = _rows_of_document(path, document, options)
    stated = {
        f"stated {name[:60]}": str(value)[:60]
        for name, value in islice(_columns_of(document, ""), 50)
        if isinstance(value, str | int | float)
    }
    notes = {**episode.info.notes, **stated}
    return replace(episode, info=replace(episode.info, notes=notes))


def _rows_of_document(path: Path, document: dict[str, Any], options: ReadOptions) -> Episode:
    if {"task", "verdict", "provenance"} <= document.keys():
        raise LogError(f"{path}: is a tuning that tunenet-tune wrote", TUNINGS_USE)
    for value in document.values():
        if rows := _rows_of_motions(value):
            return _read_records(
                path, iter(rows), rows[:UNIT_ROWS], options, [], _rate_of(document)
            )
    records = max(
        (value for value in document.values() if _is_records(value)), key=len, default=None
    )
    if records is not None:
        # Records that each hold a list of records are flattened, their lists numbered as runs.
        inner = next((key for key, value in records[0].items() if _is_records(value)), None)
        rows = (
            records
            if inner is None
            else [
                {**row, "run": number}
                for number, record in enumerate(records, 1)
                if isinstance(record, dict) and _is_records(record.get(inner))
                for row in record[inner]
                if isinstance(row, dict)
            ]
        )
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


def _rows_of_motions(value: object) -> list[dict[str, Any]]:
    """Return the rows of motions that each hold lists of one length; empty for others."""
    motions = value if isinstance(value, list) else []
    found: list[dict[str, Any]] = []
    for number, motion in enumerate(motions, 1):
        if not isinstance(motion, dict):
            return []
        lists = {key: one for key, one in motion.items() if isinstance(one, list)}
        count = max(map(len, lists.values()), default=0)
        columns = {key: one for key, one in lists.items() if len(one) == count}
        if count < _MIN_SAMPLES or len(columns) < 2 or len(found) + count > _MAX_MOTION_ROWS:
            return []
        rows = zip(*columns.values(), strict=True)
        found += [
            {"run": number, "frame": at, **dict(zip(columns, cells, strict=True))}
            for at, cells in enumerate(rows)
        ]
    return found


def _rate_of(document: dict[str, Any]) -> float | None:
    """Return the rate of rows [Hz] that a document states; None where it states none, or two."""
    found = {
        float(value)
        for name, value in _columns_of(document, "")
        if type(value) in (int, float) and re.fullmatch(r"fps|.*(?:^|[._])(?:hz|rate)", name, re.I)
    }
    rate = found.pop() if len(found) == 1 else 0.0
    return rate if 0.01 < rate < 1e6 else None


def _is_records(value: object) -> bool:
    return isinstance(value, list) and len(value) >= 3 and isinstance(value[0], dict)


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
        return np.array(number_of(value))
    if not isinstance(value, list) or not value:
        return None
    widths = {len(row) if isinstance(row, list) else 0 for row in value}
    if widths == {0} and any(type(one) is str for one in value):  # a float loses a time's digits
        return np.array([str(one)[:60] for one in value])
    if widths == {0}:
        whole = _whole(value)
        return np.array([number_of(one) for one in value]) if whole is None else whole
    if len(widths) > 1 or max(widths) > _MAX_LIST:
        return None
    return np.array([[number_of(one) for one in row] for row in value], np.float64)


def _whole(values: list[Any]) -> NDArray[np.int64] | None:
    """Return values as integers where all are, shape (T,)."""
    are_whole = all(type(one) is int and abs(one) < 2**62 for one in values)
    return np.array(values, np.int64) if are_whole else None


def _read_records(
    path: Path,
    records: Iterator[Any],
    first: list[Any],
    options: ReadOptions,
    losses: list[str],
    rate_hz: float | None = None,
) -> Episode:
    paths = list(dict.fromkeys(one for record in first for one in _paths(record, (), 0)))
    names, meant = _names(paths)
    plan = plan_columns(path, names, options, meant, rate_hz=rate_hz)
    if not options.columns:
        plan = told_apart(plan, [[_cell(_at(one, keys)) for keys in paths] for one in first])
    exact = {at for clock in plan.clocks for at in clock.indices}
    exact.update(at for at, _ in plan.runs)
    texts: dict[int, list[Any]] = {at: [] for at in exact}
    numbers = {at: array("d") for at in plan.needed if at not in exact}
    adders: list[tuple[_Path, Callable[[Any], None]]] = [
        *((paths[at], texts[at].append) for at in texts),
        *(
            (paths[at], lambda value, add=of.append: add(number_of(value)))
            for at, of in numbers.items()
        ),
    ]
    for count, record in enumerate(records, 1):
        if count > MAX_ROWS:
            check_rows(path, count, plan)
        for keys, add in adders:
            add(_at(record, keys))
    arrays: dict[int, NDArray[Any]] = {
        at: np.frombuffer(values, np.float64) for at, values in numbers.items()
    }
    for at, values in texts.items():
        whole = _whole(values)
        arrays[at] = np.array([_cell(one) for one in values], object) if whole is None else whole
    more: dict[str, Any] = {"losses": losses, "rate_hz": rate_hz}
    return episode_of_columns(path, "JSON records", plan, arrays, options, **more)


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
_MAX_ARRAYS = 5000  # in a file
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
    """Read arrays named like columns: t, z, ball (T, 3), q and tau (T, J)."""
    unused: dict[str, str] = {}
    try:
        with open_regular(path) as file:
            is_single = file.read(len(_NPY)) == _NPY
            file.seek(0)
            array = _array(file, path.stat().st_size, MAX_ARRAY_BYTES) if is_single else None
        arrays = _members(path, unused) if array is None else {path.stem: array}
    except _DAMAGED as error:
        why = str(error).partition("\n")[0][:120]
        if isinstance(error, _RefusedError):
            raise LogError(f"{path}: {why}", "save it again, as numbers alone") from error
        raise LogError(f"{path}: NumPy's file is damaged ({why}); save it again") from error
    if array is not None and array.dtype.names is None:
        arrays = number_names(array, path, options)
    what = "NumPy arrays" if array is None else "NumPy array"
    return episode_of_table(path, Table(what, arrays, unused=unused), options)


def _members(path: Path, unused: dict[str, str]) -> dict[str, NDArray[Any]]:
    """Read the arrays of an .npz, adding refused ones to `unused`."""
    if (size := path.stat().st_size) > 1024**3:
        raise _RefusedError(f"has {size} bytes, over the limit of 1 GiB; save fewer arrays")
    arrays: dict[str, NDArray[Any]] = {}
    left = MAX_ARRAY_BYTES
    with open_regular(path) as packed:
        if (listed := directory_bytes(packed, size)) is None:
            raise ValueError("its end is missing")
        if listed > 1024**2:  # `zipfile` reads all at once: a MiB lists some 10,000 members
            raise _RefusedError("holds more arrays than can be read; save fewer")
        archive = zipfile.ZipFile(packed)
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


def directory_bytes(file: IO[bytes], size: int) -> int | None:
    """Return the size of a zip's list of files, as its end states it; None without an end."""
    file.seek(max(0, size - 65_735))  # a comment of 65,535 bytes may end it
    tail = file.read()
    at, at64 = tail.rfind(b"PK\x05\x06"), tail.rfind(b"PK\x06\x06")
    if at < 0 or at + 22 > len(tail):
        return None
    stated = int.from_bytes(tail[at + 12 : at + 16], "little")
    if at64 >= 0:
        stated = max(int.from_bytes(tail[at64 + 40 : at64 + 48], "little"), stated % 0xFFFFFFFF)
    return stated


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
    size = math.prod(shape) * dtype.itemsize
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
