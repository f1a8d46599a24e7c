"""Read lines of a text file and cells of a line, both bounded."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from tunenet_logs.errors import LogError
from tunenet_logs.regular_file import open_regular, open_regular_text

SUFFIXES = (".csv", ".tsv", ".txt")  # of files that may be tables
SEPARATORS = ("\t", ";", ",", None)  # in the order in which they are tried; None is white space
MAX_LINE = 1024**2  # characters; a row of 5000 columns of 20 digits is a tenth of that
_MAX_BYTES = 512 * 1024**2  # of a table: its cells are read one by one, in Python
_LOOK_BYTES = 65_536  # of a file, by which text is told from what is none, and its encoding
# Share of bytes beyond ASCII in a text of one byte a character; pictures and sound have more.
_MAX_FOREIGN = 0.3

_NUMBER = re.compile(r"[-+]?(?:[0-9]++(?:[.,][0-9]++)?|[.,][0-9]++)(?:[eE][-+]?[0-9]+)?")

# How encodings begin that mark themselves; spreadsheets write UTF-16 as "Unicode text".
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
    (codecs.BOM_UTF8, "utf-8-sig"),
)

# Bytes that no text has; a terminal's log has ESC (1b), an old one of DOS ends with 1a.
_CONTROLS = re.compile(rb"[\x00-\x08\x0e-\x19\x1c-\x1f\x7f]")

_MAX_LINES = 4_000_000  # of a table, empty ones too: as many again as it may have rows


def encoding_of(start: bytes) -> str | None:
    """Detect the encoding of a text file by its first bytes; None where it is no text.

    UTF-8, UTF-16 and UTF-32 are known by their marks, UTF-16 without a mark by its zeros, and what
    is no UTF-8 is taken as Windows' own (CP1252). A damaged byte of UTF-8 stands beside intact
    multi-byte characters; in CP1252 there are none of these.
    """
    start = start[:_LOOK_BYTES]
    for mark, encoding in _MARKS:
        if start.startswith(mark):
            return encoding
    even, odd = start[::2], start[1::2]
    if b"\0" in start:
        if even.count(0) * odd.count(0) or start.count(0) * 2 < len(odd):
            return None
        encoding = "utf-16-le" if odd.count(0) else "utf-16-be"
        text = start.decode(encoding, "replace").encode(errors="replace")
        return None if _CONTROLS.search(text) else encoding
    if _CONTROLS.search(start):
        return None
    try:
        start.decode()
    except UnicodeDecodeError as error:
        is_cut = error.start >= len(start) - 3 and error.reason.startswith("unexpected end")
        others = sum(byte > 127 for byte in start)
        if not is_cut:
            is_utf8 = not start.decode("utf-8", "ignore").isascii()
            text = "utf-8-sig" if is_utf8 else "cp1252"
            return text if others < _MAX_FOREIGN * len(start) else None
    return "utf-8-sig"


def text_encoding(path: Path) -> str:
    """Detect the encoding of a file to be read as text in any case.

    Raises:
        OSError: it cannot be read.
    """
    with open_regular(path) as file:
        return encoding_of(file.read(_LOOK_BYTES)) or "utf-8-sig"


def is_text(start: bytes, suffix: str) -> bool:
    """Return whether a file is text, by its first bytes; a table's suffix allows damaged text."""
    if encoding_of(start) is not None:
        return True
    return suffix.lower() in SUFFIXES and b"\0" not in start[:_LOOK_BYTES]


def is_table(path: Path) -> bool:
    """Return whether a file has a table's suffix, and is text.

    Raises:
        OSError: it cannot be read.
    """
    if path.suffix.lower() not in SUFFIXES:
        return False
    with open_regular(path) as file:
        return is_text(file.read(_LOOK_BYTES), path.suffix)


def has_rows(lines: Iterable[str]) -> bool:
    """Return whether any line begins with a number, and is mostly numbers, two or more."""
    return any(map(_is_row, lines))


def _is_row(line: str) -> bool:
    cells = re.split(r"[,;\s]+", line[:_LOOK_BYTES].strip(" ,;\t"))
    numbers = sum(_NUMBER.fullmatch(cell) is not None for cell in cells)
    return numbers > 1 and numbers * 2 >= len(cells) and _NUMBER.fullmatch(cells[0]) is not None


def lines_of(path: Path) -> Iterator[str | None]:
    """Yield the lines without their ends; None for one that is too long for any table.

    Raises:
        LogError: the file is too large, or has too many lines.
        OSError: it cannot be read.
    """
    size = path.stat().st_size
    if size > _MAX_BYTES:
        raise LogError(f"{path}: is a table of {size} bytes, over the limit of 512 MiB; split it")
    with open_regular_text(path, text_encoding(path), errors="replace") as file:
        count = 0
        while line := file.readline(MAX_LINE):
            count += 1
            if count > _MAX_LINES:
                raise LogError(
                    f"{path}: is a table of over {_MAX_LINES} lines, the limit; split it"
                )
            whole = line.endswith("\n") or len(line) < MAX_LINE
            while not line.endswith("\n") and len(line) == MAX_LINE:
                line = file.readline(MAX_LINE)
            yield line.rstrip("\n") if whole else None


def cells_of(line: str, separator: str | None) -> list[str]:
    """Split a line into cells; none where it is malformed.

    A cell never spans lines: an unclosed quote must not swallow the rest of a file.
    """
    if separator is None:
        return line.split()
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        return []
