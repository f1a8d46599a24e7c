"""Run a batch: skip logs that are done, tune the others, and keep the ledger.

`tuned_and_written` does the work of one log, in a process of this machine or on a Ray cluster.
`run_batch` maps it over all logs, and enters each result in the ledger as it comes. Results are
shown as a table with a summary, or as JSON lines.
"""

from __future__ import annotations

import json
import os
import platform
import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, get_args

from tunenet_logs import __version__
from tunenet_logs.addresses import Address
from tunenet_logs.analysis.batch.ledger import (
    Journal,
    Ledger,
    LedgerRow,
    check_batch_file,
    journal,
    ledger_file,
    ledger_key,
    ledger_row,
    options_digest,
    overview_file,
    overview_place,
    write_csv,
)
from tunenet_logs.analysis.batch.logs import (
    OF_BATCH,
    FoundLog,
    LogState,
    fetched,
    is_remote,
    remote_state,
    result_files,
    result_names,
)
from tunenet_logs.analysis.checks import Verdict
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Cluster, on_cluster, streamed
from tunenet_logs.analysis.presentation import (
    Row,
    gaps_table,
    laid_out,
    number_words,
    row_of,
    table,
)
from tunenet_logs.analysis.record import (
    MAX_RECORD_BYTES,
    Record,
    read_record,
    record_fields,
    to_json,
)
from tunenet_logs.analysis.result_files import known_sha256, review_of, tuning_of, writable
from tunenet_logs.analysis.tuning import provenance_of, tune_log
from tunenet_logs.console import is_stdout, print_traceback
from tunenet_logs.errors import LogError, UsageError, WeightsError
from tunenet_logs.files import json_line, parse_json, real_path
from tunenet_logs.terminal import Progress, listed, one_line, short_name, terminal_columns
from tunenet_logs.writing.owned_path import OutputPlace

# ---- One log: tune it, write its results, and build its ledger row.

_DIED = "the process that tuned it died each time (out of memory?)"

_ORDER = get_args(Verdict)  # the best first


@dataclass(frozen=True)
class Writing:
    """What is written for each log, beside its JSON."""

    overwrite: bool = False  # whether results of other logs may be replaced
    reviewed: frozenset[str] = frozenset(_ORDER)  # verdicts whose logs get a review
    also: Callable[[Tuning], None] | None = None  # writes something else; else a LogError


@dataclass(frozen=True)
class Work:
    """A log, and where its results go, without the suffix."""

    log: Path | Address
    name: Path


@dataclass(frozen=True)
class Result:
    """Result of one log: small, so that it travels between processes."""

    row: Row  # without the curves
    entry: LedgerRow  # the log's row in the ledger
    review: Path | None = None  # the recording to open; None if there is nothing to show
    trouble: str | None = None  # why results could not be written, in one line; None if they were
    report: Path | None = None  # the JSON that was written; None if none was
    was: str | None = None  # the better verdict that was replaced, in one line; None if none was


def tuned_and_written(work: Work, options: TuneOptions, writing: Writing) -> Result:
    """Tune one log and write its results."""
    if isinstance(work.log, Path):
        return _of_file(work, work.log, LogState.of(work.log), options, writing)
    try:
        state = remote_state(work.log)
        with fetched(work.log) as path:
            return _of_file(work, path, state, options, writing)
    except LogError as error:
        reason = str(error).removeprefix(f"{work.log}: ")
        return untuned(work, options, reason, LogState(), error=str(error))


