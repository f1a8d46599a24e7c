"""Ledger of a batch: an append-only journal while logs are tuned, a Parquet table at the end.

There is one row per log: a later one replaces an earlier. A kill at any moment loses at most the
line being written; the next run resumes from the rest. A row has a digest of the options, which
tells whether the next run would tune the log alike.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, get_args

import numpy as np

from tunenet_logs.addresses import Address
from tunenet_logs.analysis.batch.logs import OF_BATCH, FoundLog, LogState
from tunenet_logs.analysis.checks import Verdict
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import Record
from tunenet_logs.analysis.result_files import log_sha256, recording, table, writable
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.files import csv_line, parse_json, real_path, text_of
from tunenet_logs.formats.readers.parquet import parquet_rows
from tunenet_logs.recorders.simulators.known import ENGINE_VARIABLE
from tunenet_logs.terminal import short_name
from tunenet_logs.writing.owned_path import OutputPlace, begins_with, write_new

if TYPE_CHECKING:
    import pandas as pd


# ---- Text files beside the results: check their place before the work.


def check_batch_file(place: OutputPlace, logs: Iterable[FoundLog], folder: Path | None) -> None:
    """Check that a file can be written, and replaces no log; `folder` may not exist yet."""
    path = place.path
    real = real_path(path)
    if any(isinstance(one.log, Path) and real_path(one.log) == real for one in logs):
        raise UsageError(f"{path}: is a log of this batch; {place.elsewhere}")
    if path.parent.is_dir() or folder is None or real_path(path.parent) != real_path(folder):
        place.check()


# ---- Rows: one per log, flat, every cell a number or a text.

Cell = str | int | float | bool | None

# Cells by the names of their columns; those without a value may be left out.
LedgerRow = Mapping[str, Cell]


def ledger_key(log: Path | Address) -> str:
    """Return a log's key in the ledger: its absolute path, or its address without secrets."""
    text = str(log if isinstance(log, Address) else real_path(log))
    return os.fsencode(text).decode(errors="replace")


def ledger_row(
    log: Path | Address, name: Path, record: Record, state: LogState, error: str | None
) -> dict[str, Cell]:
    """Build the ledger's row of one log."""
    known, fit = record.provenance, record.motion.fit
    row: dict[str, Cell] = {
        "log": ledger_key(log),
        "verdict": record.verdict,
        "reason": record.reason,
        "error": error,
        **{name: getattr(record, name) for name in ("task", "method", "ball", "topic", "rollouts")},
        "seconds": record.seconds.get("total"),
        "sha256": known and known.log_sha256,
        "bytes": state.size,
        "modified_ns": state.modified_ns,
        "results": ledger_key(name),
        "tuned": known and known.date,
        "version": known and known.version,
        "engine": known and known.engine,
    }
    for estimate in record.estimates:
        # A value with its unit, its interval as `_low` and `_high`, a vector by its axes.
        unit = re.sub(r"[^A-Za-z0-9]+", "_", estimate.unit).strip("_")
        for part in estimate.components:
            column = part.name + ("" if estimate.unit == "1" else f"_{unit}")
            row[column] = part.value
            if part.interval95 is not None:
                row[f"{column}_low"], row[f"{column}_high"] = part.interval95
    if fit is not None and record.estimates:
        kinds = ("rms", "worst", "noise", "excess", "held_out")
        row |= {f"fit_{kind}_percent": getattr(fit, f"{kind}_percent") for kind in kinds}
    return row


# ---- Journal and table: append rows under a lock, then compact them to Parquet.

TEXTS = ("log", "verdict", "reason", "error", "task", "method", "ball", "topic", "sha256")
TEXTS += ("results", "tuned", "version", "engine", "options")
_WHOLE = ("rollouts", "bytes", "modified_ns")
# Columns that every ledger has: texts and whole numbers. All others are numbers.
COLUMNS = (*TEXTS, *_WHOLE)

_GO_ON = "free some space, then go on with --resume"  # what to do where a disk is full
_ELSEWHERE = "choose another folder with -o"
_MOVE = f"move it away, or {_ELSEWHERE}"

