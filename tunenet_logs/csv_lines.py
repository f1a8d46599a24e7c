"""Write results as CSV in which no cell is a formula, regardless of the names in a log.

A spreadsheet runs a cell that begins with `=`, `+`, `-` or `@`, be it a topic's name
(https://owasp.org/www-community/attacks/CSV_Injection).
"""

from __future__ import annotations

import re
from collections.abc import Iterable

# How a text begins that a spreadsheet may run, with the wide forms that some read as well.
_RUN = re.compile(r"[\s\x00'\u200b\ufeff]*[=+\-@\uff1d\uff0b\uff0d\uff20]|[\t\r\n\x00]")

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)

# Where a text needs quotes, by whatever separator the table is opened.
_QUOTED = re.compile(r'[,;|"\s]')


def csv_line(cells: Iterable[object]) -> str:
    """Write cells as one line of CSV, with its end.

    Args:
        cells: numbers as they are; None and NaN are empty. A text that a spreadsheet would run has
            an apostrophe before it, which shows that it is text.
    """
    return ",".join(map(_cell, cells)) + "\n"


def text_of(cell: str) -> str:
    """Return the text given to `csv_line` from the cell that a CSV reader returns."""
    return cell[1:] if cell[:1] == "'" and _RUN.match(cell[1:]) else cell


def _cell(value: object) -> str:
    if value is None or value != value:  # noqa: PLR0124 (NaN)
        return ""
    text = str(value)
    if isinstance(value, str) and _RUN.match(text) and not _NUMBER.fullmatch(text):
        text = f"'{text}"
    return '"' + text.replace('"', '""') + '"' if _QUOTED.search(text) else text