def _of_file(
    work: Work, log: Path, state: LogState, options: TuneOptions, writing: Writing
) -> Result:
    """Tune a log on this machine, possibly a copy, and write its results."""
    sha256, before = "", None
    report_file, review_file = result_files(work.name)
    if os.path.lexists(report_file) or os.path.lexists(review_file):
        sha256 = known_sha256(log)
    if sha256:
        places = _places(work, log, sha256, writing)
        wanted = places if writing.reviewed else places[:1]
        if why := next(filter(None, (place.why_not() for place in wanted)), None):
            reason = "not tuned: its results would replace others"
            return untuned(work, options, reason, state, error=why)
        with suppress(LogError):  # what was there of the same log
            known = read_record(report_file)
            if known.provenance is not None and known.provenance.log_sha256 == sha256:
                before = known
    try:
        tuning = tune_log(log, options)
    except (UsageError, WeightsError):  # the same for every log
        raise
    except Exception as error:  # noqa: BLE001 (a defect of ours must not cost the other logs)
        print_traceback()
        reason = f"unexpected {type(error).__name__}: {error}; please report it with the log"
        tuning = Tuning(log, options.task, options.preset, "rejected", reason)
    is_log = log.is_file() or tuning.episode is not None  # a folder may be one
    sha256 = sha256 or (known_sha256(log) if is_log else "")
    tuning = replace(tuning, provenance=provenance_of(tuning, sha256, options))
    record = tuning.record
    review, trouble, report = None, None, None
    try:
        if is_log and (sha256 or not os.path.lexists(report_file)):
            review = _write(_places(work, log, sha256, writing), tuning, record, writing)
            report = report_file
            if writing.also is not None:
                writing.also(tuning)
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
    was = None
    if report and before and _ORDER.index(before.verdict) < _ORDER.index(record.verdict):
        values = [part for known in before.estimates for part in known.components][:1]
        said = "".join(f", {number_words(part.value, part.interval95)}" for part in values)
        was = f"{report}: was {before.verdict}{said}; is {record.verdict} now"
    return Result(row, entry, review, trouble, report, was)


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
    """Write the results of a log, and return the path of the review, if it gets one."""
    report, recording = places
    report.path.parent.mkdir(parents=True, exist_ok=True)
    review, episode = None, tuning.episode
    if record.verdict not in writing.reviewed:
        recording.remove()  # that of the tuning that this one replaces
    elif episode is not None and (
        episode.signals or episode.picture_topics or episode.sound_topics
    ):
        from tunenet_logs.analysis.review.tuning import write_review

        review = recording.path
        with recording.replacing() as unfinished:
            write_review(tuning, record, unfinished)
    with report.replacing() as unfinished:
        unfinished.write_text(to_json(record), "utf-8", errors="backslashreplace")
    return review


def untuned(work: Work, options: TuneOptions, reason: str, state: LogState, error: str) -> Result:
    """Build the result of a log that could not be tuned, and why (`error`)."""
    log = work.log if isinstance(work.log, Path) else Path(work.log.name)
    tuning = Tuning(log, options.task, options.preset, "rejected", reason)
    tuning = replace(tuning, provenance=provenance_of(tuning, "", options))
    record = tuning.record
    row = replace(row_of(tuning, record), log=work.log)
    entry = ledger_row(work.log, work.name, record, state, error=error)
    return Result(row, entry, trouble=None if error == reason else error)


# ---- Batch: map the work over the logs, and enter the results in the ledger.

MAX_SHOWN = 40  # logs of a batch whose results are kept to be shown one by one
_TELL_EVERY_S = 60.0  # where no bar is shown, a line tells how far a batch is
_NUMBER = re.compile(r"[-+]?[0-9][0-9.,]*(e[-+]?[0-9]+)?")

# Does work on every item somewhere, and gives the results as they come: (work, items, lost=...);
# see `streamed`.
Streamed = Callable[..., Iterable[tuple[int, Result]]]


@dataclass(frozen=True)
class Order:
    """Logs of a batch, and how to tune them."""

    logs: Sequence[FoundLog]
    options: TuneOptions = field(default_factory=TuneOptions)
    writing: Writing = field(default_factory=Writing)
    folder: Path | None = None  # where results go; None for beside each log
    keeps_ledger: bool = False  # whether a ledger is kept there
    resumes: bool = False  # whether to skip unchanged logs that it has, under equal options
    csv: OutputPlace | None = None  # where the ledger goes as a text table, too
    jobs: int | None = None  # number of processes; None for all cores
    ray: str | None = None  # address of a Ray cluster; None for processes of this machine


