"""Read the sheets of a workbook or of an archive of tables, through a resource-limited process."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

from tunenet_logs.errors import LogError
from tunenet_logs.formats.exports.sheets import sheet_process

_MAX_WAIT_S = 60.0  # for the other process, whose own time is bounded to less


@dataclass(frozen=True)
class Sheet:
    """One table.

    Attributes:
        lines: its rows, with tabs between cells; in an archive as they stand in the file.
    """

    name: str
    lines: list[str] = field(default_factory=list)


def sheets_of(path: Path, what: str, *, is_archive: bool) -> list[Sheet]:
    """Read all sheets of a file.

    Args:
        path: of the file.
        what: kind of file, for messages: "spreadsheet", ...
        is_archive: whether it is a zip archive of CSV files, not a workbook.

    Raises:
        LogError: it is too large, damaged, or python-calamine is missing.
        OSError: it cannot be read.
    """
    if not is_archive and find_spec("python_calamine") is None:
        raise LogError(
            f"{path}: is a {what}, which needs python-calamine; pip install 'tunenet-logs[tables]'"
        )
    if (size := path.stat().st_size) > sheet_process.MAX_FILE_BYTES:
        limit = sheet_process.MAX_FILE_BYTES >> 20
        raise LogError(
            f"{path}: is a {what} of {size >> 20} MiB, over the limit of {limit} MiB; save the "
            "sheet alone, as CSV"
        )
    kind = "archive" if is_archive else "book"
    words = [sys.executable, "-P", sheet_process.__file__, str(path.resolve()), kind]
    try:
        done = subprocess.run(  # noqa: S603
            words, capture_output=True, timeout=_MAX_WAIT_S, check=False
        )
    except subprocess.TimeoutExpired:
        done = None
    sheets: list[Sheet] = []
    if done is None or done.returncode:
        raise LogError(
            f"{path}: is a {what} that breaks what reads it: it is damaged, or claims more cells "
            "than it has; save the sheet alone, as CSV"
        )
    for word, *texts in _said(done.stdout):
        if word == "sheet":
            sheets.append(Sheet(texts[0]))
        elif word == "rows":
            sheets[-1].lines.extend(texts)
        else:
            raise LogError(f"{path}: is a {what}, but {texts[0]}; {texts[1]}")
    return sheets


def _said(output: bytes) -> Iterator[list[str]]:
    for line in io.BytesIO(output):
        yield json.loads(line)
