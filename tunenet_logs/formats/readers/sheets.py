"""Read spreadsheets (.xls, .xlsx, .xlsm, .xlsb, .ods), and exports of phyphox and sensor programs.

Sheets are unpacked in the sandbox; each is then a table as any other, a tracking program's table
that was pasted, or a list of impact times by the phone app phyphox.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import LogError
from tunenet_logs.formats.columns.cells import (
    SEPARATORS,
    Numbers,
    best_separator,
    cells_of,
    decimal_of,
    lines_of,
)
from tunenet_logs.formats.columns.names import (
    CoordinateColumn,
    JointColumn,
    TimeColumn,
    meaning_of,
    short_list,
    without_run,
)
from tunenet_logs.formats.columns.table import export_episode, time_stamps, unique_names
from tunenet_logs.formats.kinds import Start, start_of
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.formats.readers import sandboxed
from tunenet_logs.formats.readers.csv import read_csv, read_lines
from tunenet_logs.formats.readers.trackers import (
    is_mtrack2,
    names_masses,
    read_masses,
    read_mtrack2,
    read_spots,
    spot_layout,
)
from tunenet_logs.formats.sandbox import Sandbox, SandboxError
from tunenet_logs.timing.stamps import sorted_stamps

# ---- Impact times heard by phyphox: its acoustic stopwatch and its collisions.
# Its own definitions of these experiments name the sheets and columns
# (https://github.com/phyphox/phyphox-experiments).

NAME = "impacts"  # of the signal
_EVENTS = "event time (s)"
_INTERVALS = "interval (s)"
# Impacts side by side, one experiment a row.
_IN_A_ROW = (re.compile(r"(?:start|stop(?: \d)?) \(s\)"), re.compile(r"bounce \d \(s\)"))
_GAPS_IN_A_ROW = re.compile(r"time \d \(s\)")  # times between impacts side by side
# What phyphox computes from the times.
_BESIDE = re.compile(r"(?:height \d \(c?m\)|energy \d(?: \(%\))?|difference \(s\)|interval \(s\))")
MAX_ROWS = 100_000  # of impacts: a phone hears no more in a day


@dataclass(frozen=True)
class ImpactTimes:
    """Impact times of a sheet."""

    runs: tuple[NDArray[np.float64], ...]  # times [s], each run shape (K,)
    unused: dict[str, str] = field(default_factory=dict)  # other columns, with the reason
    # whether the times are cumulated intervals, so that the first is 0
    is_first_unknown: bool = False
    is_list: bool = False  # whether all impacts stand in one column, however many there were

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
    return _columns(_lower_names(line)) is not None


def impact_times(lines: Iterable[str]) -> ImpactTimes | None:
    """Read a sheet's impact times; None where its first line names none.

    Raises:
        ValueError: a cell is no number.
    """
    rows = (line for line in islice(lines, MAX_ROWS) if line.strip(" \t,;"))
    header = next(rows, "")
    names = _lower_names(header)
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


def _lower_names(line: str) -> list[str]:
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


# ---- Runs of a physics lab's sensors, side by side in one table, each with its own times.
# PASCO Capstone names columns "Position (m) Run #1"; Vernier Logger Pro and Graphical Analysis name
# them "Latest: Position (m)", "Run 1: Position (m)" or "Data Set 1:Position(m)".

_MAX_BEFORE = 20  # lines before the names
_MAX_COLUMNS = 200  # that are searched for a run's name


def is_sensor_runs(start: Start) -> bool:
    """Return whether a file is a table with a time column per run."""
    return bool(_names_of_runs(start))


def read_sensor_runs(path: Path, options: ReadOptions) -> Episode:
    """Read one signal per run and position.

    Raises:
        LogError: it holds no positions, or see `read_csv`.
    """
    names = [without_run(name) for name in _names_of_runs(start_of(path))]
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


def _names_of_runs(start: Start) -> Sequence[str]:
    """Return the column names, if a time column names its run; else nothing."""
    for line in start.lines[:_MAX_BEFORE]:
        for separator in SEPARATORS[:-1]:
            cells = cells_of(line, separator) if separator and separator in line else []
            marked = [without_run(cell.strip()) for cell in cells[:_MAX_COLUMNS]]
            if any(run and isinstance(meaning_of(name), TimeColumn) for run, name in marked):
                return [cell.strip() for cell in cells[:_MAX_COLUMNS]]
    return []


# ---- The sheets of a workbook or of an archive of tables, through a process of their own.

_MAX_FILE_BYTES = 128 * 1024**2


@dataclass(frozen=True)
class Sheet:
    """One table."""

    name: str
    # its rows, with tabs between cells; in an archive as they stand in the file
    lines: list[str] = field(default_factory=list)


def sheets_of(path: Path, what: str, *, is_archive: bool) -> list[Sheet]:
    """Read all sheets of a file.

    Raises:
        LogError: it is too large, damaged, or python-calamine is missing.
        OSError: it cannot be read.
    """
    if not is_archive and find_spec("python_calamine") is None:
        raise LogError(
            f"{path}: is a {what}, which needs python-calamine; pip install 'tunenet-logs[tables]'"
        )
    if (size := path.stat().st_size) > _MAX_FILE_BYTES:
        limit = _MAX_FILE_BYTES >> 20
        raise LogError(
            f"{path}: is a {what} of {size >> 20} MiB, over the limit of {limit} MiB; save the "
            "sheet alone, as CSV"
        )
    found: list[Sheet] = []
    try:
        with Sandbox() as sandbox:
            for said, _ in sandbox.answers(sandboxed.sheets, str(path.resolve()), is_archive):
                if isinstance(said, str):
                    found.append(Sheet(said))
                else:
                    found[-1].lines.extend(said)
    except SandboxError as error:
        remedy = error.remedy or "save the sheet alone, as CSV"
        raise LogError(f"{path}: is a {what}, but {error}", remedy) from error
    return found


# ---- Read all sheets of a file as one episode.

_BOOKS = (".xls", ".xlsx", ".xlsm", ".xlsb", ".ods")  # endings of workbooks
_OLE2 = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_ZIP = b"PK\x03\x04"
# How the names of a workbook's parts begin.
_IN_BOOKS = ("[Content_Types].xml", "_rels/", "xl/", "docProps/", "mimetype", "META-INF/")
# Sheets in which phyphox describes the phone and the clock.
_ABOUT = ("metadata device", "metadata time", "meta/device", "meta/time")
_MAX_REASONS = 3  # sheets that are named where none is of use
_MAX_REASON = 150  # characters about each


def is_sheets(start: Start) -> bool:
    """Return whether a file is a workbook, an archive of CSV files, or phyphox's impact CSV."""
    if start.data.startswith(_OLE2):
        return True
    if start.data.startswith(_ZIP):
        return start.suffix in _BOOKS or _is_book(start) or _is_archive(start)
    lines = start.lines
    if start.suffix in _BOOKS and lines:
        return True
    return bool(lines) and names_impacts(lines[0])