@dataclass
class BatchResult:
    """Result of a batch."""

    results: list[Result]  # of at most `MAX_SHOWN` logs; of more, the first ones that failed
    verdicts: Counter[str]  # count of logs by verdict, skipped ones included
    reasons: Counter[str] = field(default_factory=Counter)  # why not ok; numbers are ignored
    skipped: int = 0  # logs that were done before
    failed: int = 0  # logs that are rejected, or whose results could not be written
    seconds: float = 0.0  # wall time
    ledger: Path | None = None  # None if none is kept

    def count(self, verdict: str, reason: object, *, failed: bool = False) -> None:
        """Count a log; of a reason the first clause without its numbers."""
        self.verdicts[verdict] += 1
        self.failed += failed or verdict == "rejected"
        if reason is not None:
            self.reasons[_NUMBER.sub("…", re.split(r"; | \(", str(reason))[0])] += 1

    @property
    def counted(self) -> str:
        """The count of logs by verdict, in words."""
        return ", ".join(f"{self.verdicts[name]} {name}" for name in _ORDER)


def run_batch(
    order: Order,
    progress: Progress,
    stream: Streamed | None = None,
    after: Callable[[Order, Ledger], None] | None = None,
    each: Callable[[Result], None] = lambda _result: None,
) -> BatchResult:
    """Tune every log, write its results, and enter it in the ledger."""
    began_s = time.monotonic()
    names = result_names(order.logs, order.folder)
    works = [Work(one.log, name) for one, name in zip(order.logs, names, strict=True)]
    work = partial(tuned_and_written, options=order.options, writing=order.writing)
    gone = partial(untuned, options=order.options, reason=_DIED, state=LogState(), error=_DIED)
    usual: Streamed = partial(streamed, jobs=order.jobs, may_stay=True)
    if order.ray:  # its machines share one file system; an actor has another working folder
        usual = partial(on_cluster, Cluster(order.ray, order.jobs))
        logs = [real_path(one.log) if isinstance(one.log, Path) else one.log for one in works]
        works = [Work(log, real_path(one.name)) for log, one in zip(logs, works, strict=True)]
    stream = stream or usual
    batch = BatchResult([], Counter())
    shown: dict[int, Result] = {}
    with ExitStack() as stack:
        kept: Journal | None = None
        digest = ""
        if order.keeps_ledger and order.folder is not None:
            kept = stack.enter_context(journal(order.folder))
            digest = options_digest(order.options)
            batch.ledger = ledger_file(order.folder)
        if kept is not None and order.resumes:
            works = [one for one in works if not _is_done(one, kept, digest, batch)]
        counted, next_s = progress, began_s + _TELL_EVERY_S
        if len(works) == 1:  # how far its own stages are says more than none of one
            stack.enter_context(progress.stages(one_line(works[0].log)))
            counted = replace(progress, quiet=True)
        with counted.bar(len(works), "tuning", "log") as bar:
            for done, (at, result) in enumerate(stream(work, works, lost=gone), 1):
                if kept is not None:
                    kept.append({**result.entry, "options": digest})
                each(result)
                record = result.row.record
                batch.count(record.verdict, record.reason, failed=result.trouble is not None)
                is_odd = record.verdict == "rejected" or result.trouble or result.was
                if len(works) <= MAX_SHOWN or (len(shown) < MAX_SHOWN and is_odd):
                    shown[at] = result
                bar.set_postfix_str(batch.counted, refresh=False)
                bar.update(1)
                now_s = time.monotonic()
                if now_s >= next_s and not progress.shows_bars:
                    next_s = now_s + _TELL_EVERY_S
                    rate = done / (now_s - began_s)
                    progress.say(
                        f"tuning: {done} of {len(works)} logs, {rate:.1f} a second, "
                        f"{(len(works) - done) / rate / 60:.0f} min left: {batch.counted}"
                    )
        if kept is not None and after is not None:
            after(order, kept.ledger)
    batch.results = [shown[at] for at in sorted(shown)]
    batch.seconds = time.monotonic() - began_s
    return batch


def _is_done(work: Work, kept: Journal, digest: str, batch: BatchResult) -> bool:
    """Check whether the ledger has a log as it is now, and count it then."""
    row = kept.ledger.row(ledger_key(work.log))
    if (
        row is None
        or row.get("error") is not None
        or row.get("options") != digest
        or row.get("results") != ledger_key(work.name)
        or not _is_same(work, row.get("bytes"), row.get("modified_ns"), row.get("sha256"))
    ):
        return False
    batch.skipped += 1
    batch.count(str(row["verdict"]), row.get("reason"))
    return True


