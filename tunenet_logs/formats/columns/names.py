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


def words_in(text: str) -> frozenset[str]:
    """Return the words of a list."""
    return frozenset(text.split())


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
    """A time."""

    power: int | None  # its unit as a power of ten of a second; None where the name states none
    scope: Words = ()  # the words before it: what it is the time of
    is_header: bool = False  # whether it is a time of acquisition, not of arrival
    part: str = ""  # "sec" or "nanosec" where another column may hold the rest


@dataclass(frozen=True)
class DateColumn:
    """A date, with a time of day or with that in another column."""


@dataclass(frozen=True)
class CoordinateColumn:
    """Coordinate of an object along an axis (0 to 2), in units of `scale` `unit`s."""

    thing: str
    axis: int
    scale: float
    unit: str  # "m", "px", or "" where the name states none
    # kind of name: 0 an axis, 1 a height, 2 a bare position, 3 a bare distance; of several for one
    # axis the first is used
    rank: int = 0
    # whether it counts only if the object has another, as in "x-ball", "y-ball"
    is_doubtful: bool = False


@dataclass(frozen=True)
class JointColumn:
    """One quantity of one joint, in units of `scale` rad, rad/s, N·m or A."""

    group: str  # the robot, or "joints"
    label: str  # the joint
    quantity: str  # "effort", "position", "velocity" or "current"
    scale: float
    number: str = ""  # the digits in the name where they alone identify the joint
    is_bare: bool = False  # whether the name identifies no joint
    # whether it is what was asked for, not what was measured; then `quantity` is "" where the name
    # does not say it
    is_command: bool = False


@dataclass(frozen=True)
class SwitchColumn:
    """Whether a joint's motor is on: a command counts only while it is."""

    label: str  # the joint; "" for all
    reason: str  # why it is not used where nothing commands its joint


@dataclass(frozen=True)
class FrameColumn:
    """Frame number: a time where the frame rate is known."""


