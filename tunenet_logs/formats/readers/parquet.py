"""Read Parquet tables: named columns, and episodes of LeRobot data sets.

The file is read in the sandbox. Here its columns are chosen by their names and arrive as arrays.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import UNSTATED, Episode
from tunenet_logs.errors import LogError, pip_install
from tunenet_logs.files import open_regular, real_path
from tunenet_logs.formats.columns.angles import PERCENT, REMEDY, is_gripper, told_by_values
from tunenet_logs.formats.columns.cells import Clock
from tunenet_logs.formats.columns.names import (
    JointColumn,
    TimeColumn,
    meaning_of,
    spread_names,
)
from tunenet_logs.formats.columns.plan import (
    ColumnPlan,
    Group,
    Used,
    plan_columns,
)
from tunenet_logs.formats.columns.signals import (
    exact_seconds,
)
from tunenet_logs.formats.columns.table import (
    episode_of_columns,
)
from tunenet_logs.formats.kinds import Start, foreign_kind, start_of
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.formats.readers import sandboxed
from tunenet_logs.formats.sandbox import Sandbox, SandboxError


@dataclass(frozen=True)
class ParquetColumn:
    """One column, which may be nested in a struct."""

    name: str  # nested names joined by dots
    kind: str  # "n" of numbers, "t" of times, "s" of texts, "" of what is not read
    width: int  # values in each row's list; 0 of a column of single values


def parquet_rows(path: Path, most_cells: int) -> Iterator[list[dict[str, Any]]]:
    """Yield rows, in batches, of a table whose columns are texts and numbers."""
    with _opened(path) as sandbox:
        for said, _ in sandbox.answers(sandboxed.table_rows, str(path.absolute()), most_cells):
            yield [
                dict(zip(said, cells, strict=True)) for cells in zip(*said.values(), strict=True)
            ]


@contextmanager
def _opened(path: Path) -> Iterator[Sandbox]:
    if find_spec("pyarrow") is None:
        raise LogError(f"{path}: {_kind(path)} needs pyarrow: {pip_install('tables')}")
    try:
        with Sandbox("numpy", "pyarrow.parquet") as sandbox:
            yield sandbox
    except SandboxError as error:
        raise _unread(path, error) from error


def _unread(path: Path, error: SandboxError) -> LogError:
    remedy = "write it again" + (", in smaller files" if error.code else "")
    return LogError(f"{path}: {_kind(path)} file that is not read: {error}", remedy)


def _kind(path: Path) -> str:
    with open_regular(path) as file:
        return "Parquet" if file.read(4) == b"PAR1" else "Arrow"


def _columns(sandbox: Sandbox, path: Path) -> list[ParquetColumn]:
    found, _ = sandbox.ask(sandboxed.table_columns, str(path.absolute()))
    return [ParquetColumn(name, one["kind"], one["width"]) for name, one in found.items()]


def _arrays(
    sandbox: Sandbox, path: Path, wanted: list[str], columns: Sequence[ParquetColumn]
) -> dict[str, NDArray[Any]]:
    width = sum(one.width or 1 for one in columns if one.name in wanted)
    arrays: dict[str, NDArray[Any]] = {}
    for _, one in sandbox.answers(sandboxed.table_arrays, str(path.absolute()), wanted, width):
        arrays |= one
    return arrays


# ---- LeRobot data sets (versions 2, 3): joint states and commands, usually without torques.

_MAX_LISTED = 1000  # chunks of a data set, and files of a chunk, that are looked at
_COLUMNS = ("timestamp", "frame_index", "episode_index")  # of every data set, beside its features
_STATES = ("observation.state", "state")  # of all joints; openpi's sets have the shorter names
_ACTIONS = ("action", "actions")


@dataclass(frozen=True)
class DataSet:
    """Metadata of a LeRobot data set."""

    robot: str = ""  # its type, or ""
    rate_hz: float | None = None  # frame rate; None where it is unstated
    # names of each feature's values
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    warning: str = ""  # why the metadata is missing; "" where it is not


def is_lerobot(columns: Sequence[ParquetColumn]) -> bool:
    """Return whether columns of a Parquet file are those of a LeRobot episode."""
    names = {column.name for column in columns}
    return names.issuperset(_COLUMNS) and bool(_features(columns))


def _features(columns: Sequence[ParquetColumn]) -> list[ParquetColumn]:
    return [
        one
        for one in columns
        if one.kind == "n"
        and one.width
        and (one.name.startswith("observation.") or one.name in (*_STATES, *_ACTIONS))
        and not one.name.endswith("_is_pad")
    ]


def _wanted(columns: Sequence[ParquetColumn]) -> list[str]:
    return [*_COLUMNS, *(one.name for one in _features(columns))]


def is_data_set(folder: Path) -> bool:
    """Return whether a folder is a data set with its own description."""
    meta = folder / "meta"
    has_data = (folder / "data").is_dir() or (meta / "episodes").is_dir()
    return (meta / "info.json").is_file() and (has_data or (meta / "episodes.jsonl").is_file())


def data_set_files(folder: Path) -> list[Path]:
    """List the files of a data set's episodes, in order."""
    chunks = islice((folder / "data").glob("chunk-*"), _MAX_LISTED)
    files = (file for chunk in chunks for file in islice(chunk.glob("*.parquet"), _MAX_LISTED))
    return sorted(files)


