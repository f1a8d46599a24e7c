"""Read and write joint paths as tables: time_s, then a column of radians per joint."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tunenet_logs.arrays import Array
from tunenet_logs.csv_lines import csv_line, text_of
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.output.owned_file import OutputPlace, begins_with
from tunenet_logs.regular_file import open_regular_text
from tunenet_logs.terminal import short_name

# An hour at 50 Hz, more joints and turns than an arm has: beyond it, a file is no path.
_MAX_ROWS, _MAX_COLUMNS, _MAX_RAD, _MAX_S = 200_000, 100, 1000.0, 3600.0

_MAX_CHARACTERS = 10_000  # of a line: a file without line ends must not fill the memory


def read_path_file(file: Path) -> tuple[tuple[str, ...], Array, Array]:
    """Read joint names (J), times [s], shape (T,), and positions [rad], shape (T, J).

    Raises:
        UsageError: no such table; with the line and what is wrong there.
    """
    try:
        with open_regular_text(file, "utf-8-sig", newline="") as stream:
            lines = iter(lambda: stream.readline(_MAX_CHARACTERS), "")
            return _read(file, csv.reader(lines))
    except OSError as error:
        raise UsageError(f"{file}: {error.strerror}; a path is a CSV with time_s first") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"{file}: is no CSV in UTF-8 ({error})") from error


def _read(file: Path, lines: Iterable[list[str]]) -> tuple[tuple[str, ...], Array, Array]:
    rows: list[list[float]] = []
    header: list[str] = []
    for number, cells in enumerate(lines, start=1):
        if not any(cell.strip() for cell in cells):
            continue
        if not header:
            header = [text_of(cell.strip()) for cell in cells]
            _check_header(file, header)
            continue
        rows.append(_row(file, number, cells, header))
        if len(rows) > _MAX_ROWS:
            raise UsageError(f"{file}: over {_MAX_ROWS} rows; give fewer samples a second")
        if len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
            raise UsageError(f"{file}: line {number}: time_s does not increase")
    if len(rows) < 2:
        raise UsageError(f"{file}: holds {len(rows)} rows of numbers; a path has two or more")
    table = np.array(rows)
    return tuple(header[1:]), table[:, 0], table[:, 1:]


def _check_header(file: Path, header: list[str]) -> None:
    if header[0] != "time_s" or not 2 <= len(header) <= _MAX_COLUMNS:
        raise UsageError(
            f"{file}: begins with {short_name(','.join(header))}; a path begins with time_s and "
            "the joints' names"
        )
    if len(set(header)) < len(header):
        raise UsageError(f"{file}: two columns have one name")


def _row(file: Path, number: int, cells: list[str], header: list[str]) -> list[float]:
    if len(cells) != len(header):
        raise UsageError(f"{file}: line {number}: {len(cells)} values under {len(header)} columns")
    values: list[float] = []
    for cell, name in zip(cells, header, strict=True):
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
        most = _MAX_S if name == "time_s" else _MAX_RAD
        if not abs(value) <= most:
            raise UsageError(
                f"{file}: line {number}: {short_name(name)} is {short_name(cell)!r}, not a number "
                f"within {most:g} {'s' if name == 'time_s' else 'rad'}"
            )
        values.append(value)
    return values


def write_path_file(
    file: Path, names: Iterable[str], seconds: Array, position_rad: Array, *, overwrite: bool
) -> None:
    """Write a path; the counterpart of `read_path_file`.

    Replaces only a path of the same joints, and only with `overwrite`.

    Raises:
        LogError: something is there already, or it cannot be written.
    """
    rows = [csv_line(["time_s", *names])]
    begins = begins_with(rows[0].encode())
    for time_s, angles in zip(seconds.tolist(), position_rad.tolist(), strict=True):
        rows.append(csv_line([f"{time_s:.6f}", *(f"{angle:.12f}" for angle in angles)]))
    place = OutputPlace(file, "path of these joints", begins, elsewhere="choose another name")
    why = place.why_not()
    if why is None and file.exists() and not overwrite:
        why = f"{file}: exists; choose another name, or give --overwrite"
    if why:
        raise LogError(why)
    try:
        with place.replacing() as partial:
            partial.write_text("".join(rows), "utf-8")
    except OSError as error:
        raise LogError(f"{file}: cannot be written ({error.strerror})") from error
