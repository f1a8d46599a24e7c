"""Interpret the name of a table column as a time, a coordinate or a joint quantity.

`meaning_of` reads one name by the words that people, spreadsheets and ROS tools use. Robot
controllers write many columns per joint: `choose_fields` takes the measured ones. `runs_of` splits
off the run that a name may state as well.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

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


# ---- Words of names: of times, coordinates, row numbers and joints.

# What a time is called, beside t and bare units.
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

_MAX_LENGTH = 200  # characters of a name that is interpreted
_MAX_WORDS = 40  # of such a name

_PIXELS = frozenset(("px", "pix", "pixel", "pixels"))  # units of pictures
_AXES = {"x": 0, "y": 1, "z": 2}  # axes by their names
# What z is called as well.
_HEIGHTS = frozenset(
    (
        *("height", "altitude", "elevation"),
        *("höhe", "hoehe", "hauteur", "altura", "altezza", "hoogte"),
    )
)

# Words beside an axis that only say that it is a position.
_PLACES = frozenset(
    (
        *("pos", "position", "positions", "pose", "point", "translation", "transform"),
        *("field", "location", "loc", "msg", "xyz", "coordinate", "coordinates"),
    )
)

# Words that make an axis one of another quantity than position.
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

# Words beside what is numbered.
_NUMBERS = frozenset(("number", "no", "nr", "num", "id", "index", "idx", "count"))

# What runs are called, or the objects of a table that stacks them.
_RUNS = {
    **dict.fromkeys(("run", "runs", "trial", "drop", "take", "episode", "throw", "rep"), "run"),
    **dict.fromkeys(("repetition", "attempt", "experiment", "versuch"), "run"),
    **{thing: thing for thing in ("track", "particle", "object", "body", "marker", "ball")},
    **{thing: thing for thing in ("entity", "actor", "agent", "subject", "tag")},
    **dict.fromkeys(("rigidbody", "asset", "thing", "item"), "object"),
    **dict.fromkeys(("id", "name", "label", "childframe"), "object"),
}

# What frames are called.
_FRAMES = frozenset(("frame", "frames", "framenumber", "frameno", "frameindex", "frameid"))

# What impacts are called.
_IMPACTS = frozenset(("bounce", "bounces", "impact", "impacts", "hit", "hits"))

# Words behind an axis that name no object.
_NO_THINGS = frozenset(
    (
        *("km", "dm", "yd", "mile", "miles", "deg", "rad", "g", "hz", "percent", "n", "v", "a"),
        *("s", "ms", "field", "axis", "flag", "score", "value", "label", "count", "index"),
    )
)

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
# Words of commanded quantities.
COMMANDED = frozenset(
    (
        *("target", "tgt", "desired", "des", "command", "commanded", "cmd", "setpoint", "goal"),
        *("reference", "ref", "planned", "action"),
    )
)

# Words of a controller's estimates: a torque without the arm's own, or computed by its model.
MODELLED = frozenset(
    (
        *("ext", "hat", "est", "estimated", "estimate", "external", "predicted", "pred"),
        *("model", "modelled", "modeled", "computed", "calculated"),
    )
)

# Words of measured quantities.
MEASURED = frozenset(("actual", "act", "measured", "meas", "msr", "feedback", "fb"))

# Words that make a joint's quantity another one.
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

_MAX_KNOWN = 1000  # names whose meaning is cached: a line is parsed in several ways


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


# ---- Fields of robot controllers: measured, commanded or model-based.


class Origin(IntEnum):
    """Origin of values, best first."""

    MEASURED = 0
    PLAIN = 1
    COMMANDED = 2
    MODELLED = 3


_ORIGINS = {
    **dict.fromkeys((*MEASURED, "sensor", "sensed", "encoder"), Origin.MEASURED),
    **dict.fromkeys(COMMANDED, Origin.COMMANDED),
    **dict.fromkeys(MODELLED, Origin.MODELLED),
}

# Words of quantities.
_QUANTITIES = {
    **JOINT_QUANTITIES,
    **{f"{word}s": quantity for word, quantity in JOINT_QUANTITIES.items()},
    "velocities": "velocity",
    "speed": "velocity",
    "moment": "effort",
}

# Names that are understood as a whole: of Universal Robots' and KUKA's own recorders.
_WHOLE: dict[Words, tuple[str, Origin]] = {
    ("actual", "current", "as", "torque"): ("effort", Origin.MEASURED),
    ("measured", "tq"): ("effort", Origin.MEASURED),
    ("mp",): ("position", Origin.MEASURED),
    ("mt",): ("effort", Origin.MEASURED),
    ("ip",): ("position", Origin.COMMANDED),
    ("et",): ("effort", Origin.MODELLED),
}

# Words that only say that it is an arm's.
_NEUTRAL = frozenset(
    ("joint", "joints", "axis", "j", "arm", "robot", "state", "states", "filtered", "raw", "motor")
)

_SIDES = ("left", "right")  # of which arm a column is, where there are two
_MAX_JOINTS = 99  # of an arm
# What Universal Robots calls its joints, base to tool.
_UR_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)


@dataclass(frozen=True)
class JointField:
    """One quantity of all joints.

    Attributes:
        stem: common part of its columns' names: "actual_q".
        side: "left" or "right" of two arms; "" of one.
        quantity: "position", "velocity", "effort" or "current".
        origin: where the values come from.
        scale: of the values, to rad, rad/s, N·m or A.
        columns: column index by joint number as in the names.
    """

    stem: str
    side: str
    quantity: str
    origin: Origin
    scale: float
    columns: Mapping[int, int]

    @property
    def title(self) -> str:
        """Column range in words."""
        numbers = sorted(self.columns)
        return f"{self.stem} {numbers[0]} to {numbers[-1]}" if len(numbers) > 1 else self.stem


@dataclass(frozen=True)
class JointChoice:
    """Fields chosen among an arm's columns.

    Attributes:
        used: the best of each quantity.
        unused: the others, with the reason.
        labels: the joints' names, by number.
    """

    used: tuple[JointField, ...]
    unused: tuple[tuple[JointField, str], ...]
    labels: Mapping[int, str]


def joint_fields(names: Sequence[str]) -> tuple[JointField, ...]:
    """Find the joint fields among columns; of two columns of one name the first counts."""
    found: dict[tuple[str, str, str, Origin, float], dict[int, int]] = {}
    for at, name in enumerate(names):
        if (parsed := _parsed(name)) is not None:
            key, number = parsed
            found.setdefault(key, {}).setdefault(number, at)
    return tuple(JointField(*key, columns=columns) for key, columns in found.items())


def tells_origin(fields: Iterable[JointField]) -> bool:
    """Return whether the names distinguish measured from other joint quantities."""
    return any(field.origin != Origin.PLAIN for field in fields)


def choose_fields(fields: Sequence[JointField]) -> JointChoice:
    """Choose one field per quantity: measured before commanded, never a model's output."""
    used: list[JointField] = []
    unused: list[tuple[JointField, str]] = []
    for key in dict.fromkeys((field.side, field.quantity) for field in fields):
        ranked = sorted(
            (field for field in fields if (field.side, field.quantity) == key),
            key=lambda field: field.origin,
        )
        best = ranked[0]
        equals = [field for field in ranked if field.origin == best.origin]
        is_clear = len(equals) == 1 and best.origin <= Origin.PLAIN
        if is_clear:
            used.append(best)
        unused += [(field, _reason(field, equals, is_clear)) for field in ranked[is_clear:]]
    zero = any(0 in field.columns for field in fields)
    numbers = sorted({number for field in fields for number in field.columns})
    labels = {number: f"joint{number + zero}" for number in numbers}
    if any(field.stem == "actual_q" for field in fields) and numbers == list(range(6)):
        labels = dict(enumerate(_UR_JOINTS))
    return JointChoice(tuple(used), tuple(unused), labels)