# Of a journal that is read: `append` compacts it at half, and a row of ours has hundreds of bytes.
_MAX_JOURNAL_BYTES, _MAX_LINES, _MAX_LINE_BYTES, _MAX_COLUMNS = 50_000_000, 60_000, 100_000, 2000
# Of a ledger that is read: 125,000 logs, and fewer where it has more columns.
_MAX_CELLS, _TYPICAL_COLUMNS = 5_000_000, 40

_HEAD = b'{"journal": "tunenet-tune"}\n'
_ROW = b'{"log": '  # how a journal begins, and each line after that
# What a table says of itself, how that stands in its file, and in how many of the last bytes.
_PARQUET_MARK = {b"tunenet-logs": b"ledger"}
_IN_PARQUET = b"tunenet-logs\x18\x06ledger"
_FOOTER_BYTES = 2**20


class Ledger:
    """Rows by log, in the order in which the logs first ended."""

    def __init__(self) -> None:
        self.columns: dict[str, list[Cell]] = {"log": []}  # cells of each, all of one length
        self._place: dict[str, int] = {}

    def __len__(self) -> int:
        return len(self._place)

    def put(self, row: LedgerRow) -> None:
        """Insert a row, or replace that of the same log."""
        count = len(self._place)
        at = self._place.setdefault(str(row["log"]), count)
        for cells in self.columns.values():
            cells[at : at + 1] = [None]
        for name, value in row.items():
            if name not in self.columns:
                if value is None or len(self.columns) >= _MAX_COLUMNS:
                    continue
                self.columns[name] = [None] * len(self._place)
            self.columns[name][at] = value

    def row(self, log: str) -> dict[str, Cell] | None:
        """Return the row of a log, or None."""
        at = self._place.get(log)
        return None if at is None else {name: cells[at] for name, cells in self.columns.items()}


def ledger_file(folder: Path) -> Path:
    """Return the path of the ledger's table in a folder of results."""
    return folder / f"{OF_BATCH}.parquet"


def read_ledger(table: Path) -> pd.DataFrame:
    """Read the table of `ledger_file`, one row per log."""
    import pandas as pd

    return pd.read_parquet(table)


def overview_file(folder: Path) -> Path:
    """Return the path of the recording that shows a whole ledger."""
    return folder / f"{OF_BATCH}.rrd"


def overview_place(folder: Path) -> OutputPlace:
    """Return the output place of the overview, which replaces an earlier one."""
    knows = recording("overview", "")
    return OutputPlace(overview_file(folder), "overview", knows, elsewhere=_ELSEWHERE)


def _knows_table(file: BinaryIO) -> Sequence[str] | None:
    if file.read(4) != b"PAR1":
        return None
    file.seek(max(0, os.fstat(file.fileno()).st_size - _FOOTER_BYTES))
    return () if _IN_PARQUET in file.read(_FOOTER_BYTES) else None


class Journal:
    """Ledger of a folder while logs are tuned into it."""

    def __init__(self, folder: Path, path: Path, file: BinaryIO) -> None:
        self.ledger = Ledger()
        self._path, self._file = path, file
        self._last: LedgerRow | None = None  # a row that a signal may have kept from the ledger
        self._table = OutputPlace(ledger_file(folder), "ledger", _knows_table, elsewhere=_ELSEWHERE)
        for place in (self._table, overview_place(folder)):
            if why := place.why_not():
                raise LogError(why)
        rows = _journal_rows(path, file)  # all of it is looked at before a byte is changed
        if self._table.path.exists():
            self._put(self._table.path, _table_rows(self._table.path))
        self._put(path, rows)

    def _put(self, path: Path, rows: Iterable[LedgerRow]) -> None:
        for row in rows:
            self.ledger.put(row)
            columns = max(_TYPICAL_COLUMNS, len(self.ledger.columns))
            if len(self.ledger) * columns > _MAX_CELLS:
                raise LogError(f"{path}: has more than any ledger; {_MOVE}")

    def append(self, row: LedgerRow) -> None:
        """Append the row of a log that has just ended, and flush it to the journal."""
        self._last = row
        line = json.dumps(row, ensure_ascii=False).encode(errors="replace")
        with writable(self._path, _GO_ON):
            self._file.write(line + b"\n")
            self._file.flush()
        self.ledger.put(row)
        self._last = None
        if os.fstat(self._file.fileno()).st_size > _MAX_JOURNAL_BYTES // 2:
            self.compact()

    def compact(self) -> Path:
        """Write all rows as one Parquet table, then truncate the journal."""
        table = self._table.path
        if self._last is not None:  # Ctrl-C came while it was put there, column by column
            self.ledger.put(self._last)
        with writable(table, _GO_ON), self._table.replacing() as unfinished:
            write_parquet(self.ledger, unfinished)
        self._file.truncate(len(_HEAD))
        return table


