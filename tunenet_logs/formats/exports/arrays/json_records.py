"""Stream JSON values out of a file, in little memory."""

from __future__ import annotations

import gc
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

from tunenet_logs.formats.tables.lines import text_encoding
from tunenet_logs.regular_file import open_regular_text

_CHUNK = 262_144  # characters read at a time
# Characters of one value: a value of the worst kind is 50 times that in memory.
_MAX_VALUE = 8 * 1024**2


class DamagedJsonError(ValueError):
    """Invalid JSON, or a value over the size limit."""


class NumberText(str):
    """A decimal number as written, so that a time loses no digits."""

    __slots__ = ()


def json_values(path: Path) -> Iterator[Any]:
    """Yield the values of a file: JSON lines, concatenated values, or the items of one array.

    Numbers with decimals are `NumberText`.

    Raises:
        DamagedJsonError: invalid JSON from some place on, or a value that is too large.
        OSError: it cannot be read.
    """
    with open_regular_text(path, text_encoding(path), errors="replace") as file:
        window = _Window(file)
        is_array = window.next_mark(" \t\r\n\ufeff") == "["
        if is_array:
            window.at += 1
        while mark := window.next_mark(" \t\r\n,"):
            if is_array and mark == "]":
                return
            yield window.value()


class _Window:
    """Sliding window over a text file; `at` is the index of its next character."""

    def __init__(self, file: TextIO) -> None:
        self.at = 0
        self._file = file
        self._text = file.read(_CHUNK)
        self._decoder = json.JSONDecoder(parse_float=NumberText, parse_constant=_no_number)
        self._count = 0

    def next_mark(self, skipped: str) -> str:
        """Skip the given characters and return the next one; "" at the end."""
        while True:
            text, at = self._text, self.at
            while at < len(text) and text[at] in skipped:
                at += 1
            self.at = at
            if at < len(text) or not self._grow(_CHUNK):
                return text[at : at + 1]

    def value(self) -> Any:
        """Decode the value that begins here and move behind it.

        Raises:
            DamagedJsonError: there is none, or it is too large.
        """
        self._count += 1
        while True:
            try:
                value, end = self._decoded()
            except RecursionError as error:
                raise DamagedJsonError(f"value {self._count} is nested too deeply") from error
            except ValueError as error:
                length = len(self._text) - self.at
                if length > _MAX_VALUE or not self._grow(max(_CHUNK, length)):
                    raise DamagedJsonError(self._why(error, length)) from error
                continue
            if end == len(self._text) and self._grow(_CHUNK):
                continue  # a number may go on
            self.at = end
            return value

    def _decoded(self) -> tuple[Any, int]:
        """Decode the value that begins here; return it with its end.

        Without garbage collection: of millions of lists, its search for cycles takes most time.
        """
        was_on = gc.isenabled()
        gc.disable()
        try:
            return self._decoder.raw_decode(self._text, self.at)
        finally:
            if was_on:
                gc.enable()

    def _grow(self, count: int) -> bool:
        """Read more of the file, dropping what is consumed."""
        more = self._file.read(count)
        self._text, self.at = self._text[self.at :] + more, 0
        return bool(more)

    def _why(self, error: ValueError, length: int) -> str:
        if length > _MAX_VALUE:
            return f"value {self._count} is larger than {_MAX_VALUE >> 20} MiB, or no JSON"
        is_json = isinstance(error, json.JSONDecodeError)
        what = error.msg.lower() if is_json else "a number of too many digits"
        return f"value {self._count} is no JSON ({what})"


def _no_number(_name: str) -> float:
    """Return NaN for NaN and Infinity, which Python and MATLAB write."""
    return float("nan")
