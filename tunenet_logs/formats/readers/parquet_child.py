"""Read columns of a Parquet file in a process of its own, with limited memory and CPU time.

Sizes in a Parquet file are claims, and its reader believes them: here the system ends what takes
too much. Run as a script, with the file's path. It writes a line of JSON that describes the
columns, reads a line of JSON that names some of them, and writes those: for each a line of JSON and
the bytes of its array.

With a bound of cells behind the path, it writes a table of texts and numbers, a line of JSON with
its columns for some rows at a time, and an empty object at the end.
"""

from __future__ import annotations

import json
import math
import resource
import sys
from typing import Any

MEMORY_BYTES = 450 * 1024**2  # more than the libraries themselves have
CPU_S = 9  # of reading
MAX_ROWS = 2_000_000
MAX_VALUES = 12_000_000  # of the columns that are read: 96 MB
MAX_COLUMNS = 5000  # of a file, those within others counted
_MAX_WIDTH = 200
_BATCH_ROWS = 16_384
_MAX_TEXT = 60
_LINE_CHARACTERS = 4_000_000
_ROWS_AT_ONCE = 200
_OF_ROWS = ("string", "large_string", "int64", "double")  # of a table that is read by rows


class TooLargeError(ValueError):
    """A file that claims or holds more than the limit."""


def main(path: str, most_cells: int | None = None) -> None:
    """Serve the columns of one file; see the module."""
    import pyarrow.parquet as pq

    _limit()
    with pq.ParquetFile(path, pre_buffer=False, thrift_string_size_limit=2**24) as file:
        if most_cells is not None:
            _send_rows(file, most_cells)
            return
        columns = _described(file)
        _say({"rows": file.metadata.num_rows, "columns": columns})
        wanted = json.loads(sys.stdin.readline() or "[]")
        for name in wanted:
            _send(name, file, sum(columns[one]["width"] or 1 for one in wanted))


def _limit() -> None:
    """Limit memory and CPU time of this process, regardless of what the file claims."""
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES, used + MEMORY_BYTES))
    spent = resource.getrusage(resource.RUSAGE_SELF)
    seconds = int(spent.ru_utime + spent.ru_stime) + CPU_S
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _say(words: object) -> None:
    sys.stdout.buffer.write(json.dumps(words).encode() + b"\n")
    sys.stdout.buffer.flush()


def _described(file: Any) -> dict[str, dict[str, Any]]:
    """Return kind and width of each column, nested ones by their joined names."""
    if file.metadata.num_columns > MAX_COLUMNS:
        raise TooLargeError(
            f"has {file.metadata.num_columns} columns, over the limit of {MAX_COLUMNS}"
        )
    if file.metadata.num_rows > MAX_ROWS:
        raise TooLargeError(f"claims {file.metadata.num_rows} rows, over the limit of {MAX_ROWS}")
    found: dict[str, dict[str, Any]] = {}
    for field in file.schema_arrow:
        _describe(field.name, field.type, found)
    lists = [name for name, one in found.items() if one["width"] is None]
    for name in lists:
        batch = next(file.iter_batches(1, columns=[name], use_threads=False), None)
        row = None if batch is None or not batch.num_rows else _inner(batch, name)[0].as_py()
        found[name]["width"] = len(row) if row and len(row) <= _MAX_WIDTH else 0
    return found


def _describe(name: str, kind: Any, found: dict[str, dict[str, Any]]) -> None:
    """Describe a column: a number ("n"), a time ("t"), a text ("s") or something else ("")."""
    from pyarrow import types

    if types.is_struct(kind):
        for inner in kind:
            _describe(f"{name}.{inner.name}", inner.type, found)
        return
    if types.is_dictionary(kind):
        kind = kind.value_type
    width: int | None = 0
    if types.is_fixed_size_list(kind):
        width, kind = kind.list_size if kind.list_size <= _MAX_WIDTH else 0, kind.value_type
        kind = kind if width else None
    elif types.is_list(kind) or types.is_large_list(kind):
        width, kind = None, kind.value_type
    found[name] = {"width": width, "kind": "" if kind is None else _kind(kind)}
    if not found[name]["kind"]:
        found[name]["width"] = 0


def _kind(kind: Any) -> str:
    from pyarrow import types

    if types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind):
        return "n"
    if types.is_boolean(kind):
        return "n"
    if types.is_timestamp(kind) or types.is_duration(kind):
        return "t"
    return "s" if types.is_string(kind) or types.is_large_string(kind) else ""


