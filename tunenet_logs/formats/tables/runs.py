"""Split stacked runs of a table, by a column that numbers them or where the times restart."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.clock_jumps import fill_holes

MAX_RUNS = 500  # of a table; each is a signal of its own
_MAX_LENGTH = 40  # of a run's name
_MAX_SHOWN = 4  # of the names of things in a message
_MIN_ROWS = 5  # of a run that nothing but its times tells
# Of the rows that are of another thing than the row before, where several are recorded at once.
_ALTERNATING = 0.5

_MAX_SHARED = 0.1  # of rows that have the stamp of another and other values: some were sent twice
_MIN_STAMPS = 0.2  # of rows: of fewer stamps no motion can be told
# Of what rows of one stamp differ by: a thing moves less than that from stamp to stamp.
_ALIKE = 0.5

_RESTART_FRACTION = 0.8  # of a run's length: by more than that the next one's times must jump back
# By whole ones of it local time is set, as at the end of summer time; and periods in which the
# first row after that comes.
_ZONE_NS, _ZONE_PERIODS = 900 * 10**9, 10

_NEARBY = 128  # rows among which those of one run may have overtaken each other
Rows = NDArray[np.intp] | slice  # which rows


class RunNames:
    """Runs of a table in order of appearance.

    Args:
        kinds: kind of each column that identifies them: "run", "ball", ...
    """

    def __init__(self, kinds: Sequence[str]) -> None:
        self._kinds = kinds
        self._numbers: dict[tuple[str, ...], int] = {}
        self._by_name: dict[tuple[str, ...], int] = {}

    @property
    def names(self) -> list[str]:
        """Names such as "run1" for a number, else the table's own; "run1.ball" for two columns."""
        parts = list(self._by_name)
        told = [at for at in range(len(self._kinds)) if len({each[at] for each in parts}) > 1]
        return [".".join(each[at] for at in told) or ".".join(each) for each in parts]

    @property
    def note(self) -> str:
        """Note that a task takes one of several objects; "" for runs, or for one object."""
        names = self.names
        if len(names) < 2 or set(self._kinds) <= {"run"}:
            return ""
        shown = ", ".join(names[:_MAX_SHOWN]) + (", ..." if len(names) > _MAX_SHOWN else "")
        return f"rows are of {len(names)} things ({shown}): each is a signal; see --topic"

    def number(self, cells: Sequence[str]) -> int:
        """Return the index of a run in `names`, by the cells of its columns."""
        texts = tuple(cell.strip()[:_MAX_LENGTH] for cell in cells)
        if (number := self._numbers.get(texts)) is not None:
            return number
        parts = tuple(map(_name_of, texts, self._kinds))
        self._numbers[texts] = self._by_name.setdefault(parts, len(self._by_name))
        return self._numbers[texts]


def _name_of(text: str, kind: str) -> str:
    """Name a run: "run2" for "2", "2.0" and "Run 2"; others keep their name."""
    if found := re.fullmatch(rf"(?:{kind}\W{{0,3}})?0*(\d{{1,15}})(?:[.,]0*)?", text, re.I | re.A):
        return f"{kind}{found[1]}"
    return re.sub(r"\W+", "_", text).strip("_").lower() or f"no_{kind}"


def telling_column(
    stamps: Sequence[Sequence[str]], columns: Mapping[int, Sequence[str]]
) -> int | None:
    """Find the column that identifies objects, where several rows share a stamp.

    Args:
        stamps: the time of each row, as it is written.
        columns: the cells of the columns with uninformative names.

    Returns:
        The index of one that makes all pairs of stamp and cell unique; None where all stamps
        differ, or there is none. Names go before numbers, and few objects before many.
    """
    times = [tuple(cells) for cells in stamps]
    if len(set(times)) == len(times):
        return None
    found: list[tuple[bool, int, int]] = []
    for at, cells in columns.items():
        things = len(set(cells))
        is_told = 1 < things <= len(cells) // 3 and all(map(str.strip, cells))
        if is_told and len(set(zip(times, cells, strict=True))) == len(times):
            found.append((any(map(_is_number, cells)), things, at))
    return min(found)[2] if found else None


def _is_number(text: str) -> bool:
    return re.fullmatch(r"[+-]?[\d.,]+", text.strip()) is not None


