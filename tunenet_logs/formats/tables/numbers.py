"""Parse numbers of a table in any locale, as long as they are unambiguous."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isfinite

# What stands in a cell for no value, in small letters.
_NUMBERLESS = frozenset(("", "-", "--", "null", "none", "na", "n/a", "<na>", "#n/a"))

# A number with whatever marks between its digits.
_NUMBER = re.compile(r"[+-]?[\d.,]+(?:e[+-]?\d+)?", re.ASCII | re.IGNORECASE)

# Thousands in groups, beyond doubt: with a mark of decimals as well, or two groups and more.
_IN_GROUPS = re.compile(
    r"[+-]?[1-9]\d{0,2}(?:(?:,\d{3})+\.\d*|(?:\.\d{3})+,\d*|(?:,\d{3}){2,}|(?:\.\d{3}){2,})",
    re.ASCII,
)

# What may be a thousand and more, or have three decimals.
_ONE_GROUP = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}", re.ASCII)


@dataclass(frozen=True)
class Numbers:
    """Number format of a table.

    Attributes:
        separator: of cells; None is white space.
        decimal: decimal mark; "" where the first rows do not show it.
    """

    separator: str | None
    decimal: str = ""

    def plain(self, cell: str) -> str:
        """Normalize a number's text to a decimal point, without thousands separators.

        Raises:
            ValueError: it is ambiguous.
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
        """Parse a number; NaN where a cell is empty or marks a missing value.

        Raises:
            ValueError: it is no number.
        """
        try:
            value = float(cell if self.decimal != "," else _pointed(cell))
        except ValueError:
            value = _from_words(self.plain(cell))
        return value if isfinite(value) else float("nan")


class Thousands:
    """Detector of columns with ambiguous thousands separators: `1.050` beside `985`.

    A table that writes decimals writes more or fewer of them somewhere, or none below 1000 only.

    Args:
        columns: indices of those that are read.
    """

    def __init__(self, columns: Iterable[int]) -> None:
        self._undecided = set(columns)
        self._groups: dict[int, str] = {}
        self._wholes: set[int] = set()

    def look(self, cells: Sequence[str]) -> None:
        """Examine one more row."""
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
        """Describe an ambiguous column; "" where there is none."""
        at = min(self._undecided & self._groups.keys() & self._wholes, default=None)
        if at is None:
            return ""
        one, two = re.split("[.,]", self._groups[at])
        return (
            f"column {names[at][:60]!r}: {self._groups[at]!r} beside whole numbers may be "
            f"{one}.{two} or {one}{two}"
        )


def _pointed(cell: str) -> str:
    """Return a number with a decimal comma as one with a point; "" where it has a point too."""
    return cell.replace(",", ".") if "." not in cell else ""


def _from_words(text: str) -> float:
    if text.lower() in _NUMBERLESS:
        return float("nan")
    try:
        return float(text)
    except ValueError:
        raise ValueError("is no number") from None


def decimal_of(cells: Iterable[str]) -> str:
    """Detect the decimal mark of numbers; "" where they show none, or disagree."""
    marks = {mark for cell in cells if (mark := _mark(cell.strip()))}
    return marks.pop() if len(marks) == 1 else ""


def _mark(text: str) -> str:
    at = max(text.rfind(","), text.rfind("."))
    if at < 0 or not _NUMBER.fullmatch(text) or _ONE_GROUP.fullmatch(text):
        return ""
    mark = text[at]
    return mark if text.count(mark) == 1 else ".,".replace(mark, "")
