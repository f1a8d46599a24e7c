"""Read spreadsheets (.xls, .xlsx, .xlsm, .xlsb, .ods), and exports of phyphox and sensor programs.

Sheets are unpacked in the sandbox; each is then a table as any other, a tracking program's table
that was pasted, or a list of impact times by the phone app phyphox.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import LogError, pip_install
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
from tunenet_logs.formats.columns.signals import (
    export_episode,
    time_stamps,
    unique_names,
)
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


def names_impacts(line: str) -> bool:
    """Return whether a header line is that of a sheet of impact times."""
    return _columns(_lower_names(line)) is not None


def impact_times(lines: Iterable[str]) -> ImpactTimes | None:
    """Read a sheet's impact times; None where its first line names none."""
    rows = (line for line in islice(lines, MAX_ROWS) if line.strip(" \t,;"))
    header = next(rows, "")
    names = _lower_names(header)
    columns = _columns(names)
    if columns is None:
        return None
    separator = best_separator(header)
    cells = [row for line in rows if len(row := cells_of(line, separator)) > max(columns)]
    numbers = Numbers(separator, decimal_of(row[at] for row in cells for at in columns))
    values = [[numbers.read(row[at]) for at in columns] for row in cells]
    kind = names[columns[0]]
    unused = dict.fromkeys(filter(_BESIDE.fullmatch, names), "phyphox reckons it from the times")
    are_gaps = kind == _INTERVALS or _GAPS_IN_A_ROW.fullmatch(kind) is not None
    if kind in (_EVENTS, _INTERVALS):  # one experiment, an impact a row
        values = [[row[0] for row in values]]
        unused.pop(kind, None)
    runs: list[NDArray[np.float64]] = []
    for row in values:
        times = np.array(row)
        if kind == _EVENTS:
            times = times[np.isfinite(times)]
        elif are_gaps:  # cumulated from 0; phyphox writes 0 where there was no more
            times = np.concatenate(([0.0], np.cumsum(times[np.isfinite(times) & (times > 0)])))
        else:  # up to the first missing impact: 0, empty or not later
            times = times[np.logical_and.accumulate(np.diff(times, prepend=-1.0) > 0)]
        runs.append(times)
    filled = tuple(run for run in runs if len(run) > 1)
    return ImpactTimes(filled, unused, is_first_unknown=are_gaps, is_list=kind == _EVENTS)


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


# ---- Runs of a physics lab's sensors, side by side in one table, each with its own times.
# PASCO Capstone names columns "Position (m) Run #1"; Vernier Logger Pro and Graphical Analysis name
# them "Latest: Position (m)", "Run 1: Position (m)" or "Data Set 1:Position(m)".

_MAX_COLUMNS = 200  # that are searched for a run's name


def is_sensor_runs(start: Start) -> bool:
    """Return whether a file is a table with a time column per run."""
    return bool(_names_of_runs(start))


def read_sensor_runs(path: Path, options: ReadOptions) -> Episode:
    """Read one signal per run and position."""
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
    for line in start.lines[:20]:
        for separator in SEPARATORS[:-1]:
            cells = cells_of(line, separator) if separator and separator in line else []
            marked = [without_run(cell.strip()) for cell in cells[:_MAX_COLUMNS]]
            if any(run and isinstance(meaning_of(name), TimeColumn) for run, name in marked):
                return [cell.strip() for cell in cells[:_MAX_COLUMNS]]
    return []


# ---- The sheets of a workbook or of an archive of tables, through a process of their own.


@dataclass(frozen=True)
class Sheet:
    """One table."""

    name: str
    # its rows, with tabs between cells; in an archive as they stand in the file
    lines: list[str] = field(default_factory=list)


