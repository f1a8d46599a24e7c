"""Read episodes of LeRobot data sets (versions 2, 3): joint states, usually without torques."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import UNSTATED, Episode
from tunenet_logs.formats.exports.arrays.column_plan import ColumnPlan, PlannedSignal
from tunenet_logs.formats.exports.arrays.named_columns import columns_episode
from tunenet_logs.formats.exports.arrays.parquet_columns import ParquetColumn
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.times import Clock
from tunenet_logs.regular_file import open_regular, real_path

_MAX_INFO_BYTES = 1024**2  # of meta/info.json
_MAX_SPEED_HZ = 10_000.0  # frames a second of any data set
_MAX_LISTED = 1000  # chunks of a data set, and files of a chunk, that are looked at
_SLACK_S = 0.002  # how far a time may be from its frame's: times have single precision
_COLUMNS = ("timestamp", "frame_index", "episode_index")  # of every data set, beside its features


@dataclass(frozen=True)
class DataSet:
    """Metadata of a LeRobot data set.

    Attributes:
        robot: its type, or "".
        rate_hz: frame rate; None where it is unstated.
        labels: names of each feature's values.
        warning: why the metadata is missing; "" where it is not.
    """

    robot: str = ""
    rate_hz: float | None = None
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    warning: str = ""


def is_lerobot(columns: Sequence[ParquetColumn]) -> bool:
    """Return whether columns of a Parquet file are those of a LeRobot episode."""
    names = {column.name for column in columns}
    return names.issuperset(_COLUMNS) and bool(_features(columns))


def lerobot_columns(columns: Sequence[ParquetColumn]) -> list[str]:
    """Return the columns of an episode to read."""
    states = [one.name for one in _features(columns) if one.name.startswith("observation.")]
    return [*_COLUMNS, *states]


def _features(columns: Sequence[ParquetColumn]) -> list[ParquetColumn]:
    return [
        one
        for one in columns
        if one.kind == "n"
        and one.width
        and (one.name.startswith("observation.") or one.name == "action")
    ]


def is_data_set(folder: Path) -> bool:
    """Return whether a folder is a data set with its own description."""
    return (folder / "meta" / "info.json").is_file() and (folder / "data").is_dir()


def a_file_of(folder: Path) -> str:
    """Name one of a data set's episode files, for messages."""
    chunks = islice((folder / "data").glob("chunk-*"), _MAX_LISTED)
    files = (file for chunk in chunks for file in islice(chunk.glob("*.parquet"), _MAX_LISTED))
    first = min(files, default=None)
    return "one of its files data/chunk-*/*.parquet" if first is None else str(first)


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
            said = json.loads(file.read(_MAX_INFO_BYTES))
        features = dict(said["features"])
        labels = {str(name): _labels(one) for name, one in features.items()}
        rate = float(said["fps"])
    except (OSError, ValueError, TypeError, KeyError, RecursionError, OverflowError):
        return DataSet(warning="meta/info.json is damaged: joints go by their numbers")
    known = 0 < rate < _MAX_SPEED_HZ
    return DataSet(str(said.get("robot_type", ""))[:60], rate if known else None, labels)


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
    """Read the states of each episode in the file, in the data set's own units.

    Raises:
        LogError: no row has a time and a state.
    """
    known = data_set_of(path)
    flat: list[NDArray[Any]] = [_seconds(arrays, known.rate_hz), arrays["episode_index"]]
    names = ["timestamp", "episode_index"]
    signals: list[PlannedSignal] = []
    unused: dict[str, str] = {}
    for feature in _features(columns):
        if feature.name == "action":
            unused["action"] = (
                "commanded, not measured; a LeRobot data set holds no torques as a rule"
            )
            continue
        labels = known.labels.get(feature.name, ())
        if len(labels) != feature.width or len(set(labels)) < len(labels):
            labels = tuple(f"joint{number + 1}" for number in range(feature.width))
        used = tuple((len(flat) + at, at, 1.0) for at in range(feature.width))
        signals.append(PlannedSignal(feature.name, labels, UNSTATED, used))
        names += [f"{feature.name}[{at}]" for at in range(feature.width)]
        flat += list(arrays[feature.name].T)
    unused |= {
        one.name: "no state of the robot"
        for one in columns
        if one.name not in _COLUMNS and one not in _features(columns)
    }
    plan = ColumnPlan(
        tuple(names),
        tuple(signals),
        Clock("timestamp", (0,), 0),
        runs=((1, "episode"),),
        unused=unused,
    )
    notes = [known.warning] if known.warning else []
    notes.append("the data set names no units of its states, which may be degrees or per cent")
    what = f"LeRobot data set{f' of {known.robot}' if known.robot else ''}"
    return columns_episode(path, what, plan, dict(enumerate(flat)), options, warnings=notes)


def _seconds(arrays: Mapping[str, NDArray[Any]], rate_hz: float | None) -> NDArray[np.float64]:
    """Return times [s]: exact, from frame numbers, where the stated rate fits the timestamps."""
    times = arrays["timestamp"].astype(np.float64)
    if rate_hz is None:
        return times
    even = arrays["frame_index"].astype(np.float64) / rate_hz
    return even if np.all(np.abs(even - times) <= _SLACK_S) else times
