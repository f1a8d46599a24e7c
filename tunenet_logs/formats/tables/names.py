"""What the name of one column means."""

from __future__ import annotations

from tunenet_logs.formats.tables.joint_names import joint_of
from tunenet_logs.formats.tables.meaning import (
    POWERS,
    Meaning,
    Time,
    Unused,
    Words,
    lowered,
    words_of,
)
from tunenet_logs.formats.tables.place_names import place_of

_TIMES = frozenset(("time", "times", "stamp", "timestamp", "elapsed", "rosbagtimestamp"))
_NO_TIMES = frozenset(("delta", "diff", "step"))
_SECONDS = frozenset(("sec", "secs", "second", "seconds"))
_IN_NS = frozenset((("rosbag", "timestamp"), ("rosbagtimestamp",), ("field", "header", "stamp")))
"""What `rostopic echo -p` and its kin write in ns, however small."""

UNKNOWN = Unused("its name says no time, position (x, y, z, height) or joint torque")


def meaning_of(name: str) -> Meaning:
    """What a column's name means."""
    for camel in (False, True):  # a joint called LeftKnee is to keep its name
        words = words_of(name, camel=camel)
        if not words:
            break
        found = _time(name, lowered(words)) or place_of(lowered(words)) or joint_of(words)
        if found is not None:
            return found
    return UNKNOWN


def _time(name: str, lower: Words) -> Time | None:
    power = POWERS.get(lower[-1])
    bare = lower if power is None else lower[:-1]
    if not bare:  # "s" is an arc's length more often
        return None if lower == ("s",) else Time(power, part=_part(lower[-1]))
    if _NO_TIMES.intersection(bare) or (bare != ("t",) and bare[-1] not in _TIMES):
        return None
    if power is None and (name.strip().startswith("%time") or lower in _IN_NS):
        power = -9
    scope = bare[: bare.index("header")] if "header" in bare else bare[:-1]
    return Time(power, scope, "header" in bare, _part(lower[-1]))


def _part(word: str) -> str:
    if word in _SECONDS:
        return "sec"
    return "nanosec" if POWERS.get(word) == -9 else ""
