"""The ledger as a table in text (`--csv`), and what it never replaces."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

from analysis.batch.batch_file import check_batch_file
from analysis.batch.found_logs import FoundLog
from analysis.batch.ledger import Ledger
from analysis.result_files import replacing
from tunenet_logs.errors import UsageError

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
    check_batch_file(path, "--csv", _BEGINS, logs, folder, overwrite=overwrite)


def write_csv(ledger: Ledger, path: Path) -> None:
    """The ledger as a table in text.

    Raises:
        OSError: it cannot be written.
    """
    with replacing(path) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(ledger.columns)
        writer.writerows([row[name] for name in ledger.columns] for row in ledger.rows())
