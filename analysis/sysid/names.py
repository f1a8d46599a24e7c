"""Names in logs: which topic and quantity a signal is, and which of a model's names it means."""

from __future__ import annotations

import re
from collections.abc import Sequence

_COMMANDS = re.compile(r"command|cmd|target|desired|reference|setpoint|goal|trajectory", re.I)
"""In a topic's name: what somebody wants, not what is."""

_STATES = re.compile(r"state|measured|actual|feedback", re.I)
"""In the last part of a topic's name: what is, whatever the parts before it say."""

_QUANTITIES = ("position", "velocity", "effort")
_PARTS = (*_QUANTITIES, "orientation", "force", "torque")
"""How the signals of one topic end."""


def topic_of(signal: str) -> str:
    """The topic of a signal, or what a pose is of: without the signal's quantity."""
    topic, _, last = signal.rpartition(".")
    return topic if last in _PARTS else signal


def quantity_of(signal: str) -> str:
    """What of joints a signal is; "" where it is none."""
    last = signal.rpartition(".")[2]
    return last if last in _QUANTITIES else ""


def is_wanted(topic: str) -> bool:
    """Whether a topic says what somebody wants, not what is: by its last part, then by all."""
    last = topic.rpartition("/")[2]
    if _COMMANDS.search(last):
        return True
    return not _STATES.search(last) and _COMMANDS.search(topic) is not None


def named_as(name: str, names: Sequence[str]) -> str | None:
    """The one name that is this but for prefix, case and marks; None where there are several."""
    if name and name in names:
        return name
    for plain in (_plain, _plain_last):
        wanted = plain(name)
        found = [one for one in names if one and plain(one) == wanted]
        if wanted and found:
            return found[0] if len(found) == 1 else None
    return None


def words_of(name: str) -> list[str]:
    """What a body's name may be in a signal's: a frame, a part of the topic, a word; last first."""
    frames = name.split(".")
    tails = [".".join(frames[place:]) for place in range(1, min(len(frames), 9))]
    return [*tails, *reversed(name.split("/")), *reversed(re.split(r"[/.@]", name))]


def _plain(name: str) -> str:
    """A name without case and marks: `Elbow-Joint` and `elbow_joint` are one."""
    return re.sub(r"[\W_]", "", name).lower()


def _plain_last(name: str) -> str:
    """Likewise without its prefix: `robot/elbow` and `elbow` are one."""
    return _plain(name.rpartition("/")[2])
