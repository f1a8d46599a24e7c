"""Make an episode of named arrays or columns, whatever the file: `episode_of_table` does all."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import (
    Episode,
)
from tunenet_logs.errors import LogError
from tunenet_logs.formats.columns.cells import (
    MAX_NS,
    UNIT_ROWS,
    Clock,
    TextClock,
    number_of,
    unit_of_times,
)
from tunenet_logs.formats.columns.names import (
    JointColumn,
    TimeColumn,
    lowered,
    meaning_of,
    reasons_of,
    spread_names,
    words_of,
)
from tunenet_logs.formats.columns.plan import (
    ROWS,
    ColumnPlan,
    plain_words,
    plan_columns,
)
from tunenet_logs.formats.columns.signals import (
    ColumnRows,
    RunNames,
    Times,
    episode_of_rows,
    told_apart,
)
from tunenet_logs.formats.options import ReadOptions

MAX_ARRAY_BYTES = 128 * 1024**2  # of all arrays of a file
MAX_ROWS = 2_000_000  # of a file: an hour at 500 Hz
MAX_PLACES = 500_000  # of a track: 8 minutes at 1 kHz; tuning takes over 512 bytes for each
MAX_WIDTH = 200  # columns of one array
# Names of a scalar that is the rate of rows [Hz], or the time from row to row [s].
_RATES = frozenset(("fps", "fs", "hz", "rate", "sampling_rate", "sample_rate", "frame_rate"))
_PERIODS = frozenset(("dt", "ts", "timestep", "time_step", "sample_time", "period"))
# Words behind a name that only say that there are many values.
_LISTS = frozenset(("list", "arr", "array", "data", "vec", "hist", "history", "log", "values"))
# What a list of the joints of the other arrays is called.
_NAMED = {(what, "names") for what in ("joint", "dof", "motor", "servo", "actuator")}
Arrays = Mapping[str, NDArray[Any]]  # arrays by their names
_NAME_THEM = "save a table of time and x, y, z, or say which is which with --columns t=..,z=.."


@dataclass(frozen=True, eq=False)
class Table:
    """What a file holds, as named columns."""

    what: str  # kind of file, in words
    # numbers, texts or dates (datetime64), by name; of two dimensions with a row (or column) a
    # time. Those as long as the times are used
    columns: Arrays
    # what else the file holds, with the reason
    unused: Mapping[str, str] = field(default_factory=dict)
    rate_hz: float | None = None  # row rate stated by the file; None where it is unstated
    name: str = ""  # of the table, where there are several
    names: Mapping[str, str] = field(default_factory=dict)  # of columns, by the file's full ones
    loss: str = ""  # what was damaged; "" where nothing was


def episode_of_table(path: Path, table: Table, options: ReadOptions) -> Episode:
    """Build an episode of a file's named columns."""
    plain: dict[str, NDArray[Any]] = {}
    for name, array in table.columns.items():
        fields = array.dtype.names or ()  # of a structured array, each of which is a column
        several = len(table.columns) > 1
        plain |= {f"{name}.{one}" if several else one: array[one] for one in fields}
        plain |= {} if fields else {name: array}
    left_out = dict(table.unused)
    count = _length(plain, options)
    named, joints = _joint_names(plain)
    plain.pop(named, None)
    names: list[str] = []
    meant: list[str] = []
    columns: list[NDArray[Any]] = []
    for name, array in plain.items():
        rows = _rows(array, count)
        if isinstance(rows, str):
            if array.size > 1 or name not in (*_RATES, *_PERIODS):
                left_out[name] = rows
            continue
        if rows.ndim == 2:
            names += spread_names(name, rows.shape[1])[0]
            of_joints = [f"{joint} {_bare(name)}" for joint in joints]
            if len(joints) == rows.shape[1] and all(map(_is_joint, of_joints)):
                meant += of_joints
            else:
                meant += spread_names(_bare(name), rows.shape[1])[1]
            columns.extend(rows.T)
        else:
            names.append(name)
            meant.append(_bare(name))
            columns.append(rows)
    if not columns:
        reasons = reasons_of(left_out)
        raise LogError(
            f"{path}: holds no array of numbers that is a place over time ({reasons})", _NAME_THEM
        )
    rate = table.rate_hz or _rate(plain)
    plan = plan_columns(path, names, options, meant, left_out, rate)
    if not options.columns:
        first = zip(*(_texts(column[:UNIT_ROWS]) for column in columns), strict=True)
        plan = told_apart(plan, list(first))
    return episode_of_columns(
        path,
        table.what,
        plan,
        {at: columns[at] for at in plan.needed},
        options,
        rate_hz=rate,
        unused=left_out,
        losses=[table.loss] if table.loss else [],
    )


