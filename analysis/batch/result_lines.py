"""Results for scripts (`--json`): one object a log on a line of its own, as each is done."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from analysis.batch.batch_file import check_batch_file
from analysis.batch.one_log import Result
from analysis.batch.result_names import OF_BATCH, result_files, result_names
from analysis.batch.run import Order
from analysis.record_json import record_fields
from analysis.result_files import replacing, writable
from tunenet_logs.commandline import is_stdout
from tunenet_logs.errors import UsageError
from tunenet_logs.json_lines import json_line
from tunenet_logs.regular_file import real_path

_BEGINS = b'{"path": '
"""A file of such lines."""

_ELSEWHERE = "choose another file with --json; what was tuned is in the logs' own JSONs"


def result_fields(result: Result) -> dict[str, Any]:
    """What came of a log: its path, what its JSON holds but the curves, and where its files are."""
    return {
        "path": str(result.row.log),
        **record_fields(result.row.record),
        "json": result.report and str(result.report),
        "rrd": result.review and str(result.review),
        "error": result.entry["error"],
    }


def check_lines(path: Path, order: Order, *, overwrite: bool) -> None:
    """Find out before hours of work whether the lines can be written, and over what.

    Args:
        path: where they go.
        order: of the batch, whose logs and results they never replace.
        overwrite: whether they may replace a file that holds no such lines.

    Raises:
        UsageError: they cannot; says why.
    """
    if is_stdout(path):
        return
    place = real_path(path)
    names = [*result_names(order.logs, order.folder), (order.folder or Path()) / OF_BATCH]
    if any(place == real_path(file) for name in names for file in result_files(name)):
        raise UsageError(f"{path}: is where a log's own results go; give --json another file")
    check_batch_file(path, "--json", _BEGINS, order.logs, order.folder, overwrite=overwrite)


@contextmanager
def result_lines(path: Path | None) -> Iterator[Callable[[Result], None]]:
    """What takes each result as it is done: it goes to a file, to standard output, or nowhere.

    Raises:
        LogError: the file cannot be written.
    """
    if path is None:
        yield lambda _result: None
    elif is_stdout(path):
        yield lambda result: print(json_line(result_fields(result)), flush=True)
    else:
        with writable(path, _ELSEWHERE):
            path.parent.mkdir(parents=True, exist_ok=True)  # the folder of the results
        with replacing(path) as partial, partial.open("w", encoding="ascii") as file:

            def write(result: Result) -> None:
                with writable(path, _ELSEWHERE):
                    print(json_line(result_fields(result)), file=file, flush=True)

            yield write