def read_sheets(path: Path, options: ReadOptions) -> Episode:
    """Read each sheet that is a table, prefixing its signals' names with the sheet's.

    Raises:
        LogError: no sheet is a table, or the file is damaged or too large.
        OSError: it cannot be read.
    """
    start = start_of(path)
    if not start.data.startswith((_OLE2, _ZIP)):
        # Read a text table: of phyphox, or one misnamed as a workbook.
        if start.data.lstrip()[:1] == b"<":
            raise LogError(
                f"{path}: is a web page or XML that is called a spreadsheet; open it there, and "
                "save it as .xlsx or .csv"
            )
        if options.columns or not names_impacts(next(iter(start.lines), "")):
            return read_csv(path, options)
        sheet = Sheet("", [line or "" for line in islice(lines_of(path), MAX_ROWS)])
        return _Sheets(path, "phyphox export", [sheet], options).episode()
    is_archive = start.data.startswith(_ZIP) and start.suffix not in _BOOKS and not _is_book(start)
    what = "zip archive of tables" if is_archive else "spreadsheet"
    if start.suffix not in _BOOKS and not is_archive:
        what = "file of an office program"
    sheets = [
        sheet
        for sheet in sheets_of(path, what, is_archive=is_archive)
        if any(line.strip() for line in sheet.lines)
    ]
    if any(sheet.name.lower().endswith(_ABOUT) for sheet in sheets):
        what = "phyphox export"
    if not sheets:
        raise LogError(f"{path}: is a {what} without any cell that is filled; save it again")
    return _Sheets(path, what, sheets, options).episode()


def _names(start: Start) -> list[str]:
    """Return the names of a zip archive's first parts."""
    names: list[str] = []
    at = start.data.find(_ZIP)
    while at >= 0 and at + 30 <= len(start.data):
        (length,) = struct.unpack_from("<H", start.data, at + 26)
        names.append(start.data[at + 30 : at + 30 + length].decode("utf-8", "replace"))
        at = start.data.find(_ZIP, at + 30)
    return names


def _is_book(start: Start) -> bool:
    return any(name.startswith(_IN_BOOKS) for name in _names(start)[:1])


def _is_archive(start: Start) -> bool:
    names = [name for name in _names(start) if not name.endswith("/")]
    return bool(names) and names[0].lower().endswith(".csv")


