"""Read spreadsheets (.xls, .xlsx, .xlsm, .xlsb, .ods), and exports of the phone app phyphox."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import LogError
from tunenet_logs.formats.csv_table import read_csv, read_lines
from tunenet_logs.formats.exports.build import export_episode
from tunenet_logs.formats.exports.sheets.phyphox import (
    MAX_ROWS,
    ImpactTimes,
    impact_times,
    names_impacts,
)
from tunenet_logs.formats.exports.sheets.workbook import Sheet, sheets_of
from tunenet_logs.formats.exports.start import Start, start_of
from tunenet_logs.formats.exports.trackers.mtrack2 import is_mtrack2, read_mtrack2
from tunenet_logs.formats.exports.trackers.spot_rows import unique_names
from tunenet_logs.formats.exports.trackers.spot_table import read_spots, spot_layout
from tunenet_logs.formats.exports.trackers.tracker import names_masses, read_masses
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.lines import lines_of

_BOOKS = (".xls", ".xlsx", ".xlsm", ".xlsb", ".ods")  # endings of workbooks
_OLE2 = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_ZIP = b"PK\x03\x04"
# How the names of a workbook's parts begin.
_IN_BOOKS = ("[Content_Types].xml", "_rels/", "xl/", "docProps/", "mimetype", "META-INF/")

# What phyphox says of the phone and of the clock.
_ABOUT = ("metadata device", "metadata time", "meta/device", "meta/time")

_MAX_REASONS = 3  # sheets that are named where none is of use
_MAX_REASON = 150  # letters of what is said of each


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
        return _read_text(path, start, options)
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


def _read_text(path: Path, start: Start, options: ReadOptions) -> Episode:
    """Read a text table: of phyphox, or one misnamed as a workbook."""
    if start.data.lstrip()[:1] == b"<":
        raise LogError(
            f"{path}: is a web page or XML that is called a spreadsheet; open it there, and save "
            "it as .xlsx or .csv"
        )
    if options.columns or not names_impacts(next(iter(start.lines), "")):
        return read_csv(path, options)
    sheet = Sheet("", [line or "" for line in islice(lines_of(path), MAX_ROWS)])
    return _Sheets(path, "phyphox export", [sheet], options).episode()


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
