"""Tune one log of a batch, write its results, and build its ledger row."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

from analysis.batch.found_logs import is_remote
from analysis.batch.ledger_row import LedgerRow, LogState, ledger_row
from analysis.batch.result_names import result_files
from analysis.checks import Verdict
from analysis.provenance import provenance_of
from analysis.record import Record, Tuning
from analysis.record_json import read_record, to_json
from analysis.result_files import log_sha256, review_of, tuning_of
from analysis.review.tuning_review import write_review
from analysis.selection import Options
from analysis.terminal_table import Row, row_of
from analysis.tuning import tune_log
from tunenet_logs.addresses import Address
from tunenet_logs.commandline import print_traceback
from tunenet_logs.errors import LogError, UsageError, WeightsError
from tunenet_logs.output.owned_file import OutputPlace

_DIED = "the process that tuned it died each time (out of memory?)"

_ORDER = get_args(Verdict)  # the best first
# Writes something of a tuning, and raises LogError or OSError where it cannot.
Also = Callable[[Tuning], None]


@dataclass(frozen=True)
class Writing:
    """What is written for each log, beside its JSON.

    Attributes:
        overwrite: Whether results of other logs may be replaced; files of others never are.
        reviewed: Verdicts whose logs get a review.
        also: Callback that keeps something else of a tuning; raises LogError or OSError on failure.
    """

    overwrite: bool = False
    reviewed: frozenset[str] = frozenset(("ok", "suspect", "rejected"))
    also: Also | None = None


@dataclass(frozen=True)
class Work:
    """A log, and where its results go, without the suffix."""

    log: Path | Address
    name: Path


@dataclass(frozen=True)
class Result:
    """Result of one log: small, so that it travels between processes.

    Attributes:
        row: Without the curves.
        entry: The log's row in the ledger.
        review: The recording to open; None if there is nothing to show.
        trouble: Why results could not be written, in one line; None if they were.
        report: The JSON that was written; None if none was.
        was: The better verdict that was replaced, in one line; None if none was.
    """

    row: Row
    entry: LedgerRow
    review: Path | None = None
    trouble: str | None = None
    report: Path | None = None
    was: str | None = None


def lost(work: Work, options: Options) -> Result:
    """Build the result of a log whose process died."""
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
        reason = str(error).removeprefix(f"{work.log}: ")
        return _untuned(work, options, reason, LogState(), error=str(error))


def _of_file(work: Work, log: Path, state: LogState, options: Options, writing: Writing) -> Result:
    """Tune a log on this machine, possibly a copy, and write its results."""
    sha256, before = "", None
    report_file, review_file = result_files(work.name)
    if os.path.lexists(report_file) or os.path.lexists(review_file):
        with suppress(OSError):  # reading and writing say why in our own words
            sha256 = log_sha256(log)
    if sha256:
        places = _places(work, log, sha256, writing)
        wanted = places if writing.reviewed else places[:1]
        if why := next(filter(None, (place.why_not() for place in wanted)), None):
            reason = "not tuned: its results would replace others"
            return _untuned(work, options, reason, state, error=why)
        before = _before(report_file, sha256)
    tuning = _tuned(log, options)
    is_log = log.is_file() or tuning.episode is not None  # a folder may be one
    if is_log and not sha256:
        with suppress(OSError):
            sha256 = log_sha256(log)
    tuning = replace(tuning, provenance=provenance_of(tuning, sha256, options))
    record = tuning.record
    review, trouble, report = None, None, None
    try:
        if is_log and (sha256 or not os.path.lexists(report_file)):
            places = _places(work, log, sha256, writing)
            review = _write(places, tuning, record, writing)
            report = report_file
            trouble = writing.also and _trouble(writing.also, tuning)
    except LogError as error:
        trouble = str(error)
    except (OSError, UnicodeError) as error:  # the latter for a name that Rerun cannot take
        place, why = work.name.parent, "its name is not UTF-8"
        if isinstance(error, OSError):
            place, why = error.filename or place, error.strerror
        trouble = f"{place}: cannot be written ({why}); choose another folder with -o"
    small = replace(record, motion=replace(record.motion, curves=None))
    row = row_of(tuning, small)
    row = replace(row, log=work.log) if is_remote(work.log) else row
    entry = ledger_row(work.log, work.name, small, state, error=trouble)
    return Result(row, entry, review, trouble, report, report and _was(before, record, report))


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


def _places(
    work: Work, log: Path, sha256: str, writing: Writing
) -> tuple[OutputPlace, OutputPlace]:
    """Return the output places of the JSON and the review."""
    report, review = result_files(work.name)
    of = log.name if is_remote(work.log) else str(log)
    elsewhere, overwrite = "choose another folder with -o", writing.overwrite
    return (
        OutputPlace(report, "tuning", tuning_of(log, sha256), of, elsewhere, overwrite),
        OutputPlace(review, "review", review_of(sha256), of, elsewhere, overwrite),
    )


def _write(
    places: tuple[OutputPlace, OutputPlace], tuning: Tuning, record: Record, writing: Writing
) -> Path | None:
    """Write the results of a log, and return the path of the review, if it gets one.

    Raises:
        LogError: A file in their place may not be replaced by now.
        OSError, UnicodeError: They cannot be written.
    """
    report, recording = places
    report.path.parent.mkdir(parents=True, exist_ok=True)
    review, episode = None, tuning.episode
    if record.verdict not in writing.reviewed:
        recording.remove()  # that of the tuning that this one replaces
    elif episode is not None and (
        episode.signals or episode.picture_topics or episode.sound_topics
    ):
        review = recording.path
        with recording.replacing() as unfinished:
            write_review(tuning, record, unfinished)
    with report.replacing() as unfinished:
        unfinished.write_text(to_json(record), "utf-8", errors="backslashreplace")
    return review


def _before(report: Path, sha256: str) -> Record | None:
    """Return the existing tuning, if it is of the same log."""
    with suppress(LogError):
        record = read_record(report)
        if record.provenance is not None and record.provenance.log_sha256 == sha256:
            return record
    return None


def _was(before: Record | None, record: Record, report: Path) -> str | None:
    """Describe the better verdict that is replaced ("was ok, 0.7400"), or return None."""
    if before is None or _ORDER.index(before.verdict) >= _ORDER.index(record.verdict):
        return None
    values = [part for known in before.estimates for part in known.components][:1]
    said = "".join(f", {part.value:.4f}" for part in values)
    return f"{report}: was {before.verdict}{said}; is {record.verdict} now"


def _untuned(work: Work, options: Options, reason: str, state: LogState, error: str) -> Result:
    log = work.log if isinstance(work.log, Path) else Path(work.log.name)
    tuning = Tuning(log, options.task, options.preset, "rejected", reason)
    tuning = replace(tuning, provenance=provenance_of(tuning, "", options))
    record = tuning.record
    row = replace(row_of(tuning, record), log=work.log)
    entry = ledger_row(work.log, work.name, record, state, error=error)
    return Result(row, entry, trouble=None if error == reason else error)


def _trouble(also: Also, tuning: Tuning) -> str | None:
    """Call `also`; return why it failed, or None."""
    try:
        also(tuning)
    except LogError as error:
        return str(error)
    except OSError as error:
        return f"{error.filename}: cannot be written ({error.strerror}); choose another place"
    return None
