"""Parse signal names of logs, and match them with a model's names."""

from __future__ import annotations

import re
from collections.abc import Sequence

# In a topic's name: what somebody wants, not what is.
_COMMANDS = re.compile(r"command|cmd|target|desired|reference|setpoint|goal|trajectory", re.I)

# In the last part of a topic's name: what is, whatever the parts before it say.
_STATES = re.compile(r"state|measured|actual|feedback", re.I)

_QUANTITIES = ("position", "velocity", "effort")
_PARTS = (*_QUANTITIES, "orientation", "force", "torque")  # how the signals of one topic end


def topic_of(signal: str) -> str:
    """Return the topic of a signal, or what a pose is of: without the signal's quantity."""
    topic, _, last = signal.rpartition(".")
    return topic if last in _PARTS else signal


def quantity_of(signal: str) -> str:
    """Return which joint quantity a signal is; "" if it is none."""
    last = signal.rpartition(".")[2]
    return last if last in _QUANTITIES else ""


def is_wanted(topic: str) -> bool:
    """Return whether a topic is a command rather than a state: by its last part, then by all."""
    last = topic.rpartition("/")[2]
    if _COMMANDS.search(last):
        return True
    return not _STATES.search(last) and _COMMANDS.search(topic) is not None


def named_as(name: str, names: Sequence[str]) -> str | None:
    """Match a name but for prefix, case and marks; None if ambiguous."""
    if name and name in names:
        return name
    for plain in (_plain, _plain_last):
        wanted = plain(name)
        found = [one for one in names if one and plain(one) == wanted]
        if wanted and found:
            return found[0] if len(found) == 1 else None
    return None


def words_of(name: str) -> list[str]:
    """List candidates of a body's name in a signal's: frame, topic parts, words; last first."""
    frames = name.split(".")
    tails = [".".join(frames[place:]) for place in range(1, min(len(frames), 9))]
    return [*tails, *reversed(name.split("/")), *reversed(re.split(r"[/.@]", name))]


def _plain(name: str) -> str:
    """Remove case and marks: `Elbow-Joint` and `elbow_joint` are one."""
    return re.sub(r"[\W_]", "", name).lower()


def _plain_last(name: str) -> str:
    """Remove the prefix too: `robot/elbow` and `elbow` are one."""
    return _plain(name.rpartition("/")[2])
