"""Parse rows of numbers of a text file in blocks: a gigabyte is read in bounded memory."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.errors import LogError
from tunenet_logs.formats.tables.lines import MAX_LINE, cells_of, text_encoding
from tunenet_logs.regular_file import open_regular_text

MAX_COLUMNS = 5000  # of a file of tracks: more than a thousand markers
_MAX_BYTES = 1024**3  # of a file
_BLOCK_CHARACTERS = 4 * 1024**2  # taken apart at once
# Where rows of numbers end and the next section begins.
_WORDS = re.compile(r'^[ \t,;"]*[A-Za-z]', re.MULTILINE)

# How cells are written where nothing was seen, in small letters too.
_UNSEEN = ("", "-", "nan", "Nan", "NAN", "-nan", "null", "none")

_LOOK_ROWS = 20  # looked at, to see how numbers are written


@dataclass(frozen=True)
class NumberFormat:
    """Number format of a file's rows.

    Attributes:
        separator: between cells.
        decimal: "." or ",".
    """

    separator: str
    decimal: str = "."


class LineReader:
    """Buffered reader of lines or of blocks of lines, in bounded memory."""

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._ahead = ""
        self._at = 0

    def line(self) -> str | None:
        """Read a line without its end, cut where it is too long for a table; None at the end."""
        self._fill()
        if not self._ahead:
            return None
        end = self._ahead.find("\n", self._at)
        if end < 0:
            end = len(self._ahead)
        taken = self._ahead[self._at : min(end, self._at + MAX_LINE)]
        self._at = end + 1
        return taken

    def block(self, *, until_words: bool = False) -> str:
        """Read a block of whole lines; "" at the end.

        Args:
            until_words: whether to stop before a line that begins with a letter.
        """
        self._fill()
        words = _WORDS.search(self._ahead, self._at) if until_words else None
        end = words.start() if words else len(self._ahead)
        taken = self._ahead[self._at : end]
        self._at = end
        return taken

    def _fill(self) -> None:
        if self._at >= len(self._ahead):
            self._ahead, self._at = self._file.read(_BLOCK_CHARACTERS), 0
            if self._ahead and not self._ahead.endswith("\n"):
                self._ahead += self._file.readline(MAX_LINE)


@contextmanager
def open_lines(path: Path) -> Iterator[LineReader]:
    """Open a text file as lines.

    Raises:
        LogError: it is too large.
        OSError: it cannot be read.
    """
    size = path.stat().st_size
    if size > _MAX_BYTES:
        raise LogError(
            f"{path}: is an export of {size} bytes, over the limit of 1 GiB; export fewer markers "
            "or a part of the take"
        )
    with open_regular_text(path, text_encoding(path), errors="replace") as file:
        yield LineReader(file)


def separator_of(line: str) -> str:
    """Return the separator of a header line: the most frequent of tab, comma and semicolon."""
    return max("\t,;", key=line.count)


def header_cells(line: str, separator: str) -> list[str]:
    """Split a header line into stripped cells.

    Raises:
        ValueError: there are too many.
    """
    if line.count(separator) > 2 * MAX_COLUMNS:
        raise ValueError(f"over {2 * MAX_COLUMNS} columns")
    cells = [cell.strip() for cell in cells_of(line, separator)]
    while cells and not cells[-1]:
        cells.pop()
    if len(cells) > MAX_COLUMNS:
        raise ValueError(f"{len(cells)} columns, over the limit of {MAX_COLUMNS}")
    return cells


def format_of(block: str, separator: str) -> NumberFormat:
    """Detect the number format of a block of rows."""
    some = "".join(block[: 64 * 1024].splitlines(keepends=True)[:_LOOK_ROWS])
    is_comma = separator != "," and "." not in some and re.search(r"\d,\d", some)
    return NumberFormat(separator, "," if is_comma else ".")


def unended(block: str) -> tuple[str, str]:
    """Split a file's last block into whole lines and an unterminated one; "" if none."""
    if block.endswith("\n"):
        return block, ""
    before, end, last = block.rpartition("\n")
    return before + end, last if last.strip() else ""


def numbers_of(
    block: str, form: NumberFormat, columns: Sequence[int]
) -> tuple[NDArray[np.float64], int]:
    """Parse cells of a block of lines; also count the lines that are malformed.

    Args:
        block: whole lines.
        form: number format.
        columns: to read, increasing.

    Returns:
        Numbers, NaN where a cell is empty or none, shape (T, len(columns)); and the count.
    """
    lines = [line for line in block[: 64 * 1024].splitlines()[:_LOOK_ROWS] if line]
    width = max((line.count(form.separator) + 1 for line in lines), default=0)
    there = [column for column in columns if column < width]
    if not there or width > 2 * MAX_COLUMNS:
        return np.empty((0, len(columns))), block.count("\n")
    values, wrong = _parsed(block, form, width, there)
    missing = np.full((len(values), len(columns) - len(there)), np.nan)
    return np.hstack([values, missing]), wrong


def _parsed(
    block: str, form: NumberFormat, width: int, columns: Sequence[int]
) -> tuple[NDArray[np.float64], int]:
    """Parse existing columns; see `numbers_of`."""
    import pandas as pd

    keywords: dict[str, Any] = {
        "sep": form.separator,
        "decimal": form.decimal,
        "header": None,
        "names": list(range(width)),
        "usecols": list(columns),
        "index_col": False,
        "on_bad_lines": "skip",
        "skipinitialspace": True,
        "na_values": _UNSEEN,
        "engine": "c",
    }
    with suppress(ValueError, OverflowError):  # pandas' own errors of parsing are ValueErrors
        table = pd.read_csv(io.StringIO(block), dtype=np.float64, **keywords)
        return table.to_numpy(np.float64), 0
    try:
        texts = pd.read_csv(io.StringIO(block), dtype=str, quoting=3, **keywords)
    except (ValueError, OverflowError):
        return np.empty((0, len(columns))), block.count("\n")
    if form.decimal == ",":
        texts = texts.apply(lambda column: column.str.replace(",", "."))
    table = texts.apply(pd.to_numeric, errors="coerce").astype(np.float64)
    unseen = texts.apply(lambda column: column.str.strip().str.lower().isin(_UNSEEN))
    wrong = (table.isna() & texts.notna() & ~unseen).any(axis=1)
    return table.to_numpy(np.float64), int(wrong.sum())
