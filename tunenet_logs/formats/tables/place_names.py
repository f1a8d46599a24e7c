"""Names of columns that hold the place of a thing along an axis."""

from __future__ import annotations

import re
from collections.abc import Sequence

from tunenet_logs.formats.tables.meaning import LENGTHS, Place, Unused

_PIXELS = frozenset(("px", "pix", "pixel", "pixels"))
_AXES = {"x": 0, "y": 1, "z": 2}
_HEIGHTS = frozenset(("height", "altitude", "elevation"))
_PLACES = frozenset(
    (
        *("pos", "position", "positions", "pose", "point", "translation", "transform"),
        *("field", "location", "loc", "msg", "xyz", "coordinate", "coordinates"),
    )
)
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
PIXELS = Unused("it is in pixels, which tell no length; tune from the video itself")


def place_of(lower: Sequence[str]) -> Place | Unused | None:
    """What the words of a name say of a place; None if nothing.

    Args:
        lower: the words in small letters.
    """
    unit, rest = "", lower
    if len(rest) > 1 and (rest[-1] in LENGTHS or rest[-1] in _PIXELS):
        unit, rest = rest[-1], rest[:-1]
    if unit in _PIXELS:
        return PIXELS
    number, rest = _numbered(rest)
    if len(rest) > 1 and rest[-1] in ("pos", "position") and rest[-2] in _AXES:
        rest = rest[:-1]
    is_height = rest[-1] in _HEIGHTS
    axis = 2 if is_height else _AXES.get(rest[-1])
    if axis is None:
        return None
    if _OTHERS.intersection(rest[:-1]):
        return Unused("it is no position")
    thing = "_".join([*(word for word in rest[:-1] if word not in _PLACES), *number])
    thing = f"track{thing}" if not thing or thing.isdecimal() else thing
    return Place(thing, axis, LENGTHS.get(unit, 1.0), is_height=is_height)


def _numbered(words: Sequence[str]) -> tuple[Sequence[str], Sequence[str]]:
    """The number of a thing whose columns are x1, y1, x2, ... or x_1, ..., and the other words."""
    if len(words) > 1 and words[-1].isdecimal() and words[-2] in _AXES:
        return words[-1:], words[:-1]
    found = re.fullmatch(r"([xyz])(\d+)", words[-1])
    return ((found[2],), (*words[:-1], found[1])) if found else ((), words)
