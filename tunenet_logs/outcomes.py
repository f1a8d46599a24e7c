"""Outcomes: what the hardware did in each attempt at a task.

An outcome is a log of its own that `tunenet-record --outcome` writes (`write_outcome`), or a line
of a table that people keep (`read_outcome_table`). `read_outcomes` takes a log, a folder of logs or
a table.
"""

from __future__ import annotations

import io
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from mcap.writer import CompressionType, Writer

from tunenet_logs import __version__, messages
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.errors import CHECK_DISK, LogError
from tunenet_logs.files import open_regular
from tunenet_logs.formats.base import (
    DAMAGED,
    Budget,
    Container,
    Decode,
    Loss,
    MessageError,
    OverBudgetError,
    RawChannel,
    RawMessage,
    UnusableError,
    described,
    one_by_one,
    type_key,
)
from tunenet_logs.formats.columns.cells import (
    SEPARATORS,
    SUFFIXES,
    Numbers,
    cells_of,
    is_table,
    lines_of,
)
from tunenet_logs.formats.decoders import listed_type
from tunenet_logs.formats.mcap import MAGIC, channels_of_summary
from tunenet_logs.formats.registry import is_folder, open_log
from tunenet_logs.messages import INFO_RECORD, OUTCOME_TOPIC, TASK_OUTCOME
from tunenet_logs.terminal import listed, short_name
from tunenet_logs.writing.owned_path import not_writable, write_new

BOUNCE_SHOT = "bounce-shot"  # the task where none is said
MAX_ATTEMPTS = 1_000_000  # of a ball at a task; what lies beyond is a number misread
MAX_LETTERS = 1000  # of a text of an outcome
LAST_NS = 2**31 * 1_000_000_000 - 1  # the last time that a ROS header holds: in the year 2038


