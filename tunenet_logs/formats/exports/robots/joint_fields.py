"""Classify an arm's joint columns as measured, commanded or model-based."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

from tunenet_logs.formats.tables.column_names import (
    COMMANDED,
    JOINT_QUANTITIES,
    JOINT_UNITS,
    MEASURED,
    MODELLED,
)
from tunenet_logs.formats.tables.meaning import Words, lowered, words_of


class Origin(IntEnum):
    """Origin of values, best first."""

    MEASURED = 0
    PLAIN = 1
    COMMANDED = 2
    MODELLED = 3


# Words that say it.
_ORIGINS = {
    **dict.fromkeys((*MEASURED, "sensor", "sensed", "encoder"), Origin.MEASURED),
    **dict.fromkeys(COMMANDED, Origin.COMMANDED),
    **dict.fromkeys(MODELLED, Origin.MODELLED),
}

# Words of what a column holds.
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

# Words that say no more than that it is an arm's.
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
