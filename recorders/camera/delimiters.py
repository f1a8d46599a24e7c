"""Find the delimiters of a multipart stream in one pass over its bytes.

A hostile camera chooses these bytes, and a regular expression may backtrack over them with the
whole process waiting. Here every byte is looked at a bounded number of times.
"""

from __future__ import annotations

import string
from dataclasses import dataclass

# In a delimiter: RFC 2046 has two dashes and 70 characters; some senders repeat the dashes.
_MAX_DASHES, _MAX_TOKEN = 70, 70

# Longer than any delimiter with its blanks: what must be kept of what was looked at.
TAIL_BYTES = 512

# What a boundary may contain (RFC 2046), without the blank.
_TOKEN = (string.ascii_letters + string.digits + "'()+_,./:=?-").encode()

_BLANKS = b" \t\r\n\f\v\0"
_ENDS = (b" ", b"\t", b"\r", b"\n")
_JPEG_END = b"\xff\xd9"
_DASH, _LINE_FEED, _RETURN = b"-\n\r"


@dataclass(frozen=True)
class Delimiter:
    """A delimiter line.

    Attributes:
        end: index just after its line feed.
        closes: whether it ends the stream.
    """

    end: int
    closes: bool


class Delimiters:
    """Finds delimiters; `token` is the boundary without leading dashes, b"" for any."""

    def __init__(self, token: bytes) -> None:
        self._token = token
        self._mark = b"--" + token

    def line(self, buffer: bytearray, start: int) -> tuple[Delimiter | None, int]:
        """Find the first whole delimiter line from `start` on; also where to resume."""
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
        """Find the end of the first body from `start` on; also where to resume.

        With a token, the end lies before the line break of a delimiter. Without one a picture may
        hold what looks like a delimiter, so one counts only after the end of a JPEG. `is_all` says
        that nothing more comes.
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
    """Return whether a run of token characters ends with dashes and a token."""
    at = run.find(b"--", max(0, len(run) - _MAX_DASHES - _MAX_TOKEN))
    return at >= 0 and len(run) - at > 2


def _ends_line(behind: bytes) -> bool | None:
    """Return whether a delimiter ends here; None where more bytes are needed."""
    rest = behind.removeprefix(b"--")
    return None if rest in (b"", b"-") else rest[:1] in _ENDS


def _leads_to_any(behind: bytes) -> bool | None:
    """Return whether blanks and any delimiter follow; None as in `_ends_line`."""
    rest = behind.lstrip(_BLANKS)
    run = len(rest) - len(rest.lstrip(_TOKEN))
    if run == len(rest):
        return None if b"--".startswith(rest[:2]) and run <= _MAX_DASHES + _MAX_TOKEN else False
    is_delimiter = rest.startswith(b"--") and 2 < run <= _MAX_DASHES + _MAX_TOKEN
    return is_delimiter and rest[run : run + 1] in _ENDS


def _line_break_before(buffer: bytearray | bytes, at: int) -> int | None:
    """Return the index of the line break before a delimiter's dashes, or None."""
    begin = at
    while begin > max(0, at - _MAX_DASHES) and buffer[begin - 1] == _DASH:
        begin -= 1
    if not begin or buffer[begin - 1] != _LINE_FEED:
        return None
    return begin - 2 if begin > 1 and buffer[begin - 2] == _RETURN else begin - 1