def _reason(field: JointField, equals: Sequence[JointField], has_better: bool) -> str:
    """Return why a field is not used; `equals` share the best origin."""
    if field.quantity == "effort" and "moment" in field.stem:
        return "the controller's own model, with the payload that was set in it: no measurement"
    if field.origin == Origin.COMMANDED:
        remedy = "" if has_better else f"; record the measured {field.quantity}"
        return f"commanded, not measured{remedy}"
    if field.origin == Origin.MODELLED:
        return "the controller's estimate, not a measurement"
    if field in equals:
        others = " and ".join(one.stem for one in equals)
        return (
            f"{others} may all be the {field.quantity}; say which: --columns {field.quantity}_1=..."
        )
    return "a measured one is used"


def _parsed(name: str) -> tuple[tuple[str, str, str, Origin, float], int] | None:
    """Parse a joint column's name into stem, side, quantity, origin, scale and joint number."""
    written = words_of(name, camel=False)
    numbered = [re.fullmatch(r"([A-Za-z]*?)(\d{1,2})", word) for word in written]
    at = [place for place, match in enumerate(numbered) if match]
    if len(at) != 1 or (match := numbered[at[0]]) is None:
        return None
    number = int(match[2])
    words = [*written[: at[0]], *filter(None, [match[1]]), *written[at[0] + 1 :]]
    stem = "_".join(words)
    lower = lowered(tuple(words))
    count = next((n for n in (3, 2, 1) if len(lower) > n and lower[-n:] in JOINT_UNITS), 0)
    fitting, scale = JOINT_UNITS[lower[-count:]] if count else ((), 1.0)
    lower = lower[: len(lower) - count]
    side = next((word for word in lower if word in _SIDES), "")
    meaning = _meaning([word for word in lower if word not in _SIDES])
    if meaning is None or (count and meaning[0] not in fitting) or number > _MAX_JOINTS:
        return None
    return (stem, side, *meaning, scale), number


