"""What a user says of a file that does not say it itself, or not in words that are known."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from tunenet_logs.errors import UsageError
from tunenet_logs.formats.tables.meaning import LENGTHS

_TARGETS = r"(?:t|frame|times|x|y|z|(?:position|velocity|effort|current)_[1-9]\d{0,2})"
"""What a column can be said to be."""

_ASSIGNMENT = re.compile(rf"(?:^|,)\s*({_TARGETS})\s*=")
"""Where the next one of `--columns` begins: a column's own name may hold commas."""

COLUMNS_EXAMPLE = "t=Zeit,z='Height (cm)', or by number from 1: t=1,z=2; of a log: z=/ball.z"
"""What `--columns` takes, for messages."""


@dataclass(frozen=True)
class ReadOptions:
    """What a user says of a file.

    Attributes:
        columns: which column or field (TOPIC.FIELD.FIELD of a log) is which: "t", "frame", "times"
            (impact times), "x", "y", "z", "position_1", "velocity_1", "effort_1", "current_1", ...
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
        named = {
            "--columns": bool(self.columns),
            "--fps": self.rate_hz is not None,
            "--length-unit": bool(self.length_unit),
            "--torque-constants": bool(self.torque_constants),
        }
        return tuple(name for name, is_given in named.items() if is_given)


AS_IT_SAYS = ReadOptions()
"""Nothing said."""


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
