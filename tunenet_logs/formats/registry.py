"""Registry of the containers and encodings that are read; a new one is one file, and one line here.

`open_log` opens all: message files by their first bytes, as names are unreliable, also when
compressed as a whole; folders of a ROS 2 bag; then `EXPORTS`, tables and videos. `may_be_log` says
what is a log among many files.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from tunenet_logs.audio import is_sound_alone, named_as_sound, read_sound
from tunenet_logs.episode import Episode
from tunenet_logs.errors import CHECK_DISK, COPY_AGAIN, LogError
from tunenet_logs.files import open_regular
from tunenet_logs.formats.base import (
    Budget,
    Container,
    Decode,
    Loss,
    RawChannel,
    RawMetadata,
    Record,
    UnusableError,
)
from tunenet_logs.formats.columns.cells import SUFFIXES, has_rows
from tunenet_logs.formats.compressed import (
    MAX_FOREIGN_BYTES,
    ZSTD_MAGIC,
    compression_of,
    unpacked,
    unpacked_start,
)
from tunenet_logs.formats.decoders import json_decoder, protobuf_decoder
from tunenet_logs.formats.kinds import Start, foreign_kind, start_of
from tunenet_logs.formats.mcap import MAGIC as MCAP_MAGIC
from tunenet_logs.formats.mcap import read_mcap
from tunenet_logs.formats.options import AS_IT_SAYS, ReadOptions
from tunenet_logs.formats.readers.arrays import (
    is_json_lines,
    is_matlab_file,
    is_numpy_file,
    read_json_lines,
    read_matlab_file,
    read_numpy_file,
)
from tunenet_logs.formats.readers.c3d import is_c3d, read_c3d
from tunenet_logs.formats.readers.csv import read_csv
from tunenet_logs.formats.readers.mocap import (
    is_motive,
    is_nexus,
    is_qualisys,
    is_trc,
    read_motive,
    read_nexus,
    read_qualisys,
    read_trc,
)
from tunenet_logs.formats.readers.parquet import a_file_of, is_data_set, is_parquet, read_parquet
from tunenet_logs.formats.readers.pictures import (
    is_picture_archive,
    is_picture_folder,
    read_picture_archive,
    read_picture_folder,
)
from tunenet_logs.formats.readers.robots import is_robot_table, read_robot_table
from tunenet_logs.formats.readers.sheets import (
    is_sensor_runs,
    is_sheets,
    read_sensor_runs,
    read_sheets,
)
from tunenet_logs.formats.readers.trackers import (
    is_deeplabcut,
    is_imagej,
    is_tracker,
    read_deeplabcut,
    read_imagej,
    read_tracker,
)
from tunenet_logs.formats.ros import ros_decoder
from tunenet_logs.formats.rosbag1 import MAGIC as BAG_MAGIC
from tunenet_logs.formats.rosbag1 import read_bag
from tunenet_logs.formats.rosbag2 import MAGIC as DB3_MAGIC
from tunenet_logs.formats.rosbag2 import read_db3
from tunenet_logs.messages import INFO_RECORD
from tunenet_logs.video import read_video

_START_BYTES = 16  # that identify a message file or a compression


class MessageFile(Protocol):
    """Reader of one kind of message file: a `Container`."""

    def __call__(
        self,
        path: Path,
        losses: list[Loss],
        topics: Sequence[str] | None = None,
        budget: Budget | None = None,
    ) -> Iterator[Record]:
        """Yield the records as `Container` does.

        Args:
            path: the file.
            losses: filled while reading.
            topics: yield only messages of these; None for all.
            budget: remaining budget, where the file was itself unpacked from another, or is
                one of several.
        """
        ...


# By the first bytes.
_READERS: dict[bytes, MessageFile] = {
    MCAP_MAGIC: read_mcap,
    BAG_MAGIC: read_bag,
    DB3_MAGIC: read_db3,
}


def message_file(start: bytes) -> MessageFile | None:
    """Return the reader of message files that begin like this; None where there is none."""
    return next((read for magic, read in _READERS.items() if start.startswith(magic)), None)


def read_packed(
    path: Path,
    losses: list[Loss],
    topics: Sequence[str] | None = None,
    budget: Budget | None = None,
) -> Iterator[Record]:
    """Yield the records of a message file that was compressed as a whole; see `MessageFile`."""
    with open_regular(path) as file:
        compression = compression_of(file.read(_START_BYTES))
    if not compression:
        raise LogError(f"{path}: is not compressed in a way that is read", "unpack it first")
    budget = budget or Budget(path.stat().st_size)
    with unpacked(path, compression, losses, budget) as inside:
        with open_regular(inside) as file:
            read = message_file(file.read(_START_BYTES))
        if read is None:
            raise LogError(
                f"{path}: holds no MCAP log and no bag", "unpack it, and name what is in it"
            )
        try:
            yield from read(inside, losses, topics, budget)
        except LogError as error:
            raise error.renamed(inside, path) from error


# ---- Folders of a ROS 2 bag: one recording in one or several files, in numeric order.

# By ending: how such a file begins, and its reader. rosbag2 can compress files as a whole.
_FOLDER_READERS: dict[str, tuple[bytes, MessageFile]] = {
    ".db3": (DB3_MAGIC, read_db3),
    ".mcap": (MCAP_MAGIC, read_mcap),
    ".db3.zstd": (ZSTD_MAGIC, read_packed),
    ".mcap.zstd": (ZSTD_MAGIC, read_packed),
}

_PACKED = ".zstd"  # what rosbag2 puts behind the name of a file that it compresses
_INDEX = "metadata.yaml"  # what rosbag2 writes beside the files when a recording ends
_MAX_PARTS = 10_000  # files of one recording; no part is missed between numbers farther apart
# NAME_NUMBER, without the suffix; as many digits as fit 64 bits.
_NUMBERED = re.compile(r"(.+)_([0-9]{1,18})", re.DOTALL)


def read_folder(
    path: Path, losses: list[Loss], topics: Sequence[str] | None = None
) -> Iterator[Record]:
    """Yield the records of a ROS 2 bag's files, one after the other; see `Container`.

    Its `metadata.yaml` is not needed: a killed recording has none.
    """
    files = _files(path)
    if len(files) > 1 and not (path / _INDEX).is_file():
        what = f"no {_INDEX}; {files[0].name} to {files[-1].name} were read as one recording"
        losses.append(Loss(what, harmless=True))
    losses += _missing_parts(files)
    troubles: list[str] = []
    described: set[Path] = set()
    begin = len(losses)
    budget = Budget(sum(file.stat().st_size for file in files))
    for file in files:
        lost: list[Loss] = []
        try:
            for record in _records(file, lost, topics, budget):
                if isinstance(record, RawMetadata) and record.name == INFO_RECORD:
                    described.add(file)
                yield record
            budget.files_bytes += file.stat().st_size
        except LogError as error:
            trouble = error.what.removeprefix(f"{file}: ")
            troubles.append(f"{file.name} {trouble}")
            lost.append(Loss(trouble, size=file.stat().st_size))
        losses += [replace(loss, file=file.name) for loss in lost]
        if len(described) > 1:  # our own recordings are one file each
            raise _several(path, files)
    if len(troubles) == len(files):
        raise LogError(f"{path}: no file in it can be read: {troubles[0]}", COPY_AGAIN)
    losses[begin:] = _without_repeats(losses[begin:])


def is_bag_folder(path: Path) -> bool:
    """Return whether a folder is one recording, and not a folder of several.

    Raises:
        OSError: it cannot be read.
    """
    if (path / _INDEX).is_file():
        return True
    try:
        files = _files(path)
    except LogError:
        return False
    others = [one for one in path.iterdir() if not one.name.startswith(".")]
    if len(files) == 1:
        return len(others) == 1 and _numbered(files[0]) is not None
    return not all(map(_is_ours, files[:2]))


def _is_ours(file: Path) -> bool:
    """Return whether a file is an intact recording of `tunenet-record`."""
    try:
        records = _records(file, [], (), Budget(file.stat().st_size))
        return any(isinstance(one, RawMetadata) and one.name == INFO_RECORD for one in records)
    except (LogError, OSError):
        return False


def _records(
    file: Path, losses: list[Loss], topics: Sequence[str] | None, budget: Budget
) -> Iterator[Record]:
    """Yield the records of one file; raise LogError where nothing of it can be read."""
    ending = _ending(file)
    magic, read = _FOLDER_READERS[ending]
    with open_regular(file) as stream:
        start = stream.read(len(magic))
    if not start:
        raise LogError(f"{file}: is empty", COPY_AGAIN)
    if start != magic:
        raise LogError(f"{file}: is no {ending} file", COPY_AGAIN)
    yield from read(file, losses, topics, budget)


def _without_repeats(losses: Sequence[Loss]) -> list[Loss]:
    """Merge equal doubts about several files into one, behind the losses."""
    doubts: dict[str, list[Loss]] = {}
    for loss in losses:
        if loss.harmless:
            doubts.setdefault(loss.what, []).append(loss)
    lost = [loss for loss in losses if not loss.harmless]
    for same in doubts.values():
        first, more = same[0], len(same) - 1
        lost.append(replace(first, file=f"{first.file} and {more} more") if more else first)
    return lost


def _files(folder: Path) -> list[Path]:
    """Return the recording's files in order; raise LogError for none, or for several recordings."""
    found = [file for file in folder.iterdir() if file.is_file() and not file.name.startswith(".")]
    names = {file.name for file in found}
    files = [
        file
        for file in found
        if _ending(file)
        and not (file.suffix == _PACKED and file.stem in names)  # `zstd -d` leaves both
    ]
    if not files:
        if is_data_set(folder):
            raise LogError(f"{folder}: is a LeRobot data set; name {a_file_of(folder)}")
        raise LogError(
            f"{folder}: is a directory without the files of a ROS 2 bag (.db3, .mcap) or numbered "
            "pictures; name a log file"
        )
    if len(files) == 1:
        return files
    if len(files) > _MAX_PARTS:
        raise LogError(
            f"{folder}: is a directory with over {_MAX_PARTS} files of messages",
            "name one of its files",
        )
    numbered = {file: match for file in files if (match := _numbered(file))}
    names = {(_ending(file), match[1]) for file, match in numbered.items()}
    if len(numbered) < len(files) or len(names) > 1:
        raise _several(folder, files)
    return sorted(files, key=lambda file: (int(numbered[file][2]), file.name))


