"""Print the cells of a workbook or an archive of tables, as a process of its own.

A malicious file ends this process, not its parent: what unpacks or parses it has bounds of time and
of memory here, and may crash. So this file imports nothing of ours.

Each line of the output is a JSON array: ["sheet", NAME], ["rows", TEXT, ...] with tabs between
cells, or ["error", WHY, REMEDY] as the last one.
"""

from __future__ import annotations

import datetime as dt
import io
import json
import os
import resource
import sys
import zipfile
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any

MAX_FILE_BYTES = 128 * 1024**2
_MAX_UNPACKED_BYTES = 384 * 1024**2
_MAX_PARTS = 5000
_MAX_SHEETS = 200
_MAX_COLUMNS = 5000
_MAX_TEXT = 64 * 1024**2
_MAX_CELL = 1000
_ROW_COST = 40
_BLOCK_ROWS = 500
_MEMORY_BYTES = 480 * 1024**2
_CPU_S = 9

# What stands in a cell whose formula failed.
_EXCEL_ERRORS = ("#N/A", "#DIV/0!", "#VALUE!", "#REF!", "#NAME?", "#NUM!", "#NULL!")

_EPOCH = dt.datetime(1899, 12, 30)  # what a time without a date counts from in some workbooks


class RefusedError(Exception):
    """Why a file is not read, and the remedy."""


def main(path: str, kind: str) -> None:
    """Print all cells of the file, of kind "book" or "archive"."""
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CPU, (_CPU_S, _CPU_S))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        sheets = _archive(path) if kind == "archive" else _book(path)
        _print(sheets)
    except RefusedError as error:
        _say("error", *error.args)
    except MemoryError:
        _say("error", "needs more memory than any table of a log", "save the sheet alone, as CSV")
    except BaseException as error:  # noqa: BLE001 (a panic of Rust is no Exception)
        why = " ".join(str(error).split())[:200] or type(error).__name__
        _say("error", f"cannot be read ({why})", "save it again, or as CSV")


def _say(*words: str) -> None:
    sys.stdout.write(json.dumps(words) + "\n")
    sys.stdout.flush()


def _print(sheets: Iterable[tuple[str, Iterable[str]]]) -> None:
    room = _MAX_TEXT
    for number, (name, rows) in enumerate(sheets):
        if number >= _MAX_SHEETS:
            raise RefusedError(f"holds over {_MAX_SHEETS} sheets", "save those of the log alone")
        sys.stdout.write(json.dumps(("sheet", name[:200])) + "\n")
        some = iter(rows)
        while block := list(islice(some, _BLOCK_ROWS)):
            room -= sum(map(len, block)) + _ROW_COST * len(block)
            if room < 0:
                raise RefusedError(
                    f"holds over {_MAX_TEXT >> 20} MiB of text", "save each sheet alone, as CSV"
                )
            sys.stdout.write(json.dumps(("rows", *block)) + "\n")
    sys.stdout.flush()


def _check_zip(path: str) -> zipfile.ZipFile:
    """Open a zip archive after checking its directory for a decompression bomb."""
    archive = zipfile.ZipFile(path)
    parts = archive.infolist()
    if len(parts) > _MAX_PARTS:
        raise RefusedError(f"is a zip archive of {len(parts)} parts", "save the sheet alone")
    size = sum(part.file_size for part in parts)
    if size > _MAX_UNPACKED_BYTES:
        raise RefusedError(
            f"unpacks to {size >> 20} MiB, over the limit of {_MAX_UNPACKED_BYTES >> 20} MiB",
            "save the sheet alone, as CSV",
        )
    if any(part.flag_bits & 1 for part in parts):
        raise RefusedError("is encrypted", "save it without a password")
    return archive


def _book(path: str) -> Iterator[tuple[str, Iterator[str]]]:
    from python_calamine import CalamineWorkbook

    if zipfile.is_zipfile(path):
        with _check_zip(path):
            pass
    with CalamineWorkbook.from_path(path) as book:
        for number, about in enumerate(book.sheets_metadata):
            if str(about.typ).rsplit(".", 1)[-1] in ("WorkSheet", "Worksheet"):
                yield about.name, _rows(book, number)


def _rows(book: Any, number: int) -> Iterator[str]:
    sheet = book.get_sheet_by_index(number)
    if sheet.width > _MAX_COLUMNS:
        yield "\t".join(["-"] * sheet.width)  # the reader of tables says what is wrong with it
        return
    empty = 0
    for row in sheet.iter_rows():
        cells = [_text(cell) for cell in row]
        if not any(cells):
            empty += 1
            if empty > 10_000:
                return
            yield ""
            continue
        empty = 0
        yield "\t".join(cells)


def _text(cell: object) -> str:
    """Format a cell as a text table has it."""
    if isinstance(cell, str):
        text = " ".join(cell[:_MAX_CELL].replace('"', "''").split())
        return "" if text in _EXCEL_ERRORS else text
    if isinstance(cell, dt.datetime | dt.date):
        return _date(cell)
    if isinstance(cell, dt.timedelta):
        return repr(cell.total_seconds())
    if isinstance(cell, dt.time):
        seconds = cell.hour * 3600 + cell.minute * 60 + cell.second
        return repr(seconds + cell.microsecond * 1e-6)
    return "" if cell is None else repr(cell)[:_MAX_CELL].removesuffix(".0")


def _date(cell: dt.date) -> str:
    """Format a date in ISO 8601; in seconds where it is a duration that was taken for a date."""
    when = cell if isinstance(cell, dt.datetime) else dt.datetime(cell.year, cell.month, cell.day)
    if when.year < 1901:
        return repr((when - _EPOCH).total_seconds())
    return when.isoformat()


def _archive(path: str) -> Iterator[tuple[str, Iterator[str]]]:
    """Yield the .csv files of a zip archive, by their names without the ending."""
    with _check_zip(path) as archive:
        parts = [part for part in archive.infolist() if part.filename.lower().endswith(".csv")]
        parts = [part for part in parts if "__MACOSX" not in part.filename]
        for part in parts:
            yield part.filename[:-4], _lines(archive, part)


def _lines(archive: zipfile.ZipFile, part: zipfile.ZipInfo) -> Iterator[str]:
    with archive.open(part) as packed:
        start = packed.read(65_536)
    encoding = "utf-16" if start[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    if not start.isascii() and start.decode(encoding, "ignore").isascii():
        encoding = "cp1252"
    with archive.open(part) as packed:
        text = io.TextIOWrapper(packed, encoding, errors="replace")
        while line := text.readline(1024**2):
            yield line.rstrip("\r\n")


if __name__ == "__main__":
    sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    os.dup2(sys.stderr.fileno(), 2)
    main(sys.argv[1], sys.argv[2])
