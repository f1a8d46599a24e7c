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
from tunenet_logs.analysis.parallel import Cluster, on_cluster, streamed
from tunenet_logs.analysis.presentation import Row, row_of, table
from tunenet_logs.analysis.record import (
    MAX_RECORD_BYTES,
    Record,
    read_record,
    record_fields,
    to_json,
)
from tunenet_logs.analysis.result_files import log_sha256, review_of, tuning_of, writable
from tunenet_logs.analysis.review.tuning import write_overview, write_review
from tunenet_logs.analysis.selection import Options
from tunenet_logs.analysis.tuning import provenance_of, tune_log
from tunenet_logs.console import is_stdout, print_traceback
from tunenet_logs.errors import LogError, UsageError, WeightsError
from tunenet_logs.files import json_line, parse_json, real_path
from tunenet_logs.terminal import Progress, listed, one_line, short_name, terminal_columns
from tunenet_logs.writing.owned_path import OutputPlace

# ---- One log: tune it, write its results, and build its ledger row.

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


# ---- Ray cluster, whose machines share one file system.


def on_ray(
    cluster: Cluster,
    work: Callable[[Work], Result],
    items: Sequence[Work],
    lost: Callable[[Work], Result],
) -> Iterator[tuple[int, Result]]:
    """Map `work` over logs on a cluster; see `on_cluster`.

    Args:
        cluster: The cluster.
        work: Reads logs and writes results by paths that every machine sees.
        items: Logs to tune; paths are made absolute, as an actor has another working folder.
        lost: Builds the result of a log whose actor died twice.

    Raises:
        UsageError: Ray is not installed, nobody answers at the address, or the options fit no log.
    """
    absolute = [
        Work(real_path(item.log), real_path(item.name))
        if isinstance(item.log, Path)
        else replace(item, name=real_path(item.name))
        for item in items
    ]
    return on_cluster(cluster, work, absolute, lost)


# ---- Batch: map the work over the logs, and enter the results in the ledger.

MAX_SHOWN = 40  # logs of a batch whose results are kept to be shown one by one
_TELL_EVERY_S = 60.0  # where no bar is shown, a line tells how far a batch is
_NUMBER = re.compile(r"[-+]?[0-9][0-9.,]*(e[-+]?[0-9]+)?")

# Does work on every item somewhere, and gives the results as they come; see `streamed`.
Streamed = Callable[
    [Callable[[Work], Result], Sequence[Work], Callable[[Work], Result]],
    Iterable[tuple[int, Result]],
]


@dataclass(frozen=True)
class Order:
    """Logs of a batch, and how to tune them.

    Attributes:
        folder: Where results go; None for beside each log.
        keeps_ledger: Whether a ledger is kept there.
        resumes: Whether to skip logs that the ledger has, with the same contents, tuned under the
            same options.
    """

    logs: Sequence[FoundLog]
    options: Options = field(default_factory=Options)
    writing: Writing = field(default_factory=Writing)
    folder: Path | None = None
    keeps_ledger: bool = False
    resumes: bool = False


@dataclass
class BatchResult:
    """Result of a batch.

    Attributes:
        results: Of at most `MAX_SHOWN` logs; where there are more, of the first ones that failed.
        verdicts: Count of logs by verdict, skipped ones included.
        reasons: Count of logs that are not ok by reason, numbers in it ignored.
        skipped: Logs that were done before.
        failed: Logs that are rejected, or whose results could not be written.
        seconds: Wall time.
        ledger: None if none is kept.
    """

    results: list[Result]
    verdicts: Counter[str]
    reasons: Counter[str] = field(default_factory=Counter)
    skipped: int = 0
    failed: int = 0
    seconds: float = 0.0
    ledger: Path | None = None