def _ending(file: Path) -> str:
    """Return which of the supported endings a file has; "" for another."""
    return next((ending for ending in _FOLDER_READERS if file.name.endswith(ending)), "")


def _numbered(file: Path) -> re.Match[str] | None:
    return _NUMBERED.fullmatch(file.name.removesuffix(_ending(file)))


def _missing_parts(files: Sequence[Path]) -> list[Loss]:
    """Return a loss for the numbers missing between those of the files."""
    numbers = [int(match[2]) for file in files if (match := _numbered(file))]
    if len(numbers) < 2 or numbers[-1] - numbers[0] > _MAX_PARTS:
        return []
    present = set(numbers)
    absent = [number for number in range(numbers[0], numbers[-1]) if number not in present][:5]
    words = ", ".join(str(number) for number in absent)
    return [Loss(f"of its files, those with number {words} are missing")] if absent else []


def _several(folder: Path, files: Iterable[Path]) -> LogError:
    shown = ", ".join(sorted(file.name for file in files)[:2])
    return LogError(f"{folder}: is a directory with several recordings ({shown}); name one of them")


# ---- Open a log of any kind.

# What programs and instruments export, by its first bytes; the first that knows a file reads it.
EXPORTS: tuple[tuple[Callable[[Start], bool], Callable[[Path, ReadOptions], Episode]], ...] = (
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

_KNOWN = "an MCAP log, a bag (.bag, .db3), a table of text, a video or sound"  # what is read
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
    return any(is_this(start) for is_this, _ in EXPORTS) or has_rows(start.lines)


def _read_foreign(path: Path, options: ReadOptions) -> Episode:
    """Read a file without messages: an export, a table or a video; raise LogError for others."""
    try:
        start = start_of(path)
        for is_this, read in EXPORTS:
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


# ---- Recognize logs among many files and folders: by name, else by their first bytes.

# Endings of names, by what the files hold.
_MESSAGES = (".mcap", ".bag", ".db3", ".mcap.zstd", ".db3.zstd", ".mcap.zst", ".bag.gz", ".mcap.gz")
_VIDEOS = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mts", ".m2ts", ".wmv", ".mjpeg")
_EXPORTED = (".c3d", ".trc", ".csv", ".tsv", ".trk", ".sto", ".mot")
_LOG_ENDINGS = (*_MESSAGES, *_VIDEOS, *_EXPORTED)  # a log, be it damaged
# Endings of what may be one.
_PERHAPS = (
    *(".txt", ".dat", ".log", ".npy", ".npz", ".mat", ".parquet", ".jsonl", ".xlsx", ".ods"),
    *(".zip", ".gz", ".zst", ".bz2", ".xml", ""),
)

_OWN = ("ledger.parquet", "ledger.csv")  # files that tuning many logs writes


def is_log_name(name: str) -> bool:
    """Return whether a file is a log by its name alone."""
    return name.lower().endswith(_LOG_ENDINGS) and name.lower() not in _OWN


def may_be_log(path: Path) -> bool:
    """Return whether a file in a folder of many is meant as a log."""
    if is_log_name(path.name):
        return path.is_file()
    if path.suffix.lower() not in _PERHAPS or path.name in _OWN or not path.is_file():
        return False
    try:
        with open_regular(path) as file:
            is_empty = not file.read(1)
        return not is_empty and is_known(path)
    except (LogError, OSError):
        return False


def is_log_folder(path: Path) -> bool:
    """Return whether a folder is one log: a bag, or an image sequence."""
    try:
        return is_bag_folder(path) or is_picture_folder(path)
    except OSError:
        return False
