"""Tell the unit of joint angles that a file does not state: by the user, or by the values.

A servo's encoder has so many ticks a turn, so its angles lie on a lattice. In degrees or radians
all joints share its step; in per cent of a calibrated range each joint has its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tunenet_logs.errors import UsageError

if TYPE_CHECKING:
    from tunenet_logs.episode import Array

PERCENT = "%"  # unit of a position: -100 and 100 are the ends of the joint's range


@dataclass(frozen=True)
class AngleUnit:
    """A unit of joint positions: `scale` times what exceeds `zero` is a position in `unit`."""

    words: str  # what it is called
    scale: float
    zero: float = 0.0
    unit: str = "rad"

    @property
    def speed_scale(self) -> float | None:
        """Scale of speeds to rad/s; None where positions do not tell their unit."""
        return self.scale if self.unit == "rad" and not self.words.startswith("ticks") else None


_TICKS = 4096  # of a turn: of Feetech's STS and Dynamixel's X, MX and P series
_NAMED = {
    "rad": AngleUnit("rad", 1.0),
    "deg": AngleUnit("degrees", math.pi / 180),
    "turn": AngleUnit("turns", math.tau),
    "percent": AngleUnit("per cent of the range", 1.0, unit=PERCENT),
}
# A gripper's per cent begin at 0, as LeRobot writes them.
_OF_GRIPPER = AngleUnit("per cent of the range", 2.0, 50.0, PERCENT)
_GRIPPERS = ("gripper", "jaw", "finger", "claw")
# Of whole numbers that are no radians: which unit they are in, the user has to say.
UNTOLD = AngleUnit("an unknown unit", 1.0, unit="")
REMEDY = "say --angle-unit rad, deg, percent or ticks"


def angle_unit(text: str) -> str:
    """Check a unit of angles that a user names; UsageError if it is none."""
    if text:
        _ = unit_of(text)
    return text


def unit_of(text: str) -> AngleUnit:
    """Return the unit of that name: a name, or `ticks[:PER_TURN[:ZERO]]`; UsageError."""
    if text in _NAMED:
        return _NAMED[text]
    kind, *numbers = text.split(":")
    try:
        values = [float(one) for one in numbers]
    except ValueError:
        values = [math.nan]
    is_sound = all(math.isfinite(one) and abs(one) < 1e9 for one in values)
    if kind == "ticks" and len(values) < 3 and is_sound and (not values or values[0] > 0):
        per_turn = values[0] if values else _TICKS
        zero = values[1] if len(values) > 1 else per_turn / 2
        return AngleUnit(f"ticks of {per_turn:g} a turn", math.tau / per_turn, zero)
    raise UsageError(
        f"--angle-unit {text[:30]!r} is not known; write rad, deg, turn, percent, ticks or "
        "ticks:PER_TURN:ZERO, such as ticks:1024:512"
    )


def is_gripper(name: str) -> bool:
    """Return whether a joint is called like a gripper."""
    return any(word in name.lower() for word in _GRIPPERS)


def of_joint(unit: AngleUnit, name: str) -> AngleUnit:
    """Return a joint's unit: per cent of a gripper begin at 0, those of others in the middle."""
    return _OF_GRIPPER if unit.unit == PERCENT and is_gripper(name) else unit


# ---- By the values: which lattice they lie on.

SHOWING = 50_000  # samples of a joint that are looked at, the first ones
_MIN_PLACES = 20  # different values of a joint that shows its lattice
# Of a step: how far values may lie from the lattice (singles of LeRobot have 24 bits).
_OFF = 0.04
# A turn in steps: LeRobot divides by the largest reading, not by the number of readings.
_TURNS = (4096, 4095)


def told_by_values(names: Sequence[str], columns: Iterable[Array]) -> AngleUnit | None:
    """Find the unit by the lattice of positions, (T,) each, of named joints; None if none shows.

    Degrees and radians: every joint that moves lies on one lattice, of 1/4096 turn. Per cent: each
    lies on its own, within -100 to 100, whose step is that of some calibrated range.
    """
    import numpy as np

    found: list[Array] = []
    for name, values in zip(names, columns, strict=True):
        some = np.asarray(values[:SHOWING], np.float64)
        places = np.unique(some[np.isfinite(some)])
        if len(places) >= _MIN_PLACES and not is_gripper(name):
            found.append(places)
    if not found:
        return None
    if all(np.all(places == np.round(places)) for places in found):
        return None  # of whole numbers nothing is told
    for unit in (_NAMED["deg"], _NAMED["rad"]):
        steps = [math.tau / unit.scale / turn for turn in _TURNS]
        if any(all(_lies_on(places, step) for places in found) for step in steps):
            return unit
    if len(found) < 2 or max(np.abs(places).max() for places in found) > 100.0 + 1e-3:
        return None
    own = [_own_step(places) for places in found]
    # Of ranges from a twentieth of a turn to a whole one, and not all equal.
    are_ranges = all(0.99 * 200 / _TICKS <= step <= 20 * 200 / _TICKS for step in own)
    return _NAMED["percent"] if are_ranges and max(own) > 1.01 * min(own) else None


def _lies_on(places: Array, step: float) -> bool:
    """Return whether sorted values, (N,), lie on a lattice of a step, and not on a coarser one."""
    import numpy as np

    counts = (places - places[0]) / step
    off = np.abs(counts - np.round(counts))
    return bool(off.max() < max(_OFF, 2e-7 * np.abs(places).max() / step))


def _own_step(places: Array) -> float:
    """Return the step of the lattice of sorted values, (N,); 0 where they lie on none."""
    import numpy as np

    steps = np.diff(places)
    step, far = float(steps[steps > 1e-4].min(initial=np.inf)), places - places[0]
    # The step from near values first, then from ever farther ones: the counts stay exact.
    for reach in (10, 100, 1000, np.inf):
        near = far[far <= reach * step]
        counts = np.round(near / step)
        if len(near) > 1 and counts[-1] > 0:
            step = float(counts @ near / (counts @ counts))
    return step if math.isfinite(step) and _lies_on(places, step) else 0.0
