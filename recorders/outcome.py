"""Options of `tunenet-record --outcome`, and the recording they ask for."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.console import given, option, printable
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.files import parse_json, read_small_file, real_path
from tunenet_logs.recorders.orders import OfBall
from tunenet_logs.terminal import one_line, short_name

if TYPE_CHECKING:
    from tunenet_logs.outcomes import Outcome

_TASK = "bounce-shot"  # of an outcome whose task is not given: the one task that is simulated here
_MAX_LETTERS = 1000  # of a text or path: it is one line of a table later
_text = printable(_MAX_LETTERS, "a line")


def _time(text: str) -> int:
    from tunenet_logs.outcomes import LAST_NS, stamp_ns

    try:
        if (stamp := stamp_ns(text)) <= LAST_NS:
            return stamp
    except ValueError as error:
        now = time.strftime("%Y-%m-%d %H:%M")
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is no time, such as '{now}'") from error
    raise argparse.ArgumentTypeError(f"{text[:40]!r} is beyond 2038, the last year of a ROS time")


_of_outcome = partial(option, group="outcome")


@dataclass(frozen=True, kw_only=True)
class OutcomeOptions(OfBall):
    """What became of an attempt."""

    task: str | None = _of_outcome(
        f"what was tried (default: {_TASK})", metavar="NAME", parse=_text
    )
    attempt: int | None = _of_outcome(
        "of this ball (default: the next one in the campaign)",
        metavar="N",
        limits=(1, 1_000_000, ""),
        is_whole=True,
    )
    shot_height_m: float | None = _of_outcome(
        "what the ball was let go from, above the impact point [m]", limits=(0, 100, "m")
    )
    miss_m: float | None = _of_outcome(
        "how far from the goal's centre it came down; short of it is negative, beyond it "
        "positive [m]",
        limits=(-100, 100, "m"),
    )
    reason: str = _of_outcome(
        "why it failed, such as short or rim", "", metavar="WORDS", parse=_text
    )
    note: str = _of_outcome("anything else", "", metavar="TEXT", parse=_text)
    drop_log: Path | None = _of_outcome(
        "the drop that it was tuned from", metavar="LOG", parse=Path
    )
    tuning: Path | None = _of_outcome(
        "what tunenet-tune wrote of that drop; says the restitution and the log, too",
        metavar="JSON",
        parse=Path,
    )
    at_ns: int | None = _of_outcome(
        "when it was, such as '2026-11-22 14:30' (default: now)",
        flag="--at",
        metavar="TIME",
        parse=_time,
    )


def record_outcome_as_asked(arguments: argparse.Namespace) -> str:
    """Record the outcome of a shot; return the summary line."""
    from tunenet_logs.outcomes import MAX_ATTEMPTS, write_outcome
    from tunenet_logs.timing.stamps import now_ns

    asked = OutcomeOptions(**given(arguments, OutcomeOptions))
    if asked.ball is None:
        raise UsageError("--outcome needs --ball NAME: which ball it was")
    if arguments.overwrite:
        raise UsageError("--overwrite does not go with --outcome: no outcome replaces another")
    output = arguments.output
    if output is not None and (output.is_file() or output.suffix == ".mcap"):
        raise UsageError(f"{output}: give -o the folder of the campaign; it names its files")
    if asked.drop_log is not None and not _is_there(asked.drop_log):
        raise UsageError(
            f"{short_name(asked.drop_log)}: no such file; name the drop's log, or leave "
            "--drop-log out"
        )
    folder = output or Path()
    outcome = _outcome(asked, folder, success=arguments.outcome == "success")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LogError(
            f"{folder}: cannot be made ({error.strerror}); name another folder"
        ) from error
    with _alone_in(folder):
        if asked.at_ns is None:  # only now: later attempts have later times
            outcome = replace(outcome, stamp_ns=now_ns())
        earlier = _earlier(folder, outcome)
        if asked.attempt is None:
            number = 1 + max((other.attempt for other in earlier), default=0)
            if number > MAX_ATTEMPTS:
                raise UsageError(
                    f"{outcome.ball}: has an attempt {MAX_ATTEMPTS}, the last; say --attempt N"
                )
            outcome = replace(outcome, attempt=number)
        path = write_outcome(folder, outcome)
    # Of an attempt's outcomes that of the latest time counts in reviews.
    same = [one for one in earlier if one.attempt == outcome.attempt and not one.is_counted]
    which = "; it had an outcome, and the later one counts" if same else ""
    if any(one.stamp_ns > outcome.stamp_ns for one in same):
        which = (
            "; it has an outcome of a later time, and that counts: say a later --at to correct it"
        )
    return f"{path}: {outcome.word} of {outcome.name}{which}"


def _outcome(asked: OutcomeOptions, folder: Path, *, success: bool) -> Outcome:
    """Make the outcome; of the first attempt where none is given."""
    from tunenet_logs.outcomes import Outcome
    from tunenet_logs.timing.stamps import now_ns

    told, log = _told_by(asked.tuning)
    assert asked.ball is not None
    try:
        return Outcome(
            task=asked.task or _TASK,
            ball=asked.ball,
            attempt=asked.attempt or 1,
            success=success,
            stamp_ns=now_ns() if asked.at_ns is None else asked.at_ns,
            shot_height_m=asked.shot_height_m,
            miss_m=asked.miss_m,
            tuned_parameter=told,
            drop_log=_place(asked.drop_log or log, folder),
            tuning=_place(asked.tuning, folder),
            reason=asked.reason,
            note=asked.note,
        )
    except ValueError as error:
        raise UsageError(f"{error}; an outcome cannot hold that") from error


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Lock the folder against other recorders, where the file system has locks."""
    import fcntl

    opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        end = time.monotonic() + 10.0  # [s]; others take a moment to write their outcomes
        while True:
            try:
                fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                if time.monotonic() > end:
                    raise LogError(
                        f"{folder}: another program has locked it for over 10 s; end that, or "
                        "choose another folder with -o"
                    ) from error
                time.sleep(0.02)
                continue
            except OSError:  # a file system without locks
                pass
            break
        yield
    finally:
        os.close(opened)


