"""Write the ledger as a CSV table (`--csv`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from analysis.batch.batch_file import check_batch_file
from analysis.batch.found_logs import FoundLog
from analysis.batch.ledger import COLUMNS, Ledger
from analysis.batch.ledger_row import ledger_key
from analysis.result_files import table
from tunenet_logs.csv_lines import csv_line, text_of
from tunenet_logs.errors import UsageError
from tunenet_logs.output.owned_file import OutputPlace

_NOT_ITS = (".json", ".rrd", ".parquet", ".jsonl")  # suffixes of what a batch writes beside it


def csv_place(path: Path, folder: Path, *, overwrite: bool) -> OutputPlace:
    """Return the output place of the CSV, which may replace one of the same folder."""
    own = ledger_key(folder)

    def lost(row: Mapping[str, str]) -> str | None:
        results = Path(text_of(row["results"]))
        return None if results.is_relative_to(own) else str(results.parent)

    elsewhere = "give --csv another file"
    return OutputPlace(path, "ledger", table(COLUMNS, lost), own, elsewhere, overwrite=overwrite)


def check_csv(place: OutputPlace, folder: Path, logs: Iterable[FoundLog] = ()) -> None:
    """Check before hours of work that the table can be written, and replaces no log.

    Raises:
        UsageError: It cannot be written.
    """
    path = place.path
    if path.suffix.lower() in _NOT_ITS:
        raise UsageError(f"{path}: is a name of other results; give --csv a name such as all.csv")
    check_batch_file(place, logs, folder)


def write_csv(ledger: Ledger, place: OutputPlace) -> None:
    """Write the ledger as CSV.

    Raises:
        LogError: A file in its place may not be replaced.
        OSError: It cannot be written.
    """
    columns = list(dict.fromkeys((*COLUMNS, *ledger.columns)))
    with (
        place.replacing() as unfinished,
        unfinished.open("w", newline="", encoding="utf-8") as file,
    ):
        file.write(csv_line(columns))
        file.writelines(csv_line(row.get(name) for name in columns) for row in ledger.rows())
