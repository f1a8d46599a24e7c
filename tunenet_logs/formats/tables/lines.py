"""The lines of a text file and the cells of a line, both bounded."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

from tunenet_logs.errors import LogError
from tunenet_logs.regular_file import open_regular, open_regular_text

SUFFIXES = (".csv", ".tsv", ".txt")
"""Of files that may be tables."""

SEPARATORS = ("\t", ";", ",", None)
"""In the order in which they are tried; None is white space."""

MOST_LINE = 1024**2
"""Characters; a row of 5000 columns of 20 digits is a tenth of that."""

_MOST_BYTES = 512 * 1024**2
"""Of a table: its cells are read one by one, in Python."""

_UTF16 = (b"\xff\xfe", b"\xfe\xff")
"""How UTF-16 begins; spreadsheets write it as "Unicode text"."""


_MOST_LINES = 4_000_000
"""Of a table, empty ones too: as many again as it may have rows."""


def is_table(path: Path) -> bool:
    """Whether a file is text, by its name and its first bytes.

    Raises:
        OSError: it cannot be read.
    """
    if path.suffix.lower() not in SUFFIXES:
        return False
    with open_regular(path) as file:
        start = file.read(4096)
    return start.startswith(_UTF16) or b"\0" not in start


def lines_of(path: Path) -> Iterator[str | None]:
    """The lines without their ends; None for one that is too long for any table.

    Raises:
        LogError: the file is too large, or has too many lines.
        OSError: it cannot be read.
    """
    size = path.stat().st_size
    if size > _MOST_BYTES:
        raise LogError(f"{path}: is a table of {size} bytes, over the limit of 512 MiB; split it")
    with open_regular(path) as file:
        encoding = "utf-16" if file.read(2) in _UTF16 else "utf-8-sig"
    with open_regular_text(path, encoding, errors="replace") as file:
        count = 0
        while line := file.readline(MOST_LINE):
            count += 1
            if count > _MOST_LINES:
                raise LogError(
                    f"{path}: is a table of over {_MOST_LINES} lines, the limit; split it"
                )
            whole = line.endswith("\n") or len(line) < MOST_LINE
            while not line.endswith("\n") and len(line) == MOST_LINE:
                line = file.readline(MOST_LINE)
            yield line.rstrip("\n") if whole else None


def cells_of(line: str, separator: str | None) -> list[str]:
    """The cells of a line; none where it is no line of a table.

    A cell never spans lines: a quote that is not closed must not swallow the rest of a file.
    """
    if separator is None:
        return line.split()
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        return []
