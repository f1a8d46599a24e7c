"""Interpret 1-D and 2-D arrays of one file as columns of equal length."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.exports.arrays.column_plan import plan_columns, spread_names
from tunenet_logs.formats.exports.arrays.named_columns import columns_episode
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.column_names import meaning_of
from tunenet_logs.formats.tables.meaning import TimeColumn, lowered, words_of

MAX_BYTES = 128 * 1024**2  # of all arrays of a file
_MAX_WIDTH = 200  # columns of one array
_MIN_ROWS = 3  # of an array that is no setting
# What a number is called that says how many rows there are in a second.
_RATES = frozenset(("fps", "fs", "hz", "rate", "sampling_rate", "sample_rate", "frame_rate"))

# What a number is called that says how many seconds there are from row to row.
_PERIODS = frozenset(("dt", "ts", "timestep", "time_step", "sample_time", "period"))

# Words behind a name that say no more than that there are many.
_LISTS = frozenset(("list", "arr", "array", "data", "vec", "hist", "history", "log", "values"))

_PLURALS = {"ts": "t", "xs": "x", "ys": "y", "zs": "z"}  # what people call many of them
Arrays = Mapping[str, NDArray[Any]]  # arrays by their names
_NAME_THEM = "save a table of time and x, y, z, or say which is which with --columns t=..,z=.."


def arrays_episode(
    path: Path, what: str, arrays: Arrays, options: ReadOptions, unused: Mapping[str, str]
) -> Episode:
    """Build an episode from arrays: those as long as the times are its columns.

    Args:
        path: of the file.
        what: kind of file, in words.
        arrays: numbers, texts or dates; of two dimensions with a row (or column) a time.
        options: the user's.
        unused: what else the file holds, with the reason.

    Raises:
        LogError: nothing is of use.
    """
    plain = _without_records(arrays)
    left_out = dict(unused)
    count = _length(plain, options)
    names: list[str] = []
    meant: list[str] = []
    columns: list[NDArray[Any]] = []
    for name, array in plain.items():
        rows = _rows(array, count)
        if isinstance(rows, str):
            if array.size > 1 or name not in (*_RATES, *_PERIODS):
                left_out[name] = rows
            continue
        own, said = [name], [_bare(name)]
        if rows.ndim == 2:
            own = spread_names(name, rows.shape[1])[0]
            said = spread_names(_bare(name), rows.shape[1])[1]
        names += own
        meant += said
        columns += [rows] if rows.ndim == 1 else list(rows.T)
    if not columns:
        reasons = "; ".join(f"{name[:40]!r}: {why}" for name, why in list(left_out.items())[:4])
        raise LogError(
            f"{path}: holds no array of numbers that is a place over time ({reasons})", _NAME_THEM
        )
    plan = plan_columns(path, names, options, meant, left_out)
    needed = {at: columns[at] for at in plan.needed}
    return columns_episode(path, what, plan, needed, options, rate_hz=_rate(plain), unused=left_out)


def _bare(name: str) -> str:
    """Strip a name of its plural or container suffix: `t_list`, `zs`."""
    words = name.split("_")
    if len(words) > 1 and words[-1].lower() in _LISTS:
        name = "_".join(words[:-1])
    return _PLURALS.get(name, name)


def _without_records(arrays: Arrays) -> dict[str, NDArray[Any]]:
    """Replace structured arrays by one array per field."""
    plain: dict[str, NDArray[Any]] = {}
    for name, array in arrays.items():
        fields = array.dtype.names
        if fields is None:
            plain[name] = array
            continue
        for field in fields:
            plain[f"{name}.{field}" if len(arrays) > 1 else field] = array[field]
    return plain


def _length(arrays: Arrays, options: ReadOptions) -> int:
    """Return the number of rows: that of the times, else the most common length."""
    said = [options.columns[one] for one in ("t", "frame", "times") if one in options.columns]
    said = said or list(options.columns.values())[:1]
    for name in said:
        if (array := arrays.get(re.sub(r"(?:\[\d+\]|\.\d+)$", "", name))) is not None:
            return max(array.shape, default=1)
    lengths = {name: max(array.shape, default=1) for name, array in arrays.items()}
    times = [
        name
        for name, length in lengths.items()
        if length >= _MIN_ROWS
        and arrays[name].size == length
        and isinstance(meaning_of(_bare(name)), TimeColumn)
    ]
    if times:
        return lengths[min(times, key=lambda name: len(words_of(name, camel=True)))]
    common = Counter(length for length in lengths.values() if length >= _MIN_ROWS)
    return max(common, key=lambda length: (common[length], length), default=0)


def _rows(array: NDArray[Any], count: int) -> NDArray[Any] | str:
    """Return an array with one row per time, shape (T,) or (T, K), or why it has none."""
    shape = " x ".join(map(str, array.shape))
    if array.dtype.kind == "O" or array.dtype.kind not in "biufMUS":
        return "it holds no numbers"
    if array.size == 1 and count != 1:
        return "one number, no column"
    if array.size == count:
        return array.reshape(count)
    if array.ndim == 2 and count in array.shape:
        rows = array if array.shape[0] == count else array.T
        if rows.shape[1] > _MAX_WIDTH:
            return f"its {rows.shape[1]} columns are more than an arm or a ball has"
        return rows
    return f"its shape {shape} has not the {count} rows that there are times"


def _rate(arrays: Arrays) -> float | None:
    """Return the sampling rate [Hz] stated by a scalar of the file; None where there is none."""
    for name, array in arrays.items():
        word = "_".join(lowered(words_of(name, camel=False)))
        if array.size != 1 or array.dtype.kind not in "iuf":
            continue
        value = float(array.reshape(()))
        if word in _RATES and 0.01 < value < 1e6:
            return value
        if word in _PERIODS and 1e-6 < value < 100:
            return 1 / value
    return None


def number_names(array: NDArray[Any], path: Path, options: ReadOptions) -> dict[str, NDArray[Any]]:
    """Return the columns of an unnamed array by their numbers from 1.

    Raises:
        LogError: the user names no columns, or it is no table.
    """
    shape = " x ".join(map(str, array.shape)) or "one number"
    if array.ndim == 1 and array.size:
        array = array.reshape(-1, 1)
    if array.ndim != 2 or not array.size or array.dtype.kind not in "biuf":
        raise LogError(f"{path}: is an array ({shape}) that is no table of numbers", _NAME_THEM)
    if array.shape[0] < array.shape[1]:
        array = array.T
    if array.shape[1] > _MAX_WIDTH:
        raise LogError(
            f"{path}: is an array ({shape}), which is more than an arm or a ball has", _NAME_THEM
        )
    if not options.columns:
        raise LogError(
            f"{path}: is an array ({shape}) whose columns have no names; say which is which by "
            "number from 1: --columns t=1,z=2"
        )
    return {str(at + 1): np.ascontiguousarray(column) for at, column in enumerate(array.T)}
