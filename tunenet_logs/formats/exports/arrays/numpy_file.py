"""Read NumPy arrays (.npy, .npz): checked before anything is allocated, never unpickled."""

from __future__ import annotations

import struct
import warnings
import zipfile
import zlib
from math import prod
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.exports.arrays.array_columns import (
    MAX_BYTES,
    arrays_episode,
    number_names,
)
from tunenet_logs.formats.exports.start import Start
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.regular_file import open_regular

_NPY = b"\x93NUMPY"
_ZIP = b"PK\x03\x04"

_MAX_FILE_BYTES = 1024**3  # of an .npz; its arrays may have less
# Of the list of an .npz's members, which `zipfile` reads at once: some 10,000.
_MAX_DIRECTORY_BYTES = 1024**2

_MAX_ARRAYS = 5000  # in a file
# The record at a zip file's end: signature, ..., bytes and place of the list of members, ...
_END = struct.Struct("<4s4H2LH")

_DAMAGED = (ValueError, EOFError, KeyError, OverflowError, zlib.error, zipfile.BadZipFile)
_DAMAGED += (struct.error, SyntaxError, TypeError, RuntimeError, NotImplementedError, MemoryError)
_DAMAGED += (RecursionError, TokenError)
"""What NumPy and `zipfile` raise at damaged files."""


class _RefusedError(ValueError):
    """An intact array that is not supported."""


def is_numpy_file(start: Start) -> bool:
    """Return whether a file holds NumPy arrays."""
    if start.data.startswith(_NPY):
        return True
    if not start.data.startswith(_ZIP) or len(start.data) < 30:
        return False
    length = int.from_bytes(start.data[26:28], "little")
    return start.data[30 : 30 + length].endswith(b".npy")


def read_numpy_file(path: Path, options: ReadOptions) -> Episode:
    """Read arrays named like columns: t, z, ball (T, 3), q and tau (T, J).

    Raises:
        LogError: it is damaged, too large, or its names do not say what it holds.
        OSError: it cannot be read.
    """
    with open_regular(path) as file:
        if file.read(len(_NPY)) == _NPY:
            file.seek(0)
            return _read_single(path, file, options)
    unused: dict[str, str] = {}
    try:
        arrays = _members(path, unused)
    except _DAMAGED as error:
        raise _damaged(path, error) from error
    return arrays_episode(path, "NumPy arrays", arrays, options, unused)


def _damaged(path: Path, error: Exception) -> LogError:
    why = str(error).partition("\n")[0][:120]
    if isinstance(error, _RefusedError):
        return LogError(f"{path}: {why}", "save it again, as numbers alone")
    return LogError(f"{path}: NumPy's file is damaged ({why}); save it again")


def _read_single(path: Path, file: IO[bytes], options: ReadOptions) -> Episode:
    try:
        array = _array(file, path.stat().st_size, MAX_BYTES)
    except _DAMAGED as error:
        raise _damaged(path, error) from error
    named = (
        {path.stem: array} if array.dtype.names is not None else number_names(array, path, options)
    )
    return arrays_episode(path, "NumPy array", named, options, {})


def _members(path: Path, unused: dict[str, str]) -> dict[str, NDArray[Any]]:
    """Read the arrays of an .npz, adding refused ones to `unused`."""
    _check_directory(path)
    arrays: dict[str, NDArray[Any]] = {}
    left = MAX_BYTES
    with open_regular(path) as packed, zipfile.ZipFile(packed) as archive:
        members = [one for one in archive.infolist() if one.filename.endswith(".npy")]
        if len(members) > _MAX_ARRAYS:
            raise _RefusedError(f"holds {len(members)} arrays, over the limit of {_MAX_ARRAYS}")
        for member in members:
            name = member.filename.removesuffix(".npy")
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                unused[name] = "compressed in a way that NumPy does not use"
                continue
            try:
                with archive.open(member) as file:
                    arrays[name] = _array(file, member.file_size, left)
            except _RefusedError as error:
                unused[name] = str(error)
                continue
            left -= arrays[name].nbytes
    return arrays


def _check_directory(path: Path) -> None:
    """Refuse an archive whose directory is larger than arrays need, with a ValueError."""
    size = path.stat().st_size
    if size > _MAX_FILE_BYTES:
        raise _RefusedError(f"has {size} bytes, over the limit of 1 GiB; save fewer arrays")
    with open_regular(path) as file:
        file.seek(max(0, size - 65536 - _END.size))
        tail = file.read()
    at = tail.rfind(b"PK\x05\x06")
    if at < 0 or len(tail) < at + _END.size:
        raise ValueError("its end is missing")
    listed = _END.unpack_from(tail, at)[5]
    if listed > _MAX_DIRECTORY_BYTES or b"PK\x06\x07" in tail[max(0, at - 20) : at]:
        raise _RefusedError("holds more arrays than can be read; save fewer")


def _array(file: IO[bytes], there: int, most: int) -> NDArray[Any]:
    """Read one array, header first; raise ValueError if damaged, too large or of objects."""
    version = npy.read_magic(file)
    read_header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    if version not in read_header:
        raise _RefusedError(f"version {version} of NumPy's format is not read; save it again")
    with warnings.catch_warnings(action="ignore"):  # of a header that Python 2 wrote
        shape, is_fortran, dtype = read_header[version](file, max_header_size=10_000)
    if dtype.hasobject:
        raise _RefusedError("Python objects, which are never unpickled; save numbers")
    if any(length < 0 for length in shape) or len(shape) > 8:
        raise ValueError(f"shape {shape}")
    size = prod(shape) * dtype.itemsize
    if len(shape) > 2:
        raise _RefusedError(f"its shape {' x '.join(map(str, shape))} is no table's")
    if size > there:
        raise ValueError(f"{size} bytes are claimed, and not there")
    if size > most:
        raise _RefusedError(f"with it there are over {MAX_BYTES >> 20} MiB; save fewer numbers")
    data = file.read(size)
    if len(data) < size:
        raise ValueError(f"{len(data)} of {size} bytes are there")
    flat = np.frombuffer(data, dtype) if dtype.itemsize else np.zeros(0, np.float64)
    return flat.reshape(shape, order="F" if is_fortran else "C")
