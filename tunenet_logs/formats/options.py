"""Reading options: what a user states of a file that is silent or ambiguous about it."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypedDict

from tunenet_logs.console import number
from tunenet_logs.errors import UsageError
from tunenet_logs.formats.columns.names import LENGTHS

# What a column can be said to be.
_TARGETS = r"(?:t|frame|times|object|x|y|z|(?:position|velocity|effort|current)_[1-9]\d{0,2})"

# Where the next one of `--columns` begins: a column's own name may hold commas.
_ASSIGNMENT = re.compile(rf"(?:^|,)\s*({_TARGETS})\s*=")

# What `--columns` takes, for messages.
COLUMNS_EXAMPLE = "t=Zeit,z='Height (cm)', or by number from 1: t=1,z=2; of a log: z=/ball.z"

RATES_HZ = (1e-3, 1e7)  # least and greatest frame rate that may be stated
_MAX_CONSTANT = 1e6  # [N·m/A]


class ReadingOptions(TypedDict, total=False):
    """Reading options for a file that is silent or ambiguous about its columns, rate or units.

    Attributes:
        columns: which column is which, as `{"t": "Zeit", "z": "Hoehe (cm)"}` or
            `"t=Zeit,z=Hoehe (cm)"`.
        fps: frame rate [Hz] of a file that counts frames and has no times.
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
    """Validated reading options of a file.

    Attributes:
        columns: which column or field (TOPIC.FIELD.FIELD of a log) is which: "t", "frame", "times"
            (impact times), "object" (identifies a table row's object), "x", "y", "z",
            "position_1", "velocity_1", "effort_1", "current_1", ...
        rate_hz: frame rate of files that count frames.
        length_unit: of positions, one of `LENGTHS` or "px"; "" to go by the file.
        torque_constants: N·m for each A of a motor's current, joint by joint.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    rate_hz: float | None = None
    length_unit: str = ""
    torque_constants: tuple[float, ...] = ()

    @property
    def length_m(self) -> float | None:
        """Size of the stated length unit [m]; None where there is none, or pixels."""
        return LENGTHS.get(self.length_unit)

    @property
    def given(self) -> tuple[str, ...]:
        """Options given, as a user names them."""
        plain = AS_IT_SAYS
        return tuple(
            name for name, field in FIELDS.items() if getattr(self, field) != getattr(plain, field)
        )


AS_IT_SAYS = ReadOptions()  # nothing said
# Of `ReadOptions`, by the options that users know.
FIELDS = {
    "--columns": "columns",
    "--fps": "rate_hz",
    "--length-unit": "length_unit",
    "--torque-constants": "torque_constants",
}


def columns_of(text: str) -> dict[str, str]:
    """Parse the value of `--columns`.

    Raises:
        UsageError: it is not like `COLUMNS_EXAMPLE`, or has a target twice.
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
    """Validate reading options; those missing or None are unset.

    Raises:
        UsageError: a value is out of range or of an unknown unit.
    """
    columns, unit, rate_hz = (given.get(name) for name in ("columns", "length_unit", "fps"))
    if unit and unit not in (*LENGTHS, "px"):
        raise UsageError(f"--length-unit {unit[:20]!r} is not known; write m, cm, mm, in, ft or px")
    if rate_hz is not None and not RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
        raise UsageError(f"--fps {rate_hz!r} is no rate; write frames a second, such as 240")
    columns = columns_of(columns) if isinstance(columns, str) else dict(columns or {})
    return ReadOptions(columns, rate_hz, unit or "", _constants(given.get("torque_constants")))


def _constants(given: str | float | Sequence[float] | None) -> tuple[float, ...]:
    """Parse torque constants [N·m/A], joint by joint."""
    if given is None:
        return ()
    parts = given.split(",") if isinstance(given, str) else given
    try:
        values = tuple(map(float, parts if isinstance(parts, Sequence) else (parts,)))
    except ValueError:
        values = (math.nan,)
    if not all(0 < abs(value) < _MAX_CONSTANT for value in values):
        shown = str(given)[:40]
        raise UsageError(
            f"--torque-constants {shown!r} are no numbers; write them as 10.5,10.5,8.1"
        )
    return values


def reading_options(group: argparse._ArgumentGroup) -> None:
    """Add the options that say what a file does not say itself."""
    add = group.add_argument
    add(
        "--columns",
        metavar="NAME=COLUMN,...",
        help="which column is which: t (time), frame, x, y, z, times (of impacts), "
        "object, position_1, velocity_1, effort_1, current_1, ...; a column by its name, or by its "
        "number from 1; of a log TOPIC.FIELD, as z=/vicon/ball.z_trans",
    )
    add(
        "--fps",
        type=number(1e-3, 1e7, "a second"),
        metavar="RATE",
        help="frames a second, of a file that counts frames and says no times",
    )
    add("--length-unit", metavar="UNIT", help="of positions: m, cm, mm, in, ft or px")
    add(
        "--torque-constants",
        metavar="K1,K2,...",
        help="torque at the joint for each A of its motor's current [N·m/A], joint by joint",
    )


def read_options_of(arguments: argparse.Namespace) -> ReadOptions:
    """Return the `ReadOptions` that the arguments of `reading_options` give.

    Raises:
        UsageError: one is not understood.
    """
    return reading_of(
        {
            "columns": arguments.columns,
            "fps": arguments.fps,
            "length_unit": arguments.length_unit,
            "torque_constants": arguments.torque_constants,
        }
    )