def episode_of_columns(
    path: Path,
    what: str,
    plan: ColumnPlan,
    columns: Mapping[int, NDArray[Any]],
    options: ReadOptions,
    **more: Any,
) -> Episode:
    """Build an episode of the columns that a plan needs; `more` as in `episode_of_rows`."""
    count = max(map(len, columns.values()), default=0)
    check_rows(path, count, plan)
    try:
        times = {clock: column_times(clock, columns, count, plan) for clock in plan.clocks}
    except ValueError as error:
        raise LogError(f"{path}: {error}") from error
    runs = RunNames([kind for _, kind in plan.runs])
    told = zip(*(_texts(columns[at]) for at, _ in plan.runs), strict=True)
    numbers = np.array([runs.number(texts) for texts in told], np.int64)
    values = {at: floats(columns[at]) for at in plan.numbers}
    rate_hz = options.fps or more.get("rate_hz")
    if any(group.clock is ROWS for group in plan.groups) and not rate_hz:
        counted = "nothing says when; rows were counted as frames (--fps, or --columns t=NAME)"
        more["warnings"] = [*more.get("warnings", ()), counted]
    rows = ColumnRows(values, times, numbers, runs.names, runs.note)
    return episode_of_rows(path, what, plan, rows, options, **more)


def check_rows(path: Path, count: int, plan: ColumnPlan) -> None:
    """Refuse a file of too many rows with a LogError."""
    width = sum(len(group.columns) for group in plan.groups)
    rows = MAX_PLACES if any(group.is_track for group in plan.groups) else MAX_ROWS
    most = min(rows, 16_000_000 // max(width, 1))  # values of all signals
    if count > most:
        raise LogError(f"{path}: has over {most} rows, the limit; split it")


def column_times(
    clock: Clock, columns: Mapping[int, NDArray[Any]], count: int, plan: ColumnPlan
) -> Times:
    """Convert a clock's columns to stamps, exact as the numbers; ValueError without a unit."""
    own = [columns[at] for at in clock.indices]
    if not own:
        return Times(np.arange(count) * 10**9, np.ones(count, np.bool_))
    is_sampled = plan.is_sampled(clock)
    if clock.has_date and own[1].dtype.kind in "iufbM":
        own = own[1:]
    if len(own) == 2 and not clock.has_date and all(one.dtype.kind in "iufb" for one in own):
        seconds, rest = (
            _numeric_times(one, power, clock) for one, power in zip(own, (0, -9), strict=True)
        )
        return Times(seconds.stamps_ns + rest.stamps_ns, seconds.known & rest.known)
    if len(own) == 1 and own[0].dtype.kind in "iufbM":
        power = 0 if clock.counts_frames else clock.power
        return _numeric_times(own[0], power, clock, is_sampled)
    texts = list(zip(*map(_texts, own), strict=True))
    reader = TextClock(clock, texts[:UNIT_ROWS], is_sampled)
    stamps, known = np.zeros(count, np.int64), np.zeros(count, np.bool_)
    for row, cells in enumerate(texts):
        with suppress(ValueError):
            stamps[row], known[row] = reader.read(cells), True
    return Times(stamps, known, reader.doubts)


def _numeric_times(
    values: NDArray[Any], power: int | None, clock: Clock, is_sampled: bool = True
) -> Times:
    if values.dtype.kind == "M":
        known = ~np.isnat(values)
        known &= np.abs(values.astype("M8[s]").astype(np.int64)) < MAX_NS // 10**9
        return Times(np.where(known, values.astype("M8[ns]").astype(np.int64), 0), known)
    first = values[:UNIT_ROWS].tolist()
    unit_ns, doubt = unit_of_times(clock.name, first, power, is_sampled=is_sampled)
    doubts = [doubt] if doubt else []
    if values.dtype.kind in "iub":
        fits = np.abs(values.astype(np.float64)) * unit_ns < MAX_NS
        return Times(np.where(fits, values, 0).astype(np.int64) * unit_ns, fits, doubts)
    with np.errstate(over="ignore", invalid="ignore"):
        nanoseconds = np.round(values.astype(np.float64) * unit_ns)
        fits = np.abs(nanoseconds) < MAX_NS  # NaN does not
    return Times(np.where(fits, nanoseconds, 0).astype(np.int64), fits, doubts)


def floats(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return a column as floats, NaN where it is no number, shape (T,)."""
    if values.dtype.kind in "iufb":
        return values.astype(np.float64)
    return np.fromiter(map(number_of, values.tolist()), np.float64, len(values))


def _texts(values: NDArray[Any]) -> list[str]:
    """Return a column as it would stand in a table of text."""
    if values.dtype.kind == "M":
        return np.datetime_as_string(values).tolist()
    found: list[str] = []
    for one in values.tolist():
        if isinstance(one, bytes):
            found.append(one.decode("utf-8", "replace").strip())
        else:
            is_whole = isinstance(one, float) and one.is_integer()
            found.append("" if one is None else str(int(one) if is_whole else one).strip())
    return found


def _bare(name: str) -> str:
    """Strip a name of its plural or container suffix: `t_list`, `zs`."""
    words = name.split("_")
    if len(words) > 1 and words[-1].lower() in _LISTS:
        name = "_".join(words[:-1])
    return name[0] if name in ("ts", "xs", "ys", "zs") else name


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
        if length >= 3
        and arrays[name].size == length
        and isinstance(meaning_of(_bare(name)), TimeColumn)
    ]
    if times:
        return lengths[min(times, key=lambda name: len(words_of(name, camel=True)))]
    common = Counter(length for length in lengths.values() if length >= 3)
    return max(common, key=lambda length: (common[length], length), default=0)


def _rows(array: NDArray[Any], count: int) -> NDArray[Any] | str:
    """Return an array with one row per time, shape (T,) or (T, K), or why it has none."""
    if array.dtype.kind not in "biufMUS":
        return "it holds no numbers"
    if array.size == 1 and count != 1:
        return "one number, no column"
    if array.size == count:
        return array.reshape(count)
    if array.ndim == 2 and count in array.shape:
        rows = array if array.shape[0] == count else array.T
        if rows.shape[1] > MAX_WIDTH:
            return f"its {rows.shape[1]} columns are more than an arm or a ball has"
        return rows
    shape = " x ".join(map(str, array.shape))
    return f"its shape {shape} has not the {count} rows that there are times"


def _joint_names(arrays: Arrays) -> tuple[str, Sequence[str]]:
    """Return which array names the joints, and their names; "" and none where none does."""
    for name, array in arrays.items():
        if (
            array.dtype.kind == "U"
            and 1 < array.size <= MAX_WIDTH
            and plain_words(name)[-2:] in _NAMED
        ):
            joints = [str(one) for one in array.ravel().tolist()]
            if len(set(joints)) == len(joints) and all(map(str.strip, joints)):
                return name, joints
    return "", ()


def _is_joint(name: str) -> bool:
    return isinstance(meaning_of(name), JointColumn)


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
    """Return the columns of an unnamed array by their numbers from 1."""
    shape = " x ".join(map(str, array.shape)) or "one number"
    if array.ndim == 1 and array.size:
        array = array.reshape(-1, 1)
    if array.ndim != 2 or not array.size or array.dtype.kind not in "biuf":
        raise LogError(f"{path}: is an array ({shape}) that is no table of numbers", _NAME_THEM)
    if array.shape[0] < array.shape[1]:
        array = array.T
    if array.shape[1] > MAX_WIDTH:
        raise LogError(
            f"{path}: is an array ({shape}), which is more than an arm or a ball has", _NAME_THEM
        )
    if not options.columns:
        raise LogError(
            f"{path}: is an array ({shape}) whose columns have no names; say which is which by "
            "number from 1: --columns t=1,z=2"
        )
    return {str(at + 1): np.ascontiguousarray(column) for at, column in enumerate(array.T)}
