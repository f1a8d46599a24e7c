"""Read variables saved by MATLAB or Octave (.mat)."""

from __future__ import annotations

from pathlib import Path

from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.exports.arrays.array_columns import arrays_episode
from tunenet_logs.formats.exports.arrays.matlab_elements import (
    MAX_BYTES,
    DamagedMatlabError,
    MatlabArrays,
    level4_header,
)
from tunenet_logs.formats.exports.start import Start
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.regular_file import open_regular

_LEVEL5 = b"MATLAB 5.0 MAT-file"
_LEVEL73 = b"MATLAB 7.3 MAT-file"
_HDF5 = b"\x89HDF\r\n"

_REMEDY = "save it with `save('FILE.mat', '-v7')`"


def is_matlab_file(start: Start) -> bool:
    """Return whether a file holds MATLAB variables."""
    return start.data.startswith((_LEVEL5, _LEVEL73)) or start.suffix == ".mat"


def read_matlab_file(path: Path, options: ReadOptions) -> Episode:
    """Read variables named like columns: t, z, ball (T x 3), q and tau (T x J), also in structs.

    Raises:
        LogError: it is of version 7.3, damaged, too large, or its names do not say what it holds.
        OSError: it cannot be read.
    """
    if (size := path.stat().st_size) > MAX_BYTES:
        raise LogError(
            f"{path}: has {size} bytes, over the limit of {MAX_BYTES >> 20} MiB; save fewer "
            "variables"
        )
    with open_regular(path) as file:
        data = file.read()
    if data.startswith((_LEVEL73, _HDF5)):
        raise LogError(f"{path}: is a MATLAB file of version 7.3, which is not read; {_REMEDY}")
    found = MatlabArrays()
    try:
        if data[124:128] and data[126:128] in (b"IM", b"MI") and not level4_header(data):
            found.read_level5(data)
        elif level4_header(data) is not None:
            found.read_level4(data)
        else:
            raise LogError(f"{path}: is no MATLAB file, whatever its name says; {_REMEDY}")
    except DamagedMatlabError as error:
        raise LogError(
            f"{path}: is a MATLAB file that cannot be read ({error}); {_REMEDY}"
        ) from error
    return arrays_episode(path, "MATLAB variables", found.arrays, options, found.unused)
