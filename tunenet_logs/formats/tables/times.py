"""Parse times of a table, exact to the nanosecond: text never goes through a float."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal
from itertools import islice, pairwise
from math import isfinite
from statistics import median

from tunenet_logs.formats.tables.meaning import POWERS

# A number and its unit: "0.008 sec".
_WITH_UNIT = re.compile(rf"(\S+)\s+({'|'.join(POWERS)})", re.ASCII | re.IGNORECASE)

# A date: the year first, or last as people write it.
_DAY = r"(\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4})"

# A time of the day, to the nanosecond.
_HOURS = r"(\d{1,2}):(\d\d)(?::(\d\d)(?:[.,](\d{1,9}))?)?(?:\s?([AaPp])[Mm])?"

# A date and perhaps the time of that day, with or without a zone: ISO 8601 and its kin.
_DATE = re.compile(rf"{_DAY}(?:[T ]\s?{_HOURS})?\s?(Z|[+-]\d\d(?::?\d\d)?)?", re.ASCII)

# The same alone, or minutes and seconds, of which a spreadsheet shows no hours: 30:25.1.
_OF_DAY = re.compile(rf"{_HOURS}|(\d{{1,4}}):(\d\d)[.,](\d{{1,9}})", re.ASCII)

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)  # what stamps count from
_MAX_DIGITS = 60  # of a time's text: a number that costs more to read is no time
_MAX_NS = 2**62  # half of what int64 holds, so that differences fit as well: to the year 2116
_S_NS = 10**9
_HOUR_NS, _DAY_NS = 3600 * _S_NS, 86_400 * _S_NS

_NAMES = {_S_NS: "s", 10**6: "ms", 10**3: "us", 1: "ns"}  # units of times [ns]
_SINCE_1970_S = (1e9, 4e9)  # times since 1970 of our days: 2001 to 2096
_SHEET_DAYS = (20_000, 80_000)  # days of a spreadsheet, which count from 1900: 1954 to 2119
_MIN_SPEED_S = 2.0  # from row to row of a log whose stamps begin in 1970
# Where a count of frames or of seconds begins; whole numbers beyond it that rise by 1 are ms.
_COUNTS_TO = 1000.0

# From which step on times are in that unit [ns]: what moves is sampled at 2.5 Hz to 2 kHz.
_STEPS = ((5e8, _S_NS), (4e5, 1), (400.0, 10**3), (2.0, 10**6))

# Steps that are hardly s: more may be another unit, less is none that a log has.
_SLOW_STEP, _FAST_STEP = 0.5, 2e-5

# From which on fractions that rise by some 1 are ms of a sensor, not s of a slow one.
_KHZ_STEP = 0.8

_FEW_RISES = 8  # from row to row, which tell no unit
_LOOK_ROWS = 100  # whose steps and size tell the unit of times that name none


@dataclass(frozen=True)
class Clock:
    """Time columns of a table's rows.

    Attributes:
        name: of its column, or of the first of two.
        indices: of the columns: one, one of seconds and one of nanoseconds, or a date and a time.
        power: the unit as a power of ten of a second; None to go by the numbers.
        scope: the words before it in its name: what it is the time of.
        counts_frames: whether it numbers frames, read as so many seconds.
        has_date: whether the first of two columns is a date, which a time of day lacks.
    """

    name: str
    indices: tuple[int, ...]
    power: int | None
    scope: tuple[str, ...] = ()
    counts_frames: bool = False
    has_date: bool = False

    def read(self, texts: Sequence[str], unit_ns: int) -> int:
        """Parse the time of a row [ns].

        Args:
            texts: cells of its columns.
            unit_ns: the unit of a plain number, where there is one column.

        Raises:
            ValueError: it is no time.
        """
        if len(texts) == 2 and not self.has_date:
            return exact_ns(texts[0], 0) + exact_ns(texts[1], -9)
        text = texts[-1]
        if ":" not in text:
            try:
                return _units_ns(text, unit_ns)
            except ValueError:
                return _own_ns(text)
        if self.has_date and is_of_day(text):
            return _own_ns(texts[0]) + _own_ns(text)
        return _own_ns(text)


@dataclass(frozen=True)
class TimeUnit:
    """Unit of a time column.

    Attributes:
        ns: its length [ns].
        doubt: how it was inferred where no name and no date states it, in words; "" where these do.
    """

    ns: int
    doubt: str = ""


class DayTurns:
    """Unwrapping of times of day, in row order, across midnight.

    Args:
        text: the first of them; one without hours wraps every hour.
    """

    def __init__(self, text: str) -> None:
        self._turn_ns = _HOUR_NS if text.count(":") == 1 else _DAY_NS
        self._last_ns = 0
        self._turns_ns = 0

    def __call__(self, time_ns: int) -> int:
        """Return the time since the first midnight [ns], from that since its own."""
        if self._turn_ns // 2 < self._last_ns - time_ns < self._turn_ns:
            self._turns_ns += self._turn_ns
        self._last_ns = time_ns
        return time_ns + self._turns_ns


def exact_ns(text: str, power: int) -> int:
    """Convert a decimal number of 10**power seconds to the nearest nanosecond.

    Raises:
        ValueError: it is no number, or out of range.
    """
    return _units_ns(text, 10 ** (9 + power))


def _units_ns(text: str, unit_ns: int) -> int:
    if len(text) > _MAX_DIGITS:
        raise ValueError("a time of too many digits")
    try:
        number = Decimal(text)
        if not number.is_finite() or number.adjusted() > 20:
            raise ValueError(f"{text} is no time")
        nanoseconds = int((number * unit_ns).to_integral_value())
    except ArithmeticError as error:
        raise ValueError(f"{text} is no number") from error
    if abs(nanoseconds) > _MAX_NS:
        raise ValueError(f"{text} is no time")
    return nanoseconds


def unit_of_times(
    name: str, texts: Iterable[object], power: int | None, *, is_sampled: bool = True
) -> TimeUnit:
    """Determine the unit of a time column by its name, else by the size and steps of its numbers.

    Stamps since 1970 show it by their size, others by their step: moving objects are sampled some 2
    to 2000 times a second, and a unit is a thousand times the next. A gap is a step among many.

    Args:
        name: of the column.
        texts: its first rows, in their order.
        power: the unit in its name, as a power of ten of a second; None where there is none.
        is_sampled: whether rows follow at a rate; impacts do not, and their steps show nothing.

    Raises:
        ValueError: no unit of a log has such steps.
    """
    if power is not None:
        return TimeUnit(10 ** (9 + power))
    numbers: list[float] = []
    for text in islice(texts, _LOOK_ROWS):
        with suppress(TypeError, ValueError):
            numbers.append(float(text))  # type: ignore[arg-type]
    numbers = [number for number in numbers if isfinite(number)]
    rises = [b - a for a, b in pairwise(numbers) if b > a]
    size, step = median(map(abs, numbers)) if numbers else 0.0, _usual(rises)
    for unit_ns in _NAMES:
        second = 1e9 / unit_ns
        is_recent = _SINCE_1970_S[0] <= size / second < _SINCE_1970_S[1]
        if is_recent and (step <= _SLOW_STEP * second or not is_sampled):
            return TimeUnit(unit_ns)
        if is_recent and step <= _MIN_SPEED_S * second:  # or since the start of a computer
            return _guessed(name, unit_ns, step)
    if _SHEET_DAYS[0] <= size < _SHEET_DAYS[1] and 0 < step * 86_400 <= _MIN_SPEED_S:
        doubt = f"{name!r} names no unit and was taken as the days of a spreadsheet since 1900"
        return TimeUnit(_DAY_NS, doubt)
    if is_sampled and 0 < step < _FAST_STEP:
        raise ValueError(
            f"column {name[:60]!r} rises by {step:.2g} from row to row, which is too fast to be s; "
            "write it in s, or name its unit: t_s, t_ms, t_us or t_ns"
        )
    if not is_sampled or step < _SLOW_STEP:
        return TimeUnit(_S_NS)
    is_count = step < _STEPS[-1][0] and (
        numbers[0] < _COUNTS_TO if _are_whole(numbers) else step < _KHZ_STEP
    )
    is_count |= len(rises) < _FEW_RISES
    found = next((unit for least, unit in _STEPS if step >= least), 10**6)
    unit_ns = _S_NS if is_count else found
    return _guessed(name, unit_ns, step)


def _guessed(name: str, unit_ns: int, step: float) -> TimeUnit:
    others = " or ".join(f"t_{other}" for ns, other in _NAMES.items() if ns != unit_ns)
    return TimeUnit(
        unit_ns,
        f"{name!r} names no unit and was taken as {_NAMES[unit_ns]}: it rises by {step:g} from row "
        f"to row; if it is not, name it {others}",
    )


def _are_whole(numbers: Sequence[float]) -> bool:
    return all(number.is_integer() for number in numbers)


def _usual(rises: Sequence[float]) -> float:
    """Return the mean increment without the largest tenth, which are gaps; 0 without any."""
    usual = sorted(rises)[: max(1, len(rises) - len(rises) // 10)]
    return sum(usual) / len(usual) if usual else 0.0


def is_of_day(text: str) -> bool:
    """Return whether a text is a time of day without a date."""
    return bool(_OF_DAY.fullmatch(text.strip()))


def says_its_unit(text: str) -> bool:
    """Return whether a text is a date or a time of day, or a number with a unit."""
    return bool(_DATE.fullmatch(text) or _WITH_UNIT.fullmatch(text) or is_of_day(text))


def lacks_zone(text: str) -> bool:
    """Return whether a text is a date and time without a time zone."""
    found = _DATE.fullmatch(text)
    return found is not None and found[2] is not None and not found[7]


def _own_ns(text: str) -> int:
    """Parse a time with its unit: "0.008 sec", a date without a zone in UTC, "9:30:00".

    Raises:
        ValueError: it has none, or there is no such time.
    """
    text = text.strip()
    if own := _WITH_UNIT.fullmatch(text):
        return exact_ns(own[1], POWERS[own[2].lower()])
    if of_day := _OF_DAY.fullmatch(text):
        *whole, minutes, seconds, part = of_day.groups()
        if minutes is None:
            return _of_day_ns(*whole)
        return int(minutes) * 60 * _S_NS + _of_day_ns("0", "0", seconds, part, None)
    found = _DATE.fullmatch(text)
    if found is None:
        raise ValueError(f"{text} is no time")
    day, *of_day, zone = found.groups()
    since = datetime.fromisoformat(f"{_iso_day(day)}T00:00:00{zone or 'Z'}") - _EPOCH
    nanoseconds = (since.days * 86400 + since.seconds) * _S_NS
    nanoseconds += _of_day_ns(*of_day) if of_day[0] else 0
    if abs(nanoseconds) > _MAX_NS:
        raise ValueError(f"{text} is no time")
    return nanoseconds


def _of_day_ns(
    hours: str, minutes: str, seconds: str | None, part: str | None, half: str | None
) -> int:
    """Return a time since midnight [ns]; raise ValueError where there is no such time."""
    hour, minute, second = int(hours), int(minutes), int(seconds or 0)
    if half:
        if not 1 <= hour <= 12:
            raise ValueError(f"there is no {hour} o'clock")
        hour = hour % 12 + (12 if half in "pP" else 0)
    if hour > 23 or minute > 59 or second > 59:
        raise ValueError("there is no such time of the day")
    return (hour * 3600 + minute * 60 + second) * _S_NS + int((part or "").ljust(9, "0"))


def _iso_day(day: str) -> str:
    """Return a date with the year first; in 1/2/2026 the month is first, unless impossible."""
    one, two, three = (int(part) for part in re.split("[-/.]", day))
    if len(day) > 4 and day[:4].isdecimal():
        return f"{one:04}-{two:02}-{three:02}"
    if "/" in day and two <= 31 and one <= 12:
        one, two = two, one
    return f"{three:04}-{two:02}-{one:02}"
