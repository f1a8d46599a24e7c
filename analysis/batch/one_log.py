"""One log of many: tuned, its results written, its line for the ledger made."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from analysis.batch.found_logs import is_remote
from analysis.batch.ledger_row import LedgerRow, LogState, ledger_row
from analysis.batch.result_names import result_files
from analysis.provenance import provenance_of
from analysis.record import Record, Tuning
from analysis.record_json import to_json
from analysis.result_files import check_own, log_sha256, replacing
from analysis.review.tuning_review import write_review
from analysis.selection import Options
from analysis.terminal_table import Row, row_of
from analysis.tuning import tune_log
from tunenet_logs.commandline import print_traceback
from tunenet_logs.errors import LogError, UsageError, WeightsError

_DIED = "the process that tuned it died each time (out of memory?)"

Also = Callable[[Tuning], None]
"""Writes something of a tuning, and raises LogError or OSError where it cannot."""


@dataclass(frozen=True)
class Writing:
    """What is written of each log, beside its JSON.

    Attributes:
        overwrite: whether results of other logs may be replaced.
        reviewed: the verdicts whose logs get a review.
        also: writes what else is to be kept of a tuning, or says why not in a LogError or OSError.
    """

    overwrite: bool = False
    reviewed: frozenset[str] = frozenset(("ok", "suspect", "rejected"))
    also: Also | None = None


@dataclass(frozen=True)
class Work:
    """One log, and where its results go, without the suffix."""

    log: Path | str
    name: Path


@dataclass(frozen=True)
class Result:
    """What came of a log, and where it went: small, so that it travels between processes.

    Attributes:
        row: without the curves.
        entry: what the ledger says of it.
        review: the recording to open; None if there is nothing to show.
        trouble: why results could not be written, one line; None if they were.
        report: the JSON that was written; None if none was.
    """

    row: Row
    entry: LedgerRow
    review: Path | None = None
    trouble: str | None = None
    report: Path | None = None


def lost(work: Work, options: Options) -> Result:
    """The result of a log whose process dies."""
    return _untuned(work, options, _DIED, LogState(), error=_DIED)


def tuned_and_written(work: Work, options: Options, writing: Writing) -> Result:
    """Tune one log and write its results.

    Raises:
        UsageError, WeightsError: the options fit no log.
    """
    if isinstance(work.log, Path):
        return _of_file(work, work.log, LogState.of(work.log), options, writing)
    from analysis.batch.remote_logs import fetched, remote_state

    try:
        state = remote_state(work.log)
        with fetched(work.log) as path:
            return _of_file(work, path, state, options, writing)
    except LogError as error:
        return _untuned(work, options, str(error), LogState(), error=str(error))


def _of_file(work: Work, log: Path, state: LogState, options: Options, writing: Writing) -> Result:
    """The same for a log on this machine, be it a copy."""
    sha256 = ""
    files = result_files(work.name)
    try:
        if any(one.exists() for one in files):
            with suppress(OSError):  # reading and writing say why in our own words
                sha256 = log_sha256(log)
                if not writing.overwrite:
                    check_own(*files, log, sha256)
    except LogError as error:
        reason = "not tuned: its results would replace others"
        return _untuned(work, options, reason, state, error=str(error))
    tuning = _tuned(log, options)
    is_log = log.is_file() or tuning.episode is not None  # a folder may be one
    if is_log and not sha256:
        with suppress(OSError):
            sha256 = log_sha256(log)
    tuning = replace(tuning, provenance=provenance_of(tuning, sha256, options))
    record = tuning.record
    review, trouble, report = None, None, None
    try:
        if is_log and (sha256 or not files[0].exists()):
            review = _write(work.name, tuning, record, writing)
            report = files[0]
            trouble = writing.also and _trouble(writing.also, tuning)
    except (OSError, UnicodeError) as error:  # the latter for a name that Rerun cannot take
        place, why = work.name.parent, "its name is not UTF-8"
        if isinstance(error, OSError):
            place, why = error.filename or place, error.strerror
        trouble = f"{place}: cannot be written ({why}); choose another folder with -o"
    small = replace(record, motion=replace(record.motion, curves=None))
    row = row_of(tuning, small)
    row = replace(row, log=work.log) if is_remote(work.log) else row
    entry = ledger_row(work.log, work.name, small, state, error=trouble)
    return Result(row, entry, review, trouble, report)


def _tuned(log: Path, options: Options) -> Tuning:
    """Tune a log; a defect of ours must not cost the other logs."""
    try:
        return tune_log(log, options)
    except (UsageError, WeightsError):  # the same for every log
        raise
    except Exception as error:  # noqa: BLE001
        print_traceback()
        reason = f"unexpected {type(error).__name__}: {error}; please report it with the log"
        return Tuning(log, options.task, options.preset, "rejected", reason)


def _write(name: Path, tuning: Tuning, record: Record, writing: Writing) -> Path | None:
    """Write the results of a log; the review, if it gets one.

    Raises:
        OSError, UnicodeError: they cannot be written.
    """
    name.parent.mkdir(parents=True, exist_ok=True)
    report, recording = result_files(name)
    review, episode = None, tuning.episode
    if record.verdict not in writing.reviewed:
        recording.unlink(missing_ok=True)  # of the tuning that this one replaces
    elif episode is not None and (
        episode.signals or episode.picture_topics or episode.sound_topics
    ):
        review = recording
        with replacing(review) as unfinished:
            write_review(tuning, record, unfinished)
    with replacing(report) as unfinished:
        unfinished.write_text(to_json(record), "utf-8", errors="backslashreplace")
    return review


def _untuned(work: Work, options: Options, reason: str, state: LogState, error: str) -> Result:
    log = Path(work.log)
    tuning = Tuning(log, options.task, options.preset, "rejected", reason)
    tuning = replace(tuning, provenance=provenance_of(tuning, "", options))
    record = tuning.record
    row = replace(row_of(tuning, record), log=work.log)
    entry = ledger_row(work.log, work.name, record, state, error=error)
    return Result(row, entry, trouble=None if error == reason else error)


def _trouble(also: Also, tuning: Tuning) -> str | None:
    """Keep what else is wanted of a tuning; why that was not possible, else None."""
    try:
        also(tuning)
    except LogError as error:
        return str(error)
    except OSError as error:
        return f"{error.filename}: cannot be written ({error.strerror}); choose another place"
    return None
