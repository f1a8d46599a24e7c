"""What the name of one column of a table means: a time, a coordinate, a quantity of a joint."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from tunenet_logs.formats.tables.meaning import (
    LENGTHS,
    POWERS,
    CoordinateColumn,
    JointColumn,
    JointNameColumn,
    Meaning,
    TimeColumn,
    UnusedColumn,
    Words,
    lowered,
    words_of,
)

# Times.
_TIMES = frozenset(("time", "times", "stamp", "timestamp", "elapsed", "rosbagtimestamp"))
"""What a time is called, beside t and units alone."""

_NO_TIMES = frozenset(("delta", "diff", "step"))
"""Words that make it a time between two rows."""

_SECONDS = frozenset(("sec", "secs", "second", "seconds"))
"""What the whole seconds of a stamp are called, whose rest is in another column."""

_IN_NS = frozenset((("rosbag", "timestamp"), ("rosbagtimestamp",), ("field", "header", "stamp")))
"""What `rostopic echo -p` and its kin write in ns, however small."""

UNKNOWN = UnusedColumn("its name says no time, position (x, y, z, height) or joint torque")
"""The meaning of every other name."""

# Coordinates.
_PIXELS = frozenset(("px", "pix", "pixel", "pixels"))
"""Units of pictures."""

_AXES = {"x": 0, "y": 1, "z": 2}
"""Axes by their names."""

_HEIGHTS = frozenset(("height", "altitude", "elevation"))
"""What z is called as well."""

_PLACES = frozenset(
    (
        *("pos", "position", "positions", "pose", "point", "translation", "transform"),
        *("field", "location", "loc", "msg", "xyz", "coordinate", "coordinates"),
    )
)
"""Words beside an axis that say no more than that it is a position."""

_OTHERS = frozenset(
    (
        *("orientation", "quaternion", "quat", "q", "rotation", "rot", "euler", "rpy"),
        *("angle", "angles", "theta", "twist", "linear", "angular", "omega", "gyro"),
        *("velocity", "vel", "speed", "v", "acceleration", "accel", "acc", "gravity"),
        *("force", "wrench", "torque", "effort", "tau", "magnetic", "mag", "normal"),
        *("covariance", "cov", "variance", "var", "std", "stddev", "sigma", "error", "err"),
        *("scale", "size", "drop", "image", "picture", "frame"),
    )
)
"""Words that make an axis that of something else than a position."""

PIXELS = UnusedColumn("it is in pixels, which tell no length; tune from the video itself")
"""The meaning of a column in pixels."""

# Joints.
_QUANTITY = re.compile(
    r"(effort|torque|tau|position|pos|angle|theta|qdot|qd|dq|q|velocity|vel)s?(\d*)"
)
"""A quantity of a joint with the joint's number, perhaps: "effort3", "velocities", "q1"."""

_QUANTITIES = {
    **dict.fromkeys(("effort", "torque", "tau"), "effort"),
    **dict.fromkeys(("position", "pos", "angle", "theta", "q"), "position"),
    **dict.fromkeys(("velocity", "vel", "qdot", "qd", "dq"), "velocity"),
}
"""What JointState calls them."""

_TURNS = ("position", "velocity")
"""Quantities that a unit of angles may stand for: people write deg for deg/s too."""

_UNITS: dict[Words, tuple[tuple[str, ...], float]] = {
    ("nm",): (("effort",), 1.0),
    ("n", "m"): (("effort",), 1.0),
    ("mnm",): (("effort",), 0.001),
    ("rad",): (_TURNS, 1.0),
    ("deg",): (_TURNS, math.pi / 180),
    ("degrees",): (_TURNS, math.pi / 180),
    ("rad", "s"): (("velocity",), 1.0),
    ("deg", "s"): (("velocity",), math.pi / 180),
}
"""Units at the end of a name: which quantities have them, and their size in rad, rad/s or N·m."""


def meaning_of(name: str) -> Meaning:
    """What a column's name means."""
    for camel in (False, True):  # a joint called LeftKnee is to keep its name
        words = words_of(name, camel=camel)
        if not words:
            break
        found = _time(name, lowered(words)) or _coordinate_of(lowered(words)) or _joint_of(words)
        if found is not None:
            return found
    return UNKNOWN


