"""Interpret the name of a table column as a time, a coordinate or a joint quantity."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import lru_cache

from tunenet_logs.formats.tables.meaning import (
    LENGTHS,
    POWERS,
    CoordinateColumn,
    DateColumn,
    FrameColumn,
    ImpactNumberColumn,
    JointColumn,
    JointNameColumn,
    Meaning,
    RunColumn,
    TimeColumn,
    UnusedColumn,
    Words,
    lowered,
    words_of,
)

# Times.
# What a time is called, beside t and units alone.
_TIMES = frozenset(
    (
        *("time", "times", "stamp", "timestamp", "timestamps", "elapsed", "rosbagtimestamp"),
        *("datetime", "zeit", "zeitstempel", "uhrzeit", "temps", "tiempo", "tempo", "tijd"),
    )
)

_DATES = frozenset(("date", "datum", "fecha"))  # what a date is called
_NO_TIMES = frozenset(("delta", "diff", "step"))  # words that make it a time between two rows
# What the whole seconds of a stamp are called, whose rest is in another column.
_SECONDS = frozenset(("sec", "secs", "second", "seconds"))

# What `rostopic echo -p` and its kin write in ns, however small.
_IN_NS = frozenset((("rosbag", "timestamp"), ("rosbagtimestamp",), ("field", "header", "stamp")))

# The meaning of every other name.
UNKNOWN = UnusedColumn("its name says no time, position (x, y, z, height) or joint torque")

_MAX_LENGTH = 200  # of a name that is looked at
_MAX_WORDS = 40  # of a name that is looked at

# Coordinates.
_PIXELS = frozenset(("px", "pix", "pixel", "pixels"))  # units of pictures
_AXES = {"x": 0, "y": 1, "z": 2}  # axes by their names
# What z is called as well.
_HEIGHTS = frozenset(
    (
        *("height", "altitude", "elevation"),
        *("höhe", "hoehe", "hauteur", "altura", "altezza", "hoogte"),
    )
)

# Words beside an axis that say no more than that it is a position.
_PLACES = frozenset(
    (
        *("pos", "position", "positions", "pose", "point", "translation", "transform"),
        *("field", "location", "loc", "msg", "xyz", "coordinate", "coordinates"),
    )
)

# Words that make an axis that of something else than a position.
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

# What the one coordinate of a motion sensor is called, with a unit of length, and its rank.
_LINES = {
    "h": 1,
    **dict.fromkeys(("position", "pos"), 2),
    **dict.fromkeys(("distance", "displacement", "dist", "s", "d", "weg", "abstand"), 3),
}

# Units of speeds and accelerations along a line, at the end of a name.
_SPEEDS = frozenset(
    (
        *((length, second) for length in LENGTHS for second in ("s", "sec", "second")),
        *((length, second) for length in LENGTHS for second in ("s2", "s²", "sec2", "s3", "s³")),
        *((length, "s", power) for length in LENGTHS for power in ("1", "2", "²", "⁻¹", "⁻²")),
        *((length, "per", second) for length in LENGTHS for second in ("s", "sec", "second")),
        *((length, "s", "s") for length in LENGTHS),
        *(("km", "h"), ("mph",), ("kmh",), ("ms", "1"), ("ms", "2"), ("ms⁻¹",), ("ms⁻²",)),
    )
)

# The meaning of a column in such a unit.
SPEED = UnusedColumn("it is a speed or an acceleration along a line; positions are used")

# Numbers of rows.
# Words beside what is numbered.
_NUMBERS = frozenset(("number", "no", "nr", "num", "id", "index", "idx", "count"))

# What runs are called, or the things of a table that holds them below each other.
_RUNS = {
    **dict.fromkeys(("run", "runs", "trial", "drop", "take", "episode", "throw", "rep"), "run"),
    **dict.fromkeys(("repetition", "attempt", "experiment", "versuch"), "run"),
    **{thing: thing for thing in ("track", "particle", "object", "body", "marker", "ball")},
    **{thing: thing for thing in ("entity", "actor", "agent", "subject", "tag")},
    **dict.fromkeys(("rigidbody", "asset", "thing", "item"), "object"),
    **dict.fromkeys(("id", "name", "label", "childframe"), "object"),
}

# What pictures are called.
_FRAMES = frozenset(("frame", "frames", "framenumber", "frameno", "frameindex", "frameid"))

# What impacts are called.
_IMPACTS = frozenset(("bounce", "bounces", "impact", "impacts", "hit", "hits"))

# Words behind an axis that are no thing's name.
_NO_THINGS = frozenset(
    (
        *("km", "dm", "yd", "mile", "miles", "deg", "rad", "g", "hz", "percent", "n", "v", "a"),
        *("s", "ms", "field", "axis", "flag", "score", "value", "label", "count", "index"),
    )
)

# Joints.
# What JointState calls them, and the current of a joint's motor.
JOINT_QUANTITIES = {
    **dict.fromkeys(("effort", "torque", "tau"), "effort"),
    **dict.fromkeys(("position", "pos", "angle", "theta", "q"), "position"),
    **dict.fromkeys(("velocity", "vel", "qdot", "qd", "dq"), "velocity"),
    "current": "current",
}

# A quantity of a joint with the joint's number, perhaps: "effort3", "velocities", "q1".
_QUANTITY = re.compile(rf"({'|'.join(sorted(JOINT_QUANTITIES, key=len, reverse=True))})s?(\d*)")

_JOINT = ("joint", "j")  # words for any joint, beside its number
# Words of what a controller asked for.
COMMANDED = frozenset(
    (
        *("target", "tgt", "desired", "des", "command", "commanded", "cmd", "setpoint", "goal"),
        *("reference", "ref", "planned", "action"),
    )
)

# Words of what a controller reckons: a torque without the arm's own, or out of its model.
MODELLED = frozenset(
    (
        *("ext", "hat", "est", "estimated", "estimate", "external", "predicted", "pred"),
        *("model", "modelled", "modeled", "computed", "calculated"),
    )
)

# Words of what was measured.
MEASURED = frozenset(("actual", "act", "measured", "meas", "msr", "feedback", "fb"))

# Words that make a quantity of a joint another one.
_NO_JOINTS = frozenset(
    (
        *("deviation", "ratio", "error", "err", "limit", "limits", "percent", "percentage"),
        *("std", "stddev", "var", "variance", "cov", "covariance", "noise", "scaling"),
        *("temperature", "temp", "voltage", "max", "min", "mode", "status", "rpm", "hz", "lbf"),
        *("volt", "volts", "counts", "ticks", "rev", "revs"),
    )
)

_ANGULAR = ("ang", "angular")  # words that are no joint's name: "AngVel"
# Quantities that a unit of angles may stand for: people write deg for deg/s too.
_TURNS = ("position", "velocity")

_RADIANS, _DEGREES = ("rad", "rads", "radian", "radians"), ("deg", "degs", "degree", "degrees")
_SECOND = (("s",), ("sec",), ("second",), ("per", "s"), ("per", "sec"), ("per", "second"))

# Units at the end of a name: which quantities have them, and their size in rad, rad/s, N·m, A.
JOINT_UNITS: dict[Words, tuple[tuple[str, ...], float]] = {
    **{(word,): (_TURNS, 1.0) for word in _RADIANS},
    **{(word,): (_TURNS, math.pi / 180) for word in _DEGREES},
    **{(word, *one): (("velocity",), 1.0) for word in _RADIANS for one in _SECOND},
    **{(word, *one): (("velocity",), math.pi / 180) for word in _DEGREES for one in _SECOND},
    ("nm",): (("effort",), 1.0),
    ("n", "m"): (("effort",), 1.0),
    ("mnm",): (("effort",), 0.001),
    ("a",): (("current",), 1.0),
    ("ma",): (("current",), 0.001),
}


_MAX_KNOWN = 1000  # names whose meaning is kept: a line is looked at in several ways


def meaning_of(name: str) -> Meaning:
    """Interpret a column's name."""
    return UNKNOWN if len(name) > _MAX_LENGTH else _meaning_of(name)


