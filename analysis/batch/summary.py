"""Print a batch's results: log by log where they are few, else by verdict."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterator, Sequence

from analysis.batch.ledger import Ledger, overview_file, overview_place
from analysis.batch.one_log import Result
from analysis.batch.run import MAX_SHOWN, BatchResult, Order
from analysis.batch.text_table import write_csv
from analysis.record import Record
from analysis.result_files import writable
from analysis.terminal_table import table
from tunenet_logs import __version__
from tunenet_logs.output.owned_file import OutputPlace
from tunenet_logs.terminal import one_line, short_name, terminal_columns

_OF_SIMULATOR = ("engine", "preset", "step_hz")

_ELSEWHERE = "free some space and run it again with --resume: the logs are done"

_MAX_REASONS, _REASON_CHARACTERS = 5, 100  # of logs that are not ok, the most frequent ones, cut


def closing(order: Order, csv: OutputPlace | None, ledger: Ledger) -> None:
    """Write what is made of a whole ledger: its overview, and a CSV table on request.

    Raises:
        LogError: One cannot be written.
    """
    if csv is not None:
        with writable(csv.path, _ELSEWHERE):
            write_csv(ledger, csv)
    if order.folder is not None:
        from analysis.review.overview import write_overview

        place = overview_place(order.folder)
        with writable(place.path, _ELSEWHERE), place.replacing() as unfinished:
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
        f"    {number} x {short_name(reason, _REASON_CHARACTERS)}"
        for reason, number in batch.reasons.most_common(_MAX_REASONS)
    ]
    return lines


def _lasting(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"
