"""Count the samples of a log that are left out, by reason, and bound how many may be.

Whoever leaves samples out counts them by the reason, beside those that remain; a tuning, a check
and an import say the same of them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import NamedTuple

from tunenet_logs.episode import Channel, Episode, Signal

MAX_LEFT_OUT = 0.02  # of all samples of a signal: beyond it what remains is not taken for the whole
# In the record of a recovered log: what of the damaged one it does not hold, of 1.
SHARE_NOTE = "lost_share"

BY_CLOCK = "by a clock that was set"
SAME_STAMP = "with the stamp of another sample"
DAMAGED_MESSAGES = "in damaged messages"
NOT_READ = "in messages that are not read"
UNREADABLE = "in rows that cannot be read"
INCOMPLETE = "without all coordinates"
IMPLAUSIBLE = "beyond what anything measures"
LOST = "in damaged places"
NOT_LATER = "not later than the one before"


class LeftOut(NamedTuple):
    """Number of samples left out of a signal or topic, by reason.

    Attributes:
        name: of a signal, or of a topic of pictures or sound.
        used: samples that remain.
        by_reason: the others.
    """

    name: str
    used: int
    by_reason: Mapping[str, int]

    @classmethod
    def of_signal(cls, signal: Signal) -> LeftOut:
        """Return what is left out of a signal."""
        return cls(signal.name, len(signal.stamps_ns), signal.left_out)

    @classmethod
    def of_channel(cls, channel: Channel) -> LeftOut:
        """Return what is left out of a channel of pictures or sound."""
        inside = channel.left_out.get(BY_CLOCK, 0)  # the others are no messages
        return cls(channel.topic, channel.messages - inside, channel.left_out)

    @property
    def share(self) -> float:
        """Fraction of all samples."""
        count = sum(self.by_reason.values())
        return count / (count + self.used) if count else 0.0

    @property
    def is_much(self) -> bool:
        """Whether too much is missing for what remains to be taken for the whole."""
        return self.share > MAX_LEFT_OUT

    def __str__(self) -> str:
        count = sum(self.by_reason.values())
        reasons = sorted(self.by_reason.items(), key=lambda reason: -reason[1])
        why = ", ".join(f"{number} {reason}" for reason, number in reasons if number)
        return f"{self.name}: {count} of {count + self.used} samples are left out ({why})"


def left_out_of(episode: Episode) -> list[LeftOut]:
    """List the signals and channels of an episode that lack samples."""
    channels = (one for one in episode.channels if (one.pictures or one.sounds) and not one.skipped)
    found = [LeftOut.of_signal(signal) for signal in episode.signals.values()]
    found += [LeftOut.of_channel(channel) for channel in channels]
    return [one for one in found if one.share]


def added(known: Mapping[str, int], more: Mapping[str, int]) -> dict[str, int]:
    """Add two counts by reason, without reasons that leave nothing out."""
    counts = {reason: known.get(reason, 0) + more.get(reason, 0) for reason in (*known, *more)}
    return {reason: count for reason, count in counts.items() if count}


def in_proportion(samples: int, lost: float, read: float) -> int:
    """Estimate the number of missing samples from the lost share of messages, rows or bytes."""
    return round(samples * lost / read) if read > 0 else 0


def as_note(by_reason: Mapping[str, int]) -> str:
    """Serialise the counts for a log's info record."""
    return json.dumps(dict(by_reason))


def of_note(text: str) -> dict[str, int]:
    """Parse such counts; what is none is left out."""
    try:
        found = json.loads(text) if len(text) < 1000 else None
    except (ValueError, RecursionError):
        return {}
    if not isinstance(found, dict):
        return {}
    counts = {key: one for key, one in found.items() if type(one) is int and 0 < one < 2**53}
    return {str(key): one for key, one in counts.items()}


def share_of_note(values: Mapping[str, str]) -> float:
    """Return the share of a log that was lost before its copy was recovered."""
    try:
        share = float(values.get(SHARE_NOTE, "0"))
    except ValueError:
        return 0.0
    return share if 0 < share < 1 else 0.0