def run_batch(
    order: Order,
    progress: Progress,
    stream: Streamed | None = None,
    jobs: int | None = None,
    after: Callable[[Ledger], None] | None = None,
    each: Callable[[Result], None] = lambda _result: None,
) -> BatchResult:
    """Tune every log, write its results, and enter it in the ledger.

    Args:
        order: The logs, and how to tune them.
        progress: Shows how many are done.
        stream: Maps the work; None for processes of this machine.
        jobs: Number of these processes; None for all cores.
        after: Called with the whole ledger at the end.
        each: Called with each result as it is done.

    Raises:
        UsageError: The options fit no log at all, or two logs would write the same results.
        LogError: The ledger cannot be written.
    """
    began_s = time.monotonic()
    names = result_names(order.logs, order.folder)
    works = [Work(one.log, name) for one, name in zip(order.logs, names, strict=True)]
    work = partial(tuned_and_written, options=order.options, writing=order.writing)
    gone = partial(lost, options=order.options)
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
            works = list(_to_do(works, kept, digest, batch))
        results = (
            stream(work, works, gone)
            if stream is not None
            else streamed(work, works, jobs, may_stay=True, lost=gone)
        )
        told = _Told(progress, len(works), began_s)
        counted = progress
        if len(works) == 1:  # how far its own stages are says more than none of one
            stack.enter_context(progress.stages(one_line(works[0].log)))
            counted = replace(progress, quiet=True)
        with counted.bar(len(works), "tuning", "log") as bar:
            for at, result in results:
                if kept is not None:
                    kept.append({**result.entry, "options": digest})
                each(result)
                verdict = result.row.record.verdict
                batch.verdicts[verdict] += 1
                batch.reasons.update(_kinds(result.row.record.reason))
                batch.failed += verdict == "rejected" or result.trouble is not None
                if len(works) <= MAX_SHOWN or (
                    len(shown) < MAX_SHOWN
                    and (verdict == "rejected" or result.trouble or result.was)
                ):
                    shown[at] = result
                if len(works) > 1:
                    bar.set_postfix_str(_counted(batch.verdicts), refresh=False)
                bar.update(1)
                told.update(batch)
        if kept is not None and after is not None:
            after(kept.ledger)
    batch.results = [shown[at] for at in sorted(shown)]
    batch.seconds = time.monotonic() - began_s
    return batch


def _to_do(works: Iterable[Work], kept: Journal, digest: str, batch: BatchResult) -> Iterator[Work]:
    """Yield the logs that the ledger does not have as they are now; count the others."""
    for work in works:
        row = kept.ledger.row(ledger_key(work.log))
        if (
            row is None
            or row.get("error") is not None
            or row.get("options") != digest
            or row.get("results") != ledger_key(work.name)
            or not _is_same(work, row.get("bytes"), row.get("modified_ns"), row.get("sha256"))
        ):
            yield work
            continue
        batch.skipped += 1
        batch.verdicts[str(row["verdict"])] += 1
        batch.reasons.update(_kinds(row.get("reason")))
        batch.failed += row["verdict"] == "rejected"


def _is_same(work: Work, size: object, modified_ns: object, sha256: object) -> bool:
    """Return whether a log is unchanged, and its results are there."""
    if not isinstance(work.log, Path):
        return _is_same_afar(work.log, size, modified_ns, sha256)
    state = LogState.of(work.log)
    report = result_files(work.name)[0]
    if state.size < 0 or not sha256 or report.is_symlink() or not report.is_file():
        return state.size < 0 and size == -1  # it could not be read, and cannot now
    if state.size != size:
        return False
    if state.modified_ns == modified_ns:
        return True
    try:
        return log_sha256(work.log) == sha256
    except OSError:
        return False


def _is_same_afar(log: Address, size: object, modified_ns: object, sha256: object) -> bool:
    """Return whether a remote log is unchanged, by state or, without one, by hash."""
    state = remote_state(log)
    if state.size >= 0 and (state.size != size or state.modified_ns):
        return (state.size, state.modified_ns) == (size, modified_ns)
    with suppress(LogError, OSError), fetched(log) as copy:  # nobody says when it changed
        return log_sha256(copy) == sha256
    return False


def _kinds(reason: object) -> list[str]:
    """Return the first clause of a reason, without its numbers; nothing if ok."""
    if reason is None:
        return []
    return [_NUMBER.sub("…", re.split(r"; | \(", str(reason))[0])]


class _Told:
    """Report a batch's progress from time to time where no bar does."""

    def __init__(self, progress: Progress, total: int, began_s: float) -> None:
        self._progress, self._total, self._began_s = progress, total, began_s
        self._done = 0
        self._next_s = began_s + _TELL_EVERY_S

    def update(self, batch: BatchResult) -> None:
        """Count one more log."""
        self._done += 1
        now_s = time.monotonic()
        if now_s < self._next_s or self._progress.shows_bars:
            return
        self._next_s = now_s + _TELL_EVERY_S
        rate = self._done / (now_s - self._began_s)
        left_s = (self._total - self._done) / rate
        self._progress.say(
            f"tuning: {self._done} of {self._total} logs, {rate:.1f} a second, "
            f"{left_s / 60:.0f} min left: {_counted(batch.verdicts)}"
        )


def _counted(verdicts: Counter[str]) -> str:
    """Format the count of logs by verdict."""
    return ", ".join(f"{verdicts[name]} {name}" for name in ("ok", "suspect", "rejected"))


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