def read_data_set(folder: Path, options: ReadOptions) -> Episode:
    """Read all episodes of a LeRobot data set as runs of one log."""
    files = data_set_files(folder)
    if not files:
        raise LogError(
            f"{folder}: is a LeRobot data set without data/chunk-*/*.parquet", "copy its data, too"
        )
    for file in files:
        start = start_of(file)
        if not is_parquet(start) and (kind := foreign_kind(start.data, file)):
            raise LogError(f"{file}: is {kind[0]}, which is not read as it is", kind[1])
    columns: list[ParquetColumn] = []
    parts: list[dict[str, NDArray[Any]]] = []
    with _opened(files[0]) as sandbox:
        for file in files:
            try:
                columns = _columns(sandbox, file)
                wanted = _wanted(columns) if is_lerobot(columns) else []
                parts.append(_arrays(sandbox, file, wanted, columns))
            except SandboxError as error:
                raise _unread(file, error) from error
            is_one = is_lerobot(columns) and parts[-1].keys() == parts[0].keys()
            if (
                not is_one
                or sum(one.size for part in parts for one in part.values()) > sandboxed.MAX_VALUES
            ):
                why = (
                    f"over {sandboxed.MAX_VALUES} values"
                    if is_one
                    else f"other columns from {file.name} on"
                )
                raise LogError(f"{folder}: has {why}", f"name one of its files, such as {files[0]}")
    try:
        arrays = {name: np.concatenate([one[name] for one in parts]) for name in parts[0]}
    except ValueError as error:
        raise LogError(f"{folder}: its files have lists of different lengths") from error
    return lerobot_episode(files[0], columns, arrays, options)


def data_set_of(path: Path) -> DataSet:
    """Read meta/info.json of the data set that a file lies in.

    Nothing outside of the data set's folder is opened.
    """
    parents = path.absolute().parents
    if len(parents) < 3:
        return DataSet(warning="no meta/info.json beside it: joints go by their numbers")
    root = real_path(parents[2])
    info = root / "meta" / "info.json"
    try:
        if not real_path(info).is_relative_to(root) or not info.is_file():
            return DataSet(warning="no meta/info.json beside it: joints go by their numbers")
        with open_regular(info) as file:
            said = json.loads(file.read(1024**2))
        features = dict(said["features"])
        labels = {str(name): _labels(one) for name, one in features.items()}
        rate = float(said["fps"])
    except (OSError, ValueError, TypeError, KeyError, RecursionError, OverflowError):
        return DataSet(warning="meta/info.json is damaged: joints go by their numbers")
    known = rate if 0 < rate < 10_000 else None
    return DataSet(str(said.get("robot_type", ""))[:60], known, labels)


def _labels(feature: Any) -> tuple[str, ...]:
    """Return the names of a feature's values, in a list or under a key."""
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    while isinstance(names, list) and len(names) == 1 and isinstance(names[0], list):
        names = names[0]
    return tuple(str(name)[:80] for name in names) if isinstance(names, list) else ()


def lerobot_episode(
    path: Path,
    columns: Sequence[ParquetColumn],
    arrays: Mapping[str, NDArray[Any]],
    options: ReadOptions,
) -> Episode:
    """Read states and commands (`action`) of each episode in the file."""
    known = data_set_of(path)
    times, frames = (arrays[one].astype(np.float64) for one in ("timestamp", "frame_index"))
    seconds = exact_seconds(times, frames, known.rate_hz) if len(times) else times
    flat: list[NDArray[Any]] = [seconds, arrays["episode_index"]]
    names = ["timestamp", "episode_index"]
    groups: list[Group] = []
    features = _features(columns)
    for feature in features:
        labels = known.labels.get(feature.name, ())
        if len(labels) != feature.width or len(set(labels)) < len(labels):
            labels = tuple(f"joint{number + 1}" for number in range(feature.width))
        own = dict(enumerate(arrays[feature.name].T.astype(np.float64)))
        groups += _feature_groups(feature.name, labels, own, len(flat), options)
        names += [f"{feature.name}.{label}" for label in labels]
        flat += list(own.values())
    others = [one for one in columns if one.name not in _COLUMNS and one not in features]
    unused = {one.name: "no state of the robot" for one in others}
    for name in unused.keys() & set(_ACTIONS):
        unused[name] = "each row is no list of numbers, but several steps, or of another kind"
    plan = ColumnPlan(tuple(names), tuple(groups), ((1, "episode"),), unused)
    notes = [known.warning] if known.warning else []
    what = f"LeRobot data set{f' of {known.robot}' if known.robot else ''}"
    episode = episode_of_columns(path, what, plan, dict(enumerate(flat)), options, warnings=notes)
    if not any(one.unit == UNSTATED for one in episode.signals.values()):
        return episode
    told = f"the data set names no units of its states, which may be degrees or per cent: {REMEDY}"
    return replace(episode, warnings=(*episode.warnings, told))