def _meaning(words: Sequence[str]) -> tuple[str, Origin] | None:
    """Return quantity and origin that words denote; None where one belongs to something else."""
    if (whole := _WHOLE.get(tuple(words))) is not None:
        return whole
    rest = [word for word in words if word not in _NEUTRAL]
    is_desired = len(rest) > 1 and rest[-1] == "d"
    rest = rest[: len(rest) - is_desired]
    quantities = [_QUANTITIES[word] for word in rest if word in _QUANTITIES]
    origins = [_ORIGINS[word] for word in rest if word in _ORIGINS]
    if len(quantities) + len(origins) != len(rest) or not quantities:
        return None
    if len(quantities) == 2 and quantities[0] == "current":  # as it is now, not a motor's
        quantities, origins = quantities[1:], [*origins, Origin.MEASURED]
    if len(quantities) != 1:
        return None
    origin = Origin.COMMANDED if is_desired else max(origins, default=Origin.PLAIN)
    return quantities[0], origin


# ---- Split off the run that a name states, where runs stand side by side.

# A run before the name: "Data Set 1:Time(s)".
_BEFORE = re.compile(
    r"\s*((?:run|trial|data ?set|set|latest|remote data|drop|take|experiment)\b[^:]{0,40})"
    r":\s*(\S.*)",
    re.IGNORECASE,
)

# A run behind the name, and a unit behind it, perhaps: "Time (s) Run #1".
_BEHIND = re.compile(
    r"(.*\S)[\s,_]+((?:run|trial|data ?set)\s*#?\s*\d{1,6})(\s*\([^()]*\))?\s*", re.IGNORECASE
)

# A number behind the name: "t1", "Height 2 (m)".
_NUMBERED = re.compile(r"(.*[^\W\d_])[\s_]*#?(\d{1,6})(\s*\([^()]*\))?\s*")

_MAX_NAME_WITH_RUN = 80  # characters


