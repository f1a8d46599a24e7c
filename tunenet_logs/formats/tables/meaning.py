"""What a column of a table can mean."""

from __future__ import annotations

import re
from dataclasses import dataclass

Words = tuple[str, ...]
"""The words of a column's name, as `words_of` takes it apart."""

LENGTHS = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), 0.01),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 0.001),
}
"""Units of lengths [m]."""

POWERS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 0),
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "milliseconds"), -3),
    **dict.fromkeys(("us", "usec", "usecs", "micros", "microseconds"), -6),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanos", "nanoseconds"), -9),
}
"""Units of times, as powers of ten of a second."""


@dataclass(frozen=True)
class TimeColumn:
    """A time.

    Attributes:
        power: its unit as a power of ten of a second; None where the name does not say.
        scope: the words before it: what it is the time of.
        is_header: whether it is when a sample was taken, not when it arrived.
        part: "sec" or "nanosec" where another column may hold the rest.
    """

    power: int | None
    scope: Words = ()
    is_header: bool = False
    part: str = ""


@dataclass(frozen=True)
class CoordinateColumn:
    """The coordinate of a thing along an axis (0 to 2), in units of `scale` m.

    Attributes:
        is_height: whether it is called a height, not an axis.
    """

    thing: str
    axis: int
    scale: float
    is_height: bool = False


@dataclass(frozen=True)
class JointColumn:
    """One quantity of one joint, in units of `scale` rad, rad/s or N·m.

    Attributes:
        group: the robot, or "joints".
        label: the joint.
        quantity: "effort", "position" or "velocity".
        number: the digits in the name where it says no more of the joint.
        is_bare: whether it says nothing of the joint.
    """

    group: str
    label: str
    quantity: str
    scale: float
    number: str = ""
    is_bare: bool = False


@dataclass(frozen=True)
class JointNameColumn:
    """A column of texts: the name of the joint of that number."""

    number: str


@dataclass(frozen=True)
class UnusedColumn:
    """A column that is not used, and why."""

    reason: str


Meaning = TimeColumn | CoordinateColumn | JointColumn | JointNameColumn | UnusedColumn
"""What a column can mean."""


def words_of(name: str, *, camel: bool) -> Words:
    """The words of a name: what stands between underscores, slashes, dots, brackets, spaces."""
    name = name.replace("°", "deg").replace("µ", "u").replace("μ", "u")
    if camel:
        name = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name)
    return tuple(word for word in re.split(r"[\W_]+", name) if word)


def lowered(words: Words) -> Words:
    """The same in small letters."""
    return tuple(word.lower() for word in words)
