"""A file as a user reads it: what is said, what of it is used, and the line that refuses it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.library_writers import ARRAYS
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import Episode, Signal
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions, columns_of
from tunenet_logs.reader import read_episode

Content = str | bytes | Mapping[str, Any] | None


def read(path: Path, content: Content = None, columns: str = "", **said: Any) -> Episode:
    """A file, of this content if it is given, in a folder a.csv; with what a user says of it.

    Arrays are written as the file's name says.
    """
    path = path / "a.csv" if path.is_dir() else path
    if isinstance(content, Mapping):
        write_arrays(path, content)
    elif content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_episode(path, ReadOptions(columns_of(columns) if columns else {}, **said))


def one(path: Path, content: Content = None, columns: str = "", **said: Any) -> Signal:
    """Its only signal."""
    (signal,) = read(path, content, columns, **said).signals.values()
    return signal


def skipped(episode: Episode) -> dict[str, str]:
    """Why what is not used is not."""
    return {one.topic: one.skipped for one in episode.channels if one.skipped}


def refusal(path: Path, content: Content = None, columns: str = "", **said: Any) -> str:
    """The line by which it is refused."""
    with pytest.raises(LogError) as caught:
        read(path, content, columns, **said)
    line = str(caught.value)
    assert line.startswith(str(path))
    assert "\n" not in line
    assert len(line) < 700 + len(str(path))
    return line


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Arrays as the file's name says; a test is skipped where what reads them is missing."""
    for suffix, library in ((".xlsx", "python_calamine"), (".parquet", "pyarrow")):
        if path.suffix == suffix:
            pytest.importorskip(library)
    ARRAYS[path.name](path, arrays)


def tuned(log: Path, **said: Any) -> float:
    """The value to which it is tuned, which nothing puts in doubt."""
    tuning = tune_log(log, TuneOptions(**said))
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.estimate is not None
    return float(tuning.estimate[0])
