"""Read impact times heard by the phone app phyphox: its acoustic stopwatch and its collisions.

Its own definitions of these experiments name the sheets and columns
(https://github.com/phyphox/phyphox-experiments).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Signal
from tunenet_logs.formats.exports.build import time_stamps
from tunenet_logs.formats.exports.trackers.spot_rows import best_separator
from tunenet_logs.formats.tables.lines import cells_of
from tunenet_logs.formats.tables.numbers import Numbers, decimal_of
from tunenet_logs.sample_order import sorted_stamps

NAME = "impacts"  # of the signal
_EVENTS = "event time (s)"
_INTERVALS = "interval (s)"

# Impacts side by side, one experiment a row.
_IN_A_ROW = (
    re.compile(r"(?:start|stop(?: \d)?) \(s\)"),
    re.compile(r"bounce \d \(s\)"),
)

_GAPS_IN_A_ROW = re.compile(r"time \d \(s\)")  # times between impacts side by side
# What phyphox reckons from the times.
_BESIDE = re.compile(r"(?:height \d \(c?m\)|energy \d(?: \(%\))?|difference \(s\)|interval \(s\))")

MAX_ROWS = 100_000  # of impacts: a phone hears no more in a day


@dataclass(frozen=True)
class ImpactTimes:
    """Impact times of a sheet.

    Attributes:
        runs: times [s], each run shape (K,).
        unused: other columns, with the reason.
        is_first_unknown: whether the times are cumulated intervals, so that the first is 0.
        is_list: whether all impacts stand in one column, however many there were.
    """

    runs: tuple[NDArray[np.float64], ...]
    unused: dict[str, str] = field(default_factory=dict)
    is_first_unknown: bool = False
    is_list: bool = False

    def signals(self, sheet: str) -> tuple[list[Signal], list[str]]:
        """Return one signal per run, and notes on repairs; `sheet` prefixes their names."""
        signals: list[Signal] = []
        notes: list[str] = []
        for number, times in enumerate(self.runs, 1):
            name = f"{sheet}{NAME}" + (f" {number}" if len(self.runs) > 1 else "")
            _, stamps, repairs, _ = sorted_stamps(time_stamps(times))
            signals.append(Signal(name, stamps, np.ones((len(stamps), 1)), ("impact",), "1"))
            notes += [f"{name}: {repair}" for repair in repairs]
        return signals, notes


def names_impacts(line: str) -> bool:
    """Return whether a header line is that of a sheet of impact times."""
    return _columns(_names(line)) is not None


def impact_times(lines: Iterable[str]) -> ImpactTimes | None:
    """Read a sheet's impact times; None where its first line names none.

    Raises:
        ValueError: a cell is no number.
    """
    rows = (line for line in islice(lines, MAX_ROWS) if line.strip(" \t,;"))
    header = next(rows, "")
    names = _names(header)
    columns = _columns(names)
    if columns is None:
        return None
    separator = best_separator(header)
    cells = [cells_of(line, separator) for line in rows]
    cells = [row for row in cells if len(row) > max(columns)]
    numbers = Numbers(separator, decimal_of(row[at] for row in cells for at in columns))
    values = [[numbers.read(row[at]) for at in columns] for row in cells]
    kind = names[columns[0]]
    unused = {
        name: "phyphox reckons it from the times" for name in names if _BESIDE.fullmatch(name)
    }
    if kind == _EVENTS:
        return ImpactTimes(_filled([_flat(values)]), unused, is_list=True)
    if kind == _INTERVALS:
        unused.pop(_INTERVALS, None)
        return ImpactTimes(_filled([_summed(_flat(values))]), unused, is_first_unknown=True)
    if _GAPS_IN_A_ROW.fullmatch(kind):
        runs = [_summed(np.array(row)) for row in values]
        return ImpactTimes(_filled(runs), unused, is_first_unknown=True)
    return ImpactTimes(_filled([_rising(row) for row in values]), unused)


def _names(line: str) -> list[str]:
    separator = best_separator(line)
    cells = cells_of(line, separator) if separator else [line]
    return [cell.strip(' "').lower() for cell in cells]


def _columns(names: Sequence[str]) -> list[int] | None:
    """Return the columns of times; None where the names are not those of phyphox."""
    if len(names) > 100:
        return None
    if _EVENTS in names:
        return [names.index(_EVENTS)]
    for pattern in (*_IN_A_ROW, _GAPS_IN_A_ROW):
        found = [at for at, name in enumerate(names) if pattern.fullmatch(name)]
        rest = [name for at, name in enumerate(names) if at not in found]
        if len(found) > 1 and all(_BESIDE.fullmatch(name) for name in rest):
            return found
    return [0] if list(names) == [_INTERVALS] else None


def _flat(values: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    times = np.array([row[0] for row in values])
    return times[np.isfinite(times)]


def _summed(gaps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cumulate intervals to impact times from 0; phyphox writes 0 where there was no more."""
    real = gaps[np.isfinite(gaps) & (gaps > 0)]
    return np.concatenate(([0.0], np.cumsum(real)))


def _rising(row: Sequence[float]) -> NDArray[np.float64]:
    """Return a row's times up to the first missing impact: 0, empty or not later."""
    times: list[float] = []
    for time in row:
        if not time > (times[-1] if times else -1.0):
            break
        times.append(time)
    return np.array(times)


def _filled(runs: Iterable[NDArray[np.float64]]) -> tuple[NDArray[np.float64], ...]:
    return tuple(run for run in runs if len(run) > 1)