def runs_of(header: Sequence[str]) -> list[tuple[str, str]]:
    """Return the run of each column ("" where it is of none), and its name without it."""
    marked = [without_run(name) for name in header]
    if any(run for run, _ in marked):
        return _labelled(marked)
    if by_prefix := _prefixed(header):
        return by_prefix
    return _blocks(header) or _numbered(header) or marked


def without_run(name: str) -> tuple[str, str]:
    """Split the run ("" where there is none) from a column's name."""
    if len(name) > _MAX_NAME_WITH_RUN:
        return "", name
    if found := _BEFORE.fullmatch(name):
        return found[1].strip().lower(), found[2]
    has_mark = any(word in name.lower() for word in ("run", "trial", "set"))
    if has_mark and (found := _BEHIND.fullmatch(name)):
        return found[2].lower(), found[1] + (found[3] or "")
    return "", name


def _prefixed(header: Sequence[str]) -> list[tuple[str, str]]:
    """Split runs named by a user, each with a time: "Bounce:Time(s)"; empty for other tables."""
    parts = [name[:_MAX_NAME_WITH_RUN].partition(":") for name in header]
    runs = {run for run, mark, name in parts if mark and "/" not in run and _is_time(name)}
    if not runs:
        return []
    pairs = zip(parts, header, strict=True)
    marked = [(run.strip(), rest) if run in runs else ("", name) for (run, _, rest), name in pairs]
    return _labelled(marked)


def _labelled(marked: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Shorten run names: "run1", "latest"; empty where there is only one run."""
    runs = list(dict.fromkeys(run for run, _ in marked if run))
    if len(runs) == 1:
        return [("", name) for _, name in marked]
    short = {run: _short(run) for run in runs}
    if len(set(short.values())) < len(runs):
        short = {run: re.sub(r"\W+", "_", run).strip("_") for run in runs}
    if len(set(short.values())) < len(runs):
        short = {run: f"run{number}" for number, run in enumerate(runs, 1)}
    return [(short.get(run, ""), name) for run, name in marked]


def _short(run: str) -> str:
    digits = re.search(r"\d+", run)
    return f"run{int(digits[0])}" if digits else re.sub(r"\W+", "_", run).strip("_")


def _blocks(header: Sequence[str]) -> list[tuple[str, str]]:
    """Split runs as blocks of equal names, each of which begins with a time."""
    names = [name.strip().lower() for name in header]
    if len(set(filter(None, names))) == len(names):
        return []
    first = next((at for at, name in enumerate(names) if name and _is_time(name)), None)
    if first is None or names.count(names[first]) < 2:
        return []
    starts = [at for at, name in enumerate(names) if name == names[first]]
    ends = [*starts[1:], len(names)]
    blocks = [tuple(filter(None, names[a:b])) for a, b in zip(starts, ends, strict=True)]
    if len(set(blocks)) > 1 or len(blocks[0]) < 2:
        return []
    found = [("", name) for name in header]
    for number, (start, end) in enumerate(zip(starts, ends, strict=True), 1):
        found[start:end] = [(f"run{number}", name) for name in header[start:end]]
    return found


def _numbered(header: Sequence[str]) -> list[tuple[str, str]]:
    """Split runs by numbers behind the names, where several times are numbered and none is not."""
    if not header or len(header[0]) > _MAX_NAME_WITH_RUN or any(map(_is_time, header)):
        return []
    found = [
        _NUMBERED.fullmatch(name) if len(name) <= _MAX_NAME_WITH_RUN else None for name in header
    ]
    parts = [(f"run{int(one[2])}", one[1] + (one[3] or "")) if one else None for one in found]
    times = Counter(part[0] for part in parts if part and _is_time(part[1]))
    if len(times) < 2 or max(times.values()) > 1:
        return []
    return [
        part if part and part[0] in times else ("", name)
        for part, name in zip(parts, header, strict=True)
    ]


def _is_time(name: str) -> bool:
    return isinstance(meaning_of(name), TimeColumn)
