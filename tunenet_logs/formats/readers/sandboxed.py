"""Read files by libraries that may crash, or allocate what a file claims: this runs in the sandbox.

Each function yields tables: words, and columns by name. So that the child starts quickly, nothing
is imported here before it is needed.
"""

from __future__ import annotations

import datetime as dt
import json
import math
import re
from contextlib import suppress
from itertools import islice
from pathlib import Path

from tunenet_logs.formats.sandbox import Refusal

TYPE_CHECKING = False  # the child imports as little as it can
if TYPE_CHECKING:
    import zipfile
    from collections.abc import Callable, Iterable, Iterator
    from typing import Any

    Yields = Iterator[tuple[Any, dict[str, Any]]]

MAX_BYTES = 128 * 1024**2  # of all arrays of a file
_MAX_ARRAYS = 5000  # in a file
_MAX_DEPTH = 6  # of names within names


class _Arrays:
    """Arrays of a file by name, within bounds, and why others are not used."""

    def __init__(self) -> None:
        self.arrays: dict[str, Any] = {}
        self.unused: dict[str, str] = {}
        self._left = MAX_BYTES

    def add(self, name: str, dtype: Any, shape: tuple[int, ...], read: Callable[[], Any]) -> None:
        """Read an array of numbers, times or short texts with at most two long sides."""
        if dtype.names is not None and not dtype.hasobject:
            for field in dtype.names:
                self.add(f"{name}.{field}", dtype[field], shape, lambda one=field: read()[one])
            return
        if dtype.subdtype is not None:
            dtype, inner = dtype.subdtype
            shape = (*shape, *inner)
        long = [length for length in shape if length != 1]
        size = math.prod(shape) * dtype.itemsize
        if dtype.kind not in "biufcMSU" or dtype.hasobject:
            self.leave(name, "no array of numbers")
        elif len(long) > 2:
            self.leave(name, f"its shape {' x '.join(map(str, shape))} is no table's")
        elif size > self._left:
            raise Refusal(
                f"it holds over the limit of {MAX_BYTES >> 20} MiB of numbers", "save fewer of them"
            )
        else:
            self.leave(name, "")
            self._left -= size
            found = read()
            found = found.real if dtype.kind == "c" else found
            self.arrays[name] = found.reshape(long or [1], order="F" if long == [*shape] else "C")

    def leave(self, name: str, why: str) -> None:
        """Note why an array is not used; "" of one that is."""
        if len(self.arrays) + len(self.unused) >= _MAX_ARRAYS:
            raise Refusal(f"it holds over {_MAX_ARRAYS} variables", "save fewer of them")
        if why:
            self.unused[name[:200]] = why


# ---- Parquet and Arrow: columns, or rows of a table of texts and numbers.

_MAX_ROWS = 2_000_000
MAX_VALUES = 12_000_000  # of the columns that are read: 96 MB
_MAX_COLUMNS = 5000  # of a file, those within others counted
_MAX_WIDTH = 200  # of a list
_BATCH_ROWS = 16_384
_MAX_TEXT = 60  # characters of a text's cell


def table_columns(path: str) -> Yields:
    """Describe a table's columns: each one's kind, and the length of its lists (0 for none)."""
    schema, batches, rows = _opened(path)
    if rows > _MAX_ROWS:
        raise Refusal(f"claims {rows} rows, over the limit of {_MAX_ROWS}")
    found: dict[str, dict[str, Any]] = {}
    for field in schema:
        _describe(field.name, field.type, found)
    if len(found) > _MAX_COLUMNS:
        raise Refusal(f"has {len(found)} columns, over the limit of {_MAX_COLUMNS}")
    for name in [name for name, one in found.items() if one["width"] is None]:
        batch = next(batches(1, [name]), None)
        row = None if batch is None or not batch.num_rows else _inner(batch, name)[0].as_py()
        found[name]["width"] = len(row) if row and len(row) <= _MAX_WIDTH else 0
    yield found, {}


