"""What a user says of a file that does not say it itself, or not in words that are known."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypedDict

from tunenet_logs.errors import UsageError
from tunenet_logs.formats.tables.meaning import LENGTHS

_TARGETS = r"(?:t|frame|times|object|x|y|z|(?:position|velocity|effort|current)_[1-9]\d{0,2})"
"""What a column can be said to be."""

_ASSIGNMENT = re.compile(rf"(?:^|,)\s*({_TARGETS})\s*=")
"""Where the next one of `--columns` begins: a column's own name may hold commas."""

COLUMNS_EXAMPLE = "t=Zeit,z='Height (cm)', or by number from 1: t=1,z=2; of a log: z=/ball.z"
"""What `--columns` takes, for messages."""


RATES_HZ = (1e-3, 1e7)
"""Least and greatest rate of frames that may be said."""

_LARGEST_CONSTANT = 1e6


class ReadingOptions(TypedDict, total=False):
    """What may be said of a file that does not say it itself.

    Attributes:
        columns: which column is which, as `{"t": "Zeit", "z": "Hoehe (cm)"}` or
            `"t=Zeit,z=Hoehe (cm)"`.
        fps: frames a second, of a file that counts frames and says no times.
        length_unit: of positions: "m", "cm", "mm", "in", "ft" or "px".
        torque_constants: torque at the joint for each A of its motor's current [N·m/A], joint by
            joint, or one number for all.
    """

    columns: str | Mapping[str, str] | None
    fps: float | None
    length_unit: str | None
    torque_constants: str | float | Sequence[float] | None


@dataclass(frozen=True)
class ReadOptions:
    """What a user says of a file.

    Attributes:
        columns: which column or field (TOPIC.FIELD.FIELD of a log) is which: "t", "frame", "times"
            (impact times), "object" (of which thing a row of a table is), "x", "y", "z",
            "position_1", "velocity_1", "effort_1", "current_1", ...
        rate_hz: frames a second, of files that count frames.
        length_unit: of positions, one of `LENGTHS` or "px"; "" to go by the file.
        torque_constants: N·m for each A of a motor's current, joint by joint.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    rate_hz: float | None = None
    length_unit: str = ""
    torque_constants: tuple[float, ...] = ()

    @property
    def length_m(self) -> float | None:
        """Metres in the unit that was said; None where none was, or pixels."""
        return LENGTHS.get(self.length_unit)

    @property
    def given(self) -> tuple[str, ...]:
        """The options given, as a user names them."""
        plain = AS_IT_SAYS
        return tuple(
            name for name, field in FIELDS.items() if getattr(self, field) != getattr(plain, field)
        )


AS_IT_SAYS = ReadOptions()
"""Nothing said."""

FIELDS = {
    "--columns": "columns",
    "--fps": "rate_hz",
    "--length-unit": "length_unit",
    "--torque-constants": "torque_constants",
}
"""Of `ReadOptions`, by the options that users know."""


def columns_of(text: str) -> dict[str, str]:
    """`--columns` taken apart.

    Raises:
        UsageError: it is not like `COLUMNS_EXAMPLE`, or says one thing twice.
    """
    marks = list(_ASSIGNMENT.finditer(text))
    if not marks or text[: marks[0].start()].strip():
        raise UsageError(f"--columns {text[:60]!r} says no column; write {COLUMNS_EXAMPLE}")
    ends = [mark.start() for mark in marks[1:]] + [len(text)]
    found: dict[str, str] = {}
    for mark, end in zip(marks, ends, strict=True):
        name = text[mark.end() : end].strip().strip("'\"")
        if not name:
            raise UsageError(f"--columns: {mark[1]} is no column; write {COLUMNS_EXAMPLE}")
        if mark[1] in found:
            raise UsageError(f"--columns says twice what {mark[1]} is; say it once")
        found[mark[1]] = name
    return found


def reading_of(given: ReadingOptions) -> ReadOptions:
    """What is said of a file, checked; what is missing or None is not said.

    Raises:
        UsageError: a value that makes no sense.
    """
    columns, unit, rate_hz = (given.get(name) for name in ("columns", "length_unit", "fps"))
    if unit and unit not in (*LENGTHS, "px"):
        raise UsageError(f"--length-unit {unit[:20]!r} is not known; write m, cm, mm, in, ft or px")
    if rate_hz is not None and not RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
        raise UsageError(f"--fps {rate_hz!r} is no rate; write frames a second, such as 240")
    columns = columns_of(columns) if isinstance(columns, str) else dict(columns or {})
    return ReadOptions(columns, rate_hz, unit or "", _constants(given.get("torque_constants")))


def _constants(given: str | float | Sequence[float] | None) -> tuple[float, ...]:
    """Torque for each A of a current [N·m/A], joint by joint."""
    if given is None:
        return ()
    parts = given.split(",") if isinstance(given, str) else given
    try:
        values = tuple(map(float, parts if isinstance(parts, Sequence) else (parts,)))
    except ValueError:
        values = (math.nan,)
    if not all(0 < abs(value) < _LARGEST_CONSTANT for value in values):
        shown = str(given)[:40]
        raise UsageError(
            f"--torque-constants {shown!r} are no numbers; write them as 10.5,10.5,8.1"
        )
    return values