def _time(name: str, lower: Words) -> TimeColumn | None:
    power = POWERS.get(lower[-1])
    bare = lower if power is None else lower[:-1]
    if not bare:  # "s" is an arc's length more often
        return None if lower == ("s",) else TimeColumn(power, part=_part(lower[-1]))
    if _NO_TIMES.intersection(bare) or (bare != ("t",) and bare[-1] not in _TIMES):
        return None
    if power is None and (name.strip().startswith("%time") or lower in _IN_NS):
        power = -9
    scope = bare[: bare.index("header")] if "header" in bare else bare[:-1]
    return TimeColumn(power, scope, "header" in bare, _part(lower[-1]))


def _part(word: str) -> str:
    if word in _SECONDS:
        return "sec"
    return "nanosec" if POWERS.get(word) == -9 else ""


def _coordinate_of(lower: Sequence[str]) -> CoordinateColumn | UnusedColumn | None:
    """What the words of a name say of a coordinate; None if nothing.

    Args:
        lower: the words in small letters.
    """
    unit, rest = "", lower
    if len(rest) > 1 and (rest[-1] in LENGTHS or rest[-1] in _PIXELS):
        unit, rest = rest[-1], rest[:-1]
    if unit in _PIXELS:
        return PIXELS
    number, rest = _numbered_thing(rest)
    if len(rest) > 1 and rest[-1] in ("pos", "position") and rest[-2] in _AXES:
        rest = rest[:-1]
    is_height = rest[-1] in _HEIGHTS
    axis = 2 if is_height else _AXES.get(rest[-1])
    if axis is None:
        return None
    if _OTHERS.intersection(rest[:-1]):
        return UnusedColumn("it is no position")
    thing = "_".join([*(word for word in rest[:-1] if word not in _PLACES), *number])
    thing = f"track{thing}" if not thing or thing.isdecimal() else thing
    return CoordinateColumn(thing, axis, LENGTHS.get(unit, 1.0), is_height=is_height)


def _numbered_thing(words: Sequence[str]) -> tuple[Sequence[str], Sequence[str]]:
    """The number of a thing whose columns are x1, y1, x2, ... or x_1, ..., and the other words."""
    if len(words) > 1 and words[-1].isdecimal() and words[-2] in _AXES:
        return words[-1:], words[:-1]
    found = re.fullmatch(r"([xyz])(\d+)", words[-1])
    return ((found[2],), (*words[:-1], found[1])) if found else ((), words)


def _joint_of(words: Words) -> JointColumn | JointNameColumn | UnusedColumn | None:
    """What the words of a name say of a joint; None if nothing."""
    lower = lowered(words)
    if found := re.fullmatch(r"field name(\d+)", " ".join(lower)):
        return JointNameColumn(found[1])
    count = next((n for n in (2, 1) if len(lower) > n and lower[-n:] in _UNITS), 0)
    quantities, scale = _UNITS[lower[-count:]] if count else (("effort", *_TURNS), 1.0)
    words = words[: len(words) - count]
    matches = [_QUANTITY.fullmatch(word) for word in lowered(words)]
    at = max((n for n, match in enumerate(matches) if match), default=None)
    if at is None:
        return None
    match = matches[at]
    assert match is not None
    quantity = _QUANTITIES[match[1]]
    if quantity not in quantities or (not count and lower[-1] in LENGTHS):
        return UnusedColumn(
            f"its unit is not one of a joint's {quantity}; a height is called height_m"
        )
    group, joint = _apart((*words[:at], *words[at + 1 :]))
    digits = match[2] or "".join(word for word in joint[-1:] if word.isdecimal())
    named = [word for word in joint if word.lower() != "joint" and not word.isdecimal()]
    if not named and digits:
        return JointColumn(group, f"joint{digits}", quantity, scale, number=digits)
    label = "_".join(joint) + match[2]
    return JointColumn(group, label or "joint1", quantity, scale, is_bare=not label)


def _apart(words: Words) -> tuple[str, Words]:
    """The robot and the joint, of the words without the quantity."""
    lower = lowered(words)
    for at in range(1, len(words)):
        if lower[at - 1] == "joint" and lower[at] in ("state", "states"):
            return "_".join(words[: at - 1]) or "joints", words[at + 1 :]
    return "joints", words[1:] if lower[:1] == ("field",) else words
