"""Runs below each other in a table: by a column that numbers them, or where the times restart."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

MOST_RUNS = 500
"""Of a table; each is a signal of its own."""

_LONGEST = 40
"""Of a run's name."""

_LEAST_ROWS = 5
"""Of a run that nothing but its times tells."""

_RESTART_FRACTION = 0.8
"""Of a run's length: by more than that the next one's times must jump back."""

Rows = NDArray[np.intp] | slice
"""Which rows."""


class RunNames:
    """The runs of a table in order of appearance.

    Attributes:
        names: "run1" of one that goes by a number, or as the table calls it.
    """

    def __init__(self, kind: str) -> None:
        self.names: list[str] = []
        self._kind = kind
        self._numbers: dict[str, int] = {}
        self._by_name: dict[str, int] = {}

    def number(self, cell: str) -> int:
        """The index of a run in `names`."""
        text = cell.strip()[:_LONGEST]
        if (number := self._numbers.get(text)) is not None:
            return number
        name = _name_of(text, self._kind)
        number = self._by_name.setdefault(name, len(self.names))
        if number == len(self.names):
            self.names.append(name)
        self._numbers[text] = number
        return number


def _name_of(text: str, kind: str) -> str:
    """What a run is called: "run2" of "2", "2.0" and "Run 2"; as it is of others."""
    if found := re.fullmatch(rf"(?:{kind}\W{{0,3}})?0*(\d{{1,15}})(?:[.,]0*)?", text, re.I | re.A):
        return f"{kind}{found[1]}"
    return re.sub(r"\W+", "_", text).strip("_").lower() or f"no_{kind}"


def rows_of_runs(
    times_ns: NDArray[np.int64], runs: NDArray[np.int64], names: Sequence[str]
) -> list[tuple[str, Rows]]:
    """The rows of each run with its name, "" where there is one alone.

    Args:
        times_ns: of T rows [ns], shape (T,).
        runs: their runs' indices in `names`, shape (T,); empty where the table numbers none.
        names: of runs.

    Raises:
        ValueError: there are too many.
    """
    backwards = np.flatnonzero(np.diff(times_ns) <= 0)
    if not len(backwards):
        return [("", slice(None))]
    if len(runs) and np.any(np.diff(runs)[backwards] != 0):
        numbers = np.unique(runs)
        if 2 * len(numbers) <= len(runs):  # else each row has a number of its own
            _check_count(len(numbers))
            return [(str(names[one]), np.flatnonzero(runs == one)) for one in numbers.tolist()]
    starts = _restarts(times_ns, backwards)
    if len(starts) == 1:
        return [("", slice(None))]
    _check_count(len(starts))
    ends = [*starts[1:], len(times_ns)]
    pairs = enumerate(zip(starts, ends, strict=True), 1)
    return [(f"run{number}", slice(start, end)) for number, (start, end) in pairs]


def _restarts(times_ns: NDArray[np.int64], backwards: NDArray[np.intp]) -> list[int]:
    """Where runs begin: a few rows out of order are none."""
    starts = [0]
    rising = np.diff(
        backwards, append=len(times_ns) - 1
    )  # rows from there to the next that is back
    for at in (backwards[rising >= _LEAST_ROWS] + 1).tolist():
        begin = starts[-1]
        ahead = times_ns[at : at + _LEAST_ROWS]
        if at - begin < _LEAST_ROWS:
            continue
        last, first = int(times_ns[at - 1]), int(times_ns[begin])
        back = last - int(times_ns[at])
        if back > _RESTART_FRACTION * (last - first) > 0 and ahead[-1] < last:
            starts.append(at)
    return starts


def _check_count(count: int) -> None:
    if count > MOST_RUNS:
        raise ValueError(f"holds {count} runs, over the limit of {MOST_RUNS}; split it")
