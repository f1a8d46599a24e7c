"""Read runs of a physics lab's sensors, side by side in one table, each with its own times.

PASCO Capstone names columns "Position (m) Run #1"; Vernier Logger Pro and Graphical Analysis name
them "Latest: Position (m)", "Run 1: Position (m)" or "Data Set 1:Position(m)".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.csv_table import read_csv
from tunenet_logs.formats.exports.start import Start, start_of
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.column_names import meaning_of
from tunenet_logs.formats.tables.lines import SEPARATORS, cells_of
from tunenet_logs.formats.tables.meaning import CoordinateColumn, JointColumn, TimeColumn
from tunenet_logs.formats.tables.offers import short_list
from tunenet_logs.formats.tables.run_names import without_run

_MAX_BEFORE = 20  # lines before the names
_MAX_COLUMNS = 200  # looked at for a run's name


def is_sensor_runs(start: Start) -> bool:
    """Return whether a file is a table with a time column per run."""
    return bool(_names(start))


def read_sensor_runs(path: Path, options: ReadOptions) -> Episode:
    """Read one signal per run and position.

    Raises:
        LogError: it holds no positions, or see `read_csv`.
    """
    names = [without_run(name) for name in _names(start_of(path))]
    meanings = [meaning_of(name) for _, name in names]
    if not options.columns and not any(
        isinstance(one, CoordinateColumn | JointColumn) for one in meanings
    ):
        pairs = zip(names, meanings, strict=True)
        others = dict.fromkeys(name for (_, name), one in pairs if not isinstance(one, TimeColumn))
        runs = len({run for run, _ in names if run})
        raise LogError(
            f"{path}: is a sensor's export of {runs} {'run' if runs == 1 else 'runs'} without "
            f"positions (it holds {short_list(list(others)) or 'times alone'}); record the drop "
            "with a motion sensor, or name a column of heights, as in --columns t=1,z=2"
        )
    episode = read_csv(path, options)
    return replace(episode, info=replace(episode.info, source=f"sensor's export {path.name}"))


def _names(start: Start) -> Sequence[str]:
    """Return the column names, if a time column names its run; else nothing."""
    for line in start.lines[:_MAX_BEFORE]:
        for separator in SEPARATORS[:-1]:
            cells = cells_of(line, separator) if separator and separator in line else []
            marked = [without_run(cell.strip()) for cell in cells[:_MAX_COLUMNS]]
            if any(run and isinstance(meaning_of(name), TimeColumn) for run, name in marked):
                return [cell.strip() for cell in cells[:_MAX_COLUMNS]]
    return []
