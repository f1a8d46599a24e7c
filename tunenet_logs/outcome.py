"""Outcome of one attempt at a task by the hardware, and its file."""

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from tunenet_logs import __version__, messages
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.errors import LogError
from tunenet_logs.messages import INFO_RECORD, OUTCOME_TOPIC, TASK_OUTCOME
from tunenet_logs.output.log_place import not_writable
from tunenet_logs.output.new_file import write_new

BOUNCE_SHOT = "bounce-shot"  # the task where none is said
MAX_ATTEMPTS = 1_000_000  # of a ball at a task; what lies beyond is a number misread
MAX_LETTERS = 1000  # of a text of an outcome
_MAX_FILES = 1000  # outcomes of one ball, attempt and millisecond; so many names are tried
LAST_NS = 2**31 * 1_000_000_000 - 1  # the last time that a ROS header holds: in the year 2038


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One attempt; None and "" where something is not known.

    Attributes:
        task: such as "bounce-shot".
        ball: its name; what is counted together.
        attempt: of this ball, from 1.
        success: whether the task was done.
        stamp_ns: when [ns since 1970]; 0 where not known.
        shot_height_m: release height above the impact point [m].
        miss_m: how far from the goal's centre it came down; negative where it was short of it,
            positive beyond it [m].
        tuned_parameter: coefficient of restitution that the shot was planned with.
        drop_log: the log of the drop that it was tuned from, as a path or a name.
        tuning: the JSON of that tuning, as a path or a name.
        reason: why it failed, in a word or two.
        note: anything else.
        is_counted: no number of the attempt was written; it was counted in its table.

    Raises:
        ValueError: a number or a text is none that an outcome may have.
    """

    task: str
    ball: str
    attempt: int
    success: bool
    stamp_ns: int = 0
    shot_height_m: float | None = None
    miss_m: float | None = None
    tuned_parameter: float | None = None
    drop_log: str = ""
    tuning: str = ""
    reason: str = ""
    note: str = ""
    is_counted: bool = field(default=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("task", "ball"):
            if not getattr(self, name).strip():
                raise ValueError(f"{name} is empty")
        for name in ("task", "ball", "drop_log", "tuning", "reason", "note"):
            if len(getattr(self, name)) > MAX_LETTERS:
                raise ValueError(f"{name} is over {MAX_LETTERS} letters long")
        if not 1 <= self.attempt <= MAX_ATTEMPTS:
            raise ValueError(f"attempt {self.attempt} is not from 1 to {MAX_ATTEMPTS}")
        if not 0 <= self.stamp_ns <= LAST_NS:
            raise ValueError(f"its time, {self.stamp_ns} ns, lies outside 1970 to 2038")
        for name in ("shot_height_m", "miss_m", "tuned_parameter"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise ValueError(f"{name} is {value}")

    @property
    def word(self) -> str:
        """Result as commands and tables print it."""
        return "success" if self.success else "failure"

    @property
    def name(self) -> str:
        """Ball and attempt in words."""
        return f"{self.ball}, attempt {self.attempt}"


def to_message(outcome: Outcome) -> Any:
    """Convert an outcome to a TaskOutcome message."""
    return messages.typestore().types[TASK_OUTCOME](
        header=messages.header(outcome.stamp_ns, ""),
        task=outcome.task,
        ball=outcome.ball,
        attempt=outcome.attempt,
        success=outcome.success,
        shot_height=_or_nan(outcome.shot_height_m),
        miss_distance=_or_nan(outcome.miss_m),
        tuned_parameter=_or_nan(outcome.tuned_parameter),
        drop_log=outcome.drop_log,
        tuning=outcome.tuning,
        reason=outcome.reason,
        note=outcome.note,
    )


def from_message(message: Any) -> Outcome:
    """Convert a TaskOutcome of any encoding to an outcome.

    Raises:
        ValueError: it holds something that no outcome does.
    """
    stamp = message.header.stamp
    return Outcome(
        task=message.task,
        ball=message.ball,
        attempt=int(message.attempt),
        success=bool(message.success),
        stamp_ns=int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec),
        shot_height_m=_or_none(message.shot_height),
        miss_m=_or_none(message.miss_distance),
        tuned_parameter=_or_none(message.tuned_parameter),
        drop_log=message.drop_log,
        tuning=message.tuning,
        reason=message.reason,
        note=message.note,
    )


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _or_none(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def write_outcome(folder: Path, outcome: Outcome) -> Path:
    """Write one outcome to a file of its own in a campaign's folder, made if need be.

    The file is there whole, and on the disk, or not at all, even if this is killed at any moment.
    Names (`outcome_TIME_BALL_ATTEMPT.mcap`) sort by time; none that is there is ever written over,
    so several may record at once.

    Raises:
        LogError: it cannot be written; nothing of it is left.
    """
    data = outcome_bytes(outcome)
    stem = _stem(outcome)
    path = folder / f"{stem}.mcap"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for number in range(2, _MAX_FILES):
            try:
                write_new(path, data)
            except FileExistsError:
                path = folder / f"{stem}_{number}.mcap"
            else:
                return path
    except OSError as error:
        raise not_writable(path, error) from error
    raise LogError(f"{path}: there are {_MAX_FILES} of that name; record to another folder")


def outcome_bytes(outcome: Outcome) -> bytes:
    """Encode an outcome as a log of its own; equal outcomes give equal bytes."""
    file = io.BytesIO()
    writer = Writer(file, compression=CompressionType.ZSTD, enable_data_crcs=True)
    writer.start(profile="ros2", library=f"tunenet-logs {__version__}")
    info = EpisodeInfo(kind="outcome", source="tunenet-record --outcome")
    writer.add_metadata(INFO_RECORD, info.to_strings())
    schema = writer.register_schema(
        TASK_OUTCOME, "ros2msg", messages.definition(TASK_OUTCOME).encode()
    )
    channel = writer.register_channel(OUTCOME_TOPIC, "cdr", schema)
    writer.add_message(
        channel,
        outcome.stamp_ns,
        messages.encode(to_message(outcome), TASK_OUTCOME),
        outcome.stamp_ns,
    )
    writer.finish()
    return file.getvalue()


def _stem(outcome: Outcome) -> str:
    """Return a file name by time, ball and attempt that any file system takes."""
    when = datetime.fromtimestamp(outcome.stamp_ns // 1_000_000_000, UTC)
    milliseconds = outcome.stamp_ns // 1_000_000 % 1000
    ball = re.sub(r"[^a-z0-9]+", "-", outcome.ball.lower()).strip("-")[:40] or "ball"
    return f"outcome_{when:%Y%m%dT%H%M%S}.{milliseconds:03d}Z_{ball}_{outcome.attempt:03d}"
