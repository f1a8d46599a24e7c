"""Read JSON records: one per line, one array of them, or one list per column."""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Iterator, Mapping
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.formats.exports.arrays.array_columns import arrays_episode
from tunenet_logs.formats.exports.arrays.column_plan import plan_columns, spread_names
from tunenet_logs.formats.exports.arrays.json_records import DamagedJsonError, json_values
from tunenet_logs.formats.exports.arrays.named_columns import MAX_ROWS, check_rows, columns_episode
from tunenet_logs.formats.exports.start import Start
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.layout import MAX_COLUMNS

_SUFFIXES = (".json", ".jsonl", ".ndjson")

# How it begins under another name: no other text does.
_JSON = re.compile(r'\s*(?:\{\s*"|\[\s*[\[{])')

_MAX_BYTES = 256 * 1024**2  # of a file: its values are read one by one, in Python
_LOOK_RECORDS = 100  # whose names are the columns
_MAX_DEPTH = 6  # of names within names
_MAX_LIST = 64  # values of a list that are columns: an arm's joints; a longer one is something else
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
    if (size := path.stat().st_size) > _MAX_BYTES:
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
