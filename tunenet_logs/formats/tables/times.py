"""Times of a table, exact to the nanosecond: text never goes through a float."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from statistics import median

_MOST_DIGITS = 60
_MOST_NS = 2**62
_MAGNITUDES = ((1e17, -9), (1e14, -6), (1e11, -3))
"""From which size on a time since 1970 must be in ns, us, ms: all other units would be far off."""


@dataclass(frozen=True)
class Clock:
    """Where a row says when it was.

    Attributes:
        name: of its column, or of the first of two.
        places: of the columns: one, or one of seconds and one of nanoseconds.
        power: the unit as a power of ten of a second; None to go by magnitude.
        scope: the words before it in its name: what it is the time of.
    """

    name: str
    places: tuple[int, ...]
    power: int | None
    scope: tuple[str, ...] = ()

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
        return exact_ns(texts[0], power)


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
