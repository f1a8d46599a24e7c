"""What separates the parts of a multipart stream, found in one pass over its bytes.

A hostile camera chooses these bytes, and a regular expression may look at each of them again and
again, with the whole process waiting. Here every byte is looked at a bounded number of times.
"""

from __future__ import annotations

import string
from dataclasses import dataclass

_MOST_DASHES, _MOST_TOKEN = 70, 70
"""In a delimiter: RFC 2046 has two dashes and 70 characters; some senders repeat the dashes."""

TAIL_BYTES = 512
"""Longer than any delimiter with its blanks: what must be kept of what was looked at."""

_TOKEN = (string.ascii_letters + string.digits + "'()+_,./:=?-").encode()
"""What a boundary may contain (RFC 2046), without the blank."""

_BLANKS = b" \t\r\n\f\v\0"
_ENDS = (b" ", b"\t", b"\r", b"\n")
_JPEG_END = b"\xff\xd9"
_DASH, _LINE_FEED, _RETURN = b"-\n\r"


@dataclass(frozen=True)
class Delimiter:
    """A delimiter's line.

    Attributes:
        end: index behind its line feed.
        closes: whether it says that no part follows.
    """

    end: int
    closes: bool


class Delimiters:
    """Finds delimiters.

    Args:
        token: what is announced, without its leading dashes; b"" for any.
    """

    def __init__(self, token: bytes) -> None:
        self._token = token
        self._mark = b"--" + token

    def line(self, buffer: bytearray, start: int) -> tuple[Delimiter | None, int]:
        """The first whole delimiter line from `start` on; and where to look from next time."""
        while (at := buffer.find(b"\n", start)) >= 0:
            start = at + 1
            line = bytes(buffer[max(0, at - TAIL_BYTES) : at]).removesuffix(b"\r").rstrip(b" \t")
            if not self._token and _is_any(line[len(line.rstrip(_TOKEN)) :]):
                return Delimiter(start, closes=False), start
            if self._token and line.endswith((self._mark, self._mark + b"--")):
                return Delimiter(start, closes=not line.endswith(self._mark)), start
        return None, max(start, len(buffer))

    def end_of_body(
        self, buffer: bytearray | bytes, start: int, *, is_all: bool
    ) -> tuple[int | None, int]:
        """Where the first body from `start` on ends; and where to look from next time.

        With a token, before the line break that leads to a delimiter. Without one a picture may
        hold what looks like a delimiter, so one counts only behind the end of a JPEG.

        Args:
            buffer: what is there of body and delimiter.
            start: what lies before it was looked at.
            is_all: whether nothing more comes.
        """
        mark = self._mark if self._token else _JPEG_END
        while (at := buffer.find(mark, start)) >= 0:
            end = at + len(mark)
            behind = bytes(buffer[end : end + TAIL_BYTES])
            may_go_on = not is_all and len(behind) < TAIL_BYTES
            found = _ends_line(behind) if self._token else _leads_to_any(behind)
            if found is None and may_go_on:
                return None, at
            if found:
                cut = _line_break_before(buffer, at) if self._token else end
                if cut is not None:
                    return cut, cut
            start = at + 1
        return None, max(start, len(buffer) - len(mark) + 1)


def _is_any(run: bytes) -> bool:
    """Whether characters of a token end with dashes and a token, be it of dashes."""
    at = run.find(b"--", max(0, len(run) - _MOST_DASHES - _MOST_TOKEN))
    return at >= 0 and len(run) - at > 2


def _ends_line(behind: bytes) -> bool | None:
    """Whether this ends a delimiter behind its token; None where more must come to know it."""
    rest = behind.removeprefix(b"--")
    return None if rest in (b"", b"-") else rest[:1] in _ENDS


def _leads_to_any(behind: bytes) -> bool | None:
    """Whether blanks and a delimiter that nobody announced follow; None as `_ends_line`."""
    rest = behind.lstrip(_BLANKS)
    run = len(rest) - len(rest.lstrip(_TOKEN))
    if run == len(rest):
        return None if b"--".startswith(rest[:2]) and run <= _MOST_DASHES + _MOST_TOKEN else False
    is_delimiter = rest.startswith(b"--") and 2 < run <= _MOST_DASHES + _MOST_TOKEN
    return is_delimiter and rest[run : run + 1] in _ENDS


def _line_break_before(buffer: bytearray | bytes, at: int) -> int | None:
    """Where the line break begins that leads to the dashes up to `at`; None where none does."""
    begin = at
    while begin > max(0, at - _MOST_DASHES) and buffer[begin - 1] == _DASH:
        begin -= 1
    if not begin or buffer[begin - 1] != _LINE_FEED:
        return None
    return begin - 2 if begin > 1 and buffer[begin - 2] == _RETURN else begin - 1