def table_arrays(path: str, names: list[str], width: int) -> Yields:
    """Yield columns of a table as arrays; `width` counts the values of a row of all."""
    import numpy as np

    _, batches, _ = _opened(path)
    for name in names:
        parts: list[Any] = []
        count = 0
        for batch in batches(_BATCH_ROWS, [name]):
            parts.append(_array(_inner(batch, name)))
            count += batch.num_rows
            if count * width > MAX_VALUES or count > _MAX_ROWS:
                raise Refusal(
                    f"has over {MAX_VALUES} values to read; name fewer columns, or split it"
                )
        yield {}, {name: np.concatenate(parts) if parts else np.zeros(0)}


def table_rows(path: str, most_cells: int) -> Yields:
    """Yield a table's cells by column, some rows at a time, within the bound of cells."""
    schema, batches, rows = _opened(path)
    names = schema.names
    if len(set(names)) < len(names):
        raise Refusal("two of its columns have one name")
    for field in schema:
        if str(field.type) not in ("string", "large_string", "int64", "double"):
            raise Refusal(f"column {field.name[:60]!r} holds neither text nor numbers")
    if rows * len(names) > most_cells:
        raise Refusal(f"claims {rows * len(names)} cells, over the limit of {most_cells}")
    cells = 0
    for batch in batches(200, names):
        cells += batch.num_rows * len(names)
        if cells > most_cells:
            raise Refusal(f"has over {most_cells} cells")
        found = dict(zip(names, map(_cells, batch.columns), strict=True))
        if len(json.dumps(found)) > 4_000_000:
            raise Refusal("holds texts that are longer than any in such a table")
        yield found, {}


def _opened(path: str) -> tuple[Any, Callable[[int, list[str]], Iterator[Any]], int]:
    """Open a Parquet or Arrow file: its schema, its batches by columns, and its rows, if said."""
    import pyarrow as pa

    with open(path, "rb") as file:
        start = file.read(6)
    if start.startswith(b"PAR1"):
        import pyarrow.parquet as pq

        table = pq.ParquetFile(path, pre_buffer=False, thrift_string_size_limit=2**24)
        if table.metadata.num_columns > _MAX_COLUMNS:
            raise Refusal(
                f"has {table.metadata.num_columns} columns, over the limit of {_MAX_COLUMNS}"
            )

        def parquet_batches(rows: int, names: list[str]) -> Iterator[Any]:
            return table.iter_batches(rows, columns=names, use_threads=False)

        return table.schema_arrow, parquet_batches, table.metadata.num_rows

    def batches(rows: int, names: list[str]) -> Iterator[Any]:
        used = {name for name in schema.names for one in names if f"{one}.".startswith(f"{name}.")}
        with opened() as reader:
            count = getattr(reader, "num_record_batches", None)
            some = map(reader.get_batch, range(count)) if count is not None else reader
            for batch in some:
                batch.validate(full=True)
                kept = batch.select([name for name in schema.names if name in used])
                for first in range(0, batch.num_rows, max(rows, _BATCH_ROWS)):
                    yield kept.slice(first, max(rows, _BATCH_ROWS))

    def opened() -> Any:
        source = pa.memory_map(path)
        return pa.ipc.open_file(source) if start == b"ARROW1" else pa.ipc.open_stream(source)

    with opened() as reader:
        schema = reader.schema
    return schema, batches, 0


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
        width, kind = kind.list_size, kind.value_type
    elif types.is_list(kind) or types.is_large_list(kind):
        width, kind = None, kind.value_type
    letters = {
        "n": (types.is_integer, types.is_floating, types.is_decimal, types.is_boolean),
        "t": (types.is_timestamp, types.is_duration),
        "s": (types.is_string, types.is_large_string),
    }
    letter = next((one for one, are in letters.items() if any(is_one(kind) for is_one in are)), "")
    letter = "" if width is not None and width > _MAX_WIDTH else letter
    found[name] = {"width": width if letter else 0, "kind": letter}