def rows_of_runs(
    times_ns: NDArray[np.int64], runs: NDArray[np.int64], names: Sequence[str]
) -> list[tuple[str, Rows]]:
    """Return name and rows of each run or object; the name is "" where there is only one.

    A column of run numbers separates runs where times restart with another number, or where
    numbers alternate: an object whose number changes once and for all is one object.

    Args:
        times_ns: of T rows [ns], shape (T,).
        runs: their runs' indices in `names`, shape (T,); empty where the table numbers none.
        names: of runs.

    Raises:
        ValueError: there are over `MAX_RUNS` runs.
    """
    changes = np.diff(runs) != 0
    backwards = np.flatnonzero(np.diff(times_ns) <= 0)
    comes_and_goes = np.count_nonzero(changes) > max(_ALTERNATING * len(runs), len(names))
    if len(runs) and (comes_and_goes or np.any(changes[backwards])):
        numbers = np.unique(runs)
        if 2 * len(numbers) <= len(runs):  # else each row has a number of its own
            _check_count(len(numbers))
            return [(str(names[one]), np.flatnonzero(runs == one)) for one in numbers.tolist()]
    if not len(backwards):
        return [("", slice(None))]
    starts = _restarts(times_ns, backwards)
    if len(starts) == 1:
        return [("", slice(None))]
    _check_count(len(starts))
    ends = [*starts[1:], len(times_ns)]
    pairs = enumerate(zip(starts, ends, strict=True), 1)
    return [(f"run{number}", slice(start, end)) for number, (start, end) in pairs]


def restarts_note(parts: Sequence[tuple[str, Rows]]) -> list[str]:
    """Note that times restart without a column of run numbers: a clock may have been set back."""
    if len(parts) < 2 or isinstance(parts[0][1], np.ndarray):
        return []
    return [
        f"its times begin again {len(parts) - 1} times: runs, or a clock that was set back; each "
        "is a signal by itself; see --topic"
    ]


def check_one_thing(times_ns: NDArray[np.int64], values: NDArray[np.float64]) -> None:
    """Refuse rows that are of several objects, or whose stamps are truncated.

    In stacked rows of several objects, the second row of each stamp is near the second row of the
    next; of one object with coarse stamps, it is near the first of its own.

    Args:
        times_ns: of T rows [ns], in the order of the file, shape (T,).
        values: shape (T, C).

    Raises:
        ValueError: which of these it is, and the remedy.
    """
    order = np.argsort(times_ns, kind="stable")
    times, rows = times_ns[order], values[order]
    is_same = np.diff(times) == 0
    if not np.any(is_same):
        return
    steps = _steps(rows)
    shared = int(np.count_nonzero(is_same & (steps > 0)))
    if shared <= _MAX_SHARED * len(times):
        return
    firsts = np.flatnonzero(np.concatenate([[True], ~is_same]))
    rank = np.arange(len(times)) - np.repeat(firsts, np.diff(firsts, append=len(times)))
    by_rank = np.argsort(rank, kind="stable")
    alike = _steps(rows[by_rank])[np.diff(rank[by_rank]) == 0]
    are_things = len(alike) > 0 and np.median(alike) < _ALIKE * np.median(steps[is_same])
    if not are_things and len(firsts) > _MIN_STAMPS * len(times):
        return
    what = "the stamps have too few digits; "
    if are_things:
        what = (
            "several things, or stamps of too few digits; say which column tells the things apart: "
            "--columns object=NAME, or "
        )
    raise ValueError(
        f"{shared} of {len(times)} rows have the stamp of another row and other values: {what}"
        "write times with all their digits"
    )


def _steps(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the largest change from each row to the next, shape (T - 1,); 0 where missing."""
    return np.nan_to_num(np.abs(np.diff(rows, axis=0))).max(axis=1, initial=0.0)


def _restarts(times_ns: NDArray[np.int64], backwards: NDArray[np.intp]) -> list[int]:
    """Return where runs begin; a few rows out of order begin none."""
    starts = [0]
    rising = np.diff(
        backwards, append=len(times_ns) - 1
    )  # rows from there to the next that is back
    for at in (backwards[rising >= _MIN_ROWS] + 1).tolist():
        begin = starts[-1]
        ahead = times_ns[at : at + _MIN_ROWS]
        if at - begin < _MIN_ROWS:
            continue
        last, first = int(times_ns[at - 1]), int(times_ns[begin])
        back = last - int(times_ns[at])
        period_ns = (last - first) / (at - 1 - begin)
        is_local = back > _ZONE_NS / 2 and -back % _ZONE_NS <= _ZONE_PERIODS * period_ns
        if times_ns[at] < first and is_local:
            continue  # one run, whose clock was set
        around = times_ns[begin : begin + max(2 * (at - begin), _NEARBY)]
        if fill_holes(around, at - begin):
            continue  # one run, whose rows overtook each other
        if back > _RESTART_FRACTION * (last - first) > 0 and ahead[-1] < last:
            starts.append(at)
    return starts


def _check_count(count: int) -> None:
    if count > MAX_RUNS:
        raise ValueError(f"holds {count} runs, over the limit of {MAX_RUNS}; split it")
