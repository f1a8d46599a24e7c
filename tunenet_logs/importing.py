"""Brings any log, table or video into our format: what a task uses, and nothing else."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tunenet_logs.episode import Episode, Signal
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.jpeg import compressed
from tunenet_logs.progress import Progress
from tunenet_logs.reader import read_episode
from tunenet_logs.writer import EpisodeWriter

_JOINT_PARTS = ("position", "velocity", "effort")
_POSITION_COLUMNS = ("x", "y", "z")

Write = Callable[[EpisodeWriter], None]
"""Writes one message."""


@dataclass(frozen=True)
class Imported:
    """What came of it.

    Attributes:
        messages: how many were written.
        left_out: channels that hold nothing that is used, with the reason.
        warnings: what was lost or is doubtful in the log that was read.
    """

    messages: int
    left_out: tuple[str, ...]
    warnings: tuple[str, ...]


def import_log(
    path: Path, output: Path, *, overwrite: bool = False, progress: Progress | None = None
) -> Imported:
    """Write positions, joints and pictures of a log to `output`, in the order of their stamps.

    Pictures that are compressed stay as they are; bare pixels of a video become JPEG.

    Raises:
        UsageError: the output is the log itself.
        LogError: the log cannot be read, holds nothing that is used, or `output` not written.
    """
    if output.suffix != ".mcap":
        raise UsageError(f"{output}: name a .mcap file with -o")
    if output.exists() and path.exists() and output.samefile(path):
        raise UsageError(f"{output}: is the log itself, which is never changed; choose another -o")
    episode = read_episode(path)
    streams = [*_signal_streams(episode), *_picture_streams(episode)]
    if not streams:
        seen = ", ".join(f"{one.topic} ({one.type_name})" for one in episode.channels) or "none"
        raise LogError(f"{path}: holds no positions, joints or pictures; channels: {seen}")
    notes = {**episode.info.notes, "imported_from": path.name}
    source = episode.info.source or path.name
    info = replace(episode.info, source=source, notes=notes)
    total = sum(one.messages for one in episode.channels if one.skipped is None)
    with (
        EpisodeWriter(output, info, overwrite=overwrite, live=False) as writer,
        (progress or Progress(quiet=True)).bar(total, "importing", "message") as bar,
    ):
        for _, _, write in heapq.merge(*streams, key=lambda one: one[:2]):
            write(writer)
            bar.update(1)
    left_out = [f"{one.topic}: {one.skipped}" for one in episode.channels if one.skipped]
    return Imported(writer.written, tuple(left_out), episode.warnings)


def ros_topic(name: str) -> str:
    """A signal's name as a topic that ROS takes: "/tf.ball" is "/tf/ball"."""
    words = "".join(one if one.isalnum() or one in "_/" else "/" for one in name)
    return "/" + "/".join(word for word in words.split("/") if word)


def _signal_streams(episode: Episode) -> Iterator[Iterator[tuple[int, str, Write]]]:
    joints: dict[str, dict[str, Signal]] = {}
    for name, signal in episode.signals.items():
        topic, _, part = name.rpartition(".")
        if part in _JOINT_PARTS and signal.columns != _POSITION_COLUMNS:
            joints.setdefault(topic, {})[part] = signal
        elif signal.columns == _POSITION_COLUMNS and signal.unit == "m":
            yield _poses(signal)
    for topic, parts in joints.items():
        yield _joint_states(topic, parts)


def _poses(signal: Signal) -> Iterator[tuple[int, str, Write]]:
    topic = ros_topic(signal.name)
    for stamp_ns, place in zip(signal.stamps_ns.tolist(), signal.values, strict=True):

        def write(writer: EpisodeWriter, stamp: int = stamp_ns, at: np.ndarray = place) -> None:
            writer.write_pose(topic, stamp, at)

        yield stamp_ns, topic, write


def _joint_states(topic: str, parts: dict[str, Signal]) -> Iterator[tuple[int, str, Write]]:
    """The parts of one topic have the same stamps: they came in the same messages."""
    first = next(iter(parts.values()))
    target = ros_topic(topic)
    for row, stamp_ns in enumerate(first.stamps_ns.tolist()):

        def write(writer: EpisodeWriter, stamp: int = stamp_ns, row: int = row) -> None:
            values = [parts[one].values[row] if one in parts else () for one in _JOINT_PARTS]
            writer.write_joints(target, stamp, first.columns, *values)

        yield stamp_ns, target, write


def _picture_streams(episode: Episode) -> Iterator[Iterator[tuple[int, str, Write]]]:
    for topic in episode.picture_topics:
        yield _pictures(episode, topic)


def _pictures(episode: Episode, topic: str) -> Iterator[tuple[int, str, Write]]:
    encodings = {one.topic: one.encoding for one in episode.channels}
    target = ros_topic(topic)
    for frame in episode.frames(topic):
        kept = compressed(frame) if encodings[topic] == "video" else frame

        def write(writer: EpisodeWriter, one=kept) -> None:  # noqa: ANN001 (a Frame)
            writer.write_frame(target, one)

        yield frame.stamp_ns, target, write