def _named(*columns: str, message: str = "", default: Any = None) -> Any:
    """Declare a field that is called otherwise in tables, any case, or in messages."""
    return field(default=default, metadata={"columns": columns, "message": message})


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One attempt; None and "" where something is not known."""

    task: str  # such as "bounce-shot"
    ball: str  # its name; what is counted together
    attempt: int = _named("attempt", "trial", default=MISSING)  # of this ball, from 1
    # whether the task was done
    success: bool = _named("success", "outcome", "result", default=MISSING)
    # when [ns since 1970]; 0 where not known
    stamp_ns: int = _named("time", "date", "stamp", default=0)
    # release height above the impact point [m]
    shot_height_m: float | None = _named("shot_height_m", "shot_height", message="shot_height")
    # how far from the goal's centre it came down; negative where it was short of it, positive
    # beyond it [m]
    miss_m: float | None = _named(
        "miss_m", "miss", "miss_distance_m", "miss_distance", message="miss_distance"
    )
    # coefficient of restitution that the shot was planned with
    tuned_parameter: float | None = _named("tuned_parameter", "restitution")
    # the log of the drop that it was tuned from, as a path or a name
    drop_log: str = _named("drop_log", "log", default="")
    tuning: str = ""  # the JSON of that tuning, as a path or a name
    reason: str = ""  # why it failed, in a word or two
    note: str = _named("note", "notes", "comment", default="")  # anything else
    # no number of the attempt was written; it was counted in its table
    is_counted: bool = field(default=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("task", "ball"):
            if not getattr(self, name).strip():
                raise ValueError(f"{name} is empty")
        for name in _TEXTS:
            if len(getattr(self, name)) > MAX_LETTERS:
                raise ValueError(f"{name} is over {MAX_LETTERS} letters long")
        if not 1 <= self.attempt <= MAX_ATTEMPTS:
            raise ValueError(f"attempt {self.attempt} is not from 1 to {MAX_ATTEMPTS}")
        if not 0 <= self.stamp_ns <= LAST_NS:
            raise ValueError(f"its time, {self.stamp_ns} ns, lies outside 1970 to 2038")
        for name in _NUMBERS:
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


_SAID = tuple(one for one in fields(Outcome) if one.name != "is_counted")
_TEXTS = tuple(one.name for one in _SAID if one.type == "str")
_NUMBERS = tuple(one.name for one in _SAID if one.type == "float | None")  # NaN in messages
# Each field's columns in a table; and its name in messages, beside their header's stamp.
_NAMES = {one.name: one.metadata.get("columns", (one.name,)) for one in _SAID}
_IN_MESSAGE = {one.name: one.metadata.get("message") or one.name for one in _SAID}
del _IN_MESSAGE["stamp_ns"]


def to_message(outcome: Outcome) -> Any:
    """Convert an outcome to a TaskOutcome message."""
    values = {said: getattr(outcome, name) for name, said in _IN_MESSAGE.items()}
    for name in _NUMBERS:
        value = values[_IN_MESSAGE[name]]
        values[_IN_MESSAGE[name]] = math.nan if value is None else float(value)
    header = messages.header(outcome.stamp_ns, "")
    return messages.typestore().types[TASK_OUTCOME](header=header, **values)


def from_message(message: Any) -> Outcome:
    """Convert a TaskOutcome of any encoding to an outcome."""
    stamp = message.header.stamp
    values = {name: getattr(message, said) for name, said in _IN_MESSAGE.items()}
    values["attempt"], values["success"] = int(values["attempt"]), bool(values["success"])
    for name in _NUMBERS:
        value = values[name]
        values[name] = None if value is None or not math.isfinite(value) else float(value)
    return Outcome(stamp_ns=int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec), **values)


def write_outcome(folder: Path, outcome: Outcome) -> Path:
    """Write one outcome to a new file in a campaign's folder, made if need be, whole or not at all.

    Names (`outcome_TIME_BALL_ATTEMPT.mcap`) sort by time; none that is there is ever written over.
    """
    data = outcome_bytes(outcome)
    # By time, ball and attempt, in letters that any file system takes.
    when = datetime.fromtimestamp(outcome.stamp_ns // 1_000_000_000, UTC)
    milliseconds = outcome.stamp_ns // 1_000_000 % 1000
    ball = re.sub(r"[^a-z0-9]+", "-", outcome.ball.lower()).strip("-")[:40] or "ball"
    stem = f"outcome_{when:%Y%m%dT%H%M%S}.{milliseconds:03d}Z_{ball}_{outcome.attempt:03d}"
    path = folder / f"{stem}.mcap"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for number in range(2, 1000):
            try:
                write_new(path, data)
            except FileExistsError:
                path = folder / f"{stem}_{number}.mcap"
            else:
                return path
    except OSError as error:
        raise not_writable(path, error) from error
    raise LogError(f"{path}: there are 1000 of that name; record to another folder")


def outcome_bytes(outcome: Outcome) -> bytes:
    """Encode an outcome as a log of its own; equal outcomes give equal bytes."""
    file = io.BytesIO()
    writer = Writer(file, compression=CompressionType.ZSTD, enable_data_crcs=True)
    writer.start(profile="ros2", library=f"tunenet-logs {__version__}")
    info = EpisodeInfo(kind="outcome", source="tunenet-record --outcome")
    writer.add_metadata(INFO_RECORD, info.to_strings())
    definition = messages.definition(TASK_OUTCOME).encode()
    schema = writer.register_schema(TASK_OUTCOME, "ros2msg", definition)
    channel = writer.register_channel(OUTCOME_TOPIC, "cdr", schema)
    data = messages.encode(to_message(outcome), TASK_OUTCOME)
    writer.add_message(channel, outcome.stamp_ns, data, outcome.stamp_ns)
    writer.finish()
    return file.getvalue()


# ---- Table: a line each, the columns by their names

_NEEDED = ("ball", "success")  # columns without which a table holds no outcomes
# How people write that an attempt succeeded, in small letters.
_WORDS = {
    **dict.fromkeys(("1", "true", "yes", "y", "success", "ok", "hit"), True),
    **dict.fromkeys(("0", "false", "no", "n", "failure", "fail", "miss"), False),
}


def read_outcome_table(path: Path) -> tuple[Outcome, ...]:
    """Read the outcomes of a table, in its order; its columns are those of `Outcome`'s fields.

    Ball and success must be there; attempts are counted by task and ball where they are not.
    """
    lines = _lines(path)
    try:
        _, header = next(lines, (0, None))
        if header is None:
            raise LogError(f"{path}: is empty; put a line with the names of the columns on top")
        columns = _columns(header)
        for name in _NEEDED:
            if name not in columns.indices:
                there = listed(map(short_name, columns.names))
                raise LogError(
                    f"{path}: has no column {name!r} (there are: {there}); name the columns in the "
                    f"first line: {','.join(_NAMES)}".replace("stamp_ns", "time")
                )
        table = _Table(path, columns)
        return tuple(table.outcome(number, line) for number, line in lines)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the numbered lines that are not empty; comments (#) stand before the header."""
    is_row = False
    for number, line in enumerate(lines_of(path), 1):
        if line is None:
            raise LogError(f"{path}: line {number} is too long for a table; split it")
        if line.strip() and (is_row or not line.startswith("#")):
            is_row = True
            yield number, line