def _inner(batch: Any, name: str) -> Any:
    """Return a batch's column, which may be nested in a struct."""
    for at in range(batch.num_columns):
        field, column = batch.schema.field(at), batch.column(at)
        if name != field.name and not name.startswith(f"{field.name}."):
            continue
        own, rest = field.name, name[len(field.name) + 1 :]
        while name != own:
            inner = next(
                one for one in column.type if rest == one.name or rest.startswith(f"{one.name}.")
            )
            column, own = column.field(inner.name), f"{own}.{inner.name}"
            rest = rest[len(inner.name) + 1 :]
        return column
    raise KeyError(name)


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
        raise Refusal("its lists have several lengths")
    if types.is_integer(kind) and not column.null_count:
        return column.cast(pa.int64()).to_numpy(zero_copy_only=False)
    return column.cast(pa.float64()).to_numpy(zero_copy_only=False)


# ---- Workbooks, and archives of tables: the text of each sheet.

_MAX_UNPACKED_BYTES = 384 * 1024**2
_MAX_SHEETS = 200
_MAX_SHEETS_TEXT = 64 * 1024**2  # characters
_MAX_CELL = 1000  # characters
# What stands in a cell whose formula failed.
_EXCEL_ERRORS = ("#N/A", "#DIV/0!", "#VALUE!", "#REF!", "#NAME?", "#NUM!", "#NULL!")


def sheets(path: str, is_archive: bool) -> Yields:
    """Yield each sheet's name, and then its rows as texts with tabs between cells."""
    room = _MAX_SHEETS_TEXT
    for number, (name, rows) in enumerate(_archive(path) if is_archive else _book(path)):
        if number >= _MAX_SHEETS:
            raise Refusal(f"holds over {_MAX_SHEETS} sheets", "save those of the log alone")
        yield name[:200], {}
        some = iter(rows)
        while block := list(islice(some, 500)):
            room -= sum(map(len, block)) + 40 * len(block)  # what a row costs beside its text
            if room < 0:
                raise Refusal(
                    f"holds over {_MAX_SHEETS_TEXT >> 20} MiB of text",
                    "save each sheet alone, as CSV",
                )
            yield block, {}


def _checked_zip(path: str) -> zipfile.ZipFile:
    """Open a zip archive after checking its directory for a decompression bomb."""
    import zipfile

    archive = zipfile.ZipFile(path)
    parts = archive.infolist()
    if len(parts) > 5000:
        raise Refusal(f"is a zip archive of {len(parts)} parts", "save the sheet alone")
    size = sum(part.file_size for part in parts)
    if size > _MAX_UNPACKED_BYTES:
        raise Refusal(
            f"unpacks to {size >> 20} MiB, over the limit of {_MAX_UNPACKED_BYTES >> 20} MiB",
            "save the sheet alone, as CSV",
        )
    if any(part.flag_bits & 1 for part in parts):
        raise Refusal("is encrypted", "save it without a password")
    return archive


def _book(path: str) -> Iterator[tuple[str, Iterable[str]]]:
    import zipfile

    from python_calamine import CalamineWorkbook

    if zipfile.is_zipfile(path):
        _checked_zip(path).close()
    with CalamineWorkbook.from_path(path) as book:
        for number, about in enumerate(book.sheets_metadata):
            if str(about.typ).rsplit(".", 1)[-1] in ("WorkSheet", "Worksheet"):
                yield about.name, _rows(book.get_sheet_by_index(number))


def _rows(sheet: Any) -> Iterator[str]:
    if sheet.width > _MAX_COLUMNS:
        yield "\t".join(["-"] * sheet.width)  # the reader of tables says what is wrong with it
        return
    empty = 0
    for row in sheet.iter_rows():
        cells = [_text(cell) for cell in row]
        empty = 0 if any(cells) else empty + 1
        if empty > 10_000:
            return
        yield "" if empty else "\t".join(cells)


def _text(cell: object) -> str:
    """Format a cell as a text table has it."""
    if isinstance(cell, str):
        text = " ".join(cell[:_MAX_CELL].replace('"', "''").split())
        return "" if text in _EXCEL_ERRORS else text
    if isinstance(cell, dt.date):
        is_whole = not isinstance(cell, dt.datetime)
        when = dt.datetime(cell.year, cell.month, cell.day) if is_whole else cell
        if when.year < 1901:  # a duration: what a time without a date counts from in some workbooks
            return repr((when - dt.datetime(1899, 12, 30)).total_seconds())
        return when.isoformat()
    if isinstance(cell, dt.timedelta):
        return repr(cell.total_seconds())
    if isinstance(cell, dt.time):
        seconds = cell.hour * 3600 + cell.minute * 60 + cell.second
        return repr(seconds + cell.microsecond * 1e-6)
    return "" if cell is None else repr(cell)[:_MAX_CELL].removesuffix(".0")