@dataclass(frozen=True)
class ImpactColumn:
    """Time of an impact in each row."""

    power: int | None  # see `TimeColumn`
    counts_frames: bool = False  # whether it numbers frames


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
    | SwitchColumn
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
_TIMES = words_in(
    "time times stamp timestamp timestamps elapsed rosbagtimestamp datetime zeit zeitstempel "
    "uhrzeit temps tiempo tempo tijd ts unix epoch unixtime"
)
_DATES = frozenset(("date", "datum", "fecha"))  # what a date is called
_NO_TIMES = frozenset(("delta", "diff", "step"))  # words that make it a time between two rows
# What the whole seconds of a stamp are called, whose rest is in another column.
_SECONDS = frozenset(("sec", "secs", "second", "seconds"))
# What `rostopic echo -p` and its kin write in ns, however small.
_IN_NS = frozenset((("rosbag", "timestamp"), ("rosbagtimestamp",), ("field", "header", "stamp")))
# The meaning of every other name.
UNKNOWN = UnusedColumn("its name says no time, position (x, y, z, height) or joint torque")
_PIXELS = frozenset(("px", "pix", "pixel", "pixels"))  # units of pictures
_AXES = {"x": 0, "y": 1, "z": 2}  # axes by their names
# What z is called as well.
_HEIGHTS = words_in("height altitude elevation höhe hoehe hauteur altura altezza hoogte")
# Words beside an axis that only say that it is a position.
_PLACES = words_in(
    "pos position positions pose point translation transform field location loc msg xyz "
    "coordinate coordinates"
)
# Words that make an axis one of another quantity than position.
_OTHERS = words_in(
    "orientation quaternion quat q rotation rot euler rpy angle angles theta twist linear angular "
    "omega gyro velocity vel speed v acceleration accel acc gravity force wrench torque effort "
    "tau magnetic mag normal covariance cov variance var std stddev sigma error err scale size "
    "drop image picture frame"
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
# Columns beside which coordinates without a unit are in pixels: SLEAP's analysis of a film.
IN_PIXELS = frozenset(("instance.score",))
# What joints are called in a table that stacks them: "motor_id".
_STACKED_JOINTS = words_in("joint motor servo actuator dof")
# What frames are called.
_FRAMES = frozenset(("frame", "frames", "framenumber", "frameno", "frameindex", "frameid"))
# What impacts are called.
_IMPACTS = frozenset(("bounce", "bounces", "impact", "impacts", "hit", "hits"))
# Words behind an axis that name no object.
_NO_THINGS = words_in(
    "km dm yd mile miles deg rad g hz percent n v a s ms field axis flag score value label count "
    "index"
)
# Quantities of joints, and the units of their signals.
JOINT_UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N·m", "current": "A"}
# What JointState calls them, and the current of a joint's motor.
_QUANTITIES = {
    **dict.fromkeys(("effort", "eff", "torque", "tau", "trq", "tor"), "effort"),
    **dict.fromkeys(("position", "pos", "angle", "theta", "q", "qpos"), "position"),
    **dict.fromkeys(("velocity", "vel", "qdot", "qd", "dq", "qvel"), "velocity"),
    "current": "current",
}
# Of the numbered fields of a controller alone: elsewhere they are of other things.
_OF_FIELDS = {"velocities": "velocity", "speed": "velocity", "moment": "effort"}
# What the topic of a ROS controller's state or commands says besides.
_CONTROLLER = "controller"
_OF_TOPICS = (_CONTROLLER, "state", "states", "data")
# A quantity of a joint with the joint's number, perhaps: "effort3", "efforts", "q1".
_QUANTITY = re.compile(rf"({'|'.join(sorted(_QUANTITIES, key=len, reverse=True))})s?(\d*)")
_JOINT = ("joint", "j", "dof")  # words for any joint, beside its number
# Words of commanded quantities.
COMMANDED = words_in(
    "target targets tgt desired des command commands commanded cmd set setpoint setpoints goal "
    "goals reference ref planned action actions ctrl soll sollwert"
)
# Of these, words of lists of joints' commands, whose places are joints even where they are three.
_COMMAND_LISTS = words_in("action actions ctrl command commands cmd targets goals setpoints")
# Why a command is not used whose joint the file does not have.
ASKED_OF_NONE = "it is what was asked for, and no joint here is called so"
# Words of a controller's estimates: a torque without the arm's own, or computed by its model.
MODELLED = words_in(
    "ext hat est estimated estimate external predicted pred model modelled modeled computed "
    "calculated calc"
)
# Words of measured quantities.
MEASURED = words_in("actual act measured meas msr feedback fb present ist istwert")
# Words that make a joint's quantity another one.
_NO_JOINTS = words_in(
    "deviation ratio error err limit limits percent percentage std stddev var variance cov "
    "covariance noise scaling temperature temp voltage max min mode status rpm hz lbf volt volts "
    "counts ticks rev revs w quat quaternion enable enabled disable disabled on off switch flag "
    "valid fault reached gain gains kp ki kd last prev previous"
)
# Words of quantities that are no position of a joint, even where their command stands beside them.
_NOT_BARE = (
    _NO_JOINTS | _OTHERS | words_in("pressure power pwm duty flow level thrust throttle load")
)
# What the switches of motors are called.
_SWITCHES = {
    (what, word)
    for what in ("torque", "motor", "servo")
    for word in ("enable", "enabled", "on", "active")
}
_ANGULAR = ("ang", "angular")  # words that are no joint's name: "AngVel"
# Quantities that a unit of angles may stand for: people write deg for deg/s too.
_TURNS = ("position", "velocity")
_RADIANS, _DEGREES = ("rad", "rads", "radian", "radians"), ("deg", "degs", "degree", "degrees")
_SECOND = (("s",), ("sec",), ("second",), ("per", "s"), ("per", "sec"), ("per", "second"))
# Units at the end of a name: which quantities have them, and their size in rad, rad/s, N·m, A.
_ANGULAR_UNITS: dict[Words, tuple[tuple[str, ...], float]] = {
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


def meaning_of(name: str) -> Meaning:
    """Interpret a column's name."""
    return UNKNOWN if len(name) > 200 else _meaning_of(name)


@lru_cache(maxsize=1000)  # a line is parsed in several ways
def _meaning_of(name: str) -> Meaning:
    before: Words = ()
    for camel in (False, True):  # a joint called LeftKnee is to keep its name
        words = words_of(name, camel=camel)
        if not words or len(words) > 40 or words == before:
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
    if len(bare) == 1 and bare != lower and bare[0] in _STACKED_JOINTS:
        return RunColumn(bare[0])
    if len(bare) == 2 and bare[0] in ("video", "movie", "image"):
        bare = bare[1:]
    if len(bare) != 1:
        return None
    if bare[0] in _IMPACTS:
        return ImpactNumberColumn()
    return FrameColumn() if bare[0] in _FRAMES else None


def is_of_joints(meaning: Meaning) -> bool:
    """Return whether a column says which joint a row is of."""
    return isinstance(meaning, RunColumn) and meaning.kind in _STACKED_JOINTS


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


def _joint_of(
    words: Words,
) -> JointColumn | JointNameColumn | SwitchColumn | UnusedColumn | None:
    """Interpret words as the name of a joint quantity; None if they are not."""
    lower = lowered(words)
    if _CONTROLLER in lower[:-1] and (lower[-1].isdecimal() or not _has_quantity(lower)):
        return _controlled(words)
    if lower[-2:] in _SWITCHES:
        joint = _joint_column("", _apart(words[:-2])[1], "", "", 1.0, is_command=False)
        label = "" if joint.is_bare else joint.label
        return SwitchColumn(label, "it is no effort of a joint, but a switch of its motor")
    if found := re.fullmatch(r"field name(\d+)", " ".join(lower)):
        return JointNameColumn(found[1])
    count, quantities, scale = _joint_unit(lower)
    words = words[: len(words) - count]
    matches = [(at, _QUANTITY.fullmatch(word)) for at, word in enumerate(lowered(words))]
    at, match = next((one for one in reversed(matches) if one[1]), (0, None))
    if match is None:
        return _by_unit(words, quantities[0], scale) if count else _command_of(words)
    quantity = _QUANTITIES[match[1]]
    if quantity not in quantities or (not count and lower[-1] in LENGTHS):
        return UnusedColumn(
            f"its unit is not one of a joint's {quantity}; a height is called height_m"
        )
    if why := _no_joint(quantity, lowered((*words[:at], match[2], *words[at + 1 :]))):
        return why
    group, joint = _apart((*words[:at], *words[at + 1 :]))
    joint = tuple(word for word in joint if word.lower() not in (*MEASURED, *_ANGULAR))
    others = lowered((*words[:at], *words[at + 1 :]))
    is_command = not COMMANDED.isdisjoint(map(_without_digits, others))
    return _joint_column(group, joint, match[2], quantity, scale, is_command=is_command)


def _has_quantity(lower: Words) -> bool:
    """Return whether the words behind a controller tell a joint's quantity."""
    return any(map(_QUANTITY.fullmatch, lower[lower.index(_CONTROLLER) :]))


def _controlled(words: Words) -> JointColumn | UnusedColumn | None:
    """Interpret words as a list's place in the topic of a ROS controller; None if they are not.

    Such as /arm_controller/state/actual/positions[0]; /arm_position_controller/commands/data[0],
    whose quantity is the topic's, if any says it.
    """
    at = lowered(words).index(_CONTROLLER) + 1
    rest = [word for word in lowered(words[at:]) if word not in _OF_TOPICS]
    if len(rest) < 2 or not rest[-1].isdecimal():
        return None
    *said, number = rest
    is_command = not COMMANDED.isdisjoint(said)
    said = [word for word in said if word not in COMMANDED and word not in MEASURED]
    names = _QUANTITIES | _OF_FIELDS | {"positions": "position"}
    if said and said[-1] not in names:
        return None
    quantity = next((names[word] for word in said or lowered(words[:at]) if word in names), "")
    if len(said) > 1:  # its error or its output
        return UnusedColumn(f"it is the {said[0]} of the controller, no {quantity} of a joint")
    # "state" tells the states of a trajectory's controller from a trajectory
    group = "_".join(words[:at]) + "/state" * ("state" in lowered(words[at:]))
    return JointColumn(group, f"joint{number}", quantity, 1.0, number, is_command=is_command)


def _joint_column(
    group: str, joint: Words, digits: str, quantity: str, scale: float, *, is_command: bool
) -> JointColumn:
    """Make a column of the words of a joint's name, and of the digits behind its quantity."""
    if is_command:  # target2 is of joint 2
        tails = [word for word in joint if _without_digits(word).lower() in COMMANDED]
        digits = digits or next((one for word in tails if (one := _digits(word))), "")
        joint = tuple(word for word in joint if word not in tails)
    number = digits or next((word for word in joint[-1:] if word.isdecimal()), "")
    named = [word for word in joint if word.lower() not in _JOINT and not word.isdecimal()]
    if not named and number:
        label = f"joint{number}"
        return JointColumn(group, label, quantity, scale, number=number, is_command=is_command)
    label = "_".join(joint if named else ()) + digits
    label, is_bare = label or "joint1", not label
    return JointColumn(group, label, quantity, scale, is_bare=is_bare, is_command=is_command)


def _command_of(words: Words) -> JointColumn | None:
    """Interpret words as a joint's command that does not say its quantity; None if they are not."""
    group, joint = _apart(words)
    if COMMANDED.isdisjoint(map(_without_digits, lowered(joint))):
        return None
    if _NO_JOINTS.intersection(lowered(joint)) or not MODELLED.isdisjoint(lowered(joint)):
        return None
    return _joint_column(group, joint, "", "", 1.0, is_command=True)


def _by_unit(words: Words, quantity: str, scale: float) -> JointColumn | None:
    """Interpret words before a joint's unit that only say who says it: "Servo1 Actual (deg)"."""
    group, joint = _apart(words)
    is_command = not COMMANDED.isdisjoint(map(_without_digits, lowered(joint)))
    if MEASURED.isdisjoint(lowered(joint)) and not is_command:
        return None
    joint = tuple(word for word in joint if word.lower() not in MEASURED)
    return _joint_column(group, joint, "", quantity, scale, is_command=is_command)


def with_counterparts(meanings: Mapping[int, Meaning], names: Sequence[str]) -> dict[int, Meaning]:
    """Take what is called as a command is, without its words, for that joint's position.

    Such as `hip` or `actual_hip` beside `hip_cmd`.
    """
    found = dict(meanings)
    commands = {
        one.label: one.group
        for one in meanings.values()
        if isinstance(one, JointColumn) and one.is_command and not (one.quantity or one.is_bare)
    }
    for at, one in meanings.items() if commands else ():
        words = words_of(names[at], camel=False)
        joint = "_".join(word for word in words if word.lower() not in MEASURED)
        if one == UNKNOWN and joint in commands and _NOT_BARE.isdisjoint(lowered(words)):
            found[at] = JointColumn(commands[joint], joint, "position", 1.0)
    return found


def _without_digits(word: str) -> str:
    return word.rstrip("0123456789")


def _digits(word: str) -> str:
    return word[len(_without_digits(word)) :]


def _joint_unit(lower: Words) -> tuple[int, Sequence[str], float]:
    """Return how many words at the end are a joint's unit, which quantities have it, its size."""
    for count in (3, 2, 1):
        if len(lower) > count and lower[-count:] in _ANGULAR_UNITS:
            return count, *_ANGULAR_UNITS[lower[-count:]]
    return 0, tuple(JOINT_UNITS), 1.0


def states_angle(name: str) -> bool:
    """Return whether a joint column's name states its unit."""
    return without_joint_unit(name) is not None


def without_joint_unit(name: str) -> Words | None:
    """Return the words before a joint column's unit, numbers apart; None without a unit."""
    words = [word for word in lowered(words_of(name, camel=False)) if not word.isdecimal()]
    count = _joint_unit(tuple(words))[0]
    return tuple(words[:-count]) if count else None


def _no_joint(quantity: str, others: Words) -> UnusedColumn | None:
    """Return why a quantity with these words beside it is none of a joint, or only estimated."""
    bare = set(map(_without_digits, others))
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
    if lower[:2] == ("observation", "state"):  # of LeRobot's
        return "joints", words[2:]
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
_NEUTRAL = words_in(
    "joint joints axis j dof dofs arm robot state states filtered raw motor motors servo servos"
)
_SIDES = ("left", "right")  # of which arm a column is, where there are two
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
    """One quantity of all joints."""

    stem: str  # common part of its columns' names: "actual_q"
    side: str  # "left" or "right" of two arms; "" of one
    quantity: str  # "position", "velocity", "effort" or "current"
    origin: Origin  # where the values come from
    scale: float  # of the values, to rad, rad/s, N·m or A
    columns: Mapping[int, int]  # column index by joint number as in the names

    @property
    def is_command(self) -> bool:
        """Whether it is what was asked for, not what was measured."""
        return self.origin == Origin.COMMANDED

    @property
    def title(self) -> str:
        """Column range in words."""
        numbers = sorted(self.columns)
        return f"{self.stem} {numbers[0]} to {numbers[-1]}" if len(numbers) > 1 else self.stem


def joint_fields(names: Sequence[str]) -> tuple[JointField, ...]:
    """Find the joint fields among columns; of two columns of one name the first counts."""
    found: dict[tuple[str, str, str, Origin, float], dict[int, int]] = {}
    for at, name in enumerate(names):
        if (parsed := _parsed(name)) is not None:
            key, number = parsed
            found.setdefault(key, {}).setdefault(number, at)
    return tuple(JointField(*key, columns=columns) for key, columns in found.items())


def is_controllers(names: Sequence[str], fields: Iterable[JointField]) -> bool:
    """Return whether a controller wrote these names: measured beside other values, or q[0], ..."""
    several = [field for field in fields if len(field.columns) > 1 and field.quantity]
    return any(
        field.origin != Origin.PLAIN or any("[" in names[at] for at in field.columns.values())
        for field in several
    )


def with_franka_times(names: Sequence[str]) -> Sequence[str]:
    """Add the unit to libfranka's times, which are in ms without saying so."""
    words = [lowered(words_of(name, camel=False)) for name in names]
    if ("success", "rate") not in words or not joint_fields(names):
        return names
    is_time = [word in (("duration",), ("time",)) for word in words]
    return ["time (ms)" if one else name for one, name in zip(is_time, names, strict=True)]


def choose_fields(
    fields: Sequence[JointField],
) -> tuple[list[JointField], list[tuple[JointField, str]], Mapping[int, str]]:
    """Choose a measured and a commanded field per quantity, never a model's output.

    Return those, the others with the reason, and the joints' names by number.
    """
    used: list[JointField] = []
    unused: list[tuple[JointField, str]] = []
    for key in dict.fromkeys((one.side, one.quantity, one.is_command) for one in fields):
        ranked = sorted(
            (one for one in fields if (one.side, one.quantity, one.is_command) == key),
            key=lambda field: field.origin,
        )
        best = ranked[0]
        equals = [field for field in ranked if field.origin == best.origin]
        is_clear = len(equals) == 1 and best.origin <= Origin.COMMANDED and not _is_model(best)
        if not best.quantity:  # of the joints whose state is there
            is_clear = is_clear and any(
                one.columns.keys() == best.columns.keys() and one.quantity
                for one in fields
                if one.side == best.side and not one.is_command
            )
        if is_clear:
            used.append(best)
        unused += [(field, _reason(field, equals)) for field in ranked[is_clear:]]
    zero = any(0 in field.columns for field in fields)
    numbers = sorted({number for field in fields for number in field.columns})
    labels = {number: f"joint{number + zero}" for number in numbers}
    if any(field.stem == "actual_q" for field in fields) and numbers == list(range(6)):
        labels = dict(enumerate(_UR_JOINTS))
    return used, unused, labels


def _is_model(field: JointField) -> bool:
    """Return whether it is a torque that a controller computes, such as UR's target_moment."""
    return field.quantity == "effort" and "moment" in field.stem


def _reason(field: JointField, equals: Sequence[JointField]) -> str:
    """Return why a field is not used; `equals` share the best origin."""
    if _is_model(field):
        return "the controller's own model, with the payload that was set in it: no measurement"
    if not field.quantity and len(equals) == 1:
        return ASKED_OF_NONE
    if field.origin == Origin.MODELLED:
        return "the controller's estimate, not a measurement"
    if field in equals:
        others = " and ".join(one.stem for one in equals)
        if field.is_command:
            what = f"commanded {field.quantity}" if field.quantity else "command"
            return f"{others} may all be the {what}; leave out all but one"
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
    count, fitting, scale = _joint_unit(lower)
    lower = lower[: len(lower) - count]
    side = next((word for word in lower if word in _SIDES), "")
    meaning = _meaning([word for word in lower if word not in _SIDES])
    if meaning is None or (meaning[0] and meaning[0] not in fitting):
        return None
    return (stem, side, *meaning, scale), number


def _meaning(words: Sequence[str]) -> tuple[str, Origin] | None:
    """Return quantity and origin that words denote; None where one belongs to something else."""
    if (whole := _WHOLE.get(tuple(words))) is not None:
        return whole
    rest = [word for word in words if word not in _NEUTRAL]
    is_desired = len(rest) > 1 and rest[-1] == "d"
    rest = rest[: len(rest) - is_desired]
    known = {**_OF_FIELDS, **_QUANTITIES}
    known |= {f"{word}s": quantity for word, quantity in known.items()}
    quantities = [known[word] for word in rest if word in known]
    origins = [_ORIGINS[word] for word in rest if word in _ORIGINS]
    if len(quantities) + len(origins) != len(rest) or not rest:
        return None
    if not quantities:  # a command alone, such as action[0]
        return ("", Origin.COMMANDED) if set(origins) == {Origin.COMMANDED} else None
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


# ---- Units that a table states beside its names: in a row of them, or in its preamble.

# Words of other units, also of those that are not read: a row of them is no row of numbers.
_OTHER_UNITS = words_in(
    "rad radian radians deg degree degrees n nm mnm kn px pix pixel pixels um km dm ma yd min "
    "mins minute minutes h hr hour hours day days"
)
_NO_UNITS = frozenset(("", "-", "1"))  # cells of a row of units that say none
# A preamble's "Length Units,Millimeters" or "units: mm".
_SAID = re.compile(r"\b(length[ _])?units?\b\W{1,5}(\w+)", re.IGNORECASE)
_REMEDY = "convert it to m, cm, mm, in or ft (times: s, ms, us or ns)"  # of a unit that is not read


def with_row(
    header: Sequence[str], cells: Sequence[str], reading: Reading = by_name
) -> list[str] | None:
    """Add the units of a row below a header to its names; None where it is no row of units."""
    if any(map(str.strip, cells[len(header) :])):
        return None
    names = [name for _, name in runs_of(header)]
    said = {
        at: unit
        for at, (name, cell) in enumerate(zip(names, cells, strict=False))
        if (unit := cell.strip(" \t()[]")) not in _NO_UNITS and _size(reading(at, name)) is not None
    }
    texts = said.values()
    if any(map(str.isdecimal, "".join(texts))) or not any(map(_is_unit, texts)):
        return None
    return [
        _units_named(name, names[at], said[at], lambda text, at=at: reading(at, text))
        if at in said
        else name
        for at, name in enumerate(header)
    ]


def length_in(line: str) -> str:
    """Return the length unit that a line of a preamble states; "" where it states none."""
    for is_length, unit in _SAID.findall(line):
        if unit.lower() in LENGTHS:
            return unit
        if is_length:
            raise ValueError(f"lengths are in {unit[:40]!r}, which is not read; {_REMEDY}")
    return ""


def with_units(
    header: Sequence[str], unit_of: Callable[[Meaning], str], reading: Reading = by_name
) -> list[str]:
    """Add the units of their meanings ("" for none) to the names that state none."""
    units = (
        unit_of(reading(at, rest)) if _without_unit(rest) is None else ""
        for at, (_, rest) in enumerate(runs_of(header))
    )
    return [f"{name} ({unit})" if unit else name for name, unit in zip(header, units, strict=True)]


def unit_behind(name: str) -> str:
    """Return the unit at the end of a name, in brackets or as last word; "" for none."""
    found = re.search(r"[(\[]([^()\[\]]{1,40})[)\]]\s*$", name)
    words = lowered(words_of(found[1] if found else name, camel=False))
    if found:
        return found[1] if any(map(_is_unit_word, words)) or words in (("a",), ("ma",)) else ""
    return words[-1] if len(words) > 1 and _is_unit_word(words[-1]) else ""


def unit_alone(text: str) -> str | None:
    """Return the unit that a cell consists of, in brackets or not; None where it is no unit."""
    stripped = text.strip(" \t()[]")
    return stripped if stripped in _NO_UNITS or _is_unit(stripped) else None


def _is_unit_word(word: str) -> bool:
    return word in LENGTHS or word in POWERS or word in _OTHER_UNITS


def _is_unit(text: str) -> bool:
    words = lowered(words_of(text, camel=False))
    return bool(words) and all(map(_is_unit_word, words))


def _without_unit(name: str) -> str | None:
    """Strip a name of its unit; None where it has none."""
    words = words_of(name, camel=False)
    rest = list(words)
    while rest and _is_unit_word(rest[-1].lower()):
        rest.pop()
    return (" ".join(rest) or "time") if len(rest) < len(words) else None


def _units_named(name: str, plain: str, unit: str, reading: Callable[[str], Meaning]) -> str:
    """Return a column's name with its unit; `plain` is the name without its run."""
    rest = _without_unit(plain)
    meaning = reading(f"{rest or plain} ({unit})")
    if meaning == UNKNOWN:
        raise ValueError(f"{name[:60]!r} is in {unit[:40]!r}, which is not read; {_REMEDY}")
    if rest is None:
        return f"{name} ({unit})"
    if _size(meaning) != _size(reading(plain)):
        raise ValueError(f"{name[:60]!r} is said to be in {unit[:40]!r}; say one unit")
    return name


def _size(meaning: Meaning) -> float | None:
    """Return the size of a meaning's unit; None where it has no values."""
    if isinstance(meaning, TimeColumn):
        return meaning.power or 0
    if isinstance(meaning, JointColumn) and not meaning.quantity:
        return None
    return meaning.scale if isinstance(meaning, CoordinateColumn | JointColumn) else None


# ---- Columns that the user names with `--columns`.

CLOCKS = ("t", "frame", "times")  # targets that are times; one of them is enough
_UNSAID = UnusedColumn("--columns does not name it")  # the meaning of all others


def contradiction_of(columns: Mapping[str, str]) -> str:
    """Return why `--columns` contradicts itself; "" where it does not."""
    clocks = [one for one in CLOCKS if one in columns]
    if len(clocks) > 1:
        return f"--columns says {clocks[0]} and {clocks[1]}; say one of them"
    if "times" in columns and len(columns) > 1:
        return "--columns says times, which are impacts, and other columns; say times alone"
    return ""


def places_of(columns: Mapping[str, str], names: Sequence[str]) -> tuple[dict[int, str], list[str]]:
    """Find the user's columns in a table; return targets by index, and the missing ones."""
    found: dict[int, str] = {}
    missing: list[str] = []
    for target, place in columns.items():
        at = index_of(place, names)
        if at is None and re.fullmatch(r"[1-9]\d{0,3}", place, re.ASCII):
            at = int(place) - 1 if int(place) <= len(names) else None
        if at is None:
            missing.append(place)
        else:
            found[at] = target
    return found, missing


def index_of(place: str, names: Sequence[str]) -> int | None:
    """Return the index of the column of a name; None where there is none, or no single one."""
    place = place.strip()
    stripped = [name.strip() for name in names]
    if place in stripped:
        return stripped.index(place)
    dotted = [_dotted(name) for name in stripped]  # the third column of a list: ball[2], ball.2
    if dotted.count(_dotted(place)) == 1:
        return dotted.index(_dotted(place))
    folded, wanted = [name.casefold() for name in stripped], place.casefold()
    if wanted in folded:
        return folded.index(wanted)
    without = [re.sub(r"(?<!\s)\s*[(\[][^()\[\]]*[)\]]$", "", name) for name in folded]
    return without.index(wanted) if without.count(wanted) == 1 else None


def _dotted(name: str) -> str:
    return re.sub(r"[.\[(]\s*(\d+)\s*[\])]?$", r".\1", name).replace(" ", "").lower()


def said_reading(places: Mapping[int, str]) -> Reading:
    """Return the interpreter of columns that a user names, by index.

    A clock that is named excludes all other clocks; values that are named, all other values. The
    interpreter raises ValueError where a column's unit does not fit its target.
    """
    targets = set(places.values()) - {"object"}
    has_clock = not targets.isdisjoint(CLOCKS)
    has_values = "times" in targets or not targets.issubset(CLOCKS)

    def read(at: int, name: str) -> Meaning:
        if at in places:
            return _meaning_as(places[at], name)
        found = meaning_of(name)
        if isinstance(found, RunColumn) and found.kind != "run" and "object" in places.values():
            return _UNSAID
        if isinstance(found, RunColumn | UnusedColumn):
            return found
        is_clock = isinstance(found, TimeColumn | FrameColumn)
        return _UNSAID if (has_clock if is_clock else has_values) else found

    return read


def _meaning_as(target: str, name: str) -> Meaning:
    """Return the meaning of a column named as a target; its name may state the unit."""
    if target in ("frame", "object"):
        return FrameColumn() if target == "frame" else RunColumn("object")
    unit = unit_behind(name)
    if target in _AXES:
        found = meaning_of(f"{target} ({unit})" if unit else target)
        if isinstance(found, CoordinateColumn):
            return found
    elif target in ("t", "times"):
        found = meaning_of(f"t ({unit})" if unit else "t")
        own = meaning_of(name)
        if target == "times" and isinstance(own, FrameColumn):
            return ImpactColumn(0, counts_frames=True)
        if not unit and isinstance(own, TimeColumn):
            found = TimeColumn(own.power)
        if isinstance(found, TimeColumn):
            return ImpactColumn(found.power) if target == "times" else found
    else:
        quantity, _, number = target.partition("_")
        quantity += "_position" if quantity == "command" and unit else ""
        found = meaning_of(f"joint{number}_{quantity}" + (f" ({unit})" if unit else ""))
        if isinstance(found, JointColumn):
            return found
    raise ValueError(
        f"--columns says that {name[:60]!r} is {target}, but it is in {unit[:40]!r}, which is no "
        "unit of that; name another column"
    )


MAX_SHOWN = 8  # columns in a message
MAX_SHOWN_LENGTH = 30  # of a name in a message


def short_list(names: Sequence[str]) -> str:
    """List the first few names."""
    shown = [repr(name.strip()[:MAX_SHOWN_LENGTH]) for name in names if name.strip()]
    more = f", ... ({len(shown)} in all)" if len(shown) > MAX_SHOWN else ""
    return ", ".join(shown[:MAX_SHOWN]) + more


def reasons_of(unused: Mapping[str, str]) -> str:
    """List the first few reasons why columns are not used, each with its columns."""
    names: dict[str, list[str]] = {}
    for name, why in unused.items():
        if name.strip():
            names.setdefault(why, []).append(name)
    return "; ".join(f"{short_list(some)}: {why}" for why, some in list(names.items())[:4])


# ---- Lists: a column of two or three values is a place, others are joints.

# What people call quantities of a ball: an array of two or three columns is no arm's.
_OF_JOINTS = words_in("joint joints dof dofs motor motors servo servos")
_OF_A_THING = {"pos", "position", "positions", "vel", "velocity", "velocities", "speed"}


def spread_names(name: str, width: int) -> tuple[list[str], list[str]]:
    """Name the columns of a list: their own names, and the names to interpret."""
    own = [f"{name}[{at}]" for at in range(width)]
    words = words_of(name, camel=False)
    lower = lowered(words)
    is_place = bool(_OF_A_THING.intersection(lower)) and _OF_JOINTS.isdisjoint(lower)
    is_command = not _COMMAND_LISTS.isdisjoint(lower)
    has_joints = is_command or any(one.quantity for one in joint_fields(own))
    if width not in (2, 3) or (has_joints and not is_place):
        return own, own
    bare = name
    unit = ""
    if len(words) > 1 and words[-1].lower() in LENGTHS:
        bare, unit = "_".join(words[:-1]), f" ({words[-1]})"
    if isinstance(meaning_of(f"{bare.lower().removesuffix('s')} x"), UnusedColumn):
        bare = bare.lower().removesuffix("s")  # "forces" are no more places than a force
    return own, [f"{bare} {axis}{unit}" for axis in "xyz"[:width]]
