"""Write results as JSON lines (`--json`), one object per log, as each is done."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from analysis.batch.batch_file import check_batch_file
from analysis.batch.ledger_row import ledger_key
from analysis.batch.one_log import Result
from analysis.batch.result_names import OF_BATCH, result_files, result_names
from analysis.batch.run import Order
from analysis.record_json import MAX_RECORD_BYTES, record_fields
from analysis.result_files import writable
from tunenet_logs.commandline import is_stdout
from tunenet_logs.errors import UsageError
from tunenet_logs.json_lines import json_line
from tunenet_logs.output.owned_file import OutputPlace
from tunenet_logs.regular_file import real_path
from tunenet_logs.small_files import parse_json
from tunenet_logs.terminal import listed

_PATH = re.compile(rb'^\{"path": ("(?:[^"\\]|\\.)*+"),', re.MULTILINE)  # how each line begins
# Some of those that each has.
_KEYS = frozenset(("path", "log", "verdict", "parameters", "provenance", "json", "rrd", "error"))

_ELSEWHERE = "choose another file with --json; what was tuned is in the logs' own JSONs"


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
        with writable(path, _ELSEWHERE):
            path.parent.mkdir(parents=True, exist_ok=True)  # the folder of the results
        with place.replacing() as partial, partial.open("w", encoding="ascii") as file:

            def write(result: Result) -> None:
                with writable(path, _ELSEWHERE):
                    print(json_line(result_fields(result)), file=file, flush=True)

            yield write