class _Columns(NamedTuple):
    """Index of each field's column, and what separates the cells."""

    indices: Mapping[str, int]
    separator: str | None
    names: tuple[str, ...]


def _columns(line: str) -> _Columns:
    """Parse a header by the separator that yields the most known names."""
    read: list[_Columns] = []
    for separator in filter(None, SEPARATORS):
        names = tuple(name.strip() for name in cells_of(line, separator))
        lowered = [name.lower().replace(" ", "_") for name in names]
        indices = {
            field: lowered.index(name)
            for field, known in _NAMES.items()
            for name in known[::-1]
            if name in lowered
        }
        read.append(_Columns(indices, separator, names))
    return max(read, key=lambda columns: len(columns.indices))


class _Table:
    """Rows of one table."""

    def __init__(self, path: Path, columns: _Columns) -> None:
        self._path = path
        self._columns = columns
        self._numbers = Numbers(columns.separator)
        self._counts: Counter[tuple[str, str]] = Counter()

    def outcome(self, number: int, line: str) -> Outcome:
        cells = [cell.strip() for cell in cells_of(line, self._columns.separator)]
        if len(cells) > len(self._columns.names):
            raise LogError(
                f"{self._path}: line {number} has {len(cells)} cells under "
                f"{len(self._columns.names)} names; put a text with a separator into quotes"
            )
        texts = {
            field: cells[index] if index < len(cells) else ""
            for field, index in self._columns.indices.items()
        }
        values = {field: self._value(number, field, text) for field, text in texts.items()}
        values["task"] = values.get("task") or BOUNCE_SHOT
        values["is_counted"] = not values.get("attempt")
        kind = values["task"], values["ball"]
        self._counts[kind] = values.get("attempt") or self._counts[kind] + 1
        values["attempt"] = self._counts[kind]
        try:
            return Outcome(**values)
        except ValueError as error:
            raise LogError(f"{self._path}: line {number}: {error}; correct that line") from error

    def _value(self, number: int, field: str, text: str) -> Any:
        """Convert a cell to its value."""
        if field == "success":
            found = _WORDS.get(text.lower())
            if found is None:
                self._refuse(number, "success", text, "write success or failure")
            return found
        if field == "stamp_ns":
            try:
                return stamp_ns(text) if text else 0
            except ValueError:
                self._refuse(number, field, text, "write it as 2026-11-22 14:30, or nothing")
        if field == "attempt":
            value = self._number(number, "attempt", text) or 0
            if value != int(value) or value < 0:
                self._refuse(number, "attempt", text, "write 1, 2, 3, ..., or nothing")
            return int(value)
        if field in _NUMBERS:
            return self._number(number, field, text)
        return text

    def _number(self, number: int, field: str, text: str) -> float | None:
        try:
            value = self._numbers.read(text)
        except ValueError as error:
            self._refuse(number, field, text, "write a number, or nothing", str(error))
        return None if math.isnan(value) else value

    def _refuse(self, number: int, field: str, text: str, remedy: str, why: str = "") -> NoReturn:
        name = self._columns.names[self._columns.indices[field]]
        reason = why or "cannot be read"
        raise LogError(
            f"{self._path}: line {number}, column {name!r}: {short_name(text)!r} {reason}; {remedy}"
        )


def stamp_ns(text: str) -> int:
    """Parse a time as people write it (2026-11-22 14:30, local without a zone) [ns since 1970]."""
    try:
        when = datetime.fromisoformat(text.strip()).astimezone()
    except OverflowError as error:
        raise ValueError("it lies beyond all clocks") from error
    microseconds = round(when.timestamp() * 1e6)
    if microseconds < 0:
        raise ValueError("it lies before 1970")
    return microseconds * 1000


# ---- Reading: a log, a folder of logs, or a table

Warn = Callable[[str], None]  # takes a warning, a sentence without its end


def _refuse(text: str) -> NoReturn:
    raise LogError(text)


