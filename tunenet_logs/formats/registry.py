"""Registry of the files that are read; a new format is a reader, and one row of a table here.

`open_log` opens all: message files by their first bytes (`MESSAGES`), as names are unreliable, also
when compressed as a whole; folders of a ROS 2 bag; then `EXPORTS`, tables and videos. What is not
read is named with a remedy (`kinds`). `may_be_log` says what is a log among many files.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tunenet_logs.audio import is_sound_alone, named_as_sound, read_sound
from tunenet_logs.episode import Episode
from tunenet_logs.errors import CHECK_DISK, COPY_AGAIN, LogError
from tunenet_logs.formats import mcap, rosbag1, rosbag2
from tunenet_logs.formats.base import Budget, Container, Loss, RawMetadata, Record, Topics
from tunenet_logs.formats.columns.cells import SUFFIXES, has_rows
from tunenet_logs.formats.compressed import (
    COMPRESSIONS,
    MAX_FOREIGN_BYTES,
    compression_of,
    unpacked,
    unpacked_start,
)
from tunenet_logs.formats.kinds import Start, foreign_kind, start_of
from tunenet_logs.formats.options import AS_IT_SAYS, ReadOptions
from tunenet_logs.formats.readers import (
    arrays,
    c3d,
    csv,
    libraries,
    mocap,
    parquet,
    pictures,
    sage,
    sheets,
    trackers,
)
from tunenet_logs.messages import INFO_RECORD
from tunenet_logs.video import read_video

_START_BYTES = 16  # that identify a message file or a compression
_KNOWN = "an MCAP log, a bag (.bag, .db3), a table of text, a video or sound"  # what is read


@dataclass(frozen=True)
class Messages:
    """A format of messages: how its files begin and end, and what reads one."""

    magic: bytes
    suffix: str
    read: Container
    in_folder: bool = False  # whether ROS 2 writes a recording as a folder of them


MESSAGES = (
    Messages(mcap.MAGIC, ".mcap", mcap.read_mcap, in_folder=True),
    Messages(rosbag1.MAGIC, ".bag", rosbag1.read_bag),
    Messages(rosbag2.MAGIC, ".db3", rosbag2.read_db3, in_folder=True),
)
# What programs and instruments export, by its first bytes; the first that knows a file reads it.
EXPORTS: tuple[tuple[Callable[[Start], bool], Callable[[Path, ReadOptions], Episode]], ...] = (
    (mocap.is_motive, mocap.read_motive),
    (mocap.is_nexus, mocap.read_nexus),
    (mocap.is_qualisys, mocap.read_qualisys),
    (mocap.is_trc, mocap.read_trc),
    (c3d.is_c3d, c3d.read_c3d),
    (trackers.is_tracker, trackers.read_tracker),
    (trackers.is_imagej, trackers.read_imagej),
    (trackers.is_deeplabcut, trackers.read_deeplabcut),
    (sage.is_sage, sage.read_sage),
    (sheets.is_sensor_runs, sheets.read_sensor_runs),
    (sheets.is_sheets, sheets.read_sheets),
    (parquet.is_parquet, parquet.read_parquet),
    (arrays.is_numpy_file, arrays.read_numpy_file),
    *((one.is_this, one.read) for one in libraries.LIBRARIES),
    (arrays.is_json_lines, arrays.read_json_lines),
    (pictures.is_picture_archive, pictures.read_picture_archive),
)
# Endings of names. Of a log, be it damaged:
_LOG_ENDINGS = (
    *(f"{one.suffix}{end}" for one in MESSAGES for end in ("", ".zstd", ".zst", ".gz")),
    *(".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mts", ".m2ts", ".wmv", ".mjpeg"),
    *(".c3d", ".trc", ".csv", ".tsv", ".trk", ".sto", ".mot"),
)
# Of what may be one:
_PERHAPS = (
    *(".txt", ".dat", ".log", ".npy", ".npz", ".mat", ".parquet", ".jsonl", ".xlsx", ".ods"),
    *(".h5", ".hdf5", ".feather", ".arrow", ".ulg"),
    *(".zip", ".gz", ".zst", ".bz2", ".xml", ""),
)
_OWN = ("ledger.parquet", "ledger.csv")  # files that tuning many logs writes


# ---- Open a log of any kind.


def open_log(path: Path, options: ReadOptions = AS_IT_SAYS) -> Container | Episode:
    """Open a log: return the reader of its messages, or the episode of a file without messages.

    Raises:
        LogError: there is no such file, or its format is not supported.
    """
    try:
        if path.is_dir():
            if sage.is_sage_folder(path):
                return sage.read_sage_folder(path, options)
            if parquet.is_data_set(path):
                return parquet.read_data_set(path, options)
            is_pictures = pictures.is_picture_folder(path)
            return pictures.read_picture_folder(path, options) if is_pictures else read_folder
        if not path.exists():
            raise LogError(f"{path}: no such file", "check its name and folder")
        start = start_of(path).data
        if not start:
            raise LogError(f"{path}: is empty; record it again")
        if container := _message_reader(start):
            return container
        if compression := compression_of(start):
            return _open_packed(path, compression, options)
        return _read_foreign(path, options)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error


def is_folder(path: Path) -> bool:
    """Return whether a log is a folder of files; False where that cannot be determined."""
    try:
        return path.is_dir()
    except OSError:
        return False


def files_of(path: Path) -> list[Path]:
    """List the files of a log, in order; raise OSError."""
    if not path.is_dir():
        return [path]
    if parquet.is_data_set(path):
        return [path / "meta" / "info.json", *parquet.data_set_files(path)]
    return [file for file in sorted(path.iterdir()) if file.is_file()]


def file_bytes(path: Path) -> int:
    """Return the size of a log [bytes], that of all its files for a folder."""
    return sum(file.stat().st_size for file in files_of(path) if file.is_file())


def is_known(path: Path) -> bool:
    """Return whether a file begins as messages, an export or a table do (videos: no)."""
    start = start_of(path)
    if compression := compression_of(start.data):
        return _message_reader(unpacked_start(path, compression, _START_BYTES)) is not None
    is_export = any(is_this(start) for is_this, _ in EXPORTS)
    return _message_reader(start.data) is not None or is_export or has_rows(start.lines)


def is_log_name(name: str) -> bool:
    """Return whether a file is a log by its name alone."""
    return name.lower().endswith(_LOG_ENDINGS) and name.lower() not in _OWN


def may_be_log(path: Path) -> bool:
    """Return whether a file in a folder of many is meant as a log: by name, else by content."""
    if is_log_name(path.name):
        return path.is_file()
    if path.suffix.lower() not in _PERHAPS or path.name in _OWN or not path.is_file():
        return False
    try:
        return bool(start_of(path).data) and is_known(path)
    except (LogError, OSError):
        return False


def is_log_folder(path: Path) -> bool:
    """Return whether a folder is one log: a bag, pictures, a data set, commands beside states."""
    try:
        is_tables = sage.is_sage_folder(path) or parquet.is_data_set(path)
        return is_tables or is_bag_folder(path) or pictures.is_picture_folder(path)
    except OSError:
        return False


def _message_reader(start: bytes) -> Container | None:
    return next((one.read for one in MESSAGES if start.startswith(one.magic)), None)


def _read_foreign(path: Path, options: ReadOptions) -> Episode:
    """Read a file without messages: an export, a table or a video; raise LogError for others."""
    start = start_of(path)
    for is_this, read in EXPORTS:
        if is_this(start):
            return read(path, options)
    kind = foreign_kind(start.data, path)
    if start.is_text:
        if kind:
            raise LogError(f"{path}: is {kind[0]}, which is not read as it is", kind[1])
        is_named = path.suffix.lower() in SUFFIXES
        if not is_named and not options.columns and not has_rows(start.lines):
            raise LogError(
                f"{path}: is not {_KNOWN}: it is text in which no line is a row of numbers",
                "name the log itself, or write a table with a line of names such as t,x,y,z",
            )
        return csv.read_csv(path, options)
    try:
        return read_video(path, options)
    except LogError as error:
        if is_sound_alone(path) or (not kind and named_as_sound(path)):
            return read_sound(path, options)
        if kind:
            what, remedy = kind
            raise LogError(f"{path}: is {what}, which is not read as it is; {remedy}") from error
        why = error.what.removeprefix(f"{path}: ")
        remedy = "convert it to one of these or, if it is one, record or copy it again"
        raise LogError(f"{path}: is not {_KNOWN}: it {why}; {remedy}") from error


def _open_packed(path: Path, compression: str, options: ReadOptions) -> Container | Episode:
    """Open a file that was compressed as a whole: messages are streamed, others read at once."""
    losses: list[Loss] = []
    if _message_reader(unpacked_start(path, compression, _START_BYTES)):
        return read_packed
    budget = Budget(path.stat().st_size)
    with unpacked(path, compression, losses, budget, MAX_FOREIGN_BYTES) as inside:
        try:
            episode = _read_foreign(inside, options)
        except LogError as error:
            raise error.renamed(inside, path) from error
    if episode.open_frames is not None or episode.open_sound is not None:
        kind = "sound" if episode.open_frames is None else "video"
        command = COMPRESSIONS[compression].command
        raise LogError(f"{path}: is a packed {kind}; unpack it first with `{command}`")
    lost = tuple(str(loss) for loss in losses)
    return replace(episode, warnings=(*lost, *episode.warnings), losses=(*lost, *episode.losses))


def read_packed(
    path: Path, losses: list[Loss], topics: Topics = None, budget: Budget | None = None
) -> Iterator[Record]:
    """Yield the records of a message file that was compressed as a whole; see `Container`."""
    compression = compression_of(start_of(path).data)
    if not compression:
        raise LogError(f"{path}: is not compressed in a way that is read", "unpack it first")
    budget = budget or Budget(path.stat().st_size)
    with unpacked(path, compression, losses, budget) as inside:
        read = _message_reader(start_of(inside).data)
        if read is None:
            raise LogError(
                f"{path}: holds no MCAP log and no bag", "unpack it, and name what is in it"
            )
        try:
            yield from read(inside, losses, topics, budget)
        except LogError as error:
            raise error.renamed(inside, path) from error


# ---- Folders of a ROS 2 bag: one recording in one or several files, in numeric order.

_PACKED = ".zstd"  # what rosbag2 puts behind the name of a file that it compresses as a whole
# By ending: how such a file begins, and its reader.
_FOLDER_FILES: dict[str, tuple[bytes, Container]] = {
    one.suffix: (one.magic, one.read) for one in MESSAGES if one.in_folder
}
_FOLDER_FILES |= {
    suffix + _PACKED: (COMPRESSIONS["zstd"].magic, read_packed) for suffix in _FOLDER_FILES
}
_INDEX = "metadata.yaml"  # what rosbag2 writes beside the files when a recording ends
_MAX_PARTS = 10_000  # files of one recording; no part is missed between numbers farther apart
# NAME_NUMBER, without the suffix; as many digits as fit 64 bits.
_NUMBERED = re.compile(r"(.+)_([0-9]{1,18})", re.DOTALL)


def read_folder(
    path: Path, losses: list[Loss], topics: Topics = None, budget: Budget | None = None
) -> Iterator[Record]:
    """Yield the records of a ROS 2 bag's files; a killed one's lack of an index is no matter."""
    files = _files(path)
    if len(files) > 1 and not (path / _INDEX).is_file():
        what = f"no {_INDEX}; {files[0].name} to {files[-1].name} were read as one recording"
        losses.append(Loss(what, harmless=True))
    losses += _missing_parts(files)
    troubles: list[str] = []
    described: set[Path] = set()
    found: list[Loss] = []
    budget = budget or Budget(sum(file.stat().st_size for file in files))
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
        found += [replace(loss, file=file.name) for loss in lost]
        if len(described) > 1:  # our own recordings are one file each
            raise _several(path, files)
    if len(troubles) == len(files):
        raise LogError(f"{path}: no file in it can be read: {troubles[0]}", COPY_AGAIN)
    losses += _without_repeats(found)


def _without_repeats(losses: Iterable[Loss]) -> Iterator[Loss]:
    """Merge equal doubts about several files into one, behind the losses."""
    doubts: dict[str, list[Loss]] = {}
    for loss in losses:
        if loss.harmless:
            doubts.setdefault(loss.what, []).append(loss)
        else:
            yield loss
    for first, *more in doubts.values():
        yield replace(first, file=f"{first.file} and {len(more)} more" if more else first.file)


def is_bag_folder(path: Path) -> bool:
    """Return whether a folder is one recording, and not a folder of several; raise OSError."""
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


def _records(file: Path, losses: list[Loss], topics: Topics, budget: Budget) -> Iterator[Record]:
    """Yield the records of one file; raise LogError where nothing of it can be read."""
    ending = _ending(file)
    magic, read = _FOLDER_FILES[ending]
    start = start_of(file).data
    if not start.startswith(magic):
        what = f"is no {ending} file" if start else "is empty"
        raise LogError(f"{file}: {what}", COPY_AGAIN)
    yield from read(file, losses, topics, budget)


def _files(folder: Path) -> list[Path]:
    """Return the recording's files in order; raise LogError for none, or for several recordings."""
    found = [file for file in folder.iterdir() if file.is_file() and not file.name.startswith(".")]
    names = {file.name for file in found}
    files = [one for one in found if _ending(one)]
    files = [one for one in files if one.suffix != _PACKED or one.stem not in names]  # `zstd -d`
    if not files:
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
    kinds = {(_ending(file), match[1]) for file, match in numbered.items()}
    if len(numbered) < len(files) or len(kinds) > 1:
        raise _several(folder, files)
    return sorted(files, key=lambda file: (int(numbered[file][2]), file.name))


def _ending(file: Path) -> str:
    """Return which of the supported endings a file has; "" for another."""
    return next((ending for ending in _FOLDER_FILES if file.name.endswith(ending)), "")


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