def _is_same(work: Work, size: object, modified_ns: object, sha256: object) -> bool:
    """Check whether a log is unchanged, and its results are there."""
    if not isinstance(work.log, Path):
        state = remote_state(work.log)
        if state.size >= 0 and (state.size != size or state.modified_ns):
            return (state.size, state.modified_ns) == (size, modified_ns)
        with suppress(LogError, OSError), fetched(work.log) as copy:  # nobody says when it changed
            return known_sha256(copy) == sha256
        return False
    state = LogState.of(work.log)
    report = result_files(work.name)[0]
    if state.size < 0 or not sha256 or report.is_symlink() or not report.is_file():
        return state.size < 0 and size == -1  # it could not be read, and cannot now
    is_same = state.modified_ns == modified_ns or known_sha256(work.log) == sha256
    return state.size == size and is_same


# ---- JSON lines (`--json`): one object per log, as each is done.

_PATH = re.compile(rb'^\{"path": ("(?:[^"\\]|\\.)*+"),', re.MULTILINE)  # how each line begins
# Some of the keys that each has.
_KEYS = frozenset(("path", "log", "verdict", "parameters", "provenance", "json", "rrd", "error"))

_JSON_REMEDY = "choose another file with --json; what was tuned is in the logs' own JSONs"


def result_fields(result: Result) -> dict[str, Any]:
    """Return the fields of a log's line: path, record without curves, and result files."""
    return {
        "path": str(result.row.log),
        **record_fields(result.row.record),
        "json": result.report and str(result.report),
        "rrd": result.review and str(result.review),
        "error": result.entry["error"],
    }


def lines_place(path: Path, order: Order, *, overwrite: bool) -> OutputPlace:
    """Check the place of the lines before hours of work; they replace no log's own results."""
    logs = {name for one in order.logs for name in (str(one.log), ledger_key(one.log))}

    def knows(file: BinaryIO) -> Sequence[str] | None:
        data = file.read(MAX_RECORD_BYTES)
        first = parse_json(data.partition(b"\n")[0])
        if not isinstance(first, dict) or not first.keys() >= _KEYS:
            return None
        paths = [json.loads(one) for one in _PATH.findall(data)]
        return [one for one in paths if one not in logs and ledger_key(one) not in logs]

    of = listed(str(one.log) for one in order.logs[:2])
    elsewhere = "give --json another file"
    place = OutputPlace(path, "file of --json", knows, of, elsewhere, overwrite=overwrite)
    if not is_stdout(path):
        names = [*result_names(order.logs, order.folder), (order.folder or Path()) / OF_BATCH]
        files = (file for name in names for file in result_files(name))
        if real_path(path) in map(real_path, files):
            raise UsageError(f"{path}: is where a log's own results go; give --json another file")
        check_batch_file(place, order.logs, order.folder)
    return place


@contextmanager
def result_lines(place: OutputPlace | None) -> Iterator[Callable[[Result], None]]:
    """Open a sink for results as they are done: a file, standard output, or nothing."""
    if place is None:
        yield lambda _result: None
    elif is_stdout(path := place.path):
        yield lambda result: print(json_line(result_fields(result)), flush=True)
    else:
        with writable(path, _JSON_REMEDY):
            path.parent.mkdir(parents=True, exist_ok=True)  # the folder of the results
        with place.replacing() as partial, partial.open("w", encoding="ascii") as file:

            def write(result: Result) -> None:
                with writable(path, _JSON_REMEDY):
                    print(json_line(result_fields(result)), file=file, flush=True)

            yield write


# ---- Terminal: print results log by log where they are few, else by verdict.

_OF_SIMULATOR = ("engine", "preset", "step_hz")
_DISK_REMEDY = "free some space and run it again with --resume: the logs are done"

# Of reasons why logs are not ok: the most frequent ones are printed, cut.
_MAX_REASONS, _MAX_REASON_CHARACTERS = 5, 100