@contextmanager
def journal(folder: Path) -> Iterator[Journal]:
    """Open the journal of a folder of results under an exclusive lock; write the table on exit."""
    path = folder / f"{OF_BATCH}.jsonl"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = _locked(path)
    except OSError as error:
        place, why = error.filename or path, error.strerror
        raise LogError(f"{place}: cannot be written ({why}); {_ELSEWHERE}") from error
    with file:
        kept = None
        try:
            kept = Journal(folder, path, file)
            yield kept
        finally:
            if kept is not None and len(kept.ledger):
                kept.compact()
            file.seek(0)
            is_new = file.read(len(_HEAD) + 1) == _HEAD
            if _is_at(path, file) and (kept is not None or is_new):
                path.unlink()


def _locked(path: Path) -> BinaryIO:
    """Open the journal under an exclusive lock; a new one has a journal's header."""
    flags = os.O_RDWR | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    while True:
        knows = begins_with(_HEAD)
        if why := OutputPlace(path, "journal", knows, elsewhere=_ELSEWHERE).why_not():
            raise LogError(why)
        try:
            file = os.fdopen(os.open(path, flags), "a+b")
        except FileNotFoundError:
            with suppress(FileExistsError):
                write_new(path, _HEAD)
            continue
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.close()
            raise UsageError(
                f"{path.parent}: another tunenet-tune writes its ledger; wait for it, or choose "
                "another folder with -o"
            ) from error
        state = os.fstat(file.fileno())
        if state.st_nlink > 1:
            file.close()
            raise LogError(f"{path}: has another name too (a hard link); {_MOVE}")
        if stat.S_ISREG(state.st_mode) and _is_at(path, file):
            return file
        file.close()  # the process that held it has just removed it


def _is_at(path: Path, file: BinaryIO) -> bool:
    try:
        return os.path.samestat(path.lstat(), os.fstat(file.fileno()))
    except OSError:
        return False


def _journal_rows(path: Path, file: BinaryIO) -> list[LedgerRow]:
    """Read the journal's complete lines, and truncate a line that a kill cut off."""
    if os.fstat(file.fileno()).st_size > _MAX_JOURNAL_BYTES:
        size = _MAX_JOURNAL_BYTES // 1_000_000
        raise LogError(f"{path}: is larger than any journal ({size} MB); {_MOVE}")
    file.seek(0)
    rows: list[LedgerRow] = []
    whole = number = 0
    while line := file.readline(_MAX_LINE_BYTES):
        number += 1
        if number > _MAX_LINES:
            raise LogError(f"{path}: has over {_MAX_LINES} lines; {_MOVE}")
        if not line.endswith(b"\n"):
            is_torn = number > 1 and len(line) < _MAX_LINE_BYTES and line[: len(_ROW)] in _ROW
            if not is_torn:
                raise _no_row(path, number, "does not end")
            break
        whole = file.tell()
        if number > 1:
            try:
                rows.append(_row(parse_json(line)))
            except ValueError as error:
                raise _no_row(path, number, short_name(error)) from error
    file.seek(0, os.SEEK_END)
    if file.tell() > whole:
        file.truncate(whole)
    return rows


def _no_row(path: Path, number: int, why: str) -> LogError:
    return LogError(f"{path}: line {number} is none of a journal ({why}); {_MOVE}")


def _row(given: Any) -> LedgerRow:
    """Validate a row of a ledger."""
    if not isinstance(given, dict) or not isinstance(given.get("log"), str):
        raise ValueError("it names no log")
    if given.get("verdict") not in get_args(Verdict):
        raise ValueError(f"its verdict is {short_name(given.get('verdict'))}")
    for name, value in given.items():
        if not (value is None or isinstance(value, str | int | float)):
            raise ValueError(f"{short_name(name)} is neither text nor number")
    return given


