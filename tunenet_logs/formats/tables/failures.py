"""Unreadable rows of a table: where, why, and the remedy."""

from __future__ import annotations

from tunenet_logs.errors import EXPORT_AGAIN

# Of the rows: with more of them it is not the file that is damaged, but us who misread it.
_MAX_UNREADABLE_FRACTION = 0.05

# What to do about a cell or a row.
NUMBER_REMEDY = "write numbers as 1050.25"
TIME_REMEDY = "write times in seconds (0.008), or as 2026-11-21T10:00:00.008Z"
CELLS_REMEDY = (
    "give each row as many cells as the header has, with ';' between them where numbers have ','"
)
DAMAGED_REMEDY = EXPORT_AGAIN


class UnreadableError(ValueError):
    """A row that cannot be read.

    Attributes:
        remedy: for the user.
        is_damage: whether it is truncated or overlong, rather than in another notation.
    """

    def __init__(self, why: str, remedy: str) -> None:
        super().__init__(why)
        self.remedy = remedy
        self.is_damage = remedy == DAMAGED_REMEDY


def unreadable(column: str, cell: str, why: object, remedy: str) -> UnreadableError:
    """Build the error of an unreadable cell."""
    return UnreadableError(f"column {column[:60]!r}: {cell.strip()[:60]!r} {why}", remedy)


class Failures:
    """Unreadable rows of a table."""

    def __init__(self) -> None:
        self._first: dict[bool, tuple[int, UnreadableError]] = {}
        self._counts = {True: 0, False: 0}

    def __len__(self) -> int:
        return sum(self._counts.values())

    def add(self, line: int, error: UnreadableError) -> None:
        """Count an unreadable line."""
        self._counts[error.is_damage] += 1
        self._first.setdefault(error.is_damage, (line, error))

    def lost(self, rows: int) -> str:
        """Describe the unreadable rows as a loss, where the others are used."""
        line, error = min(self._first.values(), key=lambda failure: failure[0])
        return (
            f"{len(self)} of {rows} rows could not be read and were left out "
            f"(the first is line {line}, {error})"
        )

    def refusal(self, rows: int) -> str:
        """Return why the table should be refused; "" where too few rows fail."""
        count = self._counts[False]
        if count < 2 or count <= _MAX_UNREADABLE_FRACTION * rows:
            return ""
        return f"{count} of {rows} rows cannot be read; {self._first_failure(is_damage=False)}"

    def nothing(self, rows: int) -> str:
        """Return why no row of a table was of use."""
        if not rows:
            return f"it has no row; {DAMAGED_REMEDY}"
        if not self._first:
            return f"none of its {rows} rows holds a value; name the columns of those that do"
        return (
            f"none of its {rows} rows can be read; {self._first_failure(False not in self._first)}"
        )

    def _first_failure(self, is_damage: bool) -> str:
        line, error = self._first[is_damage]
        return f"the first is line {line}, {error}; {error.remedy}"
