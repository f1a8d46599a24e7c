"""Read Parquet tables: named columns, and episodes of LeRobot data sets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tunenet_logs.episode import Episode
from tunenet_logs.formats.exports.arrays.column_plan import ColumnPlan, plan_columns, spread_names
from tunenet_logs.formats.exports.arrays.lerobot import is_lerobot, lerobot_columns, lerobot_episode
from tunenet_logs.formats.exports.arrays.named_columns import columns_episode
from tunenet_logs.formats.exports.arrays.parquet_columns import ParquetColumn, parquet_columns
from tunenet_logs.formats.exports.start import Start
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.column_names import meaning_of
from tunenet_logs.formats.tables.meaning import TimeColumn

_MAGIC = b"PAR1"


def is_parquet(start: Start) -> bool:
    """Return whether a file is Parquet."""
    return start.data.startswith(_MAGIC)


def read_parquet(path: Path, options: ReadOptions) -> Episode:
    """Read a table by its column names, or the episodes of a LeRobot data set.

    Raises:
        LogError: it is damaged, too large, or its names do not say what it holds; or `pyarrow` is
            not installed.
    """
    reading = _ParquetChoice(path, options)
    arrays = parquet_columns(path, reading.choose)
    if reading.plan is None:
        return lerobot_episode(path, reading.columns, arrays, options)
    needed = {
        at: arrays[name] if place is None else arrays[name][:, place]
        for at in reading.plan.needed
        for name, place in [reading.sources[at]]
    }
    return columns_episode(path, "Parquet table", reading.plan, needed, options)


class _ParquetChoice:
    """Selection of a file's columns.

    Attributes:
        columns: all of the file's.
        sources: file column and list index behind each of the plan's columns.
        plan: their meaning; None for a LeRobot data set.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        self._path = path
        self._options = options
        self.columns: Sequence[ParquetColumn] = ()
        self.sources: list[tuple[str, int | None]] = []
        self.plan: ColumnPlan | None = None

    def choose(self, columns: Sequence[ParquetColumn]) -> list[str]:
        """Select the columns to read; raise LogError if none is of use."""
        self.columns = columns
        if is_lerobot(columns) and not self._options.columns:
            return lerobot_columns(columns)
        names: list[str] = []
        meant: list[str] = []
        clocks = [one.name for one in columns if one.kind == "t"]
        is_named = any(isinstance(meaning_of(one.name), TimeColumn) for one in columns)
        for one in columns:
            if not one.kind:
                continue
            if one.width:
                own, said = spread_names(one.name, one.width)
                names += own
                meant += said
                self.sources += [(one.name, place) for place in range(one.width)]
                continue
            names.append(one.name)
            meant.append("time" if clocks == [one.name] and not is_named else one.name)
            self.sources.append((one.name, None))
        self.plan = plan_columns(self._path, names, self._options, meant)
        return [self.sources[at][0] for at in self.plan.needed]
