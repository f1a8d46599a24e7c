"""Write and read a record's contribution of sound as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from analysis.motion import SoundShare


def sound_fields(sound: SoundShare) -> dict[str, Any]:
    """Return the key `sound` of a record."""
    return {
        "impacts": sound.impacts,
        "heard": sound.heard,
        "offset_s": sound.offset_s,
        "used": sound.used,
        "reason": sound.reason or None,
        "without": {"restitution": sound.restitution, "interval95": sound.interval95},
    }


def read_sound(fields: Mapping[str, Any]) -> SoundShare:
    """Parse what `sound_fields` wrote.

    Raises:
        ValueError, TypeError, LookupError: A value is invalid.
    """
    offset_s, without = fields["offset_s"], fields["without"]
    low, high = without["interval95"]
    numbers = [float(without["restitution"]), float(low), float(high)]
    numbers += [] if offset_s is None else [float(offset_s)]
    if not all(map(math.isfinite, numbers)):
        raise ValueError("a number of its sound is not finite")
    reason = str(fields["reason"] or "")
    if bool(fields["used"]) != (offset_s is not None) or bool(reason) == bool(fields["used"]):
        raise ValueError("its sound is used and is not")
    return SoundShare(
        int(fields["impacts"]),
        int(fields["heard"]),
        None if offset_s is None else numbers[3],
        reason,
        numbers[0],
        (numbers[1], numbers[2]),
    )
