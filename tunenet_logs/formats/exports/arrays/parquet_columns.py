"""Read columns of a Parquet file through a resource-limited process; see `parquet_child`."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from threading import Timer
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.errors import LogError
from tunenet_logs.stopping import end_child

_CHILD = Path(__file__).with_name("parquet_child.py")

_MAX_LINE = 4 * 1024**2  # of what describes a file, or some rows
_MAX_BYTES = 512 * 1024**2  # of one column; texts have 240 bytes each
_MAX_S = 60.0  # what the process may wait for its disk, beside its time of reading


@dataclass(frozen=True)
class ParquetColumn:
    """One column, which may be nested in a struct.

    Attributes:
        name: nested names joined by dots.
        kind: "n" of numbers, "t" of times, "s" of texts, "" of what is not read.
        width: values in each row's list; 0 of a column of single values.
    """

    name: str
    kind: str
    width: int


Choose = Callable[[Sequence[ParquetColumn]], Sequence[str]]  # which columns to read


def parquet_columns(path: Path, choose: Choose) -> dict[str, NDArray[Any]]:
    """Read the columns that `choose` selects, by name: shape (T,), or (T, width) for lists.

    Raises:
        LogError: `pyarrow` is not installed, or the file is damaged or too large; or `choose`
            says so.
    """
    with _child(path) as (wishes, answers):
        return _served(path, wishes, answers, choose)


def parquet_rows(path: Path, most_cells: int) -> Iterator[list[dict[str, Any]]]:
    """Yield rows, in batches, of a table whose columns are texts and numbers.

    Raises:
        LogError: `pyarrow` is not installed, or the file is damaged, too large or another table.
    """
    with _child(path, str(most_cells)) as (_, answers):
        while said := _answer(path, answers).get("rows"):
            yield [
                dict(zip(said, cells, strict=True)) for cells in zip(*said.values(), strict=True)
            ]


@contextmanager
def _child(path: Path, *words: str) -> Iterator[tuple[IO[bytes], IO[bytes]]]:
    """Open the pipes to the process that reads a file; raise LogError without `pyarrow`."""
    if find_spec("pyarrow") is None:
        raise LogError(f"{path}: Parquet needs pyarrow: pip install 'tunenet-logs[tables]'")
    child = subprocess.Popen(  # noqa: S603 (our own script, without a shell)
        [sys.executable, "-P", str(_CHILD), str(path.absolute()), *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    timer = Timer(_MAX_S, child.kill)
    timer.start()
    try:
        assert child.stdin is not None
        assert child.stdout is not None
        yield child.stdin, child.stdout
    finally:
        timer.cancel()
        end_child(child)


def _served(
    path: Path, wishes: IO[bytes], answers: IO[bytes], choose: Choose
) -> dict[str, NDArray[Any]]:
    said = _answer(path, answers)
    columns = [
        ParquetColumn(name, one["kind"], one["width"]) for name, one in said["columns"].items()
    ]
    wanted = list(dict.fromkeys(choose(columns)))
    with suppress(BrokenPipeError):  # its answer says why
        wishes.write(json.dumps(wanted).encode() + b"\n")
        wishes.flush()
    found: dict[str, NDArray[Any]] = {}
    for name in wanted:
        head = _answer(path, answers)
        dtype, shape = np.dtype(head["dtype"]), tuple(head["shape"])
        size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
        if size > _MAX_BYTES:
            raise LogError(f"{path}: Parquet column {name[:60]!r} has {size} bytes; split the file")
        data = answers.read(size)
        if len(data) < size:
            raise _ended(path)
        found[name] = np.frombuffer(data, dtype).reshape(shape)
    return found


def _answer(path: Path, answers: IO[bytes]) -> dict[str, Any]:
    line = answers.readline(_MAX_LINE)
    if not line.endswith(b"\n"):
        raise _ended(path)
    said = json.loads(line)
    if "error" in said:
        raise LogError(f"{path}: Parquet file that is not read: {said['error']}", "write it again")
    return said


def _ended(path: Path) -> LogError:
    """Return the error of a child process that the system ended."""
    return LogError(
        f"{path}: Parquet file that is not read: it is damaged, or takes more memory or time than "
        "any log; write it again, in smaller files"
    )
