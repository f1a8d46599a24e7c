"""The ledger as a table in text (`--csv`), and what it never replaces."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

from analysis.batch.found_logs import FoundLog
from analysis.batch.ledger import Ledger
from analysis.result_files import check_writable, replacing
from tunenet_logs.errors import UsageError
from tunenet_logs.regular_file import open_regular, real_path

_BEGINS = b"log,"
"""A text table of a ledger: its first column."""

_NOT_ITS = (".json", ".rrd", ".parquet", ".jsonl")
"""Suffixes of what a batch writes beside it."""


def check_csv(path: Path, folder: Path, logs: Iterable[FoundLog] = (), *, overwrite: bool) -> None:
    """Find out before hours of work whether the table can be written, and over what.

    Args:
        path: where it goes.
        folder: of the results; it need not be there yet.
        logs: of the batch, which it never replaces.
        overwrite: whether it may replace a file that is no such table.

    Raises:
        UsageError: it cannot; says why.
    """
    if path.suffix.lower() in _NOT_ITS:
        raise UsageError(f"{path}: is a name of other results; give --csv a name such as all.csv")
    place = real_path(path)
    if any(isinstance(one.log, Path) and real_path(one.log) == place for one in logs):
        raise UsageError(f"{path}: is a log of this batch; give --csv another file")
    if path.parent.is_dir() or real_path(path.parent) != real_path(folder):
        check_writable(path, "--csv")
    if path.exists() and not overwrite and not _is_table(path):
        raise UsageError(
            f"{path}: exists, and is no table of a ledger; give --csv another file, or pass "
            "--overwrite"
        )


def _is_table(path: Path) -> bool:
    try:
        with open_regular(path) as file:
            begins = file.read(len(_BEGINS))
    except OSError:
        return False
    return begins in (b"", _BEGINS)


def write_csv(ledger: Ledger, path: Path) -> None:
    """The ledger as a table in text.

    Raises:
        OSError: it cannot be written.
    """
    with replacing(path) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(ledger.columns)
        writer.writerows([row[name] for name in ledger.columns] for row in ledger.rows())
