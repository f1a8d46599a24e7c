"""Run a batch: skip logs that are done, tune the others, and keep the ledger."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from analysis.batch.found_logs import FoundLog
from analysis.batch.ledger import Journal, Ledger, journal, ledger_file
from analysis.batch.ledger_row import LogState, ledger_key
from analysis.batch.one_log import Result, Work, Writing, lost, tuned_and_written
from analysis.batch.options_digest import options_digest
from analysis.batch.result_names import result_files, result_names
from analysis.processes import streamed
from analysis.result_files import log_sha256
from analysis.selection import Options
from tunenet_logs.addresses import Address
from tunenet_logs.errors import LogError
from tunenet_logs.terminal import Progress, one_line

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
    from analysis.batch.remote_logs import fetched, remote_state

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
