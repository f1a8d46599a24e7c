"""Possible meanings of a table column."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

Words = tuple[str, ...]  # the words of a column's name, as `words_of` takes it apart
# Units of lengths [m].
LENGTHS = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), 0.01),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 0.001),
    **dict.fromkeys(("um", "micrometer", "micrometers", "micrometre", "micrometres"), 1e-6),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
    **dict.fromkeys(("ft", "foot", "feet"), 0.3048),
}

# Units of times, as powers of ten of a second.
POWERS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "sek", "sekunden"), 0),
    **dict.fromkeys(("ms", "msec", "msecs", "milis", "millis", "millisecond", "milliseconds"), -3),
    **dict.fromkeys(("us", "usec", "usecs", "micros", "microsecond", "microseconds"), -6),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanos"), -9),
    **dict.fromkeys(("nanosecond", "nanoseconds"), -9),
}


@dataclass(frozen=True)
class TimeColumn:
    """A time.

    Attributes:
        power: its unit as a power of ten of a second; None where the name states none.
        scope: the words before it: what it is the time of.
        is_header: whether it is a time of acquisition, not of arrival.
        part: "sec" or "nanosec" where another column may hold the rest.
    """

    power: int | None
    scope: Words = ()
    is_header: bool = False
    part: str = ""


@dataclass(frozen=True)
class DateColumn:
    """A date, with a time of day or with that in another column."""


@dataclass(frozen=True)
class CoordinateColumn:
    """Coordinate of an object along an axis (0 to 2), in units of `scale` `unit`s.

    Attributes:
        unit: "m", "px", or "" where the name states none.
        rank: kind of name: 0 an axis, 1 a height, 2 a bare position, 3 a bare distance; of
            several for one axis the first is used.
        is_doubtful: whether it counts only if the object has another, as in "x-ball", "y-ball".
    """

    thing: str
    axis: int
    scale: float
    unit: str
    rank: int = 0
    is_doubtful: bool = False


@dataclass(frozen=True)
class JointColumn:
    """One quantity of one joint, in units of `scale` rad, rad/s, N·m or A.

    Attributes:
        group: the robot, or "joints".
        label: the joint.
        quantity: "effort", "position", "velocity" or "current".
        number: the digits in the name where they alone identify the joint.
        is_bare: whether the name identifies no joint.
    """

    group: str
    label: str
    quantity: str
    scale: float
    number: str = ""
    is_bare: bool = False


@dataclass(frozen=True)
class FrameColumn:
    """Frame number: a time where the frame rate is known."""


@dataclass(frozen=True)
class ImpactColumn:
    """Time of an impact in each row.

    Attributes:
        power: see `TimeColumn`.
        counts_frames: whether it numbers frames.
    """

    power: int | None
    counts_frames: bool = False


@dataclass(frozen=True)
class ImpactNumberColumn:
    """Number of an impact: the times beside it are those of impacts."""


@dataclass(frozen=True)
class RunColumn:
    """Number or name of a row's run or object; `kind` is "run", "object", ..."""

    kind: str


@dataclass(frozen=True)
class JointNameColumn:
    """A text column: the name of the joint of that number."""

    number: str


@dataclass(frozen=True)
class UnusedColumn:
    """An unused column, with the reason."""

    reason: str


# What a column can mean.
Meaning = (
    TimeColumn
    | DateColumn
    | CoordinateColumn
    | JointColumn
    | FrameColumn
    | ImpactColumn
    | ImpactNumberColumn
    | RunColumn
    | JointNameColumn
    | UnusedColumn
)

Reading = Callable[[int, str], Meaning]  # what the column at an index, of that name, means


def words_of(name: str, *, camel: bool) -> Words:
    """Split a name at underscores, slashes, dots, brackets and spaces; `camel` also at capitals."""
    name = name.replace("°", "deg").replace("µ", "u").replace("μ", "u")
    name = name[:1] + name[1:].replace(
        "%", " percent "
    )  # it begins the names of `rostopic echo -p`
    if camel:
        name = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name)
    return tuple(word for word in re.split(r"[\W_]+", name) if word)


def lowered(words: Words) -> Words:
    """Return the words in lower case."""
    return tuple(word.lower() for word in words)