@lru_cache(maxsize=_MAX_KNOWN)
def _meaning_of(name: str) -> Meaning:
    before: Words = ()
    for camel in (False, True):  # a joint called LeftKnee is to keep its name
        words = words_of(name, camel=camel)
        if not words or len(words) > _MAX_WORDS or words == before:
            break
        before = words
        lower = lowered(words)
        if "in" in lower[-4:-1] and lower[0] != "in":  # "h in cm", not "h (in)"
            at = len(lower) - 2 - lower[-2::-1].index("in")
            words, lower = (*words[:at], *words[at + 1 :]), (*lower[:at], *lower[at + 1 :])
        found = _time(name, lower) or _number_of(lower) or _coordinate_of(lower) or _joint_of(words)
        if found is not None:
            return found
    return UNKNOWN


def by_name(_index: int, name: str) -> Meaning:
    """Interpret a column by its name alone, ignoring its index."""
    return meaning_of(name)


def _number_of(lower: Words) -> FrameColumn | ImpactNumberColumn | RunColumn | None:
    """Interpret words as the name of a row counter; None if they are not."""
    bare = lower[:-1] if len(lower) > 1 and lower[-1] in (*_NUMBERS, "name", "label") else lower
    if "".join(bare) in _RUNS:
        return RunColumn(_RUNS["".join(bare)])
    if len(bare) == 2 and bare[0] in ("video", "movie", "image"):
        bare = bare[1:]
    if len(bare) != 1:
        return None
    if bare[0] in _IMPACTS:
        return ImpactNumberColumn()
    return FrameColumn() if bare[0] in _FRAMES else None