def _archive(path: str) -> Iterator[tuple[str, Iterable[str]]]:
    """Yield the .csv files of a zip archive, by their names without the ending."""
    with _checked_zip(path) as archive:
        for part in archive.infolist():
            if part.filename.lower().endswith(".csv") and "__MACOSX" not in part.filename:
                yield part.filename[:-4], _lines(archive, part)


def _lines(archive: zipfile.ZipFile, part: zipfile.ZipInfo) -> Iterator[str]:
    import io

    with archive.open(part) as packed:
        start = packed.read(65_536)
    encoding = "utf-16" if start[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    if not start.isascii() and start.decode(encoding, "ignore").isascii():
        encoding = "cp1252"
    with archive.open(part) as packed:
        text = io.TextIOWrapper(packed, encoding, errors="replace")
        while line := text.readline(1024**2):
            yield line.rstrip("\r\n")


# ---- Variables of MATLAB and Octave, to version 7.


def matlab(path: str) -> Yields:
    """Yield a file's variables; the fields of structs by their names joined by dots."""
    import warnings

    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError, matfile_version

    try:
        level = matfile_version(path)[0]
    except (ValueError, MatReadError):
        raise Refusal("it is no MATLAB file, despite its name") from None
    if level == 1:
        _check_elements(path)
    found = _Arrays()
    with warnings.catch_warnings(action="ignore"):
        variables = loadmat(path, appendmat=False)
    for name, value in variables.items():
        if not name.startswith("__"):
            _variable(found, name, value, 0)
    yield {"unused": found.unused}, found.arrays


def _check_elements(path: str) -> None:
    """Refuse a file of level 5 that is cut, or skips the rest: the library reads what it can."""
    size = Path(path).stat().st_size
    with open(path, "rb") as file:
        order: Any = "little" if file.read(128)[126:] == b"IM" else "big"
        at = 128
        while at + 8 <= size:
            file.seek(at + 4)
            length = int.from_bytes(file.read(4), order)
            at += 8 + length
            if at > size:
                raise Refusal(f"it is damaged: an element claims {length} bytes, beyond its end")


def _variable(found: _Arrays, name: str, value: Any, depth: int) -> None:
    from scipy.io.matlab import MatlabFunction, MatlabObject, MatlabOpaque
    from scipy.sparse import issparse

    if isinstance(value, MatlabOpaque):
        name = name if name != "None" else bytes(value["s0"].flat[0]).decode("utf-8", "replace")
        why = "a table, timetable or timeseries, which only MATLAB can read; save its columns"
        found.leave(name or "unnamed", why)
    elif isinstance(value, MatlabFunction):
        found.leave(name, "a function")
    elif isinstance(value, MatlabObject):
        found.leave(name, "an object")
    elif issparse(value):
        found.leave(name, "a sparse matrix")
    elif value.dtype.names is not None and value.size != 1:
        size = " x ".join(map(str, value.shape))
        found.leave(name, f"an array of structs ({size}); save one of them")
    elif value.dtype.names is not None and depth == _MAX_DEPTH:
        found.leave(name, "structs within structs within structs; save the inner one")
    elif value.dtype.names is not None:
        for field in value.dtype.names:
            _variable(found, f"{name}.{field}", value[field].flat[0], depth + 1)
    elif value.dtype.kind in "OU":
        found.leave(name, "a cell array" if value.dtype.kind == "O" else "text")
    else:
        found.add(name, value.dtype, value.shape, lambda: value)


# ---- HDF5, and MATLAB 7.3: links to other files are not followed, plugins not loaded.

_FILTERS = (1, 2, 3, 4, 5, 6, 32000)  # deflate, shuffle, Fletcher, szip, nbit, scale-offset, LZF
_RATES = ("fps", "rate", "sampling_rate", "sample_rate", "frame_rate", "control_freq")
_DEMO = r"(?i:demo|episode|ep|traj|trajectory|rollout|run|trial|take)s?[_-]?\d+"
_CONTAINERS = ("data", "obs", "observation", "observations", "states", "articulation", "robot")
_JOINTS = {"qpos": "joint_position", "qvel": "joint_velocity", "effort": "joint_effort"}


def hdf5(path: str) -> Yields:
    """Yield a table of a file's data sets, or of each demonstration or run that is a group."""
    import h5py

    with h5py.File(path, "r") as file:
        if isinstance(file.get("tracks"), h5py.Dataset) and "node_names" in file:
            yield {}, _poses(file)
            return
        groups = _demos(file) or {"": file}
        for name, group in groups.items():
            found = _Arrays()
            _walk(found, group, "", set())
            rates = [_rate(one.attrs) for one in (group, group.parent, file)]
            rate_hz = next((one for one in rates if one is not None), None)
            names = _short_names(list(found.arrays))
            about = {"unused": found.unused, "rate_hz": rate_hz, "names": names}
            yield {"name": name, **about}, {names[one]: found.arrays[one] for one in names}


def _poses(file: Any) -> dict[str, Any]:
    """Return the places of an analysis by SLEAP [px], whose rows are frames."""
    tracks = file["tracks"]  # track, x or y, node, frame
    if tracks.ndim != 4 or tracks.shape[1] != 2 or tracks.size * 8 > MAX_BYTES:
        raise Refusal("its tracks are none of SLEAP's", "export it from SLEAP as CSV")
    nodes = [name.decode("utf-8", "replace") for name in file["node_names"][()].tolist()]
    places, several = tracks[()], tracks.shape[0] > 1
    return {
        f"{f'track{track}_' if several else ''}{node}_{axis}_px": places[track, at, number]
        for track in range(len(places))
        for number, node in enumerate(nodes)
        for at, axis in enumerate("xy")
    }


def _short_names(names: list[str]) -> dict[str, str]:
    """Leave out the groups that all arrays are in, or that only say that they were observed."""
    shared = 0
    parts = {name: name.split(".") for name in names}
    while len({tuple(one[: shared + 1]) for one in parts.values()}) == 1 and len(names) > 1:
        shared += 1
    found: dict[str, str] = {}
    for name, words in parts.items():
        rest = words[shared:]
        while len(rest) > 1 and rest[0] in _CONTAINERS:
            rest = rest[1:]
        short = _JOINTS.get(".".join(rest), ".".join(rest))
        found[name] = name if short in found.values() else short
    return found


def _members(group: Any) -> Iterator[tuple[str, Any]]:
    """Yield names and objects of a group, but for links to elsewhere."""
    import h5py

    for name in islice(group, _MAX_ARRAYS):
        kind = group.get(name, getlink=True)
        if isinstance(kind, h5py.HardLink) and not name.startswith("#"):  # as of MATLAB's own
            yield name, group[name]


def _demos(file: Any) -> dict[str, Any]:
    """Return the groups of a file, or of one group in it, that are demonstrations or runs."""
    import h5py

    tops = [one for _, one in _members(file) if isinstance(one, h5py.Group)]
    for group in (file, *tops):
        found = {
            name: one
            for name, one in _members(group)
            if isinstance(one, h5py.Group) and re.fullmatch(_DEMO, name)
        }
        if found:
            order = sorted(found, key=lambda name: [int(n) for n in re.findall(r"\d+", name)])
            return {name: found[name] for name in order}
    return {}


def _rate(attributes: Any) -> float | None:
    """Return the rate of rows [Hz] that a group's attributes state."""
    rate_hz = None
    with suppress(ValueError, TypeError, StopIteration):
        rate_hz = float(next(attributes[name] for name in _RATES if name in attributes))
    with suppress(ValueError, TypeError, AttributeError, KeyError, ArithmeticError, RecursionError):
        said = json.loads(attributes["env_args"])  # robomimic's and Isaac Lab's environment
        if rate := said.get("env_kwargs", {}).get("control_freq"):
            rate_hz = float(rate)
        elif sim := said.get("sim_args"):
            rate_hz = 1 / (float(sim["dt"]) * float(sim.get("decimation", 1)))
    return rate_hz if rate_hz is not None and 1e-3 <= rate_hz <= 1e7 else None


def _walk(found: _Arrays, group: Any, above: str, seen: set[Any]) -> None:
    import h5py

    if group in seen or above.count(".") > _MAX_DEPTH:  # by its place in the file
        return
    seen.add(group)
    for name, one in _members(group):
        if isinstance(one, h5py.Group):
            _walk(found, one, f"{above}{name}.", seen)
        elif isinstance(one, h5py.Dataset):
            _data_set(found, f"{above}{name}", one)


def _data_set(found: _Arrays, name: str, one: Any) -> None:
    filters = one.id.get_create_plist()
    kinds = [filters.get_filter(at)[0] for at in range(filters.get_nfilters())]
    matlab_class = one.attrs.get("MATLAB_class", b"")
    if one.is_virtual or one.external:
        found.leave(name, "its numbers lie in other files")
    elif any(kind not in _FILTERS for kind in kinds):
        found.leave(name, "compressed by a plugin, which is not loaded; save it with gzip")
    elif one.shape is None or matlab_class in (b"char", b"cell", b"function_handle"):
        found.leave(name, "no array of numbers")
    elif matlab_class:
        found.add(name, one.dtype, one.shape[::-1], lambda: one[()].T)
    else:
        found.add(name, one.dtype, one.shape, lambda: one[()])


# ---- Tables of PyTorch: weights alone, no objects.


def torch(path: str) -> Yields:
    """Yield the tensors of a file, those within dictionaries and lists by their joined names."""
    from pickle import UnpicklingError

    import torch

    found = _Arrays()
    try:
        _tensors(found, "", torch.load(path, map_location="cpu", weights_only=True), 0)
    except UnpicklingError:
        raise Refusal("it holds more than tensors: objects are never unpickled") from None
    yield {"unused": found.unused}, found.arrays


def _tensors(found: _Arrays, name: str, value: Any, depth: int) -> None:
    import numpy as np
    import torch

    if isinstance(value, torch.Tensor):
        plain = value.detach()
        if plain.layout is not torch.strided or plain.dtype is torch.bfloat16:
            plain = plain.to_dense().float()
        dtype = np.dtype(str(plain.dtype).removeprefix("torch."))
        found.add(name, dtype, tuple(plain.shape), lambda: plain.contiguous().numpy())
    elif isinstance(value, dict | list | tuple) and depth <= _MAX_DEPTH:
        inner = value.items() if isinstance(value, dict) else enumerate(value)
        for key, one in islice(inner, _MAX_ARRAYS):
            _tensors(found, f"{name}.{key}" if name else str(key), one, depth + 1)
    elif isinstance(value, int | float):
        found.add(name, np.dtype(float), (1,), lambda: np.array([value], float))
    else:
        found.leave(name or "it", "no tensor")


# ---- Recordings for the Rerun viewer: scalars and points, a table for each entity.

_VALUES = {  # components that are read, and their columns
    "Scalars:scalars": 1,
    "Points3D:positions": 3,
    "Points2D:positions": 2,
    "Ellipsoids3D:centers": 3,
    "Transform3D:translation": 3,
}


def rerun(path: str) -> Yields:
    """Yield the values of entities, those with the same times in one table."""
    import warnings

    import numpy as np
    from rerun.chunk import RrdReader

    parts: dict[tuple[str, str], list[tuple[Any, Any]]] = {}
    unused: dict[str, str] = {}
    room = MAX_BYTES
    with warnings.catch_warnings(record=True) as warned:  # of a file that was not finished
        warnings.simplefilter("always")
        chunks = list(RrdReader(path).stream())
    loss = f"is damaged: {str(warned[0].message)[:120]}" if warned else ""
    for chunk in chunks:
        entity = str(chunk.entity_path).strip("/")
        batch = chunk.to_record_batch()
        columns = dict(zip(batch.schema.names, batch.columns, strict=True))
        component = next(filter(columns.get, _VALUES), None)
        if chunk.is_static or not chunk.timeline_names or component is None:
            continue
        # A user's timelines come before those of logging.
        clock = min(chunk.timeline_names, key=lambda name: name in ("log_tick", "log_time"))
        flat, width = columns[component].flatten(), _VALUES[component]
        if len(flat) != batch.num_rows or columns[component].null_count:
            unused[entity] = "it has not one value at each time"
            continue
        values = (flat.flatten() if width > 1 else flat).to_numpy(zero_copy_only=False)
        is_count = str(columns[clock].type) == "int64"
        stamps = columns[clock].cast("int64").to_numpy(zero_copy_only=False)
        room -= values.nbytes + stamps.nbytes
        if room < 0 or len(parts) > _MAX_ARRAYS:
            raise Refusal("it holds more numbers than any log", "name the log that it is of")
        key = (entity, "frame" if is_count else "time")
        shape = (batch.num_rows, width) if width > 1 else (batch.num_rows,)
        parts.setdefault(key, []).append((stamps, values.reshape(shape)))
    is_review = any(entity.endswith("/observed") for entity, _ in parts)  # one of ours
    tables: dict[tuple[str, bytes], dict[str, Any]] = {}
    for (entity, clock), found in parts.items():
        if is_review and not entity.endswith("/observed"):
            unused[entity] = "not observed"
            continue
        stamps, values = (np.concatenate(one) for one in zip(*found, strict=True))
        times = stamps if clock == "frame" else stamps.astype("M8[ns]")
        table = tables.setdefault((clock, stamps.tobytes()), {clock: times})
        name = entity.replace("/", ".")
        table[name.removesuffix(".observed") if is_review else name] = values
    for number, table in enumerate(tables.values(), 1):
        about = {"name": f"table {number}", "loss": loss}
        yield {**about, "unused": {} if number > 1 else unused}, table


# ---- Logs of a PX4 autopilot: a table for each topic.

# Fields of PX4 that are a place [m], with those of older logs; no other topic's x, y, z are one.
_PLACES = re.compile(r"(?!.*setpoint).*(_position|odometry|mocap)")
_PLACE = {"x": "x_m", "y": "y_m", "z": "z_m"}
_PLACE |= {f"position[{at}]": f"{axis}_m" for at, axis in enumerate("xyz")}


def ulog(path: str, reads_all: bool) -> Yields:
    """Yield each topic's times and place, or all its fields: what is numbered as one array."""
    import numpy as np
    from pyulog import ULog

    log = ULog(path, disable_str_exceptions=True)
    data, at = Path(path).read_bytes(), 16
    while at + 3 <= len(data):  # the library does not say of a file that it is cut
        at += 3 + data[at] + 256 * data[at + 1]
    is_damaged = at != len(data) or log.file_corruption
    loss = "is damaged: messages in it are missing" if is_damaged else ""
    if not log.data_list:
        raise Refusal("it holds no topic")
    for topic in log.data_list[:_MAX_ARRAYS]:
        name = topic.name + (f"_{topic.multi_id}" if topic.multi_id else "")
        times = (topic.data["timestamp"].astype("i8") * 1000).astype("M8[ns]")
        if not reads_all:
            known = _PLACE if _PLACES.fullmatch(topic.name) else {}
            fields = {known[one]: values for one, values in topic.data.items() if one in known}
            why = {} if fields else {name: "it is no place; say which of its fields with --columns"}
            yield {"name": name, "loss": loss, "unused": why}, fields and {"time": times, **fields}
            continue
        fields = {"time": times}
        lists: dict[str, list[Any]] = {}
        for field, values in topic.data.items():
            if numbered := re.fullmatch(r"(.+)\[\d+\]", field):
                lists.setdefault(numbered[1], []).append(values)
            elif field != "timestamp":
                fields[f"{name}.{field}"] = values
        for field, several in lists.items():
            fields[f"{name}.{field}"] = np.column_stack(several)
        yield {"name": name, "loss": loss}, fields
