"""Convert time columns to stamps, exact where the file's own numbers are."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.formats.tables.times import (
    Clock,
    DayTurns,
    TimeUnit,
    is_of_day,
    says_its_unit,
    unit_of_times,
)

_LOOK_ROWS = 100  # which tell whether times say their own unit
_MAX_NS = 2**62  # half of what int64 holds, so that differences fit as well


def column_stamps(
    clock: Clock, columns: Sequence[NDArray[Any]], *, is_sampled: bool = True
) -> tuple[NDArray[np.int64], NDArray[np.bool_], str]:
    """Convert one time column to stamps [ns], or two: seconds and nanoseconds, or date and time.

    Args:
        clock: meaning of the columns.
        columns: whole numbers, floats, dates (datetime64) or texts, shape (T,) each.
        is_sampled: see `unit_of_times`.

    Returns:
        Stamps, 0 where invalid, shape (T,); the mask of valid rows, shape (T,); and any doubt about
        their unit, in words.

    Raises:
        ValueError: they have no unit that a log has.
    """
    if len(columns) == 1 or (clock.has_date and columns[1].dtype.kind in "iufbM"):
        return _stamps(columns[-1], clock.power, clock, is_sampled)
    if clock.has_date:
        return _text_stamps(columns, TimeUnit(10 ** (9 + (clock.power or 0))), clock)
    seconds, some, _ = _stamps(columns[0], 0, clock)
    rest, others, _ = _stamps(columns[1], -9, clock)
    return seconds + rest, some & others, ""


def _stamps(
    values: NDArray[Any], power: int | None, clock: Clock, is_sampled: bool = True
) -> tuple[NDArray[np.int64], NDArray[np.bool_], str]:
    if values.dtype.kind == "M":
        known = ~np.isnat(values)
        known &= np.abs(values.astype("M8[s]").astype(np.int64)) < _MAX_NS // 10**9
        return np.where(known, values.astype("M8[ns]").astype(np.int64), 0), known, ""
    if values.dtype.kind not in "iufb":
        texts = [str(value).strip() for value in values.tolist() if value is not None]
        unit = TimeUnit(10 ** (9 + (power or 0)))
        if not any(map(says_its_unit, texts[:_LOOK_ROWS])):
            unit = unit_of_times(clock.name, texts, power, is_sampled=is_sampled)
        return _text_stamps([values], unit, clock)
    unit = unit_of_times(clock.name, values.tolist(), power, is_sampled=is_sampled)
    if values.dtype.kind in "iub":
        fits = np.abs(values.astype(np.float64)) * unit.ns < _MAX_NS
        return np.where(fits, values, 0).astype(np.int64) * unit.ns, fits, unit.doubt
    with np.errstate(over="ignore", invalid="ignore"):
        nanoseconds = np.round(values.astype(np.float64) * unit.ns)
        fits = np.abs(nanoseconds) < _MAX_NS  # NaN does not
    return np.where(fits, nanoseconds, 0).astype(np.int64), fits, unit.doubt


def _text_stamps(
    columns: Sequence[NDArray[Any]], unit: TimeUnit, clock: Clock
) -> tuple[NDArray[np.int64], NDArray[np.bool_], str]:
    rows = [
        ["" if cell is None else str(cell).strip() for cell in cells]
        for cells in zip(*(column.tolist() for column in columns), strict=True)
    ]
    stamps = np.zeros(len(rows), np.int64)
    fits = np.zeros(len(rows), np.bool_)
    of_day = next((texts[-1] for texts in rows if is_of_day(texts[-1])), None)
    turned = DayTurns(of_day) if of_day is not None and len(columns) == 1 else None
    one = replace(clock, indices=tuple(range(len(columns))))
    for row, texts in enumerate(rows):
        with suppress(ValueError):
            time_ns = one.read(texts, unit.ns)
            stamps[row], fits[row] = (turned(time_ns) if turned else time_ns), True
    return stamps, fits, unit.doubt