def write_parquet(ledger: Ledger, path: Path) -> None:
    """Write the ledger as a Parquet table with one type per column."""
    import pyarrow as pa
    from pyarrow import parquet

    arrays: dict[str, Any] = {}
    for name in dict.fromkeys((*COLUMNS[:1], *ledger.columns, *COLUMNS)):
        kind, made, taken = pa.float64(), float, int | float
        if name in TEXTS:
            kind, made, taken = pa.string(), str, object
        elif name in _WHOLE:
            kind, made, taken = pa.int64(), int, int
        cells = ledger.columns.get(name, [None] * len(ledger))
        usable = (one if isinstance(one, taken) else None for one in cells)
        arrays[name] = pa.array([None if one is None else made(one) for one in usable], kind)
    parquet.write_table(pa.table(arrays).replace_schema_metadata(_PARQUET_MARK), path)


def _table_rows(path: Path) -> Iterator[LedgerRow]:
    """Yield the rows of a table, each validated: the file is untrusted."""
    try:
        for rows in parquet_rows(path, _MAX_CELLS):
            yield from map(_row, rows)
    except ValueError as error:
        raise LogError(f"{path}: is no ledger ({error}); {_MOVE}") from error
    except LogError as error:
        raise LogError(error.what, _MOVE) from error


# ---- Options digest: a hash of all that decides a log's result.


def options_digest(options: TuneOptions) -> str:
    """Hash the options, the contents of the files they name, the engine and our version."""
    known = hashlib.sha256()
    engine = os.environ.get(ENGINE_VARIABLE, "")
    known.update(f"{version('tunenet-logs')} {engine}\n".encode())
    _add(known, options)
    return known.hexdigest()[:16]


def _add(known: Any, value: Any) -> None:
    if isinstance(value, Path):
        try:
            known.update(log_sha256(value).encode())
        except OSError:  # every log will be rejected for it
            known.update(str(value).encode(errors="replace"))
    elif isinstance(value, np.ndarray):
        known.update(f"{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value) and not isinstance(value, Episode):
        for field in fields(value):
            known.update(field.name.encode())
            _add(known, getattr(value, field.name))
    elif isinstance(value, tuple | list):
        known.update(f"({len(value)}".encode())
        for one in value:
            _add(known, one)
    elif isinstance(value, dict):
        for name in sorted(value):
            known.update(str(name).encode())
            _add(known, value[name])
    else:
        known.update(f"{value!r};".encode())


# ---- CSV: the ledger as a text table (`--csv`).

_NOT_ITS = (".json", ".rrd", ".parquet", ".jsonl")  # suffixes of what a batch writes beside it


def csv_place(
    path: Path, folder: Path, logs: Iterable[FoundLog], *, overwrite: bool
) -> OutputPlace:
    """Check the place of the CSV before hours of work; it may replace one of the same folder."""
    own = ledger_key(folder)

    def lost(row: Mapping[str, str]) -> str | None:
        results = Path(text_of(row["results"]))
        return None if results.is_relative_to(own) else str(results.parent)

    elsewhere = "give --csv another file"
    place = OutputPlace(path, "ledger", table(COLUMNS, lost), own, elsewhere, overwrite=overwrite)
    if path.suffix.lower() in _NOT_ITS:
        raise UsageError(f"{path}: is a name of other results; give --csv a name such as all.csv")
    check_batch_file(place, logs, folder)
    return place


def write_csv(ledger: Ledger, place: OutputPlace) -> None:
    """Write the ledger as CSV."""
    columns = list(dict.fromkeys((*COLUMNS, *ledger.columns)))
    with (
        place.replacing() as unfinished,
        unfinished.open("w", newline="", encoding="utf-8") as file,
    ):
        file.write(csv_line(columns))
        nothing: list[Cell] = [None] * len(ledger)
        cells = [ledger.columns.get(name, nothing) for name in columns]
        file.writelines(map(csv_line, zip(*cells, strict=True)))
