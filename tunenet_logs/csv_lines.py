"""Tables of results as CSV: no cell of them is a formula, whatever names a log holds.

A spreadsheet runs a cell that begins with `=`, `+`, `-` or `@`, be it a topic's name
(https://owasp.org/www-community/attacks/CSV_Injection).
"""

from __future__ import annotations

import re
from collections.abc import Iterable

_RUN = re.compile(r"[\s\x00'\u200b\ufeff]*[=+\-@\uff1d\uff0b\uff0d\uff20]|[\t\r\n\x00]")
"""How a text begins that a spreadsheet may run, with the wide forms that some read as well."""

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)

_QUOTED = re.compile(r'[,;|"\s]')
"""Where a text needs quotes, by whatever separator the table is opened."""


def csv_line(cells: Iterable[object]) -> str:
    """Write cells as one line of CSV, with its end.

    Args:
        cells: numbers as they are; None and NaN are empty. A text that a spreadsheet would run has
            an apostrophe before it, which shows that it is text.
    """
    return ",".join(map(_cell, cells)) + "\n"


def text_of(cell: str) -> str:
    """Return the text that `csv_line` was given, of a cell as a reader of CSV gives it."""
    return cell[1:] if cell[:1] == "'" and _RUN.match(cell[1:]) else cell


def _cell(value: object) -> str:
    if value is None or value != value:  # noqa: PLR0124 (NaN)
        return ""
    text = str(value)
    if isinstance(value, str) and _RUN.match(text) and not _NUMBER.fullmatch(text):
        text = f"'{text}"
    return '"' + text.replace('"', '""') + '"' if _QUOTED.search(text) else text
