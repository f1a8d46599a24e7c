"""Registry of the containers and encodings that are read; a new one is one file, and one line here.

A container is detected by its first bytes; names are unreliable.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from tunenet_logs.episode import Episode
from tunenet_logs.errors import CHECK_DISK, LogError
from tunenet_logs.formats.base import Container, Decode, Loss, RawChannel, UnusableError
from tunenet_logs.formats.budget import Budget
from tunenet_logs.formats.csv_table import read_csv
from tunenet_logs.formats.exports.arrays.json_lines import is_json_lines, read_json_lines
from tunenet_logs.formats.exports.arrays.matlab_file import is_matlab_file, read_matlab_file
from tunenet_logs.formats.exports.arrays.numpy_file import is_numpy_file, read_numpy_file
from tunenet_logs.formats.exports.arrays.parquet import is_parquet, read_parquet
from tunenet_logs.formats.exports.mocap.c3d import is_c3d, read_c3d
from tunenet_logs.formats.exports.mocap.motive import is_motive, read_motive
from tunenet_logs.formats.exports.mocap.nexus import is_nexus, read_nexus
from tunenet_logs.formats.exports.mocap.qualisys import is_qualisys, read_qualisys
from tunenet_logs.formats.exports.mocap.trc import is_trc, read_trc
from tunenet_logs.formats.exports.pictures.picture_archive import (
    is_picture_archive,
    read_picture_archive,
)
from tunenet_logs.formats.exports.pictures.picture_folder import (
    is_picture_folder,
    read_picture_folder,
)
from tunenet_logs.formats.exports.robots.robot_table import is_robot_table, read_robot_table
from tunenet_logs.formats.exports.sheets.sensor_runs import is_sensor_runs, read_sensor_runs
from tunenet_logs.formats.exports.sheets.sheets import is_sheets, read_sheets
from tunenet_logs.formats.exports.start import Start, start_of
from tunenet_logs.formats.exports.trackers.deeplabcut import is_deeplabcut, read_deeplabcut
from tunenet_logs.formats.exports.trackers.imagej import is_imagej, read_imagej
from tunenet_logs.formats.exports.trackers.tracker import is_tracker, read_tracker
from tunenet_logs.formats.foreign_kinds import foreign_kind
from tunenet_logs.formats.json_messages import json_decoder
from tunenet_logs.formats.message_files import message_file, read_packed
from tunenet_logs.formats.packed_file import (
    MAX_FOREIGN_BYTES,
    compression_of,
    unpacked,
    unpacked_start,
)
from tunenet_logs.formats.protobuf import protobuf_decoder
from tunenet_logs.formats.read_options import AS_IT_SAYS, ReadOptions
from tunenet_logs.formats.ros import ros_decoder
from tunenet_logs.formats.ros2_folder import read_folder
from tunenet_logs.formats.sound_file import is_sound_alone, named_as_sound, read_sound
from tunenet_logs.formats.tables.lines import SUFFIXES, has_rows
from tunenet_logs.formats.video import read_video
from tunenet_logs.regular_file import open_regular

# What programs and instruments export, by how its files begin; the first that knows a file reads
# it.
_EXPORTS: tuple[tuple[Callable[[Start], bool], Callable[[Path, ReadOptions], Episode]], ...] = (
    (is_motive, read_motive),
    (is_nexus, read_nexus),
    (is_qualisys, read_qualisys),
    (is_trc, read_trc),
    (is_c3d, read_c3d),
    (is_tracker, read_tracker),
    (is_imagej, read_imagej),
    (is_deeplabcut, read_deeplabcut),
    (is_sensor_runs, read_sensor_runs),
    (is_sheets, read_sheets),
    (is_robot_table, read_robot_table),
    (is_parquet, read_parquet),
    (is_numpy_file, read_numpy_file),
    (is_matlab_file, read_matlab_file),
    (is_json_lines, read_json_lines),
    (is_picture_archive, read_picture_archive),
)

# What is read, in short.
_KNOWN = "an MCAP log, a bag (.bag, .db3), a table of text, a video or sound"

_START_BYTES = 16  # of a file, by which one of messages is known
# What unpacks a file, by its compression.
_UNPACK = {"zstd": "`zstd -d`", "gzip": "`gunzip`", "bzip2": "`bunzip2`", "lz4": "`lz4 -d`"}

# Encodings of messages; a function makes the decoder for a channel, or raises UnusableError.
DECODERS: dict[str, Callable[[RawChannel], Decode]] = {
    "cdr": ros_decoder,
    "ros1": ros_decoder,
    "protobuf": protobuf_decoder,
    "json": json_decoder,
}


def open_log(path: Path, options: ReadOptions = AS_IT_SAYS) -> Container | Episode:
    """Open a log: return the reader of its messages, or the episode of a file without messages.

    Args:
        path: of the log.
        options: the user's, for a file without messages.

    Raises:
        LogError: there is no such file, or its format is not supported.
    """
    try:
        if path.is_dir():
            is_pictures = is_picture_folder(path)
            return read_picture_folder(path, options) if is_pictures else read_folder
        if not path.exists():
            raise LogError(f"{path}: no such file", "check its name and folder")
        with open_regular(path) as file:
            start = file.read(_START_BYTES)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error
    if not start:
        raise LogError(f"{path}: is empty; record it again")
    if container := message_file(start):
        return container
    if compression := compression_of(start):
        return _open_packed(path, compression, options)
    return _read_foreign(path, options)


def is_folder(path: Path) -> bool:
    """Return whether a log is a folder of files; False where that cannot be determined."""
    try:
        return path.is_dir()
    except OSError:
        return False


def file_bytes(path: Path) -> int:
    """Return the size of a log [bytes], that of all its files for a folder."""
    files = path.iterdir() if path.is_dir() else (path,)
    return sum(file.stat().st_size for file in files if file.is_file())


def decoder_for(channel: RawChannel) -> Decode:
    """Return the decoder of the channel's messages.

    Raises:
        UnusableError: its encoding or type is not supported.
    """
    if channel.encoding not in DECODERS:
        known = ", ".join(DECODERS)
        raise UnusableError(
            f"message encoding {channel.encoding[:20]!r} is not read (only {known})"
        )
    return DECODERS[channel.encoding](channel)


def is_known(path: Path) -> bool:
    """Return whether a file begins as messages, an export or a table do; videos are not detected.

    Raises:
        LogError, OSError: it cannot be read.
    """
    with open_regular(path) as file:
        first = file.read(_START_BYTES)
    if message_file(first):
        return True
    if compression := compression_of(first):
        return message_file(unpacked_start(path, compression, _START_BYTES)) is not None
    start = start_of(path)
    return any(is_this(start) for is_this, _ in _EXPORTS) or has_rows(start.lines)


def _read_foreign(path: Path, options: ReadOptions) -> Episode:
    """Read a file without messages: an export, a table or a video; raise LogError for others."""
    try:
        start = start_of(path)
        for is_this, read in _EXPORTS:
            if is_this(start):
                return read(path, options)
        if start.is_text:
            return _read_text(start, options)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error
    try:
        return read_video(path, options)
    except LogError as error:
        if is_sound_alone(path):
            return read_sound(path, options)
        if kind := foreign_kind(start.data, path):
            what, remedy = kind
            raise LogError(f"{path}: is {what}, which is not read as it is; {remedy}") from error
        if named_as_sound(path):
            return read_sound(path, options)
        why = error.what.removeprefix(f"{path}: ")
        remedy = "convert it to one of these or, if it is one, record or copy it again"
        raise LogError(f"{path}: is not {_KNOWN}: it {why}; {remedy}") from error


def _read_text(start: Start, options: ReadOptions) -> Episode:
    """Read a table of any name; raise LogError for other text."""
    path = start.path
    if kind := foreign_kind(start.data, path):
        what, remedy = kind
        raise LogError(f"{path}: is {what}, which is not read as it is", remedy)
    if path.suffix.lower() not in SUFFIXES and not options.columns and not has_rows(start.lines):
        raise LogError(
            f"{path}: is not {_KNOWN}: it is text in which no line is a row of numbers",
            "name the log itself, or write a table with a line of names such as t,x,y,z",
        )
    return read_csv(path, options)


def _open_packed(path: Path, compression: str, options: ReadOptions) -> Container | Episode:
    """Open a file that was compressed as a whole: messages are streamed, others read at once."""
    losses: list[Loss] = []
    try:
        if message_file(unpacked_start(path, compression, _START_BYTES)):
            return read_packed
        budget = Budget(path.stat().st_size)
        with unpacked(path, compression, losses, budget, MAX_FOREIGN_BYTES) as inside:
            episode = _read_inside(inside, path, options)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error
    if episode.open_frames is not None or episode.open_sound is not None:
        kind = "sound" if episode.open_frames is None else "video"
        raise LogError(f"{path}: is a packed {kind}; unpack it first with {_UNPACK[compression]}")
    lost = tuple(str(loss) for loss in losses)
    return replace(episode, warnings=(*lost, *episode.warnings), losses=(*lost, *episode.losses))


def _read_inside(inside: Path, path: Path, options: ReadOptions) -> Episode:
    """Read a decompressed file; errors name the compressed one."""
    try:
        return _read_foreign(inside, options)
    except LogError as error:
        raise error.renamed(inside, path) from error
