"""Read the outcomes of a campaign from a log, a folder of logs, or a table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

from tunenet_logs.errors import CHECK_DISK, LogError
from tunenet_logs.formats.base import (
    DAMAGED,
    Container,
    Decode,
    Loss,
    MessageError,
    RawChannel,
    RawMessage,
    UnusableError,
    described,
    one_by_one,
)
from tunenet_logs.formats.budget import Budget, OverBudgetError
from tunenet_logs.formats.mcap_container import MAGIC as MCAP_MAGIC
from tunenet_logs.formats.mcap_parts import channels_of_summary
from tunenet_logs.formats.message_types import type_key
from tunenet_logs.formats.registry import decoder_for, is_folder, open_log
from tunenet_logs.formats.tables.lines import SUFFIXES, is_table
from tunenet_logs.messages import TASK_OUTCOME
from tunenet_logs.outcome import MAX_ATTEMPTS, Outcome, from_message
from tunenet_logs.outcome_table import is_outcome_table, read_outcome_table
from tunenet_logs.regular_file import open_regular

Warn = Callable[[str], None]  # takes a warning, a sentence without its end


def _refuse(text: str) -> NoReturn:
    raise LogError(text)


def read_outcomes(path: Path, warn: Warn = _refuse) -> tuple[Outcome, ...]:
    """Read the outcomes in a log, a folder of logs, or a table, in the order of their times.

    Args:
        path: an MCAP file with messages of tunenet_msgs/msg/TaskOutcome, in CDR or JSON,
            one or many; a folder with such files, where others are passed over; or a CSV whose
            columns are named task, ball, attempt, success, ...
        warn: called with what is damaged, and with outcomes that make no sense; they are left
            out.

    Raises:
        LogError: there is no such file, it holds no outcome, or a line of a table is wrong; and,
            without `warn`, anything that it would be called with.
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
    """Give outcomes without a written number one that no other of task and ball has.

    Raises:
        LogError: there is none left.
    """
    every = list(outcomes)
    taken = {
        (outcome.task, outcome.ball, outcome.attempt) for outcome in every if not outcome.is_counted
    }
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
    """List the files of a folder that hold outcomes, by their first and last bytes.

    Args:
        folder: those in it are not gone through.
        warn: called with what cannot be read.

    Raises:
        LogError: without `warn`, anything that it would be called with.
    """
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
    """Check whether a file holds outcomes, without reading its messages.

    A log whose end is damaged may hold some; it has to be read to know.

    Raises:
        LogError: it cannot be read.
    """
    try:
        if is_table(file):
            return is_outcome_table(file)
        with open_regular(file) as opened:
            if opened.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                return False
            size = file.stat().st_size
            channels = channels_of_summary(opened, size, Budget(size))
    except OverBudgetError:
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
                if record.channel not in decoders:
                    decoders[record.channel] = _decoder(path, record.channel, warn)
                decode = decoders[record.channel]
                if decode is not None:
                    yield from _decoded(path, decode, record.data, warn)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error
    if channels and not any(map(_is_outcome, channels)):
        return  # what is damaged is a recording of something else
    for loss in losses:
        if not loss.harmless:
            warn(f"{path}: {loss}; save what is whole with tunenet-logs recover")


def _decoder(path: Path, channel: RawChannel, warn: Warn) -> Decode | None:
    try:
        return decoder_for(channel)
    except UnusableError as reason:
        warn(f"{path}: the outcomes of {channel.topic} are not read: {reason}")
        return None


def _decoded(path: Path, decode: Decode, data: bytes | memoryview, warn: Warn) -> Iterator[Outcome]:
    try:
        yield from_message(decode(data))
    except (MessageError, *DAMAGED) as error:
        warn(f"{path}: an outcome was left out: {described(error)}")
