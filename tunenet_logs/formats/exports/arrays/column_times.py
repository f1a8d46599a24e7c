"""Columns of times as stamps, exact where the file's own numbers are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.formats.tables.times import Clock, power_by_size

_LOOK_ROWS = 100
"""Whose size tells the unit of times that name none."""

_MOST_NS = 2**62
"""Half of what int64 holds, so that differences fit as well."""


def column_stamps(
    clock: Clock, columns: Sequence[NDArray[Any]]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Stamps [ns] of one column of times or of two of seconds and nanoseconds.

    Args:
        clock: what the columns are.
        columns: whole numbers, floats, dates (datetime64) or texts, shape (T,) each.

    Returns:
        Stamps, shape (T,), and which rows have one, shape (T,); the stamp of another is 0.
    """
    if len(columns) == 2:
        seconds, some = _stamps(columns[0], 0, clock)
        rest, others = _stamps(columns[1], -9, clock)
        return seconds + rest, some & others
    return _stamps(columns[0], clock.power, clock)


def _stamps(
    values: NDArray[Any], power: int | None, clock: Clock
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    if values.dtype.kind == "M":
        known = ~np.isnat(values)
        known &= np.abs(values.astype("M8[s]").astype(np.int64)) < _MOST_NS // 10**9
        return np.where(known, values.astype("M8[ns]").astype(np.int64), 0), known
    if values.dtype.kind not in "iufb":
        return _text_stamps(values, power, clock)
    if power is None:
        power = power_by_size([repr(float(value)) for value in values[:_LOOK_ROWS]])
    factor = 10 ** (9 + power)
    if values.dtype.kind in "iub":
        fits = np.abs(values.astype(np.float64)) * factor < _MOST_NS
        return np.where(fits, values, 0).astype(np.int64) * factor, fits
    numbers = values.astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        nanoseconds = np.round(numbers * factor)
        fits = np.abs(nanoseconds) < _MOST_NS  # NaN does not
    return np.where(fits, nanoseconds, 0).astype(np.int64), fits


def _text_stamps(
    values: NDArray[Any], power: int | None, clock: Clock
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    texts = ["" if value is None else str(value).strip() for value in values.tolist()]
    if power is None:
        power = power_by_size(texts[:_LOOK_ROWS])
    stamps = np.zeros(len(texts), np.int64)
    fits = np.zeros(len(texts), np.bool_)
    one = Clock(clock.name, (0,), power)
    for row, text in enumerate(texts):
        try:
            stamps[row], fits[row] = one.read([text], power), True
        except ValueError:
            continue
    return stamps, fits