def _feature_groups(
    feature: str,
    labels: Sequence[str],
    values: Mapping[int, NDArray[np.float64]],
    first: int,
    options: ReadOptions,
) -> Iterator[Group]:
    """Yield the groups of a feature: by the quantity of its labels, the grippers apart.

    Of labels that say no quantity ("main_elbow") all are positions where the user or the values
    tell their unit. LeRobot writes a gripper's opening in per cent, or from 0 to 1, whatever the
    unit of the other joints is.
    """
    clock, drives = Clock("timestamp", (0,), 0), feature in _ACTIONS
    parts: dict[tuple[str, bool], dict[int, str]] = {}
    for at, label in enumerate(labels):
        meaning, quantity = meaning_of(label), ""
        if isinstance(meaning, JointColumn) and not (meaning.is_bare or meaning.is_command):
            quantity = meaning.quantity
        short = label.rpartition(".")[0] if quantity and "." in label else label
        part = parts.setdefault((quantity, is_gripper(label)), {})
        part[at] = label if short in part.values() else short
    plain = parts.get(("", False), {})
    if plain and feature in (*_STATES, *_ACTIONS) and ("position", False) not in parts:
        names, columns = [*plain.values()], [values[at] for at in plain]
        if options.angle_unit or told_by_values(names, columns):
            parts["position", False] = parts.pop(("", False))
    for (quantity, is_one), part in parts.items():
        used = tuple(Used(first + at, place, 1.0) for place, at in enumerate(part))
        name = f"{feature}.{quantity}" if quantity else feature
        group = Group(name, tuple(part.values()), UNSTATED, used, clock, drives=drives)
        if is_one:
            group = replace(group, name=f"{feature}.gripper{name.removeprefix(feature)}")
        is_opening = is_one and quantity in ("", "position")
        if is_opening and not options.angle_unit.startswith("ticks"):
            opening = np.concatenate([values[at] for at in part])
            low, high = np.nanmin(opening, initial=0.0), np.nanmax(opening, initial=0.0)
            whole = 1.0 if high <= 1.2 else 100.0
            if -0.2 * whole <= low and high <= 1.2 * whole:
                used = tuple(one._replace(scale=200.0 / whole, zero=whole / 2) for one in used)
                name = f"{feature}.gripper.position"
                group = replace(group, name=name, unit=PERCENT, used=used)
        yield group


# ---- Tables of any columns, and the choice between these two.

_ARROW_STARTS = (b"ARROW1", b"\xff\xff\xff\xff")  # of a file (Feather), and of a stream


def is_parquet(start: Start) -> bool:
    """Return whether a file is Parquet, Feather, or Arrow's file or stream."""
    return start.data.startswith((b"PAR1", *_ARROW_STARTS))


def read_parquet(path: Path, options: ReadOptions) -> Episode:
    """Read a table by its column names, or the episodes of a LeRobot data set."""
    with _opened(path) as sandbox:
        columns = _columns(sandbox, path)
        plan: ColumnPlan | None = None
        sources: list[tuple[str, int | None]] = []  # file column and list index of each column
        if is_lerobot(columns) and not options.columns:
            wanted = _wanted(columns)
        else:
            plan, sources = _plan(path, columns, options)
            wanted = list(dict.fromkeys(sources[at][0] for at in plan.needed))
        arrays = _arrays(sandbox, path, wanted, columns)
    if plan is None:
        return lerobot_episode(path, columns, arrays, options)
    needed = {
        at: arrays[name] if place is None else arrays[name][:, place]
        for at in plan.needed
        for name, place in [sources[at]]
    }
    return episode_of_columns(path, f"{_kind(path)} table", plan, needed, options)


def _plan(
    path: Path, columns: Sequence[ParquetColumn], options: ReadOptions
) -> tuple[ColumnPlan, list[tuple[str, int | None]]]:
    """Plan which columns to read, and return the file column and list index of each."""
    names: list[str] = []
    meant: list[str] = []
    sources: list[tuple[str, int | None]] = []
    clocks = [one.name for one in columns if one.kind == "t"]
    is_named = any(isinstance(meaning_of(one.name), TimeColumn) for one in columns)
    for one in columns:
        if one.kind and one.width:
            own, said = spread_names(one.name, one.width)
            names += own
            meant += said
            sources += [(one.name, place) for place in range(one.width)]
        elif one.kind:
            names.append(one.name)
            meant.append("time" if clocks == [one.name] and not is_named else one.name)
            sources.append((one.name, None))
    return plan_columns(path, names, options, meant), sources
