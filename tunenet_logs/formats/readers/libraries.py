"""Read files of arrays by their libraries, in the sandbox.

MATLAB and Octave (.mat), HDF5, PyTorch (.pt), recordings for the Rerun viewer (.rrd) and logs of
PX4 (.ulg). Each gives one table of named columns or several, which are joined.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import LogError, pip_install
from tunenet_logs.formats.columns.plan import (
    name_of_run,
)
from tunenet_logs.formats.columns.table import (
    Table,
    episode_of_table,
    number_names,
)
from tunenet_logs.formats.kinds import Start, is_hdf5
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.formats.readers import sandboxed
from tunenet_logs.formats.sandbox import CPU_S, Sandbox, SandboxError

if TYPE_CHECKING:
    from tunenet_logs.formats.sandbox import Function

_MAX_TABLES = 200  # of a file that are read


@dataclass(frozen=True)
class Library:
    """How files of one kind are read."""

    what: str  # kind of file, in words, with its article
    source: str  # what an episode names as its source
    is_this: Callable[[Start], bool]  # whether a file is one, by its start
    tables: Function  # yields tables in the sandbox
    modules: tuple[str, ...]  # that it needs, the library's own first
    remedy: str  # where it is not read
    most_bytes: int = 512 * 1024**2  # of a file
    cpu_s: int = CPU_S  # of reading it
    extra: str = ""  # of this project that has the library; "" where it is always there
    knows_columns: bool = False  # whether it is told that the user names columns

    def read(self, path: Path, options: ReadOptions) -> Episode:
        """Read a file's tables by the names of their columns."""
        name = self.modules[0].partition(".")[0]
        if find_spec(name) is None:
            raise LogError(f"{path}: is {self.what}, which needs {name}: {pip_install(self.extra)}")
        if (size := path.stat().st_size) > self.most_bytes:
            raise LogError(
                f"{path}: has {size} bytes, over the limit of {self.most_bytes >> 20} MiB of "
                f"{self.what}; save less in it"
            )
        found: list[Table] = []
        try:
            with Sandbox("numpy", *self.modules, cpu_s=self.cpu_s) as sandbox:
                asked = (bool(options.columns),) if self.knows_columns else ()
                for said, arrays in sandbox.answers(self.tables, str(path.absolute()), *asked):
                    found.append(Table(self.source, arrays, **said))
                    # An autopilot has hundreds of topics, of which a few are places.
                    if sum(bool(one.columns) for one in found) > _MAX_TABLES:
                        raise LogError(f"{path}: has over {_MAX_TABLES} tables; split it")
        except SandboxError as error:
            remedy = error.remedy or self.remedy
            raise LogError(f"{path}: is {self.what} that is not read: {error}", remedy) from error
        return _tables_episode(path, self.source, found, options)


def _tables_episode(
    path: Path, what: str, tables: Iterable[Table], options: ReadOptions
) -> Episode:
    """Build one episode of a file's tables; signals of several bear their table's name."""
    tables = [table for table in tables if table.columns or table.unused]
    if len(tables) == 1:
        return _episode(path, tables[0], options)
    if not tables:
        raise LogError(f"{path}: is {what} without any numbers", "name the log itself")
    signals: dict[str, Signal] = {}
    channels: list[Channel] = []
    warnings: list[str] = []
    first: LogError | None = None
    for table in tables:
        try:
            episode = _episode(path, table, options)
        except LogError as error:
            why = error.what.removeprefix(f"{path}: ")
            channels.append(
                Channel(table.name[:200], "", "export", np.empty(0, np.int64), skipped=why[:200])
            )
            first = first or error
            continue
        for channel in episode.channels:
            name = name_of_run(channel.topic, "" if table.name in channel.topic else table.name)
            if channel.topic in episode.signals:
                signals[name] = replace(episode.signals[channel.topic], name=name)
            channels.append(replace(channel, topic=name))
        warnings += [
            text if text == table.loss else f"{table.name}: {text}" for text in episode.warnings
        ]
    if first is not None and not signals:
        raise first
    info = EpisodeInfo(source=f"{what} {path.name}")
    losses = tuple(dict.fromkeys(table.loss for table in tables if table.loss))
    return Episode(info, signals, tuple(channels), tuple(dict.fromkeys(warnings)), losses)


def _episode(path: Path, table: Table, options: ReadOptions) -> Episode:
    columns = dict(options.columns)
    for target, said in columns.items():  # a full name, also with slashes
        name, bracket, place = said.partition("[")
        if (full := name.replace("/", ".").strip(".")) in table.names:
            columns[target] = table.names[full] + bracket + place
    options = replace(options, columns=columns)
    if set(table.columns) == {""}:  # it has no name
        table = replace(table, columns=number_names(table.columns[""], path, options))
    return episode_of_table(path, table, options)


# ---- Kinds of files. Of a table of pandas and a project of SLEAP, both HDF5, `kinds` tells.


def _is_hdf5(start: Start) -> bool:
    return is_hdf5(start.data) and start.suffix != ".slp" and b"pandas_type" not in start.data


LIBRARIES = (
    Library(
        "an HDF5 file",
        "HDF5 file",
        _is_hdf5,  # MATLAB's since 7.3, too
        sandboxed.hdf5,
        ("h5py",),
        "write it again, as HDF5 or .npz",
    ),
    Library(
        "a MATLAB file",
        "MATLAB variables",
        lambda start: start.data.startswith(b"MATLAB 5.0 MAT-file") or start.suffix == ".mat",
        sandboxed.matlab,
        ("scipy.io", "scipy.sparse"),
        "save it with `save('FILE.mat', '-v7')`",
        most_bytes=128 * 1024**2,
    ),
    Library(
        "a file of PyTorch",
        "PyTorch tensors",
        lambda start: start.data.startswith(b"PK\x03\x04") and b"/data.pkl" in start.data[:300],
        sandboxed.torch,
        ("torch",),
        "save its tensors alone: torch.save({'t': times, 'z': heights}, 'log.pt')",
        extra="train",
    ),
    Library(
        "a recording for the Rerun viewer",
        "Rerun recording",
        lambda start: start.data.startswith((b"RRF", b"RRIO")),
        sandboxed.rerun,
        ("rerun.chunk",),
        "name the log that it was made of",
    ),
    Library(
        "a log of a PX4 autopilot (ULog)",
        "ULog",
        lambda start: start.data.startswith(b"ULog\x01"),
        sandboxed.ulog,
        ("pyulog",),
        "cut it, or write its topics as CSV: ulog2csv FILE",
        cpu_s=60,  # each of its messages takes some microseconds
        knows_columns=True,
    ),
)