def read_outcomes(path: Path, warn: Warn = _refuse) -> tuple[Outcome, ...]:
    """Read the outcomes in a log, a folder of logs, or a table, in the order of their times.

    Messages of a log are in CDR or JSON. `warn` is told what is damaged, and outcomes that make no
    sense, which are left out; without it they are a LogError.
    """
    if is_folder(path) and not (path / "metadata.yaml").exists():
        files = outcome_files(path, warn)
        found = numbered(outcome for file in files for outcome in _of_file(file, warn))
    else:
        found = list(_of_file(path, warn))
    if not found:
        raise LogError(f"{path}: holds no outcome; record one with tunenet-record --outcome")
    return tuple(sorted(found, key=lambda outcome: (outcome.stamp_ns, outcome.attempt)))


def numbered(outcomes: Iterable[Outcome]) -> list[Outcome]:
    """Give outcomes without a written number one that no other of task and ball has."""
    every = list(outcomes)
    taken = {(one.task, one.ball, one.attempt) for one in every if not one.is_counted}
    following: dict[tuple[str, str], int] = {}
    for index, outcome in enumerate(every):
        if not outcome.is_counted:
            continue
        kind = (outcome.task, outcome.ball)
        number = max(outcome.attempt, following.get(kind, 1))
        while (*kind, number) in taken:
            number += 1
        if number > MAX_ATTEMPTS:
            raise LogError(
                f"{outcome.ball}: over {MAX_ATTEMPTS} attempts; write their numbers down"
            )
        following[kind] = number + 1
        every[index] = replace(outcome, attempt=number)
    return every


def outcome_files(folder: Path, warn: Warn = _refuse) -> list[Path]:
    """List the files of a folder, not of those in it, that hold outcomes."""
    found: list[Path] = []
    for file in sorted(folder.iterdir()):
        if file.suffix.lower() not in (".mcap", *SUFFIXES) or not file.is_file():
            continue
        try:
            found += [file] if holds_outcomes(file) else []
        except LogError as error:
            warn(str(error))
    return found


def holds_outcomes(file: Path) -> bool:
    """Check whether a file holds outcomes, without reading its messages."""
    try:
        if is_table(file):
            header = next((_columns(line) for _, line in _lines(file)), None)
            return header is not None and all(name in header.indices for name in _NEEDED)
        with open_regular(file) as opened:
            if opened.read(len(MAGIC)) != MAGIC:
                return False
            size = file.stat().st_size
            channels = channels_of_summary(opened, size, Budget(size))
    except OverBudgetError:  # its end is damaged: it has to be read to know
        return True
    except OSError as error:
        raise LogError(f"{file}: cannot be read ({error.strerror})", CHECK_DISK) from error
    return not channels or any(map(_is_outcome, channels.values()))


def _is_outcome(channel: RawChannel) -> bool:
    return type_key(channel.type_name) == TASK_OUTCOME


def _of_file(path: Path, warn: Warn) -> Iterator[Outcome]:
    if path.is_file() and is_table(path):
        yield from read_outcome_table(path)
        return
    found = open_log(path)
    if not callable(found):
        raise LogError(f"{path}: holds no outcome, but a recording; name it as one of drops")
    yield from _of_log(path, found, warn)


def _of_log(path: Path, container: Container, warn: Warn) -> Iterator[Outcome]:
    losses: list[Loss] = []
    decoders: dict[RawChannel, Decode | None] = {}
    channels: list[RawChannel] = []
    try:
        for record in one_by_one(container(path, losses)):
            if isinstance(record, RawChannel):
                channels.append(record)
            elif isinstance(record, RawMessage) and _is_outcome(record.channel):
                channel = record.channel
                if channel not in decoders:
                    decoders[channel] = None
                    try:
                        decoders[channel] = listed_type(channel).decode
                    except UnusableError as reason:
                        warn(f"{path}: the outcomes of {channel.topic} are not read: {reason}")
                if decode := decoders[channel]:
                    try:
                        yield from_message(decode(record.data))
                    except (MessageError, *DAMAGED) as error:
                        warn(f"{path}: an outcome was left out: {described(error)}")
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error
    if channels and not any(map(_is_outcome, channels)):
        return  # what is damaged is a recording of something else
    for loss in losses:
        if not loss.harmless:
            warn(f"{path}: {loss}; save what is whole with tunenet-logs recover")