def _inner(batch: Any, name: str) -> Any:
    """Return a batch's column, which may be nested in a struct."""
    for at in range(batch.num_columns):
        field = batch.schema.field(at)
        if name == field.name:
            return batch.column(at)
        if name.startswith(f"{field.name}."):
            column, rest = batch.column(at), name[len(field.name) + 1 :]
            while True:
                inner = next(
                    one
                    for one in column.type
                    if rest == one.name or rest.startswith(f"{one.name}.")
                )
                column = column.field(inner.name)
                if rest == inner.name:
                    return column
                rest = rest[len(inner.name) + 1 :]
    raise KeyError(name)


def _send(name: str, file: Any, width: int) -> None:
    """Write one column's values in all rows as an array."""
    import numpy as np

    parts: list[Any] = []
    count = 0
    for batch in file.iter_batches(_BATCH_ROWS, columns=[name], use_threads=False):
        parts.append(_array(_inner(batch, name)))
        count += batch.num_rows
        if count * width > MAX_VALUES or count > MAX_ROWS:
            raise TooLargeError(
                f"has over {MAX_VALUES} values to read; name fewer columns, or split it"
            )
    whole = np.concatenate(parts) if parts else np.zeros(0)
    _say({"name": name, "dtype": whole.dtype.str, "shape": whole.shape})
    sys.stdout.buffer.write(np.ascontiguousarray(whole).tobytes())
    sys.stdout.buffer.flush()


def _send_rows(file: Any, most_cells: int) -> None:
    """Write all rows of a table of texts and numbers, within the bound of cells."""
    names = file.schema_arrow.names
    if len(set(names)) < len(names):
        raise TooLargeError("two of its columns have one name")
    for field in file.schema_arrow:
        if str(field.type) not in _OF_ROWS:
            raise TooLargeError(f"column {field.name[:60]!r} holds neither text nor numbers")
    cells = file.metadata.num_rows * len(names)
    if cells > most_cells:
        raise TooLargeError(f"claims {cells} cells, over the limit of {most_cells}")
    cells = 0
    for batch in file.iter_batches(_ROWS_AT_ONCE, use_threads=False):
        cells += batch.num_rows * len(names)
        if cells > most_cells:
            raise TooLargeError(f"has over {most_cells} cells")
        line = json.dumps({"rows": dict(zip(names, map(_cells, batch.columns), strict=True))})
        if len(line) > _LINE_CHARACTERS:
            raise TooLargeError("holds texts that are longer than any in such a table")
        sys.stdout.buffer.write(line.encode() + b"\n")
    _say({})


def _cells(column: Any) -> list[Any]:
    """Return values as JSON has them: null for none, and for a number that is not finite."""
    values = column.to_pylist()
    if str(column.type) != "double":
        return values
    return [None if one is None or not math.isfinite(one) else one for one in values]


def _array(column: Any) -> Any:
    """Return values as NumPy has them: NaN for none, lists as rows."""
    import numpy as np
    import pyarrow as pa
    from pyarrow import types

    if types.is_dictionary(column.type):
        column = column.dictionary_decode()
    kind = column.type
    if types.is_timestamp(kind) or types.is_duration(kind):
        unit = pa.timestamp("ns") if types.is_timestamp(kind) else pa.duration("ns")
        return column.cast(unit).to_numpy(zero_copy_only=False).astype("i8").astype("M8[ns]")
    if types.is_string(kind) or types.is_large_string(kind):
        texts = [text[:_MAX_TEXT] if text else "" for text in column.to_pylist()]
        return np.array(texts, f"U{_MAX_TEXT}")
    if types.is_fixed_size_list(kind) or types.is_list(kind) or types.is_large_list(kind):
        flat = _array(column.flatten()).astype("f8")
        if len(column) and len(flat) % len(column) == 0:
            return flat.reshape(len(column), -1)
        raise TooLargeError("its lists have several lengths")
    if types.is_integer(kind) and not column.null_count:
        return column.cast(pa.int64()).to_numpy(zero_copy_only=False)
    return column.cast(pa.float64()).to_numpy(zero_copy_only=False)


if __name__ == "__main__":
    try:
        main(sys.argv[1], *map(int, sys.argv[2:]))
    except MemoryError:
        _say({"error": "it claims more memory than any log needs"})
    except TooLargeError as error:
        _say({"error": str(error)})
    except Exception as error:  # noqa: BLE001 (whatever a library raises at a damaged file)
        _say({"error": f"it is damaged ({str(error).partition(chr(10))[0][:160]})"})
