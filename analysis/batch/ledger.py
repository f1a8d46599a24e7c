"""The ledger of many logs: a journal that grows by a line as each log ends, a table at the end.

A kill at any moment loses no line of the journal but the one being written. The next run reads
what is there, and goes on. One row a log: a later one takes the place of an earlier.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from analysis.batch.ledger_row import Cell, LedgerRow
from analysis.batch.result_names import OF_BATCH
from analysis.result_files import replacing, writable
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.regular_file import open_regular

if TYPE_CHECKING:
    import pandas as pd

_TEXTS = ("log", "verdict", "reason", "error", "task", "method", "ball", "topic", "sha256")
_TEXTS += ("results", "tuned", "version", "engine", "options")
_KNOWN_BY = ("log", "verdict")
"""Columns of text without which a table is no ledger, of whatever version."""

_WHOLE = ("rollouts", "bytes", "modified_ns")
"""Columns that every ledger has; all others are numbers."""

_GO_ON = "free some space, then go on with --resume"
"""What to do where a disk is full."""

_MOST_LINE = 100_000
"""Bytes of a line of the journal."""

_MOST_COLUMNS = 2000


class Ledger:
    """Rows by log, in the order in which the logs first ended.

    Attributes:
        columns: cells of each column, all of one length.
    """

    def __init__(self) -> None:
        self.columns: dict[str, list[Cell]] = {"log": []}
        self._place: dict[str, int] = {}

    def __len__(self) -> int:
        return len(self._place)

    def put(self, row: LedgerRow) -> None:
        """Enter a row, for the one of the same log if there is one."""
        log = str(row["log"])
        count = len(self._place)
        at = self._place.setdefault(log, count)
        if at == count:
            for cells in self.columns.values():
                cells.append(None)
        else:
            for cells in self.columns.values():
                cells[at] = None
        for name, value in row.items():
            if name not in self.columns:
                if value is None or len(self.columns) >= _MOST_COLUMNS:
                    continue
                self.columns[name] = [None] * len(self._place)
            self.columns[name][at] = value

    def row(self, log: str) -> dict[str, Cell] | None:
        """That of a log; None where there is none."""
        at = self._place.get(log)
        return None if at is None else {name: cells[at] for name, cells in self.columns.items()}

    def rows(self) -> Iterator[dict[str, Cell]]:
        """All of them."""
        for at in range(len(self)):
            yield {name: cells[at] for name, cells in self.columns.items()}


def ledger_file(folder: Path) -> Path:
    """The table of a folder of results."""
    return folder / f"{OF_BATCH}.parquet"


def read_ledger(table: Path) -> pd.DataFrame:
    """The table of `ledger_file`, a row a log."""
    import pandas as pd

    return pd.read_parquet(table)


def _journal_file(folder: Path) -> Path:
    return folder / f"{OF_BATCH}.jsonl"


class Journal:
    """The ledger of a folder while logs are tuned into it."""

    def __init__(self, folder: Path, file: BinaryIO) -> None:
        self.folder = folder
        self.ledger = Ledger()
        table = ledger_file(folder)
        if table.exists():
            for row in _table_rows(table):
                self.ledger.put(row)
        self._file = file
        for row in _journal_rows(file):
            self.ledger.put(row)

    def append(self, row: LedgerRow) -> None:
        """Enter the row of a log that has just ended; it outlives this process.

        Raises:
            LogError: the journal cannot be written.
        """
        line = json.dumps(row, ensure_ascii=False).encode(errors="replace")
        with writable(_journal_file(self.folder), _GO_ON):
            self._file.write(line + b"\n")
            self._file.flush()
        self.ledger.put(row)

    def compact(self) -> Path:
        """Write all rows as one Parquet table, and empty the journal.

        Raises:
            LogError: it cannot be written; the journal keeps all.
        """
        table = ledger_file(self.folder)
        with writable(table, _GO_ON), replacing(table) as unfinished:
            write_parquet(self.ledger, unfinished)
        self._file.truncate(0)
        return table


@contextmanager
def journal(folder: Path) -> Iterator[Journal]:
    """The journal of a folder of results, this process's alone; at the end it is the table.

    Raises:
        UsageError: another process tunes into the folder.
        LogError: the folder cannot be written, or its ledger is damaged.
    """
    path = _journal_file(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = _locked(path)
    except OSError as error:
        raise LogError(
            f"{error.filename or path}: cannot be written ({error.strerror}); choose another "
            "folder with -o"
        ) from error
    with file:
        kept = Journal(folder, file)
        try:
            yield kept
        finally:
            if len(kept.ledger):
                kept.compact()
            path.unlink(missing_ok=True)


def _locked(path: Path) -> BinaryIO:
    """The journal's file, opened for this process alone."""
    while True:
        file = path.open("a+b")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.close()
            raise UsageError(
                f"{path.parent}: another tunenet-tune writes its ledger; wait for it, or choose "
                "another folder with -o"
            ) from error
        if path.exists() and os.fstat(file.fileno()).st_ino == path.stat().st_ino:
            return file
        file.close()  # the process that held it has just removed it


def _journal_rows(file: BinaryIO) -> Iterator[dict[str, Any]]:
    """The journal's whole lines; what a kill has cut off is taken away."""
    file.seek(0)
    whole = 0
    while line := file.readline(_MOST_LINE):
        if not line.endswith(b"\n"):
            break
        whole = file.tell()
        try:
            row = json.loads(line)
        except ValueError:
            continue
        if isinstance(row, dict) and isinstance(row.get("log"), str) and _are_cells(row):
            yield row
    file.seek(0, os.SEEK_END)
    if file.tell() > whole:
        file.truncate(whole)


def _are_cells(row: Mapping[Any, Any]) -> bool:
    return all(value is None or isinstance(value, str | int | float) for value in row.values())


def write_parquet(ledger: Ledger, path: Path) -> None:
    """The ledger as a Parquet table; every column has one type."""
    import pyarrow as pa
    from pyarrow import parquet

    arrays: dict[str, Any] = {}
    for name in dict.fromkeys((*_TEXTS[:1], *ledger.columns, *_TEXTS, *_WHOLE)):
        cells = ledger.columns.get(name, [None] * len(ledger))
        kind: Any = pa.float64()
        if name in _TEXTS:
            kind, cells = pa.string(), [None if one is None else str(one) for one in cells]
        elif name in _WHOLE:
            kind, cells = pa.int64(), [one if isinstance(one, int) else None for one in cells]
        else:
            numbers = (one if isinstance(one, int | float) else None for one in cells)
            cells = [None if one is None else float(one) for one in numbers]
        arrays[name] = pa.array(cells, kind)
    parquet.write_table(pa.table(arrays), path)


def _table_rows(path: Path) -> Iterator[dict[str, Any]]:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        with open_regular(path) as file, parquet.ParquetFile(file) as table:
            kinds = dict(zip(table.schema_arrow.names, table.schema_arrow.types, strict=True))
            if any(kinds.get(name) not in (pa.string(), pa.large_string()) for name in _KNOWN_BY):
                raise LogError(f"{path}: is no ledger of tunenet-tune; choose another folder (-o)")
            for batch in table.iter_batches(1000):
                yield from (row for row in batch.to_pylist() if isinstance(row["log"], str))
    except (OSError, pa.ArrowException) as error:
        raise LogError(
            f"{path}: cannot be read ({error}); move it away, or choose another folder with -o"
        ) from error