class _Sheets:
    """All sheets of a file, while they are read."""

    def __init__(
        self, path: Path, what: str, sheets: Sequence[Sheet], options: ReadOptions
    ) -> None:
        self._path = path
        self._what = what
        self._options = options
        self._sheets = list(zip(unique_names(sheet.name for sheet in sheets), sheets, strict=True))
        self._signals: dict[str, Signal] = {}
        self._channels: list[Channel] = []
        self._warnings: list[str] = []
        self._losses: list[str] = []
        self._notes: dict[str, str] = {}
        self._skipped: dict[str, str] = {}
        self._impacts: list[tuple[str, ImpactTimes]] = []

    def episode(self) -> Episode:
        """Combine the sheets into one episode; raise LogError if nothing is of use."""
        for name, sheet in self._sheets:
            if name.lower().endswith(_ABOUT):
                self._skipped[name] = "it tells of the phone, not of what was measured"
                continue
            try:
                self._read(name, sheet)
            except LogError as error:
                self._skipped[name] = str(error).removeprefix(f"{self._path}: ")
            except ValueError as error:
                self._skipped[name] = f"its impact times cannot be read ({error})"
        self._add_impacts()
        if not self._signals:
            raise LogError(f"{self._path}: {self._refusal()}")
        rest = export_episode(self._path, self._what, [], unused=self._skipped)
        info = EpisodeInfo(source=f"{self._what} {self._path.name}", notes=self._notes)
        return Episode(
            info,
            self._signals,
            (*self._channels, *rest.channels),
            tuple(self._warnings),
            tuple(self._losses),
        )

    def _prefix(self, name: str) -> str:
        return f"{name}/" if len(self._sheets) > 1 else ""

    def _read(self, name: str, sheet: Sheet) -> None:
        found = None if self._options.columns else impact_times(sheet.lines)
        if found is not None:
            self._impacts.append((name, found))
            return
        episode = self._reader(sheet)(self._path, iter(sheet.lines), self._options)
        prefix = self._prefix(name)
        for signal in episode.signals.values():
            renamed = replace(signal, name=f"{prefix}{signal.name}")
            self._signals[renamed.name] = renamed
        self._channels += [
            replace(channel, topic=f"{prefix}{channel.topic}") for channel in episode.channels
        ]
        about = f"{name}: " if prefix else ""
        self._warnings += [f"{about}{text}" for text in episode.warnings]
        self._losses += [f"{about}{text}" for text in episode.losses]
        self._notes.update(episode.info.notes)

    def _reader(self, sheet: Sheet) -> Callable[[Path, Iterable[str], ReadOptions], Episode]:
        """Choose a sheet's reader: a tracking program's table may have been pasted there."""
        if self._options.columns:
            return read_lines
        if names_masses(sheet.lines[:4]):
            return read_masses
        if is_mtrack2(sheet.lines[0]):
            return read_mtrack2
        return read_lines if spot_layout(sheet.lines[0]) is None else read_spots

    def _add_impacts(self) -> None:
        """Add the impacts of the sheet with most, and of those that do not repeat them."""
        kept: list[tuple[str, np.ndarray]] = []
        order = sorted(
            self._impacts,
            key=lambda one: (-max(map(len, one[1].runs), default=0), not one[1].is_list),
        )
        for name, found in order:
            prefix = self._prefix(name)
            if not found.runs:
                self._skipped[name or "impacts"] = "it holds fewer than two impacts"
                continue
            told = next((other for other, times in kept if _is_within(found, times)), None)
            if told is not None:
                self._skipped[name] = f"its impacts are in {told} as well"
                continue
            kept += [(name, run) for run in found.runs]
            signals, notes = found.signals(prefix)
            rest = {f"{prefix}{key}": why for key, why in found.unused.items()}
            made = export_episode(self._path, self._what, signals, unused=rest)
            self._signals.update(made.signals)
            self._channels += made.channels
            self._warnings += notes

    def _refusal(self) -> str:
        """Return why nothing is of use."""
        if len(self._sheets) == 1:
            return f"is a {self._what} that {_clause(next(iter(self._skipped.values())))}"
        reasons = [
            f"{name!r}: {why}"
            for name, why in self._skipped.items()
            if not name.lower().endswith(_ABOUT)
        ]
        short = [reason.partition("; ")[0][:_MAX_REASON] for reason in reasons]
        more = f" and {len(short) - _MAX_REASONS} more" if len(short) > _MAX_REASONS else ""
        return (
            f"is a {self._what} of {len(short)} sheets without a track, torques or impact times "
            f"({'; '.join(short[:_MAX_REASONS])}{more}); {self._remedy()}"
        )

    def _remedy(self) -> str:
        if self._what == "phyphox export":
            return "record the drop with 'Acoustic Stopwatch' or '(In)elastic Collision'"
        return "name the columns above the numbers, or say which they are with --columns"


def _is_within(found: ImpactTimes, times: np.ndarray) -> bool:
    """Return whether `times` contain all of the found impacts."""
    if found.is_first_unknown:
        return len(found.runs) == 1 and bool(
            np.isin(np.round(np.diff(found.runs[0]), 6), np.round(np.diff(times), 6)).all()
        )
    return all(np.isin(np.round(run, 6), np.round(times, 6)).all() for run in found.runs)


def _clause(why: str) -> str:
    return why if why.startswith(("holds", "has", "is ")) else f"is of no use: {why}"