def sheets_of(path: Path, what: str, *, is_archive: bool) -> list[Sheet]:
    """Read all sheets of a file."""
    if not is_archive and find_spec("python_calamine") is None:
        raise LogError(f"{path}: is a {what}, which needs python-calamine; {pip_install('tables')}")
    if (size := path.stat().st_size) > 128 * 1024**2:
        raise LogError(
            f"{path}: is a {what} of {size >> 20} MiB, over the limit of 128 MiB; save the "
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
    """Read each sheet that is a table, prefixing its signals' names with the sheet's."""
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
        return _joined(path, "phyphox export", [sheet], options)
    is_archive = start.data.startswith(_ZIP) and start.suffix not in _BOOKS and not _is_book(start)
    what = "zip archive of tables" if is_archive else "spreadsheet"
    if start.suffix not in _BOOKS and not is_archive:
        what = "file of an office program"
    every = sheets_of(path, what, is_archive=is_archive)
    sheets = [sheet for sheet in every if any(map(str.strip, sheet.lines))]
    if any(sheet.name.lower().endswith(_ABOUT) for sheet in sheets):
        what = "phyphox export"
    if not sheets:
        raise LogError(f"{path}: is a {what} without any cell that is filled; save it again")
    return _joined(path, what, sheets, options)


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


def _joined(path: Path, what: str, sheets: Sequence[Sheet], options: ReadOptions) -> Episode:
    """Join the sheets of a file to one episode; signals of several bear their sheet's name."""
    named = list(zip(unique_names(sheet.name for sheet in sheets), sheets, strict=True))
    parts: list[tuple[str, Episode]] = []
    impacts: list[tuple[str, ImpactTimes]] = []
    skipped: dict[str, str] = {}
    for name, sheet in named:
        try:
            if name.lower().endswith(_ABOUT):
                skipped[name] = "it tells of the phone, not of what was measured"
            elif not options.columns and (found := impact_times(sheet.lines)) is not None:
                impacts.append((name, found))
            else:
                read = _reader(sheet, options)
                parts.append((name, read(path, iter(sheet.lines), options)))
        except LogError as error:
            skipped[name] = str(error).removeprefix(f"{path}: ")
        except ValueError as error:
            skipped[name] = f"its impact times cannot be read ({error})"
    parts += _impacts(path, what, impacts, skipped)
    if not any(episode.signals for _, episode in parts):
        raise LogError(f"{path}: is a {what} {_refusal(what, len(named), skipped)}")
    signals: dict[str, Signal] = {}
    channels: list[Channel] = []
    warnings: list[str] = []
    losses: list[str] = []
    notes: dict[str, str] = {}
    for name, episode in parts:
        prefix, about = (f"{name}/", f"{name}: ") if len(named) > 1 else ("", "")
        for key, signal in episode.signals.items():
            signals[f"{prefix}{key}"] = replace(signal, name=f"{prefix}{key}")
        channels += [replace(one, topic=f"{prefix}{one.topic}") for one in episode.channels]
        warnings += [f"{about}{text}" for text in episode.warnings]
        losses += [f"{about}{text}" for text in episode.losses]
        notes |= episode.info.notes
    channels += export_episode(path, what, [], unused=skipped).channels
    info = EpisodeInfo(source=f"{what} {path.name}", notes=notes)
    return Episode(info, signals, tuple(channels), tuple(warnings), tuple(losses))


def _reader(
    sheet: Sheet, options: ReadOptions
) -> Callable[[Path, Iterable[str], ReadOptions], Episode]:
    """Choose a sheet's reader: a tracking program's table may have been pasted there."""
    if options.columns:
        return read_lines
    if names_masses(sheet.lines[:4]):
        return read_masses
    if is_mtrack2(sheet.lines[0]):
        return read_mtrack2
    return read_lines if spot_layout(sheet.lines[0]) is None else read_spots


def _impacts(
    path: Path, what: str, impacts: list[tuple[str, ImpactTimes]], skipped: dict[str, str]
) -> Iterator[tuple[str, Episode]]:
    """Yield the impacts of the sheet with most, and of those that do not repeat them, by sheet."""
    kept: list[tuple[str, np.ndarray]] = []
    most_first = sorted(
        impacts, key=lambda one: (-max(map(len, one[1].runs), default=0), not one[1].is_list)
    )
    for name, found in most_first:
        if not found.runs:
            skipped[name or "impacts"] = "it holds fewer than two impacts"
            continue
        told = next((other for other, times in kept if _is_within(found, times)), None)
        if told is not None:
            skipped[name] = f"its impacts are in {told} as well"
            continue
        signals: list[Signal] = []
        repairs: list[str] = []
        for number, times in enumerate(found.runs, 1):
            kept.append((name, times))
            title = "impacts" + (f" {number}" if len(found.runs) > 1 else "")
            _, stamps, repaired, _ = sorted_stamps(time_stamps(times))
            signals.append(Signal(title, stamps, np.ones((len(stamps), 1)), ("impact",), "1"))
            repairs += [f"{title}: {repair}" for repair in repaired]
        yield name, export_episode(path, what, signals, unused=found.unused, warnings=repairs)


def _refusal(what: str, count: int, skipped: Mapping[str, str]) -> str:
    """Return why nothing in a file's sheets is of use."""
    if count == 1:
        why = next(iter(skipped.values()))
        is_clause = why.startswith(("holds", "has", "is "))
        return f"that {why if is_clause else f'is of no use: {why}'}"
    reasons = [
        f"{name!r}: {why}".partition("; ")[0][:150]
        for name, why in skipped.items()
        if not name.lower().endswith(_ABOUT)
    ]
    more = f" and {len(reasons) - 3} more" if len(reasons) > 3 else ""
    remedy = "name the columns above the numbers, or say which they are with --columns"
    if what == "phyphox export":
        remedy = "record the drop with 'Acoustic Stopwatch' or '(In)elastic Collision'"
    return (
        f"of {len(reasons)} sheets without a track, torques or impact times "
        f"({'; '.join(reasons[:3])}{more}); {remedy}"
    )


def _is_within(found: ImpactTimes, times: np.ndarray) -> bool:
    """Return whether `times` contain all of the found impacts."""
    if found.is_first_unknown:
        return len(found.runs) == 1 and bool(
            np.isin(np.round(np.diff(found.runs[0]), 6), np.round(np.diff(times), 6)).all()
        )
    return all(np.isin(np.round(run, 6), np.round(times, 6)).all() for run in found.runs)
