"""Numbers of a table as any country writes them, where there is no doubt what they are."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isfinite

_NUMBERLESS = frozenset(("", "-", "--", "null", "none", "na", "n/a", "<na>", "#n/a"))
"""What stands in a cell for no value, in small letters."""

_NUMBER = re.compile(r"[+-]?[\d.,]+(?:e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
"""A number with whatever marks between its digits."""

_IN_GROUPS = re.compile(
    r"[+-]?[1-9]\d{0,2}(?:(?:,\d{3})+\.\d*|(?:\.\d{3})+,\d*|(?:,\d{3}){2,}|(?:\.\d{3}){2,})",
    re.ASCII,
)
"""Thousands in groups, beyond doubt: with a mark of decimals as well, or two groups and more."""

_ONE_GROUP = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}", re.ASCII)
"""What may be a thousand and more, or have three decimals."""


@dataclass(frozen=True)
class Numbers:
    """How a table writes its numbers.

    Attributes:
        separator: of cells; None is white space.
        decimal: what its decimals stand behind; "" where its first rows do not tell.
    """

    separator: str | None
    decimal: str = ""

    def plain(self, cell: str) -> str:
        """A number's text with a decimal point, and without separators of thousands.

        Raises:
            ValueError: it can be read in two ways.
        """
        text = cell.strip()
        if "," not in text and text.count(".") < (1 if self.decimal == "," else 2):
            return text
        if _IN_GROUPS.fullmatch(text):
            mark = max(text.rfind(","), text.rfind("."))
            if text.count(text[mark]) > 1:
                return text.replace(text[mark], "")
            return re.sub("[.,]", "", text[:mark]) + "." + text[mark + 1 :]
        if _ONE_GROUP.fullmatch(text) and self._is_doubtful("," if "," in text else "."):
            digits = re.split("[.,]", text)
            raise ValueError(f"may be {'.'.join(digits)} or {''.join(digits)}")
        return text.replace(",", ".") if self.separator != "," and "." not in text else text

    def _is_doubtful(self, mark: str) -> bool:
        return mark == self.separator or self.decimal not in ("", mark)

    def read(self, cell: str) -> float:
        """A number; NaN where a cell is empty or says that there is none.

        Raises:
            ValueError: it is something else.
        """
        try:
            value = float(cell if self.decimal != "," else _pointed(cell))
        except ValueError:
            value = _from_words(self.plain(cell))
        return value if isfinite(value) else float("nan")


class Thousands:
    """Columns whose numbers may have thousands behind a point: `1.050` beside `985`.

    A table that writes decimals writes more or fewer of them somewhere, or none below 1000 only.

    Args:
        columns: indices of those that are read.
    """

    def __init__(self, columns: Iterable[int]) -> None:
        self._undecided = set(columns)
        self._groups: dict[int, str] = {}
        self._wholes: set[int] = set()

    def look(self, cells: Sequence[str]) -> None:
        """One more row."""
        for at in tuple(self._undecided):
            text = cells[at].strip()
            if _ONE_GROUP.fullmatch(text):
                self._groups.setdefault(at, text)
            elif (digits := text.lstrip("+-")).isdecimal() and len(digits) < 4:
                if digits.strip("0"):
                    self._wholes.add(at)
            elif any(map(str.isdecimal, text)):
                self._undecided.discard(at)

    def doubt(self, names: Sequence[str]) -> str:
        """What may be read in two ways; "" where nothing is."""
        at = min(self._undecided & self._groups.keys() & self._wholes, default=None)
        if at is None:
            return ""
        one, two = re.split("[.,]", self._groups[at])
        return (
            f"column {names[at][:60]!r}: {self._groups[at]!r} beside whole numbers may be "
            f"{one}.{two} or {one}{two}"
        )


def _pointed(cell: str) -> str:
    """A number with a decimal comma; what has a point too is for a closer look."""
    return cell.replace(",", ".") if "." not in cell else ""


def _from_words(text: str) -> float:
    if text.lower() in _NUMBERLESS:
        return float("nan")
    try:
        return float(text)
    except ValueError:
        raise ValueError("is no number") from None


def decimal_of(cells: Iterable[str]) -> str:
    """What decimals stand behind in these numbers; "" where they do not tell, or disagree."""
    marks = {mark for cell in cells if (mark := _mark(cell.strip()))}
    return marks.pop() if len(marks) == 1 else ""


def _mark(text: str) -> str:
    at = max(text.rfind(","), text.rfind("."))
    if at < 0 or not _NUMBER.fullmatch(text) or _ONE_GROUP.fullmatch(text):
        return ""
    mark = text[at]
    return mark if text.count(mark) == 1 else ".,".replace(mark, "")
