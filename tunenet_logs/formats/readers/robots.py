"""Read robot controllers' tables: many columns per joint, some measured and some commanded.

Universal Robots' RTDE recorder, libfranka's log and their kin.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Episode
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.formats.columns.arrays import (
    MAX_ROWS,
    ColumnPlan,
    check_rows,
    columns_episode,
    plan_columns,
)
from tunenet_logs.formats.columns.cells import (
    CELLS_REMEDY,
    DAMAGED_REMEDY,
    NUMBER_REMEDY,
    SEPARATORS,
    Failures,
    Numbers,
    Thousands,
    UnreadableError,
    cells_of,
    lines_of,
    unreadable,
)
from tunenet_logs.formats.columns.names import TimeColumn, joint_fields, meaning_of, tells_origin
from tunenet_logs.formats.columns.table import MAX_COLUMNS
from tunenet_logs.formats.kinds import Start
from tunenet_logs.formats.options import ReadOptions

_LOOK_LINES = 20  # in which the names of the columns are looked for
_MIN_JOINTS = 2  # of a quantity: one column alone may be anything


def is_robot_table(start: Start) -> bool:
    """Return whether a table distinguishes measured from commanded joint quantities."""
    return _header(start.lines) is not None


def read_robot_table(path: Path, options: ReadOptions) -> Episode:
    """Read the measured positions, velocities and torques of a robot's joints.

    Currents become torques with the user's torque constants. A controller's own model of the
    torques, with the payload that was set in it, is never taken for a measurement.

    Raises:
        LogError: its rows cannot be read, or it holds nothing that is measured.
        OSError: it cannot be read.
    """
    lines = lines_of(path)
    first = list(islice(lines, _LOOK_LINES))
    found = _header([line or "" for line in first])
    if found is None:
        raise LogError(f"{path}: the line of its columns' names is damaged", EXPORT_AGAIN)
    at, separator, names = found
    rows = _Rows(plan_columns(path, names, options), separator)
    rows.read(path, chain(enumerate(first[at + 1 :], at + 2), enumerate(lines, len(first) + 1)))
    return columns_episode(
        path, "robot's table", rows.plan, rows.arrays(path), options, losses=rows.lost
    )


def _header(lines: Sequence[str]) -> tuple[int, str | None, list[str]] | None:
    """Return index, separator and names of the header line; None where there is none."""
    for at, line in enumerate(lines[:_LOOK_LINES]):
        for separator in SEPARATORS:
            text = line.lstrip("#% ")
            names = [name.strip() for name in cells_of(text, separator)]
            while names and not names[-1]:
                names.pop()
            if 3 <= len(names) <= MAX_COLUMNS and _is_robots(names):
                return at, separator, names
    return None


def _is_robots(names: Sequence[str]) -> bool:
    if not any(isinstance(meaning_of(name), TimeColumn) or name == "duration" for name in names):
        return False
    fields = [one for one in joint_fields(names) if len(one.columns) >= _MIN_JOINTS]
    return tells_origin(fields) or any(
        "[" in names[at] for one in fields for at in one.columns.values()
    )


class _Rows:
    """Needed columns of a table's rows.

    Attributes:
        plan: which they are.
        lost: description of unreadable rows.
    """

    def __init__(self, plan: ColumnPlan, separator: str | None) -> None:
        self.plan = plan
        self.lost: list[str] = []
        self._separator = separator
        clocks = [plan.clock, plan.impacts, *(signal.clock for signal in plan.signals)]
        texts = {at for clock in clocks if clock is not None for at in clock.indices}
        texts.update(at for at, _ in plan.runs)
        self._numbers = {at: array("d") for at in plan.needed if at not in texts}
        self._texts: dict[int, list[str]] = {at: [] for at in texts}
        self._failures = Failures()
        self._thousands = Thousands({*self._numbers, *self._texts})
        self._count = 0

    def read(self, path: Path, lines: Iterator[tuple[int, str | None]]) -> None:
        """Read all rows, counting unreadable ones; raise LogError if there are too many."""
        reading: Numbers | None = None
        for number, line in lines:
            if line is not None and (not line.strip() or line.startswith("#")):
                continue
            try:
                cells = self._cells(line)
                reading = reading or self._reading(cells)
                self._add(cells, reading)
            except UnreadableError as error:
                self._failures.add(number, error)
            self._count += 1
            if self._count > MAX_ROWS:
                check_rows(path, self._count, self.plan)

    def _reading(self, cells: Sequence[str]) -> Numbers:
        """Detect the number format from the first row."""
        has_comma = any("," in cells[at] for at in self._numbers)
        return Numbers(self._separator, "," if has_comma and self._separator != "," else "")

    def _cells(self, line: str | None) -> list[str]:
        if line is None:
            raise UnreadableError("it is longer than any table's", DAMAGED_REMEDY)
        cells, width = cells_of(line, self._separator), len(self.plan.names)
        if len(cells) < width:
            raise UnreadableError(f"it has {len(cells)} of {width} cells", DAMAGED_REMEDY)
        if any(cell.strip() for cell in cells[width:]):
            raise UnreadableError(f"it has {len(cells)} cells, the header {width}", CELLS_REMEDY)
        return cells

    def _add(self, cells: Sequence[str], reading: Numbers) -> None:
        self._thousands.look(cells)
        values: dict[int, float] = {}
        for at in self._numbers:
            try:
                values[at] = reading.read(cells[at])
            except ValueError as why:
                raise unreadable(self.plan.names[at], cells[at], why, NUMBER_REMEDY) from None
        for at, value in values.items():
            self._numbers[at].append(value)
        for at, texts in self._texts.items():
            cell = cells[at].strip()
            texts.append(cell.replace(",", ".") if reading.decimal == "," else cell)

    def arrays(self, path: Path) -> dict[int, NDArray[Any]]:
        """Return the columns by index; raise LogError if no or too few rows are readable."""
        if len(self._failures) == self._count:
            raise LogError(f"{path}: {self._failures.nothing(self._count)}")
        if why := self._failures.refusal(self._count):
            raise LogError(f"{path}: {why}")
        if why := self._thousands.doubt(self.plan.names):
            raise LogError(f"{path}: {why}", NUMBER_REMEDY)
        if self._failures:
            self.lost.append(self._failures.lost(self._count))
        found: dict[int, NDArray[Any]] = {
            at: np.frombuffer(values, np.float64) for at, values in self._numbers.items()
        }
        return found | {at: np.array(texts, object) for at, texts in self._texts.items()}
