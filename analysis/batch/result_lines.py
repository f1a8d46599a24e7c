"""Results for scripts (`--json`): one object a log on a line of its own, as each is done."""

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
from analysis.record_json import MOST_RECORD_BYTES, record_fields
from analysis.result_files import writable
from tunenet_logs.commandline import is_stdout
from tunenet_logs.errors import UsageError
from tunenet_logs.json_lines import json_line
from tunenet_logs.output.owned_file import OutputPlace
from tunenet_logs.regular_file import real_path
from tunenet_logs.small_files import parse_json
from tunenet_logs.terminal import listed

_PATH = re.compile(rb'^\{"path": ("(?:[^"\\]|\\.)*+"),', re.MULTILINE)
"""How each line begins."""

_KEYS = frozenset(("path", "log", "verdict", "parameters", "provenance", "json", "rrd", "error"))
"""Some of those that each has."""

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
    check_batch_file(lines_place(path, order, overwrite=overwrite), order.logs, order.folder)


def lines_place(path: Path, order: Order, *, overwrite: bool) -> OutputPlace:
    """Where the lines go: over those of the same logs, by their paths."""
    logs = {name for one in order.logs for name in (str(one.log), ledger_key(one.log))}

    def knows(file: BinaryIO) -> Sequence[str] | None:
        data = file.read(MOST_RECORD_BYTES)
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
    """What takes each result as it is done: it goes to a file, to standard output, or nowhere.

    Raises:
        LogError: the file cannot be written.
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