def _is_there(path: Path) -> bool:
    """Return whether a path exists; False for one that no file system takes."""
    try:
        return path.exists()
    except OSError:
        return False


def _earlier(folder: Path, outcome: Outcome) -> list[Outcome]:
    """Read the campaign's outcomes of this task and ball; damaged ones only warn."""
    from tunenet_logs.outcomes import numbered, outcome_files, read_outcomes

    def warn(text: str) -> None:
        print(one_line(f"tunenet-record: {text}"), file=sys.stderr)

    found: list[Outcome] = []
    for file in outcome_files(folder, warn):
        try:
            found += read_outcomes(file, warn)
        except LogError as error:
            warn(str(error))
    kind = (outcome.task, outcome.ball)
    return [other for other in numbered(found) if (other.task, other.ball) == kind]


def _told_by(tuning: Path | None) -> tuple[float | None, Path | None]:
    """Read the restitution from a tuning's JSON, and the path of its log beside it."""
    if tuning is None:
        return None, None
    remedy = "name a JSON that tunenet-tune wrote, or leave --tuning out"
    try:
        told = parse_json(read_small_file(tuning, 4_000_000))  # far more than a tuning has
        log = tuning.parent / Path(told["log"]).name
        # None where it was rejected or is of something else than a drop.
        parameters = told["parameters"]
        value = None
        if not isinstance(parameters, dict | None):
            raise ValueError("no parameters")
        if parameters and "restitution" in parameters:
            value = parameters["restitution"]["value"]
            is_number = isinstance(value, float | int) and not isinstance(value, bool)
            if not is_number or not 0 <= value <= 1:
                raise ValueError("no restitution")
        return (None if value is None else float(value)), (log if _is_there(log) else None)
    except OSError as error:
        raise UsageError(f"{tuning}: cannot be read ({error.strerror}); {remedy}") from error
    except (ValueError, TypeError, LookupError) as error:
        raise UsageError(f"{tuning}: is no tuning; {remedy}") from error


def _place(path: Path | None, folder: Path) -> str:
    """Return a path relative to the campaign's folder where it lies inside."""
    if path is None:
        return ""
    full, root = real_path(path), real_path(folder)
    text = os.fspath(full.relative_to(root) if full.is_relative_to(root) else full)
    if len(text) > _MAX_LETTERS:
        raise UsageError(
            f"{short_name(text)}: is a path of over {_MAX_LETTERS} letters; lay it into the "
            "campaign's folder"
        )
    return text
