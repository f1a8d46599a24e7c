"""Reading options: what a user states of a file that is silent or ambiguous about it."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tunenet_logs.console import CheckedOptions, add_options, given, option
from tunenet_logs.errors import UsageError
from tunenet_logs.formats.columns.angles import angle_unit
from tunenet_logs.formats.columns.names import LENGTHS

# Where a column of `--columns` begins, and what it is; a column's own name may hold commas.
_ASSIGNMENT = re.compile(
    r"(?:^|,)\s*(t|frame|times|object|x|y|z"
    r"|(?P<of_joint>position|velocity|effort|current|command)(?P<joint>_[1-9]\d{0,2})?)\s*="
)
_OF_JOINTS = re.compile(r"([1-9]\d{0,3}):([1-9]\d{0,3})", re.ASCII)  # columns of joints 1, 2, ...
COLUMNS_EXAMPLE = (
    "t=Zeit,z='Height (cm)', or by number from 1: t=1,z=2; of joints: t=1,position=2:7; of a log: "
    "z=/ball.z"
)


def columns_of(text: str) -> dict[str, str]:
    """Parse the value of `--columns`; raise UsageError."""
    marks = list(_ASSIGNMENT.finditer(text))
    if not marks or text[: marks[0].start()].strip():
        raise UsageError(f"--columns {text[:60]!r} says no column; write {COLUMNS_EXAMPLE}")
    ends = [mark.start() for mark in marks[1:]] + [len(text)]
    found: dict[str, str] = {}
    for mark, end in zip(marks, ends, strict=True):
        name = text[mark.end() : end].strip().strip("'\"")
        if not name:
            raise UsageError(f"--columns: {mark[1]} is no column; write {COLUMNS_EXAMPLE}")
        is_range = mark["of_joint"] is not None and mark["joint"] is None
        for target, column in (_spread(mark[1], name) if is_range else {mark[1]: name}).items():
            if target in found:
                raise UsageError(f"--columns says twice what {target} is; say it once")
            found[target] = column
    return found


def _spread(target: str, name: str) -> dict[str, str]:
    """Return the columns of joints 1, 2, ..., from the first to the last number."""
    ends = _OF_JOINTS.fullmatch(name)
    numbers = range(int(ends[1]), int(ends[2]) + 1) if ends else range(0)
    if not 0 < len(numbers) < 1000:
        raise UsageError(
            f"--columns: {target}={name[:40]} names no joints; write {target}_1=COLUMN for one, or "
            f"{target}=2:7 for joints 1 to 6 in columns 2 to 7"
        )
    return {f"{target}_{joint}": str(number) for joint, number in enumerate(numbers, 1)}


def _length_unit(text: str) -> str:
    if text not in ("", *LENGTHS, "px"):
        raise UsageError(f"--length-unit {text[:20]!r} is not known; write m, cm, mm, in, ft or px")
    return text


def constants_of(given: str | float | Sequence[float]) -> tuple[float, ...]:
    """Parse torque constants [N·m/A], joint by joint; raise UsageError."""
    parts = given.split(",") if isinstance(given, str) else given
    try:
        values = tuple(map(float, parts if isinstance(parts, Sequence) else (parts,)))
    except ValueError:
        values = (math.nan,)
    if not all(0 < abs(value) < 1e6 for value in values):
        shown = str(given)[:40]
        raise UsageError(
            f"--torque-constants {shown!r} are no numbers; write them as 10.5,10.5,8.1"
        )
    return values


@dataclass(frozen=True)
class ReadOptions(CheckedOptions):
    """What a file does not state itself: which column is which, its rate [Hz], its units."""

    # Python gives columns as a mapping and constants as numbers, or both as the command line does.

    columns: Mapping[str, str] = option(
        "which column is which: t (time), frame, x, y, z, times (of impacts), "
        "object, position_1, velocity_1, effort_1, current_1, command_1, ...; a column by its "
        "name, or by its number from 1, joints in a row as position=2:7; of a log TOPIC.FIELD, as "
        "z=/vicon/ball.z_trans",
        dict,
        group="files",
        metavar="NAME=COLUMN,...",
        parse=columns_of,
    )
    fps: float | None = option(
        "frames a second, of a file that counts frames and says no times",
        group="files",
        metavar="RATE",
        limits=(1e-3, 1e7, "a second"),
    )
    length_unit: str = option(
        "of positions: m, cm, mm, in, ft or px",
        "",
        group="files",
        subject="lengths",
        metavar="UNIT",
        parse=_length_unit,
    )
    angle_unit: str = option(
        "of joints, where the file states none: rad, deg, turn, percent (of the range, -100 to "
        "100), ticks (4096 a turn, 0 at 2048) or ticks:PER_TURN:ZERO",
        "",
        group="files",
        subject="joints",
        metavar="UNIT",
        parse=angle_unit,
    )
    torque_constants: tuple[float, ...] = option(
        "torque at the joint for each A of its motor's current [N·m/A], joint by joint, or one for "
        "all",
        (),
        group="files",
        subject="arm",
        metavar="K1,K2,...",
        parse=constants_of,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "torque_constants", constants_of(self.torque_constants))

    @property
    def length_m(self) -> float | None:
        """Size of the stated length unit [m]; None where there is none, or pixels."""
        return LENGTHS.get(self.length_unit)


AS_IT_SAYS = ReadOptions()  # nothing said


def reading_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what a file does not say itself."""
    group = parser.add_argument_group("what a file does not say itself")
    add_options(ReadOptions, lambda _: group)


def read_options_of(arguments: argparse.Namespace) -> ReadOptions:
    """Return the options that the arguments of `reading_options` give; raise UsageError."""
    return ReadOptions(**given(arguments, ReadOptions))