def _time(name: str, lower: Words) -> TimeColumn | DateColumn | None:
    if len(lower) == 1 and lower[0] in _DATES:
        return DateColumn()
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
    """Interpret lower-case words as the name of a coordinate; None if they are not."""
    if any(lower[-n:] in _SPEEDS for n in (1, 2, 3) if len(lower) > n):
        return SPEED
    unit, rest = "", lower
    if len(rest) > 1 and (rest[-1] in LENGTHS or rest[-1] in _PIXELS):
        unit, rest = rest[-1], rest[:-1]
    number, rest = _numbered_thing(rest)
    if len(rest) > 1 and rest[-1] in ("pos", "position") and rest[-2] in _AXES:
        rest = rest[:-1]
    rank = 1 if rest[-1] in _HEIGHTS else 0
    if unit in LENGTHS and len(rest) == 1 and not rank:
        rank = _LINES.get(rest[0], 0)
    axis = 2 if rank else _AXES.get(rest[-1])
    is_doubtful = axis is None and len(rest) > 1 and rest[0] in _AXES
    is_doubtful = is_doubtful and not _NO_THINGS.intersection(rest)
    if is_doubtful:
        axis, rest = _AXES[rest[0]], (*rest[1:], rest[0])
    if axis is None:
        return None
    if _OTHERS.intersection(rest[:-1]):
        return UnusedColumn("it is no position")
    thing = "_".join([*(word for word in rest[:-1] if word not in _PLACES), *number])
    thing = f"track{thing}" if not thing or thing.isdecimal() else thing
    kind = "px" if unit in _PIXELS else "m" if unit else ""
    return CoordinateColumn(thing, axis, LENGTHS.get(unit, 1.0), kind, rank, is_doubtful)


def _numbered_thing(words: Sequence[str]) -> tuple[Sequence[str], Sequence[str]]:
    """Split off an object's number, as in x1, y1, x2, ... or x_1, ..., from the other words."""
    if len(words) > 1 and words[-1].isdecimal() and words[-2] in _AXES:
        return words[-1:], words[:-1]
    found = re.fullmatch(r"([xyz])(\d+)", words[-1])
    return ((found[2],), (*words[:-1], found[1])) if found else ((), words)


def _joint_of(words: Words) -> JointColumn | JointNameColumn | UnusedColumn | None:
    """Interpret words as the name of a joint quantity; None if they are not."""
    lower = lowered(words)
    if found := re.fullmatch(r"field name(\d+)", " ".join(lower)):
        return JointNameColumn(found[1])
    count = next((n for n in (3, 2, 1) if len(lower) > n and lower[-n:] in JOINT_UNITS), 0)
    known = ("effort", *_TURNS, "current")
    quantities, scale = JOINT_UNITS[lower[-count:]] if count else (known, 1.0)
    words = words[: len(words) - count]
    matches = [_QUANTITY.fullmatch(word) for word in lowered(words)]
    at = max((n for n, match in enumerate(matches) if match), default=None)
    if at is None:
        return None
    match = matches[at]
    assert match is not None
    quantity = JOINT_QUANTITIES[match[1]]
    if quantity not in quantities or (not count and lower[-1] in LENGTHS):
        return UnusedColumn(
            f"its unit is not one of a joint's {quantity}; a height is called height_m"
        )
    if why := _no_joint(quantity, lowered((*words[:at], match[2], *words[at + 1 :]))):
        return why
    group, joint = _apart((*words[:at], *words[at + 1 :]))
    digits = match[2] or "".join(word for word in joint[-1:] if word.isdecimal())
    joint = tuple(word for word in joint if word.lower() not in (*MEASURED, *_ANGULAR))
    named = [word for word in joint if word.lower() not in _JOINT and not word.isdecimal()]
    if not named and digits:
        return JointColumn(group, f"joint{digits}", quantity, scale, number=digits)
    label = "_".join(joint) + match[2]
    return JointColumn(group, label or "joint1", quantity, scale, is_bare=not label)


def _no_joint(quantity: str, others: Words) -> UnusedColumn | None:
    """Return why a quantity with these words beside it was not measured at a joint."""
    bare = {word.rstrip("0123456789") for word in others}
    if not COMMANDED.isdisjoint(bare):
        return UnusedColumn("it is what was asked for, not what was measured")
    if not MODELLED.isdisjoint(bare):
        return UnusedColumn("it is the controller's estimate, not a measurement")
    if _NO_JOINTS.intersection(others):
        return UnusedColumn(f"it is no {quantity} of a joint")
    is_named = any("joint" in word or word.isdecimal() for word in others)
    if quantity == "current" and not is_named:
        return UnusedColumn("it is a current of no joint; name it joint1_current")
    return None


def _apart(words: Words) -> tuple[str, Words]:
    """Split words without the quantity into robot and joint."""
    lower = lowered(words)
    for at in range(1, len(words)):
        if lower[at - 1] == "joint" and lower[at] in ("state", "states"):
            return "_".join(words[: at - 1]) or "joints", words[at + 1 :]
    return "joints", words[1:] if lower[:1] == ("field",) else words
