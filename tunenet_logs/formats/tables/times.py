"""Times of a table, exact to the nanosecond: text never goes through a float."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal
from statistics import median

from tunenet_logs.formats.tables.meaning import POWERS

_WITH_UNIT = re.compile(rf"(\S+)\s+({'|'.join(POWERS)})", re.ASCII | re.IGNORECASE)
"""A number and its unit: "0.008 sec"."""

_DATE = re.compile(
    r"(\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d)?)(?:[.,](\d{1,9}))?\s?(Z|[+-]\d\d(?::?\d\d)?)?",
    re.ASCII,
)
"""ISO 8601 to the nanosecond, with or without a zone."""

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
"""What stamps count from."""

_MOST_DIGITS = 60
"""Of a time's text: a number that costs more to read is no time."""

_MOST_NS = 2**62
"""Half of what int64 holds, so that differences fit as well: to the year 2116."""

_MAGNITUDES = ((1e17, -9), (1e14, -6), (1e11, -3))
"""From which size on a time since 1970 must be in ns, us, ms: all other units would be far off."""


@dataclass(frozen=True)
class Clock:
    """Where a row says when it was.

    Attributes:
        name: of its column, or of the first of two.
        indices: of the columns: one, or one of seconds and one of nanoseconds.
        power: the unit as a power of ten of a second; None to go by magnitude.
        scope: the words before it in its name: what it is the time of.
        counts_frames: whether it numbers frames, read as so many seconds.
    """

    name: str
    indices: tuple[int, ...]
    power: int | None
    scope: tuple[str, ...] = ()
    counts_frames: bool = False

    def read(self, texts: Sequence[str], power: int) -> int:
        """The time that its columns say in a row [ns].

        Args:
            texts: those of its columns.
            power: the unit, where one column says it all.

        Raises:
            ValueError: it is none.
        """
        if len(texts) == 2:
            return exact_ns(texts[0], 0) + exact_ns(texts[1], -9)
        try:
            return exact_ns(texts[0], power)
        except ValueError:
            return _own_ns(texts[0])


def exact_ns(text: str, power: int) -> int:
    """A decimal number of 10**power seconds, to the nearest nanosecond.

    Raises:
        ValueError: it is no number, or no time.
    """
    if len(text) > _MOST_DIGITS:
        raise ValueError("a time of too many digits")
    try:
        number = Decimal(text)
        if not number.is_finite() or number.adjusted() > 20:
            raise ValueError(f"{text} is no time")
        nanoseconds = int(number.scaleb(9 + power).to_integral_value())
    except ArithmeticError as error:
        raise ValueError(f"{text} is no number") from error
    if abs(nanoseconds) > _MOST_NS:
        raise ValueError(f"{text} is no time")
    return nanoseconds


def power_by_size(texts: Sequence[str]) -> int:
    """The unit of times without one, as a power of ten of a second."""
    sizes: list[float] = []
    for text in texts:
        try:
            sizes.append(abs(float(text)))
        except ValueError:
            continue
    usual = median(sizes) if sizes else 0.0
    return next((power for least, power in _MAGNITUDES if usual > least), 0)


def says_its_unit(text: str) -> bool:
    """Whether a text is a date and time, or a number with a unit, and not a number alone."""
    return bool(_DATE.fullmatch(text) or _WITH_UNIT.fullmatch(text))


def lacks_zone(text: str) -> bool:
    """Whether a text is a date and time that does not say where."""
    found = _DATE.fullmatch(text)
    return found is not None and not found[3]


def _own_ns(text: str) -> int:
    """The time of a text that says its unit: "0.008 sec", or as ISO 8601 without a zone in UTC.

    Raises:
        ValueError: it says none, or there is no such time.
    """
    if own := _WITH_UNIT.fullmatch(text):
        return exact_ns(own[1], POWERS[own[2].lower()])
    found = _DATE.fullmatch(text)
    if found is None:
        raise ValueError(f"{text} is no time")
    since = datetime.fromisoformat(found[1] + (found[3] or "Z")) - _EPOCH
    seconds = since.days * 86400 + since.seconds
    nanoseconds = seconds * 10**9 + int((found[2] or "").ljust(9, "0"))
    if abs(nanoseconds) > _MOST_NS:
        raise ValueError(f"{text} is no time")
    return nanoseconds
