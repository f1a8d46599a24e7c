"""Names of columns that hold torques, positions or velocities of joints."""

from __future__ import annotations

import math
import re

from tunenet_logs.formats.tables.meaning import (
    LENGTHS,
    JointName,
    JointValue,
    Unused,
    Words,
    lowered,
)

_QUANTITY = re.compile(
    r"(effort|torque|tau|position|pos|angle|theta|qdot|qd|dq|q|velocity|vel)s?(\d*)"
)
_QUANTITIES = {
    **dict.fromkeys(("effort", "torque", "tau"), "effort"),
    **dict.fromkeys(("position", "pos", "angle", "theta", "q"), "position"),
    **dict.fromkeys(("velocity", "vel", "qdot", "qd", "dq"), "velocity"),
}
_TURNS = ("position", "velocity")
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


def joint_of(words: Words) -> JointValue | JointName | Unused | None:
    """What the words of a name say of a joint; None if nothing."""
    lower = lowered(words)
    if found := re.fullmatch(r"field name(\d+)", " ".join(lower)):
        return JointName(found[1])
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
        return Unused(f"its unit is not one of a joint's {quantity}; a height is called height_m")
    group, joint = _apart((*words[:at], *words[at + 1 :]))
    digits = match[2] or "".join(word for word in joint[-1:] if word.isdecimal())
    named = [word for word in joint if word.lower() != "joint" and not word.isdecimal()]
    if not named and digits:
        return JointValue(group, f"joint{digits}", quantity, scale, number=digits)
    label = "_".join(joint) + match[2]
    return JointValue(group, label or "joint1", quantity, scale, is_bare=not label)


def _apart(words: Words) -> tuple[str, Words]:
    """The robot and the joint, of the words without the quantity."""
    lower = lowered(words)
    for at in range(1, len(words)):
        if lower[at - 1] == "joint" and lower[at] in ("state", "states"):
            return "_".join(words[: at - 1]) or "joints", words[at + 1 :]
    return "joints", words[1:] if lower[:1] == ("field",) else words