def check_lines(path: Path, order: Order, *, overwrite: bool) -> None:
    """Check before hours of work that the lines can be written, and what they would replace.

    Args:
        path: Where they go.
        order: Of the batch, whose logs and results they never replace.
        overwrite: Whether they may replace a file that holds no such lines.

    Raises:
        UsageError: They cannot be written.
    """
    if is_stdout(path):
        return
    place = real_path(path)
    names = [*result_names(order.logs, order.folder), (order.folder or Path()) / OF_BATCH]
    if any(place == real_path(file) for name in names for file in result_files(name)):
        raise UsageError(f"{path}: is where a log's own results go; give --json another file")
    check_batch_file(lines_place(path, order, overwrite=overwrite), order.logs, order.folder)


def lines_place(path: Path, order: Order, *, overwrite: bool) -> OutputPlace:
    """Return the output place of the lines, which may replace those of the same logs."""
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
    return OutputPlace(path, "file of --json", knows, of, elsewhere, overwrite=overwrite)


@contextmanager
def result_lines(place: OutputPlace | None) -> Iterator[Callable[[Result], None]]:
    """Open a sink for results as they are done: a file, standard output, or nothing.

    Raises:
        LogError: The file cannot be written.
    """
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


def closing(order: Order, csv: OutputPlace | None, ledger: Ledger) -> None:
    """Write what is made of a whole ledger: its overview, and a CSV table on request.

    Raises:
        LogError: One cannot be written.
    """
    if csv is not None:
        with writable(csv.path, _DISK_REMEDY):
            write_csv(ledger, csv)
    if order.folder is not None:
        place = overview_place(order.folder)
        with writable(place.path, _DISK_REMEDY), place.replacing() as unfinished:
            write_overview(ledger.columns, unfinished)


def print_table(results: Sequence[Result]) -> None:
    """Print a table of the logs that could be read."""
    rows = [result.row for result in results if result.row.is_read]
    if rows:
        print(table(rows, terminal_columns()))


def print_remarks(results: Sequence[Result]) -> None:
    """Print the warnings of logs, and why some could not be read, to standard error."""
    for result in results:
        record = result.row.record
        remarks = record.warnings if result.row.is_read else (record.reason, *record.warnings)
        for remark in () if result.trouble and not result.row.is_read else remarks:
            print(one_line(f"tunenet-tune: {result.row.log}: {remark}"), file=sys.stderr)
        if result.was:
            print(one_line(f"tunenet-tune: {result.was}"), file=sys.stderr)
        if result.trouble:
            print(one_line(f"tunenet-tune: {result.trouble}"), file=sys.stderr)


def print_details(results: Sequence[Result]) -> None:
    """Print each log's topic, window, method, timing and every check to standard error."""
    known = f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"
    print(f"tunenet-logs {__version__}, {known}", file=sys.stderr)
    for result in results:
        for line in _details(result.row.record):
            print(one_line(f"{result.row.log}: {line}"), file=sys.stderr)


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


def summary(batch: BatchResult, count: int) -> str:
    """Format the summary below the table of a batch of `count` logs."""
    lines: list[str] = []
    records = [result.row.record for result in batch.results]
    engines = {record.simulator["engine"] for record in records if record.simulator}
    if engines:
        lines += ["", f"simulated by {', '.join(sorted(engines))}"]
    if batch.ledger is not None:
        lines += ["", *_of_verdicts(batch, count)]
    reviews = [one_line(result.review) for result in batch.results if result.review]
    if reviews and count <= MAX_SHOWN:
        lines.append("review: " + "\n        ".join(f"rerun {review}" for review in reviews))
    if batch.ledger is not None:
        lines.append(f"ledger: {one_line(batch.ledger)}")
        lines.append(f"        rerun {one_line(overview_file(batch.ledger.parent))}")
    return "".join(f"{line}\n" for line in lines)


def _of_verdicts(batch: BatchResult, count: int) -> list[str]:
    done = count - batch.skipped
    rate = f", {done / batch.seconds:.1f} a second" if done and batch.seconds > 0 else ""
    before = f"; {batch.skipped} were done before" if batch.skipped else ""
    lines = [f"{count} logs: {done} tuned in {_lasting(batch.seconds)}{rate}{before}"]
    for name in ("ok", "suspect", "rejected"):
        number = batch.verdicts[name]
        if number:
            lines.append(f"  {name:8}  {number:6}  {100 * number / count:5.1f} %")
    lines += [
        f"    {number} x {short_name(reason, _MAX_REASON_CHARACTERS)}"
        for reason, number in batch.reasons.most_common(_MAX_REASONS)
    ]
    return lines


def _lasting(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"