def closing(order: Order, ledger: Ledger) -> None:
    """Write what is made of a whole ledger: its overview, and a CSV table on request."""
    if order.csv is not None:
        with writable(order.csv.path, _DISK_REMEDY):
            write_csv(ledger, order.csv)
    if order.folder is not None:
        from tunenet_logs.analysis.review.ledger import write_overview

        place = overview_place(order.folder)
        with writable(place.path, _DISK_REMEDY), place.replacing() as unfinished:
            write_overview(ledger.columns, unfinished)


def show(batch: BatchResult, count: int, *, has_table: bool, is_verbose: bool) -> None:
    """Print what became of `count` logs: a table and a summary; remarks to standard error."""
    rows = [result.row for result in batch.results]
    if is_verbose:
        known = f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"
        details = [f"{row.log}: {line}" for row in rows for line in _details(row.record)]
        _say(f"tunenet-logs {__version__}, {known}", *details)
    read = [row for row in rows if row.is_read]
    if read and has_table:
        print(table(read, terminal_columns()))
        if len(read) == 1 and (gaps := gaps_table(read[0].record)).rows:
            print(f"\n{laid_out(gaps, terminal_columns())}")
    for result in batch.results:  # warnings, and why a log could not be read or written
        record, is_read = result.row.record, result.row.is_read
        if is_read or not result.trouble:
            remarks = record.warnings if is_read else (record.reason, *record.warnings)
            _say(*(f"tunenet-tune: {result.row.log}: {remark}" for remark in remarks))
        _say(*(f"tunenet-tune: {one}" for one in (result.was, result.trouble) if one))
    if has_table:
        print("".join(f"{line}\n" for line in _summary(batch, count)), end="")


def _say(*lines: str) -> None:
    for line in lines:
        print(one_line(line), file=sys.stderr)


def _details(record: Record) -> Iterator[str]:
    where = f" in {record.topic}" if record.topic else ""
    yield f"{record.task or 'no experiment'}{where}"
    if record.window:
        moments = ", ".join(
            f"{name.removesuffix('_s')} {at_s:.3f} s" for name, at_s in record.window.items()
        )
        yield f"moments since its first sample: {moments}"
    if record.simulator is not None:
        engine, preset, step_hz = (record.simulator[name] for name in _OF_SIMULATOR)
        yield (
            f"{record.method}, preset {preset}, {record.rollouts} rollouts in {engine} at "
            f"{step_hz:g} steps a second"
        )
    stages = sorted(record.seconds.items(), key=lambda stage: stage[0] == "total")
    yield ", ".join(f"{name} {seconds:.3f} s" for name, seconds in stages)
    for check in record.checks:
        yield f"{'passed' if check.passed else 'FAILED'}: {check.name}: {check.detail}"


def _summary(batch: BatchResult, count: int) -> Iterator[str]:
    """Yield the lines below the table of a batch of `count` logs."""
    records = [result.row.record for result in batch.results]
    if engines := {record.simulator["engine"] for record in records if record.simulator}:
        yield from ("", f"simulated by {', '.join(sorted(engines))}")
    if batch.ledger is not None:
        done = count - batch.skipped
        rate = f", {done / batch.seconds:.1f} a second" if done and batch.seconds > 0 else ""
        before = f"; {batch.skipped} were done before" if batch.skipped else ""
        yield from ("", f"{count} logs: {done} tuned in {_lasting(batch.seconds)}{rate}{before}")
        for name in _ORDER:
            if number := batch.verdicts[name]:
                yield f"  {name:8}  {number:6}  {100 * number / count:5.1f} %"
        for reason, number in batch.reasons.most_common(_MAX_REASONS):
            yield f"    {number} x {short_name(reason, _MAX_REASON_CHARACTERS)}"
    reviews = [one_line(result.review) for result in batch.results if result.review]
    if reviews and count <= MAX_SHOWN:
        yield "review: " + "\n        ".join(f"rerun {review}" for review in reviews)
    if batch.ledger is not None:
        yield f"ledger: {one_line(batch.ledger)}"
        yield f"        rerun {one_line(overview_file(batch.ledger.parent))}"


def _lasting(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"
